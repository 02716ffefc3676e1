// Named, validated attributes of a plugin instance.
#pragma once

#include <cmath>
#include <cstddef>
#include <span>
#include <string>

#include <mujoco/mujoco.h>

#include "hydraulics/parameters.h"

namespace leglab::plugin {

using hydraulics::ParameterSpec;

// Stops loading with a message that names plugin, instance and error; does not return.
[[noreturn]] void refuse(const mjModel* m, int instance, const std::string& message);

// Formats a value for messages.
std::string number(double value);

// Text of an attribute; empty if it is absent.
std::string text_attribute(const mjModel* m, int instance, const char* key);

// Converts a unit of a table for an instance on a slide joint; returns it unchanged for any other.
std::string unit_at_joint(const mjModel* m, int instance, const char* unit);

// Reads all attributes of a table into `values`; absent attributes get defaults. Rejects an attribute
// that is missing without a default, is not a finite number, or is out of bounds.
void read_parameters(const mjModel* m, int instance, std::span<const ParameterSpec> specs,
                     double* values);

// Index, among the first `count` elements of a kind, of the element named `text`, else of the element
// named `text` with the prefix and suffix of the instance's name; -1 if neither exists. Attaching a
// model (mjs_attach) adds prefix and suffix to the names of elements but not to names in attributes.
int element_named(const mjModel* m, int instance, mjtObj kind, int count, const std::string& text);

// Index of the element that the attribute `key` names, among the first `count` of a kind; rejects any
// other name.
int element_attribute(const mjModel* m, int instance, const char* key, mjtObj kind, int count);

// Joint that the attribute `joint` names; hinge or slide.
int joint_attribute(const mjModel* m, int instance);

// Rejects a time integrator that does not call `advance` once per evaluation of the forces.
void require_single_stage_integrator(const mjModel* m, int instance);

inline mjtNum* state_of(const mjModel* m, const mjData* d, int instance) {
  return d->plugin_state + m->plugin_stateadr[instance];
}

}  // namespace leglab::plugin

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

// Stops loading with a message that names plugin, instance and what is wrong; does not return.
[[noreturn]] void refuse(const mjModel* m, int instance, const std::string& message);

// A value as messages show it.
std::string number(double value);

// Text of an attribute, empty where it is absent.
std::string text_attribute(const mjModel* m, int instance, const char* key);

// Unit of a parameter of a table at the joint that an instance acts on; that of the table elsewhere.
std::string unit_at_joint(const mjModel* m, int instance, const char* unit);

// Reads all attributes of a table into `values`; defaults where absent. Refuses what is missing
// without a default, is not a finite number, or lies outside its bounds.
void read_parameters(const mjModel* m, int instance, std::span<const ParameterSpec> specs,
                     double* values);

// Element of a kind, one of the first `count`, that an instance means by a name; -1 for none. That is the
// element called so, else the one whose name has the prefix and suffix that the instance's own has:
// attaching a model to another one (mjs_attach) changes names of elements, not those in attributes.
int element_named(const mjModel* m, int instance, mjtObj kind, int count, const std::string& text);

// Element of a kind that an attribute called like the kind names; refuses what names none of the
// first `count`.
int element_attribute(const mjModel* m, int instance, const char* key, mjtObj kind, int count);

// Joint that the attribute `joint` names; hinge or slide.
int joint_attribute(const mjModel* m, int instance);

// Plugin instances need a time integrator that calls `advance` once per evaluation of the forces.
void require_single_stage_integrator(const mjModel* m, int instance);

inline mjtNum* state_of(const mjModel* m, const mjData* d, int instance) {
  return d->plugin_state + m->plugin_stateadr[instance];
}

}  // namespace leglab::plugin

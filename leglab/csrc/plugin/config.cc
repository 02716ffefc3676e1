#include "plugin/config.h"

#include <charconv>
#include <cstdio>
#include <cstring>

namespace leglab::plugin {

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

namespace {

std::string range(const ParameterSpec& spec) {
  return std::string(spec.minimum_allowed ? "[" : "(") + number(spec.minimum) + ", " +
         number(spec.maximum) + "] " + spec.unit;
}

bool parse(const std::string& text, double& value) {
  const std::size_t begin = text.find_first_not_of(" \t\n");
  if (begin == std::string::npos) return false;
  const char* end = text.data() + text.find_last_not_of(" \t\n") + 1;
  const auto result = std::from_chars(text.data() + begin, end, value);
  return result.ec == std::errc() && result.ptr == end && std::isfinite(value);
}

}  // namespace

void refuse(const mjModel* m, int instance, const std::string& message) {
  const mjpPlugin* plugin = mjp_getPluginAtSlot(m->plugin[instance]);
  std::string where = plugin->name;
  const char* name = mj_id2name(m, mjOBJ_PLUGIN, instance);
  if (name && *name) {
    where += std::string(" '") + name + "'";
  } else {
    for (int i = 0; i < m->nu; ++i) {
      const char* actuator = mj_id2name(m, mjOBJ_ACTUATOR, i);
      if (m->actuator_plugin[i] == instance && actuator) where += std::string(" '") + actuator + "'";
    }
    for (int i = 0; i < m->nsensor; ++i) {
      const char* sensor = mj_id2name(m, mjOBJ_SENSOR, i);
      if (m->sensor_plugin[i] == instance && sensor) where += std::string(" '") + sensor + "'";
    }
  }
  mju_error("%s: %s", where.c_str(), message.c_str());
  std::abort();
}

std::string text_attribute(const mjModel* m, int instance, const char* key) {
  const char* text = mj_getPluginConfig(m, instance, key);
  return text ? text : "";
}

void read_parameters(const mjModel* m, int instance, std::span<const ParameterSpec> specs,
                     double* values) {
  for (std::size_t i = 0; i < specs.size(); ++i) {
    const ParameterSpec& spec = specs[i];
    const std::string text = text_attribute(m, instance, spec.name);
    double value = spec.nominal;
    if (text.empty()) {
      if (std::isnan(value)) {
        refuse(m, instance, std::string("attribute '") + spec.name + "' is missing; allowed " + range(spec));
      }
    } else if (!parse(text, value)) {
      refuse(m, instance, std::string("attribute '") + spec.name + "' = '" + text +
                              "' is not a number; allowed " + range(spec));
    }
    const bool above = spec.minimum_allowed ? value >= spec.minimum : value > spec.minimum;
    if (!above || value > spec.maximum) {
      refuse(m, instance, std::string("attribute '") + spec.name + "' = " + number(value) +
                              " is out of range; allowed " + range(spec));
    }
    values[i] = value;
  }
}

std::vector<const char*> attribute_names(std::span<const ParameterSpec> specs,
                                         std::initializer_list<const char*> texts) {
  std::vector<const char*> names(texts);
  for (const ParameterSpec& spec : specs) names.push_back(spec.name);
  return names;
}

int joint_attribute(const mjModel* m, int instance) {
  const std::string name = text_attribute(m, instance, "joint");
  if (name.empty()) refuse(m, instance, "attribute 'joint' is missing; allowed: a hinge or slide joint");
  const int joint = mj_name2id(m, mjOBJ_JOINT, name.c_str());
  if (joint < 0) {
    std::string known;
    for (int i = 0; i < m->njnt; ++i) {
      const char* other = mj_id2name(m, mjOBJ_JOINT, i);
      if (other && *other) known += (known.empty() ? "" : ", ") + std::string(other);
    }
    refuse(m, instance, "attribute 'joint' = '" + name + "' names no joint; allowed: " + known);
  }
  if (m->jnt_type[joint] != mjJNT_HINGE && m->jnt_type[joint] != mjJNT_SLIDE) {
    refuse(m, instance, "attribute 'joint' = '" + name + "' must be a hinge or slide joint");
  }
  return joint;
}

void require_single_stage_integrator(const mjModel* m, int instance) {
  if (m->opt.integrator == mjINT_RK4) {
    refuse(m, instance, "option integrator = 'RK4' cannot serve plugins that carry their own state; "
                        "allowed: Euler, implicit, implicitfast");
  }
}

}  // namespace leglab::plugin

#include "plugin/config.h"

#include <charconv>
#include <cstdio>
#include <cstring>

#include "plugin/tables.h"

namespace leglab::plugin {

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

namespace {

std::string range(const ParameterSpec& spec, const std::string& unit) {
  return std::string(spec.minimum_allowed ? "[" : "(") + number(spec.minimum) + ", " +
         number(spec.maximum) + "] " + unit;
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
    const auto add = [&](mjtObj kind, int count, const int* plugins) {
      for (int i = 0; i < count; ++i) {
        const char* user = mj_id2name(m, kind, i);
        if (plugins[i] == instance && user) where += std::string(" '") + user + "'";
      }
    };
    add(mjOBJ_ACTUATOR, m->nu, m->actuator_plugin);
    add(mjOBJ_SENSOR, m->nsensor, m->sensor_plugin);
  }
  mju_error("%s: %s", where.c_str(), message.c_str());
  std::abort();
}

std::string text_attribute(const mjModel* m, int instance, const char* key) {
  const char* text = mj_getPluginConfig(m, instance, key);
  return text ? text : "";
}

std::string unit_at_joint(const mjModel* m, int instance, const char* unit) {
  const int joint = mj_name2id(m, mjOBJ_JOINT, text_attribute(m, instance, "joint").c_str());
  return joint >= 0 && m->jnt_type[joint] == mjJNT_SLIDE ? unit_at_slide(unit) : unit;
}

void read_parameters(const mjModel* m, int instance, std::span<const ParameterSpec> specs,
                     double* values) {
  for (const ParameterSpec& spec : specs) {
    const auto wrong = [&](const std::string& what) {
      refuse(m, instance, std::string("attribute '") + spec.name + "' " + what + "; allowed " +
                              range(spec, unit_at_joint(m, instance, spec.unit)));
    };
    const std::string text = text_attribute(m, instance, spec.name);
    double value = spec.nominal;
    if (text.empty()) {
      if (std::isnan(value)) wrong("is missing");
    } else if (!parse(text, value)) {
      wrong("= '" + text + "' is not a number");
    }
    const bool above = spec.minimum_allowed ? value >= spec.minimum : value > spec.minimum;
    if (!above || value > spec.maximum) wrong("= " + number(value) + " is out of range");
    *values++ = value;
  }
}

int element_attribute(const mjModel* m, int instance, const char* key, mjtObj kind, int count) {
  const std::string text = text_attribute(m, instance, key);
  const int id = text.empty() ? -1 : mj_name2id(m, kind, text.c_str());
  if (id >= 0) return id;
  std::string known;
  for (int i = 0; i < count; ++i) {
    const char* name = mj_id2name(m, kind, i);
    if (name && *name) known += (known.empty() ? "" : ", ") + std::string(name);
  }
  refuse(m, instance, std::string("attribute '") + key + "' = '" + text + "' names no " + key +
                          "; allowed: " + known);
}

int joint_attribute(const mjModel* m, int instance) {
  const std::string name = text_attribute(m, instance, "joint");
  if (name.empty()) refuse(m, instance, "attribute 'joint' is missing; allowed: a hinge or slide joint");
  const int joint = element_attribute(m, instance, "joint", mjOBJ_JOINT, m->njnt);
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

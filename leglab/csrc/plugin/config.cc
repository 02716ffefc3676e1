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

namespace {

// Name of an instance; if it has none, the name of its actuator or sensor.
std::string owner_name(const mjModel* m, int instance) {
  const auto text = [](const char* name) { return std::string(name ? name : ""); };
  const std::string own = text(mj_id2name(m, mjOBJ_PLUGIN, instance));
  if (!own.empty()) return own;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] == instance) return text(mj_id2name(m, mjOBJ_ACTUATOR, i));
  }
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] == instance) return text(mj_id2name(m, mjOBJ_SENSOR, i));
  }
  return "";
}

}  // namespace

int element_named(const mjModel* m, int instance, mjtObj kind, int count, const std::string& text) {
  if (text.empty()) return -1;
  const int exact = mj_name2id(m, kind, text.c_str());
  if (exact >= 0) return exact;
  const std::string owner = owner_name(m, instance);
  int found = -1;
  std::size_t longest = 0;
  for (int i = 0; i < count; ++i) {
    const char* name = mj_id2name(m, kind, i);
    const std::string whole = name ? name : "";
    const std::size_t at = whole.rfind(text);
    if (at == std::string::npos || whole.size() <= longest) continue;
    const std::string prefix = whole.substr(0, at), suffix = whole.substr(at + text.size());
    if (owner.starts_with(prefix) && owner.ends_with(suffix)) found = i, longest = whole.size();
  }
  return found;
}

std::string unit_at_joint(const mjModel* m, int instance, const char* unit) {
  const int joint =
      element_named(m, instance, mjOBJ_JOINT, m->njnt, text_attribute(m, instance, "joint"));
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
  const int id = element_named(m, instance, kind, count, text);
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

// `element_named` among all elements of a kind, exported for Python tools.
extern "C" __attribute__((visibility("default"))) int leglab_element_named(
    const mjModel* m, int instance, int kind, const char* text) {
  const auto object = static_cast<mjtObj>(kind);
  const int count = object == mjOBJ_JOINT ? m->njnt : object == mjOBJ_PLUGIN ? m->nplugin : m->nactuator;
  return leglab::plugin::element_named(m, instance, object, count, text);
}

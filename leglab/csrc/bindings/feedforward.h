// Adaptive feed-forward and valve maps for Python, beside the bank of identifiers that it lets learn.
#pragma once

#include "bindings/identification_bank.h"
#include "feedforward/controller.h"

namespace leglab::bindings {

namespace ff = feedforward;

using SplineNarxBank64 = Bank<id::SplineNarx<double>, id::SplineNarxSettings<double>, double>;

inline std::vector<double> values(nb::dict parts, const char* name) {
  const auto array = nb::cast<Input>(parts[name]);
  return {array.data(), array.data() + array.size()};
}

// Valve tables of all joints, with the values that they point to.
class ValveTables {
 public:
  explicit ValveTables(nb::dict parts)
      : commands_(values(parts, "commands")), shares_(values(parts, "shares")) {
    const std::vector<double> start = values(parts, "start"), spacing = values(parts, "spacing");
    tables_.resize(start.size());
    for (std::size_t j = 0; j < tables_.size(); ++j) {
      ff::ValveTable& table = tables_[j];
      table.columns = int(shares_.size());
      table.rows = int(commands_.size() / (tables_.size() * shares_.size()));
      table.start = start[j];
      table.spacing = spacing[j];
      table.speed = shares_.data();
      table.commands = commands_.data() + j * std::size_t(table.rows * table.columns);
    }
  }

  ValveTables(const ValveTables&) = delete;
  ValveTables& operator=(const ValveTables&) = delete;

  const std::vector<ff::ValveTable>& tables() const { return tables_; }

 private:
  std::vector<double> commands_, shares_;
  std::vector<ff::ValveTable> tables_;
};

// Commands of calibrated valve maps; beyond their ends those of the ends.
class ValveMaps {
 public:
  explicit ValveMaps(nb::dict parts) : tables_(parts), full_speed_(values(parts, "full_speed")) {}

  void command(Input position, Input velocity, Output out) const {
    const auto& tables = tables_.tables();
    if (position.size() != tables.size() || velocity.size() != tables.size() ||
        out.size() != tables.size()) {
      throw nb::value_error("wrong number of values");
    }
    for (std::size_t j = 0; j < tables.size(); ++j) {
      const double share = std::clamp(velocity.data()[j] / full_speed_[j], -1.0, 1.0);
      out.data()[j] = tables[j].command(position.data()[j], share);
    }
  }

 private:
  ValveTables tables_;
  std::vector<double> full_speed_;
};

// `parts` are the attributes of leglab.control.feedforward.adaptive's `AdaptiveFeedforward` as arrays and
// numbers; the front-end has checked them.
class Feedforward {
 public:
  explicit Feedforward(nb::dict parts)
      : tables_(parts),
        core_({settings(parts), map(parts), window(parts), reference(parts), tables_.tables(),
               values(parts, "learn_lower"), values(parts, "learn_upper"),
               values(parts, "bandwidth")},
              {values(parts, "position_gain"), values(parts, "velocity_gain")}) {}

  Feedforward(const Feedforward&) = delete;
  Feedforward& operator=(const Feedforward&) = delete;

  // The bank must outlive this object: Python keeps it.
  void reset(SplineNarxBank64& bank) {
    std::vector<id::SplineNarx<double>*> learners;
    for (int j = 0; j < bank.joints(); ++j) learners.push_back(&bank.model(j));
    core_.reset(std::move(learners));
  }

  // Rows of `out`: command, feed-forward, feedback, error of the model, whether the calibration
  // stands in. (5, joints)
  void step(double time, Input measured, Input measured_velocity, Input position, Input velocity,
            Input acceleration, Output out) {
    const std::size_t n = tables_.tables().size();
    for (const Input* array : {&measured, &measured_velocity, &position, &velocity, &acceleration}) {
      if (array->size() != n) throw nb::value_error("wrong number of values");
    }
    double* row = out.data();
    core_.step(time, measured.data(), measured_velocity.data(),
               {position.data(), velocity.data(), acceleration.data()},
               {row, row + n, row + 2 * n, row + 3 * n, row + 4 * n});
  }

  void sent(Input command) {
    if (command.size() != tables_.tables().size()) throw nb::value_error("wrong number of values");
    core_.sent(command.data());
  }

 private:
  static double number(nb::dict parts, const char* name) { return nb::cast<double>(parts[name]); }

  static ff::AdaptiveSettings settings(nb::dict parts) {
    ff::AdaptiveSettings out;
    out.period = number(parts, "control_period");
    out.interval = nb::cast<int>(parts["interval"]);
    out.stop_time = number(parts, "stop_time");
    out.limit = number(parts, "limit");
    out.rate_limit = number(parts, "rate_limit");
    out.least_speed = number(parts, "least_speed");
    out.saturation = number(parts, "saturation");
    out.acceleration = number(parts, "greatest_acceleration");
    out.forward = nb::cast<bool>(parts["forward"]);
    out.supervised = nb::cast<bool>(parts["supervised"]);
    out.trust_time = number(parts, "trust_time");
    out.margin = number(parts, "margin");
    out.noise = number(parts, "noise");
    return out;
  }

  static int joints(nb::dict parts) { return int(values(parts, "full_speed").size()); }

  static ff::InverseMap map(nb::dict parts) {
    ff::MotionScale scale;
    scale.centre = values(parts, "centre");
    scale.half_range = values(parts, "half_range");
    scale.speed = values(parts, "full_speed");
    scale.acceleration = number(parts, "acceleration");
    scale.jerk = number(parts, "jerk");
    return {std::move(scale), nb::cast<bool>(parts["products"])};
  }

  static ff::SmoothingWindow window(nb::dict parts) {
    return {joints(parts), values(parts, "kernel")};
  }

  static ff::ReferenceMotion reference(nb::dict parts) {
    return {joints(parts), number(parts, "control_period"), number(parts, "lead"),
            number(parts, "position_delay"), number(parts, "velocity_delay")};
  }

  ValveTables tables_;  // the core's point into them
  ff::Controller core_;
};

inline void bind_feedforward(nb::module_& module) {
  nb::class_<Feedforward>(module, "Feedforward")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("reset", &Feedforward::reset, nb::keep_alive<1, 2>())
      .def("step", &Feedforward::step)
      .def("sent", &Feedforward::sent);
  nb::class_<ValveMaps>(module, "ValveMaps")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("command", &ValveMaps::command);
}

}  // namespace leglab::bindings

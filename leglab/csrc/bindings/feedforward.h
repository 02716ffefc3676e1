// Adaptive feed-forward and valve maps for Python, beside the bank of identifiers that it lets learn.
#pragma once

#include "bindings/identification_bank.h"
#include "feedforward/adaptive.h"

namespace leglab::bindings {

namespace ff = feedforward;

using SplineNarxBank64 = Bank<id::SplineNarx<double>, id::SplineNarxSettings<double>, double>;

using Numbers = std::vector<double>;

// Valve tables of all joints, with the values that they point to.
class ValveTables {
 public:
  explicit ValveTables(const nb::dict& parts)
      : commands_(get<Numbers>(parts, "command")), shares_(get<Numbers>(parts, "share")) {
    const Numbers start = get<Numbers>(parts, "start"), spacing = get<Numbers>(parts, "spacing");
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
  int joints() const { return int(tables_.size()); }

 private:
  Numbers commands_, shares_;
  std::vector<ff::ValveTable> tables_;
};

// Commands of calibrated valve maps; beyond their ends those of the ends.
class ValveMaps {
 public:
  explicit ValveMaps(const nb::dict& parts) : tables_(parts), full_speed_(get<Numbers>(parts, "full_speed")) {}

  void command(Input position, Input velocity, Output out) const {
    const auto& tables = tables_.tables();
    for (const std::size_t size : {position.size(), velocity.size(), out.size()}) {
      if (size != tables.size()) throw nb::value_error("wrong number of values");
    }
    for (std::size_t j = 0; j < tables.size(); ++j) {
      const double share = std::clamp(velocity.data()[j] / full_speed_[j], -1.0, 1.0);
      out.data()[j] = tables[j].command(position.data()[j], share);
    }
  }

 private:
  ValveTables tables_;
  Numbers full_speed_;
};

inline ff::AdaptiveSettings read_adaptive(const nb::dict& settings) {
  ff::AdaptiveSettings out;
  LEGLAB_READ_4(control_period, interval, stop_time, limit)
  LEGLAB_READ_4(rate_limit, least_speed, saturation, greatest_acceleration)
  LEGLAB_READ_2(forward, supervised)
  LEGLAB_READ_3(trust_time, margin, noise)
  LEGLAB_READ_3(learn_lower, learn_upper, bandwidth)
  LEGLAB_READ_2(position_gain, velocity_gain)
  return out;
}

inline ff::MotionScale read_motion_scale(const nb::dict& settings) {
  ff::MotionScale out;
  LEGLAB_READ_3(centre, half_range, full_speed)
  LEGLAB_READ_2(acceleration, jerk)
  return out;
}

// `parts` are the settings of leglab.control.feedforward.adaptive's `AdaptiveFeedforward`, its valve
// tables and what follows from both, as arrays and numbers by name; the front-end has checked them.
class Feedforward {
 public:
  explicit Feedforward(const nb::dict& parts)
      : tables_(parts),
        core_(read_adaptive(parts), {read_motion_scale(parts), get<bool>(parts, "products")},
              {tables_.joints(), get<Numbers>(parts, "kernel")},
              {tables_.joints(), get<double>(parts, "control_period"), get<double>(parts, "lead"),
               get<double>(parts, "position_delay"), get<double>(parts, "velocity_delay")},
              tables_.tables()) {}

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

  void freeze() { core_.freeze(); }

  void keep(int samples) { core_.keep(samples); }
  int kept() const { return core_.kept(); }

  // Moves the kept samples to the first rows of `out`, (capacity, joints, parameters + 3); returns
  // how many they are.
  int take_kept(Output out) {
    const std::size_t count =
        std::size_t(core_.kept()) * tables_.tables().size() * std::size_t(core_.kept_width());
    if (out.size() < count) throw nb::value_error("too few rows for the kept samples");
    std::copy_n(core_.kept_samples(), count, out.data());
    const int kept = core_.kept();
    core_.drop_kept();
    return kept;
  }

  void sent(Input command) {
    if (command.size() != tables_.tables().size()) throw nb::value_error("wrong number of values");
    core_.sent(command.data());
  }

 private:
  ValveTables tables_;  // the core's point into them
  ff::AdaptiveFeedforward core_;
};

inline void bind_feedforward(nb::module_& module) {
  nb::class_<Feedforward>(module, "Feedforward")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("reset", &Feedforward::reset, nb::keep_alive<1, 2>())
      .def("step", &Feedforward::step)
      .def("sent", &Feedforward::sent)
      .def("keep", &Feedforward::keep)
      .def("kept", &Feedforward::kept)
      .def("take_kept", &Feedforward::take_kept)
      .def("freeze", &Feedforward::freeze);
  nb::class_<ValveMaps>(module, "ValveMaps")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("command", &ValveMaps::command);
}

}  // namespace leglab::bindings

// The adaptive feed-forward for Python, beside the bank of identifiers that it lets learn.
#pragma once

#include "bindings/identification_bank.h"
#include "feedforward/adaptive.h"

namespace leglab::bindings {

namespace ff = feedforward;

using SplineNarxBank64 = Bank<id::SplineNarx<double>, id::SplineNarxSettings<double>, double>;

// `parts` are the attributes of leglab.feedforward.adaptive's `AdaptiveFeedforward` as arrays and
// numbers; the front-end has checked them.
class Feedforward {
 public:
  explicit Feedforward(nb::dict parts)
      : commands_(values(parts, "commands")), speeds_(values(parts, "speeds")),
        core_(settings(parts), map(parts), window(parts), reference(parts), tables(parts),
              values(parts, "learn_lower"), values(parts, "learn_upper"),
              values(parts, "bandwidth")) {}

  Feedforward(const Feedforward&) = delete;
  Feedforward& operator=(const Feedforward&) = delete;

  // The bank must outlive this object: Python keeps it.
  void reset(SplineNarxBank64& bank) {
    std::vector<id::SplineNarx<double>*> learners;
    for (int j = 0; j < bank.joints(); ++j) learners.push_back(&bank.model(j));
    core_.reset(std::move(learners));
  }

  // Rows of `out`: command, position and velocity that the sensors would show. (3, joints)
  void step(double time, Input measured, Input position, Input velocity, Input acceleration,
            Output out) {
    const std::size_t n = measured.size();
    core_.step(time, measured.data(), {position.data(), velocity.data(), acceleration.data()},
               out.data(), out.data() + n, out.data() + 2 * n);
  }
  void sent(Input command) { core_.sent(command.data()); }

  // Rows of `out`: error of the model [share of full speed], whether the calibration stands in.
  void report(Output out) const {
    const auto& error = core_.error();
    std::copy(error.begin(), error.end(), out.data());
    std::copy(core_.fallback().begin(), core_.fallback().end(), out.data() + error.size());
  }

 private:
  static double number(nb::dict parts, const char* name) { return nb::cast<double>(parts[name]); }

  static std::vector<double> values(nb::dict parts, const char* name) {
    const auto array = nb::cast<Input>(parts[name]);
    return {array.data(), array.data() + array.size()};
  }

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

  std::vector<ff::ValveTable> tables(nb::dict parts) const {
    const std::vector<double> start = values(parts, "start"), spacing = values(parts, "spacing");
    std::vector<ff::ValveTable> out(start.size());
    for (std::size_t j = 0; j < out.size(); ++j) {
      out[j].columns = int(speeds_.size());
      out[j].rows = int(commands_.size() / (out.size() * speeds_.size()));
      out[j].start = start[j];
      out[j].spacing = spacing[j];
      out[j].speed = speeds_.data();
      out[j].commands = commands_.data() + j * std::size_t(out[j].rows * out[j].columns);
    }
    return out;
  }

  std::vector<double> commands_, speeds_;  // the tables point into them
  ff::AdaptiveFeedforward core_;
};

inline void bind_feedforward(nb::module_& module) {
  nb::class_<Feedforward>(module, "Feedforward")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("reset", &Feedforward::reset, nb::keep_alive<1, 2>())
      .def("step", &Feedforward::step)
      .def("sent", &Feedforward::sent)
      .def("report", &Feedforward::report);
}

}  // namespace leglab::bindings

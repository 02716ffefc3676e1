// Learned load of a motion, and the valves' inverse (command for a flow) at this load's pressures.
#pragma once

#include <cmath>
#include <vector>

#include "feedforward/motion.h"
#include "feedforward/pressure_valve.h"

namespace leglab::feedforward {

// Measured pressures [Pa]; none if `a` is null.
struct Pressures {
  const double *a = nullptr, *b = nullptr;
  double supply = 0.0;
};

// Feed-forward with data sheets and measured pressures. A load map, learned from the measured load,
// predicts the load of a motion. The valve's equation at the pressures for that load replaces the
// calibrated valve map. The losses of leak paths are further inputs of the map of the excess flow.
template <class Learner>
class PressureCascade {
 public:
  explicit PressureCascade(std::vector<PressureValve> valves)
      : valves_(std::move(valves)), a_(valves_.size()), b_(a_), middle_a_(a_), middle_b_(a_),
        middle_command_(a_) {}

  bool any() const { return !valves_.empty(); }

  // Sets the maps from motion to load.
  void reset(std::vector<Learner*> loads) {
    loads_ = std::move(loads);
    supply_ = 0.0;
  }

  // Stores pressures; keeps the last value if a reading is lost.
  void read(const Pressures& now) {
    const auto keep = [](double value, double& last) {
      if (std::isfinite(value)) last = value;
    };
    for (std::size_t j = 0; j < valves_.size(); ++j) {
      keep(now.a[j], a_[j]);
      keep(now.b[j], b_[j]);
    }
    keep(now.supply, supply_);
  }

  // Flow of a command at the last pressures [share of full speed].
  double share(std::size_t j, double position, double command) const {
    const ChamberPressures now{a_[j], b_[j]};
    return valves_[j].share(valves_[j].at(position, now, supply_), now, command);
  }

  // Adds the last pressures to a window; `middle` computes the pressures in its middle for `learn`.
  void push(SmoothingWindow& window) const { window.push_pressures(a_.data(), b_.data()); }
  void middle(const SmoothingWindow& window) {
    window.middle_pressures(middle_a_.data(), middle_b_.data(), middle_command_.data());
  }

  // Command for the flow that `flow()` returns. `inputs` holds `count` inputs of the motion; the
  // losses of leak paths are appended to it before `flow()` is called.
  template <class Flow>
  double command(std::size_t j, double position, double* inputs, int count, Flow flow) {
    const ChamberPressures now{a_[j], b_[j]};
    const PressureValve::Place at = valves_[j].at(position, now, supply_);
    const ChamberPressures expected = expect(j, at, now, inputs, count);
    return valves_[j].command(at, expected, flow());
  }

  // Updates the load map with the middle of the window; appends the losses of leak paths to
  // `inputs`. Returns the sample's flow at predicted minus measured pressures, which the map of the
  // excess flow learns too, because it is used with predicted pressures.
  double learn(std::size_t j, double position, double* inputs, int count, bool usable) {
    const PressureValve& valve = valves_[j];
    const ChamberPressures measured{middle_a_[j], middle_b_[j]};
    const PressureValve::Place at = valve.at(position, measured, supply_);
    const ChamberPressures expected = expect(j, at, measured, inputs, count);
    const double command = middle_command_[j];
    const double excess = valve.share(at, expected, command) - valve.share(at, measured, command);
    loads_[j]->update(inputs, valve.load(at, measured), usable);
    return excess;
  }

 private:
  // Pressures with the load that the load map predicts and the measured common mode of the
  // chambers. With the measured load, the inverse of the valve would cancel, with a delay, the
  // damping of the oil spring by valve and leakage.
  ChamberPressures expect(std::size_t j, const PressureValve::Place& at,
                          const ChamberPressures& measured, double* inputs, int count) const {
    const double load = loads_[j]->peek(inputs);
    const ChamberPressures expected = valves_[j].with_load(at, measured, load);
    valves_[j].leak(at, expected, inputs + count);
    return expected;
  }

  std::vector<PressureValve> valves_;  // empty if pressures are not measured
  std::vector<Learner*> loads_;
  std::vector<double> a_, b_;  // last readings [Pa]
  std::vector<double> middle_a_, middle_b_, middle_command_;
  double supply_ = 0.0;
};

}  // namespace leglab::feedforward

// Deviations of valves from their calibrated maps, and the resulting flows and commands.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "feedforward/motion.h"
#include "feedforward/valve_table.h"

namespace leglab::feedforward {

struct ValveSettings {
  double turn = 0.0;         // least change of a command that sets its direction [valve command]
  double state_step = 0.0;   // step of a state for the finite difference of the flow
  double state_time = 0.0;   // time constant of learning a state; of command ranges 10 times it [s]
  double state_doubt = 0.0;  // prior standard deviation of a state over its proposed magnitude
  double state_noise = 0.0;  // noise of flow errors [share of full speed]
};

// State of one worn valve. The command u that gives the flow of the calibrated valve at command x is
//   u = shift + x (1 + more) + dead_band clip(x/w, -1, 1) + play/2 sign(du/dt)
// with the `more` of the sign of x, and w from `knee`. Units: valve command; 1 for `more`.
using ValveShape = std::array<double, 5>;
enum : std::size_t { SHIFT, DEAD_BAND, PLAY, MORE_POSITIVE, MORE_NEGATIVE };

// Valve states of all joints: the state in use and the states that contenders assume. With play the
// spool trails the command by half the play's width (Krasnosel'skii and Pokrovskii 1989); `command`
// inverts play and the other deviations. The magnitude of the state in use is learned from the map's
// errors by least mean squares; the regressor is the part of the flow's sensitivity to the magnitude
// that the map cannot explain. Play and dead band are limited to a quarter of the command's recent
// range, because wider ones pass so little of the command that they fit any motion.
class ValveStates {
 public:
  static constexpr int in_use = -1;  // index of the state in use; proposed states count from 0

  // control_period, sample: control period and time between learned samples [s].
  ValveStates(const ValveSettings& settings, double control_period, double sample,
              const std::vector<ValveTable>& tables)
      : settings_(settings), settle_(std::min(1.0, sample / settings.state_time)),
        leak_(0.1 * control_period / settings.state_time), tables_(tables) {
    last_.resize(tables.size());
    direction_ = power_ = highest_ = lowest_ = last_;
    reset();
  }

  void reset() {
    for (auto* values : {&last_, &direction_, &power_, &highest_, &lowest_}) {
      std::fill(values->begin(), values->end(), 0.0);
    }
    used_ = State{std::vector<ValveShape>(tables_.size())};
    further_ = used_;
    proposed_.clear();
    worn_ = false;
  }

  bool any() const { return worn_ || !proposed_.empty(); }
  bool worn() const { return worn_; }  // whether the state in use differs from the calibration

  ValveShape shape(int place, std::size_t j) const { return limited(state(place).shape[j], j); }

  // Adds a state with one shape per joint, (joints), and returns its index.
  int propose(const ValveShape* shapes, const SmoothingWindow& window) {
    proposed_.emplace_back();
    revise(int(proposed_.size()) - 1, shapes, window);
    return int(proposed_.size()) - 1;
  }

  void revise(int place, const ValveShape* shapes, const SmoothingWindow& window) {
    proposed_[std::size_t(place)].shape.assign(shapes, shapes + tables_.size());
    fill(proposed_[std::size_t(place)], window);
  }

  // Puts a state in use; learning then moves it along its difference from the previous state.
  void settle(int place, const SmoothingWindow& window) {
    if (place != in_use) {
      State& next = proposed_[std::size_t(place)];
      along_.assign(tables_.size(), {});
      prior_.resize(tables_.size());
      worn_ = false;
      for (std::size_t j = 0; j < tables_.size(); ++j) {
        double square = 0.0;
        for (std::size_t k = 0; k < along_[j].size(); ++k) {
          along_[j][k] = next.shape[j][k] - used_.shape[j][k];
          square += along_[j][k] * along_[j][k];
          worn_ |= next.shape[j][k] != 0.0;
        }
        for (double& part : along_[j]) part /= std::sqrt(std::max(square, 1e-300));
        const double noise = settings_.state_noise / settings_.state_doubt;
        prior_[j] = noise * noise / std::max(square, 1e-300);
      }
      used_ = std::move(next);
      std::fill(power_.begin(), power_.end(), 0.0);
      moved_.assign(power_.size(), 0.0);
      further();
      fill(further_, window);
    }
    proposed_.clear();
  }

  // Takes the positions and sent commands of a period; `window` must have taken them before.
  void take(const double* position, const double* sent, SmoothingWindow& window) {
    for (std::size_t j = 0; j < last_.size(); ++j) {
      const double forgotten = leak_ * (highest_[j] - lowest_[j]);
      highest_[j] = std::max(sent[j], highest_[j] - forgotten);
      lowest_[j] = std::min(sent[j], lowest_[j] + forgotten);
    }
    each([&](State& state) {
      pass(state, position, sent);
      window.put_latest(state.flow.data(), state.series);
    });
  }

  // Computes the flows in the window's middle; they are valid until the next call of `take`.
  void middle(const SmoothingWindow& window) {
    each([&](State& state) { window.middle_of(state.series, state.flow.data()); });
  }

  double flow(int place, std::size_t j) const { return state(place).flow[j]; }

  // Derivative of the flow by the magnitude of the state in use, as a finite difference.
  double slope(std::size_t j) const {
    return (further_.flow[j] - used_.flow[j]) / settings_.state_step;
  }

  // Updates a joint's state in use by normalised least mean squares, from an error of the joint's map
  // and the part of `slope` that the map cannot explain. Returns the change of the magnitude.
  double learn(std::size_t j, double error, double slope) {
    power_[j] += settle_ * (slope * slope - power_[j]);
    const double by = -settle_ * (error * slope + prior_[j] * moved_[j]) / (power_[j] + prior_[j]);
    const ValveShape before = used_.shape[j];
    used_.shape[j] = limited(moved(before, along_[j], by), j);
    further();
    double moved_by = 0.0;
    for (std::size_t k = 0; k < before.size(); ++k) {
      moved_by += along_[j][k] * (used_.shape[j][k] - before[k]);
    }
    moved_[j] += moved_by;
    return moved_by;
  }

  // Updates the direction in which the command of a joint moves; call it once per period.
  void turn(std::size_t j, double command) {
    if (std::abs(command - last_[j]) > settings_.turn) {
      direction_[j] = command > last_[j] ? 1.0 : -1.0;
      last_[j] = command;
    }
  }

  // Command to the worn valve that gives the calibrated valve's flow at the command `wanted`.
  double command(int place, std::size_t j, double wanted) const {
    const ValveShape shape = this->shape(place, j);
    return shape[SHIFT] + wanted * gain(shape, wanted) +
           shape[DEAD_BAND] * std::clamp(wanted / knee(shape), -1.0, 1.0) +
           0.5 * shape[PLAY] * direction_[j];
  }

 private:
  struct State {
    std::vector<ValveShape> shape;  // (joints)
    std::vector<double> spool = {}, flow = {}, series = {};
  };

  const State& state(int place) const {
    return place == in_use ? used_ : proposed_[std::size_t(place)];
  }

  template <class Do>
  void each(const Do& act) {
    if (worn_) {
      act(used_);
      act(further_);
    }
    for (State& state : proposed_) act(state);
  }

  static double gain(const ValveShape& shape, double command) {
    return 1.0 + shape[command > 0.0 ? MORE_POSITIVE : MORE_NEGATIVE];
  }

  // Half width w of the ramp through the dead band: at least twice the command change that sets a
  // direction, and four times a negative dead band (worn overlap), so that u(x) increases strictly.
  double knee(const ValveShape& shape) const {
    return std::max(2.0 * settings_.turn, 4.0 * std::abs(std::min(shape[DEAD_BAND], 0.0)));
  }

  // Command at which the calibrated valve gives the flow of the worn valve with its spool at `spool`.
  double calibrated(const ValveShape& shape, double spool) const {
    const double beyond = spool - shape[SHIFT], far = std::abs(beyond);
    const double w = knee(shape), slope = gain(shape, beyond);
    const double edge = slope * w + shape[DEAD_BAND];
    if (far <= edge) return beyond * w / edge;
    return std::copysign((far - shape[DEAD_BAND]) / slope, beyond);
  }

  // Limits each sign's gain to [0.5, 2], the null shift to 0.5, play and dead band to `widest`.
  ValveShape limited(ValveShape shape, std::size_t j) const {
    const double widest = 0.25 * (highest_[j] - lowest_[j]);
    shape[SHIFT] = std::clamp(shape[SHIFT], -0.5, 0.5);
    shape[DEAD_BAND] = std::clamp(shape[DEAD_BAND], -widest, widest);
    shape[PLAY] = std::clamp(shape[PLAY], 0.0, widest);
    shape[MORE_POSITIVE] = std::clamp(shape[MORE_POSITIVE], -0.5, 1.0);
    shape[MORE_NEGATIVE] = std::clamp(shape[MORE_NEGATIVE], -0.5, 1.0);
    return shape;
  }

  static ValveShape moved(ValveShape shape, const ValveShape& along, double by) {
    for (std::size_t k = 0; k < shape.size(); ++k) shape[k] += by * along[k];
    return shape;
  }

  void further() {
    further_ = {used_.shape, std::move(further_.spool), std::move(further_.flow),
                std::move(further_.series)};
    for (std::size_t j = 0; j < along_.size(); ++j) {
      further_.shape[j] = moved(used_.shape[j], along_[j], settings_.state_step);
    }
  }

  // Updates the spools with these commands, and computes their flows.
  void pass(State& state, const double* position, const double* sent) const {
    for (std::size_t j = 0; j < tables_.size(); ++j) {
      const ValveShape shape = limited(state.shape[j], j);
      const double half = 0.5 * shape[PLAY];
      state.spool[j] = std::clamp(state.spool[j], sent[j] - half, sent[j] + half);
      state.flow[j] = tables_[j].share(position[j], calibrated(shape, state.spool[j]));
    }
  }

  // Computes the flows of all samples in the window as if the valves had always been in this state. A
  // spool starts half a play away from the first command, against the command's direction.
  void fill(State& state, const SmoothingWindow& window) const {
    const std::size_t n = tables_.size();
    state.spool.resize(n);
    state.flow.resize(n);
    state.series.resize(window.size());
    const double *first = window.command(0), *last = window.command(2 * window.half());
    for (std::size_t j = 0; j < n; ++j) {
      const double half = 0.5 * limited(state.shape[j], j)[PLAY];
      state.spool[j] = first[j] - std::copysign(half, last[j] - first[j]);
    }
    for (int k = 0; k <= 2 * window.half(); ++k) {
      pass(state, window.position(k), window.command(k));
      window.put_at(k, state.flow.data(), state.series);
    }
  }

  ValveSettings settings_;
  double settle_;  // adaptation gain per sample of a state in use
  double leak_;    // share of a command's recent range that is forgotten per control period
  std::vector<ValveTable> tables_;
  State used_, further_;  // state in use, and that state plus `state_step`
  std::vector<State> proposed_;
  std::vector<ValveShape> along_;  // direction in which a state is learned, unit vector or zero
  std::vector<double> last_, direction_, power_, prior_, moved_;
  std::vector<double> highest_, lowest_;  // range of recent commands
  bool worn_ = false;
};

}  // namespace leglab::feedforward

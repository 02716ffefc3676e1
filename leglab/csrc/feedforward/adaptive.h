// Feed-forward of all joints from a map that is learned online, combined with a PD loop.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "feedforward/contenders.h"
#include "feedforward/inverse_map.h"
#include "feedforward/kept_samples.h"
#include "feedforward/motion.h"
#include "feedforward/pressure_cascade.h"
#include "feedforward/proof.h"
#include "feedforward/supervisor.h"
#include "feedforward/valve_state.h"
#include "feedforward/valve_table.h"
#include "identification/spline_narx.h"

namespace leglab::feedforward {

struct AdaptiveSettings : SupervisorSettings, ProofSettings, ContenderSettings, ValveSettings {
  double control_period = 0.0;  // [s]
  int interval = 1;             // control periods between learned samples
  double stop_time = 0.0;       // end of adaptation [s]
  double limit = 1.0;           // largest feed-forward [valve command]
  double rate_limit = 0.0;      // largest rate of the feed-forward [1/s]
  double least_speed = 0.0;     // share of full speed below which nothing is learned
  double saturation = 1.0;      // windows with a larger command are not learned
  double greatest_acceleration = 0.0;  // largest possible acceleration of a joint [rad/s^2]
  bool forward = false;         // the map predicts the speed by a flow and is solved for the flow
  bool supervised = true;
  std::vector<double> learn_lower, learn_upper;  // range of positions for learning [rad]
  std::vector<double> position_gain, velocity_gain;  // [1/rad], [s/rad], with the valve's sign

  double sample() const { return interval * control_period; }  // time between learned samples [s]
};

struct Reference {
  const double *position, *velocity, *acceleration;  // [rad], [rad/s], [rad/s^2]
};

// Outputs of one control period; arrays with one value per joint.
struct Period {
  double *command, *feedforward, *feedback;
  double* error;     // error of the learned map at its last sample [share of full speed]
  double* fallback;  // 1 if the calibration replaces the learned map
};

// u = feed-forward + PD, where the PD loop compares a measurement with the reference of the same age.
// The map learns the excess flow, due to leakage, compression and load: the valve's flow minus the flow
// for the speed of the motion, as a share of full speed. The calibrated valve map converts flow to
// command and back. So a learned excess of zero gives the command of the calibration alone, and an
// error of the learned map is an error of speed, which the joint integrates.
// With data sheets and measured pressures the valve map is replaced by a `PressureCascade`.
class AdaptiveFeedforward {
 public:
  using Learner = identification::SplineNarx<double>;

  AdaptiveFeedforward(AdaptiveSettings settings, InverseMap map, SmoothingWindow window,
                      ReferenceMotion reference, std::vector<ValveTable> tables,
                      std::vector<PressureValve> valves = {})
      : settings_(std::move(settings)), map_(std::move(map)), window_(std::move(window)),
        reference_(std::move(reference)), tables_(std::move(tables)), cascade_(std::move(valves)),
        supervisor_(settings_, settings_.control_period, map_.speed()),
        contenders_(settings_, settings_.sample(), tables_.size()),
        valves_(settings_, settings_.control_period, settings_.sample(), tables_) {
    const std::size_t n = tables_.size();
    motion_.resize(4 * n);
    feedforward_ = error_ = sent_ = flow_ = last_ = before_last_ = std::vector<double>(n);
    seen_position_ = seen_velocity_ = feedforward_;
  }

  // `load_learners` predict the load of a motion; needed if pressures are measured. `slope_learners`
  // predict a flow's sensitivity to the valve state; needed if `propose` is called with valve states.
  void reset(std::vector<Learner*> learners, std::vector<Learner*> load_learners = {},
             std::vector<Learner*> slope_learners = {}) {
    learners_ = std::move(learners);
    slope_learners_ = std::move(slope_learners);
    cascade_.reset(std::move(load_learners));
    window_.clear();
    reference_.clear();
    for (auto* values : {&feedforward_, &error_, &sent_}) {
      std::fill(values->begin(), values->end(), 0.0);
    }
    supervisor_.clear();
    proofs_ = proofs(learners_);
    contenders_.clear();
    valves_.reset();
    count_ = 0;
    frozen_ = false;
  }

  // Adds a contender: a map that competes with the map in use until `reset` or `settle`. It learns,
  // too, and is weighted by its prior log odds and its errors. error: see `Contenders::add`;
  // shapes: valve states that the contender assumes, (joints); null for the states in use.
  void propose(std::vector<Learner*> learners, double odds, double error,
               const ValveShape* shapes = nullptr) {
    const int place = shapes ? valves_.propose(shapes, window_) : ValveStates::in_use;
    contenders_.add(learners, proofs(learners), odds, error, place);
  }

  // Tests whether data sheets and measured pressures are used.
  bool with_pressures() const { return cascade_.any(); }

  // State of a valve that the map in use assumes.
  ValveShape valve(std::size_t j) const { return valves_.shape(ValveStates::in_use, j); }

  // Excludes all contenders except `contender`; the map in use stays.
  void only(int contender) { contenders_.only(contender); }

  // Restarts a contender whose parameters the caller has set; `shapes` replaces its valve states.
  void revise(int contender, double error, const ValveShape* shapes = nullptr) {
    if (shapes) valves_.revise(contenders_.valves(contender), shapes, window_);
    contenders_.revise(contender, error);
  }

  // Removes all contenders. winner: number, from 1, of the contender copied to the map in use, or 0.
  void settle(int winner) {
    if (winner > 0) proofs_ = contenders_.proofs(winner - 1);
    valves_.settle(winner > 0 ? contenders_.valves(winner - 1) : ValveStates::in_use, window_);
    contenders_.clear();
  }

  // Weights of the maps in the prediction: first the map in use, then each contender.
  const std::vector<double>& shares() const { return contenders_.weight(); }

  // Stops learning until `reset`.
  void freeze() { frozen_ = true; }

  // Keeps at most `samples` learned samples; 0 keeps none. Call it after `reset`.
  void keep(int samples) {
    kept_.keep(samples, int(learners_.size()), learners_.empty() ? 0 : learners_[0]->parameters());
  }

  KeptSamples& kept() { return kept_; }
  const KeptSamples& kept() const { return kept_; }

  // Computes the commands of a control period from the present measurements and reference. If a
  // measurement is missing (NaN), the joint's command is the feed-forward alone.
  void step(double time, const double* measured, const double* measured_velocity,
            const Reference& reference, const Period& out, const Pressures& pressures = {}) {
    if (cascade_.any()) cascade_.read(pressures);
    learn(time, measured);
    reference_.take(reference.position, reference.velocity, reference.acceleration,
                    motion_.data(), seen_position_.data(), seen_velocity_.data());
    map_.take(motion_.data());
    const double most = settings_.rate_limit * settings_.control_period;
    for (int i = 0; i < map_.joints(); ++i) {
      const std::size_t j = std::size_t(i);
      const double share = map_.share(i);
      const ValveTable& table = tables_[j];
      const double learned =
          allowed(cascade_.any() ? wanted_command(i, share)
                                 : table.command(motion_[j], wanted_flow(i, share)));
      const double calibrated = allowed(table.command(motion_[j], share));
      if (settings_.supervised) {
        supervisor_.take(j, measured[j] - seen_position_[j],
                         table.share(motion_[j], learned) - table.share(motion_[j], calibrated));
      }
      double wish = supervisor_.fallback(j) ? calibrated : learned;
      if (count_ > 1) wish = std::clamp(wish, feedforward_[j] - most, feedforward_[j] + most);
      out.feedforward[j] = feedforward_[j] = wish;
      const double proportional = settings_.position_gain[j] * (seen_position_[j] - measured[j]);
      const double derivative =
          settings_.velocity_gain[j] * (seen_velocity_[j] - measured_velocity[j]);
      out.feedback[j] = proportional + derivative;
      const double sum = wish + out.feedback[j], wanted = std::isfinite(sum) ? sum : wish;
      valves_.turn(j, wanted);
      const bool plain = supervisor_.fallback(j) || !contenders_.any();
      out.command[j] = !valves_.any() ? wanted
                       : plain ? valves_.command(ValveStates::in_use, j, wanted)
                               : command(j, share, wanted - learned);
      out.error[j] = error_[j];
      out.fallback[j] = supervisor_.fallback(j) ? 1.0 : 0.0;
    }
    sent(out.command);
  }

  // Sets the command that was sent, if it differs from the result of `step`; clips it to [-1, 1].
  void sent(const double* command) {
    for (std::size_t j = 0; j < sent_.size(); ++j) sent_[j] = std::clamp(command[j], -1.0, 1.0);
  }

 private:
  // Flow for the speed `share`, both as shares of full speed. In the forward model the excess
  // depends weakly on the flow itself, so a few fixed-point iterations find the flow.
  double wanted_flow(int i, double share) {
    double flow = share;
    for (int k = 0; k < (settings_.forward ? 4 : 1); ++k) {
      map_.inputs(i, flow, inputs_);
      flow = share + excess(std::size_t(i));
    }
    return flow;
  }

  // Command for a motion with measured pressures.
  double wanted_command(int i, double share) {
    const std::size_t j = std::size_t(i);
    map_.inputs(i, share, inputs_);
    return cascade_.command(j, motion_[j], inputs_, map_.inputs(),
                            [&] { return share + excess(j); });
  }

  // Predicted excess flow for `inputs_`, as a share of full speed.
  double excess(std::size_t j) {
    const double learned = learners_[j]->peek(inputs_);
    const double own = proofs_[j].used(count_, learners_[j]->regressor(), learned);
    return contenders_.any() ? contenders_.used(j, inputs_, count_, own) : own;
  }

  // Weighted mean of the commands of all maps. A map's command is that for flow `share` plus the
  // predicted excess, plus the feedback `beside`, corrected by the inverse of its valve state.
  double command(std::size_t j, double share, double beside) const {
    const std::vector<double>&weight = contenders_.weight(), &said = contenders_.said();
    const auto sent = [&](int place, double excess) {
      const double wanted = allowed(tables_[j].command(motion_[j], share + excess)) + beside;
      return valves_.command(place, j, wanted);
    };
    double alike = weight[0], excess = alike * said[0], sum = 0.0;
    for (std::size_t k = 1; k < weight.size(); ++k) {
      const int place = contenders_.valves(int(k) - 1);
      if (place == ValveStates::in_use) {
        alike += weight[k];
        excess += weight[k] * said[k];
      } else if (weight[k] > 0.0) {
        sum += weight[k] * sent(place, said[k]);
      }
    }
    return alike > 0.0 ? sum + alike * sent(ValveStates::in_use, excess / alike) : sum;
  }

  // Proofs of all joints. Their delay is one period from request to measurement, and half a window.
  std::vector<Proof> proofs(const std::vector<Learner*>& learners) const {
    std::vector<Proof> out;
    for (const Learner* learner : learners) {
      out.emplace_back(settings_, settings_.sample(), window_.half() + 1, learner->parameters());
    }
    return out;
  }

  double allowed(double command) const {
    return std::clamp(command, -settings_.limit, settings_.limit);
  }

  void learn(double time, const double* position) {
    for (std::size_t j = 0; j < tables_.size(); ++j) {
      flow_[j] = cascade_.any() ? cascade_.share(j, position[j], sent_[j])
                                : tables_[j].share(position[j], sent_[j]);
    }
    if (jumps(position)) window_.clear();
    window_.push(position, flow_.data(), sent_.data());
    valves_.take(position, sent_.data(), window_);
    if (cascade_.any()) cascade_.push(window_);
    ++count_;
    const bool stopped = frozen_ || time >= settings_.stop_time;
    if (count_ % settings_.interval || stopped || !window_.full()) return;
    window_.middle(motion_.data(), flow_.data());
    map_.take(motion_.data());
    if (!(map_.largest_share() >= settings_.least_speed)) return;  // also for NaN
    valves_.middle(window_);
    if (cascade_.any()) cascade_.middle(window_);
    for (int j = 0; j < map_.joints(); ++j) learn_joint(j);
    contenders_.judge();
    kept_.next();
  }

  // Tests whether a reading is impossible after the two previous readings, because an encoder is lost,
  // shifted or failed. The smoothing window would turn the jump into a false motion.
  bool jumps(const double* position) {
    const double h = settings_.control_period, most = settings_.greatest_acceleration * h * h;
    bool found = false;
    for (std::size_t j = 0; j < tables_.size(); ++j) {
      const double bend = position[j] - 2.0 * last_[j] + before_last_[j];
      if (count_ > 1) found |= !(std::abs(bend) <= most);  // also for NaN
      before_last_[j] = last_[j];
      last_[j] = position[j];
    }
    return found;
  }

  void learn_joint(int i) {
    const std::size_t j = std::size_t(i);
    if (valves_.worn()) flow_[j] = valves_.flow(ValveStates::in_use, j);
    map_.inputs(i, settings_.forward ? flow_[j] : map_.share(i), inputs_);
    double excess = flow_[j] - map_.share(i);
    const bool usable = window_.largest_command(i) < settings_.saturation &&
                        motion_[j] > settings_.learn_lower[j] &&
                        motion_[j] < settings_.learn_upper[j];
    if (cascade_.any()) {
      excess += cascade_.learn(j, motion_[j], inputs_, map_.inputs(), usable);
    }
    const auto learned = learners_[j]->state().learned;
    const double predicted = learners_[j]->update(inputs_, excess, usable);
    error_[j] = usable ? excess - predicted : 0.0;
    if (learners_[j]->state().learned > learned) {
      proofs_[j].take(count_, excess, learners_[j]->rls().theta());
    }
    const auto found_with = [&](int valves) {
      const bool same = valves == ValveStates::in_use;
      return same ? excess : excess + valves_.flow(valves, j) - flow_[j];
    };
    contenders_.take(j, inputs_, found_with, usable, error_[j], count_);
    if (valves_.worn()) learn_state(j, usable);
    if (kept_.any()) kept_.put(i, usable ? learners_[j]->regressor() : nullptr, excess, error_[j]);
  }

  // Learns the magnitude of a valve's state. A second map predicts the flow's sensitivity to it by
  // the motion. Only the unpredicted part is used, as the map in use explains the predicted part.
  void learn_state(std::size_t j, bool usable) {
    const double slope = valves_.slope(j);
    Learner& told = *slope_learners_[j];
    const double beyond = slope - told.update(inputs_, slope, usable);
    if (!usable) return;
    const double by = valves_.learn(j, error_[j], beyond);
    double* theta = learners_[j]->rls().theta();
    for (int k = 0; k < learners_[j]->parameters(); ++k) theta[k] += by * told.rls().theta()[k];
  }

  AdaptiveSettings settings_;
  InverseMap map_;
  SmoothingWindow window_;
  ReferenceMotion reference_;
  std::vector<ValveTable> tables_;
  PressureCascade<Learner> cascade_;
  std::vector<Learner*> learners_, slope_learners_;
  std::vector<Proof> proofs_;
  Supervisor supervisor_;
  Contenders<Learner> contenders_;
  ValveStates valves_;
  std::vector<double> motion_, feedforward_, error_, sent_, flow_;
  std::vector<double> last_, before_last_;  // readings [rad]
  std::vector<double> seen_position_, seen_velocity_;  // reference at the time of the measurements
  double inputs_[identification::GuardSettings<double>::max_inputs] = {};
  KeptSamples kept_;
  long count_ = 0;
  bool frozen_ = false;
};

}  // namespace leglab::feedforward

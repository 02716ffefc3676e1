// Feed-forward of all joints from a map learned while the machine moves.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "feedforward/inverse_map.h"
#include "feedforward/motion.h"
#include "feedforward/valve_table.h"
#include "identification/spline_narx.h"

namespace leglab::feedforward {

struct AdaptiveSettings {
  double period = 0.0;          // control period [s]
  int interval = 1;             // periods from one learned sample to the next
  double stop_time = 0.0;       // adaptation stops then [s]
  double limit = 1.0;           // largest feed-forward [valve command]
  double rate_limit = 0.0;      // its fastest change [1/s]
  double least_speed = 0.0;     // share of full speed below which nothing is learned
  double saturation = 1.0;      // a window with a larger command teaches nothing
  bool supervised = true;
  double trust_time = 0.0;      // time constant of the errors that are compared [s]
  double margin = 1.0;          // learned over calibrated RMS at which the calibration takes over
  double noise = 0.0;           // tracking errors below this are no reason to distrust [rad]
};

// The learned part is the flow beyond that of the motion itself, as a share of full speed: what
// leaks, is compressed or is lost to load. The calibrated valve map turns flow into command and
// back, so a model that says zero is the calibration, and an error of the model is an error of
// speed, which is what the joint integrates.
class AdaptiveFeedforward {
 public:
  using Learner = identification::SplineNarx<double>;

  AdaptiveFeedforward(AdaptiveSettings settings, InverseMap map, SmoothingWindow window,
                      ReferenceMotion reference, std::vector<ValveTable> tables,
                      std::vector<double> lower, std::vector<double> upper,
                      std::vector<double> bandwidth)
      : settings_(settings), map_(std::move(map)), window_(std::move(window)),
        reference_(std::move(reference)), tables_(std::move(tables)), lower_(std::move(lower)),
        upper_(std::move(upper)), bandwidth_(std::move(bandwidth)) {
    const std::size_t n = tables_.size();
    motion_.resize(4 * n);
    feedforward_ = error_ = sent_ = flow_ = learned_ = calibrated_ = std::vector<double>(n);
    tracking_.resize(2 * n);
    fallback_.assign(n, 0.0);
  }

  void reset(std::vector<Learner*> learners) {
    learners_ = std::move(learners);
    window_.clear();
    reference_.clear();
    for (auto* values : {&feedforward_, &error_, &sent_, &learned_, &calibrated_, &tracking_,
                         &fallback_}) {
      std::fill(values->begin(), values->end(), 0.0);
    }
    count_ = 0;
  }

  const std::vector<double>& error() const { return error_; }
  const std::vector<double>& fallback() const { return fallback_; }

  // Takes the positions measured now; NaN where there is none.
  void learn(double time, const double* position) {
    for (std::size_t j = 0; j < tables_.size(); ++j) {
      flow_[j] = tables_[j].share(position[j], sent_[j]);
    }
    window_.push(position, flow_.data(), sent_.data());
    ++count_;
    if (count_ % settings_.interval || time >= settings_.stop_time || !window_.full()) return;
    window_.middle(motion_.data(), flow_.data());
    map_.take(motion_.data());
    if (!(map_.largest_share() >= settings_.least_speed)) return;  // also for NaN
    for (int j = 0; j < map_.joints(); ++j) learn_joint(j);
  }

  // Valve commands for a reference of now; seen: the reference as the sensors show it.
  void command(const double* position, const double* velocity, const double* acceleration,
               double* out, double* seen_position, double* seen_velocity) {
    reference_.take(position, velocity, acceleration, motion_.data(), seen_position,
                    seen_velocity);
    map_.take(motion_.data());
    const double step = settings_.rate_limit * settings_.period;
    for (int i = 0; i < map_.joints(); ++i) {
      const std::size_t j = std::size_t(i);
      const double share = map_.share(i);
      double excess = 0.0;
      if (fallback_[j] == 0.0) {
        map_.inputs(i, inputs_);
        excess = learners_[j]->peek(inputs_);
      }
      double wish = tables_[j].command(motion_[j], share + excess);
      wish = std::clamp(wish, -settings_.limit, settings_.limit);
      if (count_ > 1) wish = std::clamp(wish, feedforward_[j] - step, feedforward_[j] + step);
      out[j] = feedforward_[j] = wish;
    }
  }

  // Takes the command that is sent now; values beyond [-1, 1] are clipped.
  void sent(const double* command) {
    for (std::size_t j = 0; j < sent_.size(); ++j) sent_[j] = std::clamp(command[j], -1.0, 1.0);
  }

 private:
  void learn_joint(int i) {
    const std::size_t j = std::size_t(i);
    map_.inputs(i, inputs_);
    const double excess = flow_[j] - map_.share(i);
    const bool usable = window_.largest_command(i) < settings_.saturation &&
                        motion_[j] > lower_[j] && motion_[j] < upper_[j];
    const double predicted = learners_[j]->update(inputs_, excess, usable);
    error_[j] = usable ? excess - predicted : 0.0;
    if (settings_.supervised) supervise(j, error_[j], usable ? excess : 0.0);
  }

  // The tracking error that an error of speed leaves behind is that of the feedback loop, a first
  // order of its crossover frequency. What counts is how far it would have gone with either map.
  void supervise(std::size_t j, double learned, double calibrated) {
    const double h = settings_.interval * settings_.period;
    const double decay = std::exp(-bandwidth_[j] * h);
    const double gain = (1.0 - decay) / bandwidth_[j] * map_.speed()[j];
    double* tracking = tracking_.data() + 2 * j;
    tracking[0] = decay * tracking[0] + gain * learned;
    tracking[1] = decay * tracking[1] + gain * calibrated;
    const double forget = std::min(1.0, h / settings_.trust_time);
    learned_[j] += forget * (tracking[0] * tracking[0] - learned_[j]);
    calibrated_[j] += forget * (tracking[1] * tracking[1] - calibrated_[j]);
    const double margin = settings_.margin * settings_.margin;
    const double noise = settings_.noise * settings_.noise;
    fallback_[j] = learned_[j] > margin * calibrated_[j] + noise ? 1.0 : 0.0;
  }

  AdaptiveSettings settings_;
  InverseMap map_;
  SmoothingWindow window_;
  ReferenceMotion reference_;
  std::vector<ValveTable> tables_;
  std::vector<double> lower_, upper_;  // positions between which something is learned [rad]
  std::vector<double> bandwidth_;      // crossover of the feedback loops [rad/s]
  std::vector<Learner*> learners_;
  std::vector<double> motion_, feedforward_, error_, sent_, flow_, learned_, calibrated_;
  std::vector<double> tracking_;  // by learned and by calibrated map, joint by joint [rad]
  std::vector<double> fallback_;  // 1 where the calibration stands in
  double inputs_[identification::GuardSettings<double>::max_inputs] = {};
  long count_ = 0;
};

}  // namespace leglab::feedforward

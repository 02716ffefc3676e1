// How far what a map has learned lately is used.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace leglab::feedforward {

struct ProofSettings {
  double settle_time = 0.0;    // time constant of the slow map [s]; 0: there is none
  double proof_time = 0.0;     // time constant of the means below [s]
  double proof_horizon = 0.0;  // from one snapshot of what was learned to the next [s]
  double proof_doubt = 0.0;    // squared errors that count as evidence for it, of their mean
  double proof_noise = 0.0;    // predictions that differ by less need no proof [of full speed]
};

// A learner whose gain is open follows its errors within a few samples. Through the machine that is
// a feedback loop, with the delays of window and valve in it: on a soft machine it shakes the joint,
// and the map of the shaking is not that of the reference. So a slow map, the parameters' mean, stands
// beside the learned one. What was learned beyond it is used by the share that held: the least
// squares of the flows found on what snapshots taken a while before had said of them beyond the
// slow map, for the reference. A joint that shakes has reversed by then.
class Proof {
 public:
  // sample: from one learned sample to the next [s]; delay: periods from a prediction to the sample
  // that is held against it.
  Proof(const ProofSettings& settings, double sample, int delay, int parameters)
      : settle_(settings.settle_time > 0.0 ? std::min(1.0, sample / settings.settle_time) : 0.0),
        forget_(std::min(1.0, sample / settings.proof_time)), doubt_(settings.proof_doubt),
        noise_(settings.proof_noise),
        horizon_(std::max(1, int(std::lround(settings.proof_horizon / sample)))),
        slow_(std::size_t(parameters)), recent_(slow_), old_(slow_),
        said_(std::size_t(delay) + 1) {}

  // What is asked of the two maps in this period, by the learner's regressor and its prediction.
  double used(long period, const double* phi, double learned) {
    if (!(settle_ > 0.0)) return learned;
    Said said{0.0, 0.0};
    for (std::size_t k = 0; k < slow_.size(); ++k) {
      said.slow += slow_[k] * phi[k];
      said.beyond += old_[k] * phi[k];
    }
    said_[row(period)] = said;
    // The learned one itself where all of it held, without rounding.
    return share_ < 1.0 ? said.slow + share_ * (learned - said.slow) : learned;
  }

  // Takes the flow found for the motion asked `delay` periods ago, and the parameters after it.
  void take(long period, double found, const double* theta) {
    if (!(settle_ > 0.0)) return;
    const Said said = said_[row(period + 1)];
    const double error = found - said.slow;
    agreed_ += forget_ * (error * said.beyond - agreed_);
    power_ += forget_ * (said.beyond * said.beyond - power_);
    missed_ += forget_ * (error * error - missed_);
    const double prior = noise_ * noise_ + doubt_ * missed_;
    share_ = std::clamp((agreed_ + prior) / (power_ + prior), 0.0, 1.0);
    for (std::size_t k = 0; k < slow_.size(); ++k) slow_[k] += settle_ * (theta[k] - slow_[k]);
    if (++since_ < horizon_) return;
    since_ = 0;
    old_.swap(recent_);
    for (std::size_t k = 0; k < slow_.size(); ++k) recent_[k] = theta[k] - slow_[k];
  }

  // These parameters are known to be right.
  void trust(const double* theta) {
    std::copy_n(theta, slow_.size(), slow_.begin());
    std::fill(recent_.begin(), recent_.end(), 0.0);
    std::fill(old_.begin(), old_.end(), 0.0);
    for (Said& said : said_) said.beyond = 0.0;
    agreed_ = power_ = 0.0;
    share_ = 1.0;
  }

 private:
  struct Said {
    double slow, beyond;  // predictions
  };

  std::size_t row(long period) const { return std::size_t(period) % said_.size(); }

  double settle_, forget_, doubt_, noise_;
  int horizon_;
  std::vector<double> slow_, recent_, old_;  // parameters, and snapshots of those beyond the slow
  std::vector<Said> said_;
  double agreed_ = 0.0, power_ = 0.0, missed_ = 0.0, share_ = 1.0;
  int since_ = 0;
};

}  // namespace leglab::feedforward

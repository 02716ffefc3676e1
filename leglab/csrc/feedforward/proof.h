// How far what a map has learned lately is used.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace leglab::feedforward {

struct ProofSettings {
  double settle = 0.0;  // share by which the slow map moves at a sample; 0: there is none
  double forget = 1.0;  // share by which the means below move at a sample
  int horizon = 1;      // samples from one snapshot of what was learned to the next
  double doubt = 0.0;   // squared errors that count as evidence for what was learned, of their mean
  double noise = 0.0;   // predictions that differ by less need no proof
  int delay = 0;        // periods from a prediction to the sample that is held against it
};

// A learner whose gain is open follows its errors within a few samples. Through the machine that is
// a feedback loop, with the delays of window and valve in it: on a soft machine it shakes the joint,
// and the map of the shaking is not that of the reference. So a slow map, the parameters' mean, stands
// beside the learned one. What was learned beyond it is used by the share that held: the least
// squares of the flows found on what snapshots taken a while before had said of them beyond the
// slow map, for the reference. A joint that shakes has reversed by then.
class Proof {
 public:
  Proof(const ProofSettings& settings, int parameters)
      : settings_(settings), slow_(std::size_t(parameters)), recent_(slow_), old_(slow_),
        said_(std::size_t(settings.delay) + 1) {}

  // What is asked of the two maps in this period, by the learner's regressor and its prediction.
  double used(long period, const double* phi, double learned) {
    if (!(settings_.settle > 0.0)) return learned;
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
    if (!(settings_.settle > 0.0)) return;
    const Said said = said_[row(period + 1)];
    const double error = found - said.slow;
    agreed_ += settings_.forget * (error * said.beyond - agreed_);
    power_ += settings_.forget * (said.beyond * said.beyond - power_);
    missed_ += settings_.forget * (error * error - missed_);
    const double prior = settings_.noise * settings_.noise + settings_.doubt * missed_;
    share_ = std::clamp((agreed_ + prior) / (power_ + prior), 0.0, 1.0);
    for (std::size_t k = 0; k < slow_.size(); ++k) slow_[k] += settings_.settle * (theta[k] - slow_[k]);
    if (++since_ < settings_.horizon) return;
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

  ProofSettings settings_;
  std::vector<double> slow_, recent_, old_;  // parameters, and snapshots of those beyond the slow
  std::vector<Said> said_;
  double agreed_ = 0.0, power_ = 0.0, missed_ = 0.0, share_ = 1.0;
  int since_ = 0;
};

}  // namespace leglab::feedforward

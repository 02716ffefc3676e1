// Share of a map's recently learned change that is used, by how well this change has predicted.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace leglab::feedforward {

struct ProofSettings {
  double settle_time = 0.0;    // time constant of the slow map [s]; 0 for no slow map
  double proof_time = 0.0;     // time constant of the means for the least-squares slope [s]
  double proof_horizon = 0.0;  // time between snapshots of the learned parameters [s]
  double proof_doubt = 0.0;    // weight of the prior share of 1, in mean squared errors
  double proof_noise = 0.0;    // prediction difference up to which the share is near 1 [full speed]
};

// A learner with high gain follows its errors within a few samples. With the machine this closes a
// feedback loop with the delays of window and valve, so that on a compliant machine the joint
// oscillates and the map learns the oscillation. So there is also a slow map, the mean of the
// parameters. The difference of learned and slow map is multiplied by a share: the least-squares
// slope of measured flow minus the slow map's, over that difference as an earlier snapshot predicts
// it. The share is small for an oscillation, because the joint has reversed since the snapshot.
class Proof {
 public:
  // sample: time between learned samples [s]; delay: periods from a prediction to the sample that it
  // is compared with.
  Proof(const ProofSettings& settings, double sample, int delay, int parameters)
      : settle_(settings.settle_time > 0.0 ? std::min(1.0, sample / settings.settle_time) : 0.0),
        forget_(std::min(1.0, sample / settings.proof_time)), doubt_(settings.proof_doubt),
        noise_(settings.proof_noise),
        horizon_(std::max(1, int(std::lround(settings.proof_horizon / sample)))),
        slow_(std::size_t(parameters)), recent_(slow_), old_(slow_),
        said_(std::size_t(delay) + 1) {}

  // Combined prediction of slow and learned map, from the learned map's regressor and output.
  double used(long period, const double* phi, double learned) {
    if (!(settle_ > 0.0)) return learned;
    Said said{0.0, 0.0};
    for (std::size_t k = 0; k < slow_.size(); ++k) {
      said.slow += slow_[k] * phi[k];
      said.beyond += old_[k] * phi[k];
    }
    said_[row(period)] = said;
    // A share of 1 gives the learned prediction itself, without rounding.
    return share_ < 1.0 ? said.slow + share_ * (learned - said.slow) : learned;
  }

  // Takes the flow measured for the motion requested `delay` periods ago, and the updated parameters.
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

  // Makes these parameters the slow map, and gives full weight to changes that are learned next.
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
    double slow, beyond;  // predictions of the slow map, and of learned minus slow map
  };

  std::size_t row(long period) const { return std::size_t(period) % said_.size(); }

  double settle_, forget_, doubt_, noise_;
  int horizon_;
  std::vector<double> slow_, recent_, old_;  // slow parameters; two snapshots of learned minus slow
  std::vector<Said> said_;
  double agreed_ = 0.0, power_ = 0.0, missed_ = 0.0, share_ = 1.0;
  int since_ = 0;
};

}  // namespace leglab::feedforward

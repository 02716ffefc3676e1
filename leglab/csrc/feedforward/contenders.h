// Contenders: maps that assume a change of the machine, learned in parallel with the map in use.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "feedforward/proof.h"

namespace leglab::feedforward {

struct ContenderSettings {
  double contest_time = 0.0;    // time constant of mean squared errors [s]
  double contest_gather = 0.0;  // time constant of the mean logarithm of the errors' ratio [s]
  double contest_errors = 0.0;  // number of independent errors in each of these two averages
  double contest_floor = 0.0;   // squared error of a joint due to noise [square of full speed]
  double contest_window = 0.0;  // ratio of mean squared errors at which a contender is excluded
};

// Bayesian model averaging (Hoeting et al. 1999) of maps that are linear in their parameters. Each map
// predicts every sample before it learns it. r is a contender's mean squared error over the mean
// squared error of the map in use. The contender's prior odds are multiplied by the likelihood ratio of
// errors with unknown variance, r^(-errors/2), with the present r and again with the geometric mean of
// past r. A contender with a large r (Occam's window; Madigan and Raftery 1994) is excluded until
// `revise`, because it also learns and would otherwise return when the motion is easy.
template <class Learner>
class Contenders {
 public:
  // sample: time between learned samples [s].
  Contenders(const ContenderSettings& settings, double sample, std::size_t joints)
      : forget_(std::min(1.0, sample / settings.contest_time)),
        gather_(std::min(1.0, sample / settings.contest_gather)), errors_(settings.contest_errors),
        floor_(settings.contest_floor * double(joints)), window_(settings.contest_window) {}

  // Removes all contenders.
  void clear() {
    others_.clear();
    weight_.assign(1, 1.0);
    error_.assign(1, 0.0);
    sum_.assign(1, 0.0);
    ratio_.assign(1, 0.0);
    said_.assign(1, 0.0);
  }

  bool any() const { return !others_.empty(); }
  const std::vector<double>& weight() const { return weight_; }

  // Adds a contender. odds: log odds; error: past mean squared error of the contender, relative to the
  // error of the map in use; valves: index of the valve state that the contender assumes.
  void add(std::vector<Learner*> learners, std::vector<Proof> proofs, double odds, double error,
           int valves) {
    others_.push_back({std::move(learners), std::move(proofs), odds, valves});
    error_.push_back(error * error_[0]);
    sum_.push_back(0.0);
    ratio_.push_back(0.0);
    weight_.push_back(0.0);
    said_.push_back(0.0);
    trust(int(others_.size()) - 1);
    weigh();
  }

  int valves(int which) const { return others_[std::size_t(which)].valves; }
  const std::vector<Proof>& proofs(int which) const { return others_[std::size_t(which)].proofs; }

  // Excludes all other contenders.
  void only(int which) {
    for (std::size_t k = 0; k < others_.size(); ++k) others_[k].out |= int(k) != which;
    weigh();
  }

  // Restarts a contender whose parameters have changed; `error` as in `add`.
  void revise(int which, double error) {
    const std::size_t k = std::size_t(which) + 1;
    error_[k] = error * error_[0];
    ratio_[k] = 0.0;
    others_[k - 1].out = false;
    trust(which);
    weigh();
  }

  // Weighted prediction of a joint's output by all maps; own: prediction of the map in use.
  double used(std::size_t j, const double* inputs, long period, double own) {
    double sum = weight_[0] * (said_[0] = own);
    for (std::size_t k = 0; k < others_.size(); ++k) {
      if (others_[k].out) continue;
      Learner& learner = *others_[k].learners[j];
      const double predicted = learner.peek(inputs);
      said_[k + 1] = others_[k].proofs[j].used(period, learner.regressor(), predicted);
      sum += weight_[k + 1] * said_[k + 1];
    }
    return sum;
  }

  // Predictions of all maps in the latest call of `used`, the map in use first.
  const std::vector<double>& said() const { return said_; }

  // Takes a joint's sample. own: error of the map in use; found_with(i): output with valve state i.
  template <class Found>
  void take(std::size_t j, const double* inputs, const Found& found_with, bool usable, double own,
            long period) {
    sum_[0] += own * own;
    for (std::size_t k = 0; k < others_.size(); ++k) {
      if (others_[k].out) continue;
      Learner& learner = *others_[k].learners[j];
      const double found = found_with(others_[k].valves);
      const auto learned = learner.state().learned;
      const double error = found - learner.update(inputs, found, usable);
      if (learner.state().learned == learned) continue;
      sum_[k + 1] += error * error;
      others_[k].proofs[j].take(period, found, learner.rls().theta());
    }
  }

  // Updates errors and weights after all joints of a sample have been taken.
  void judge() {
    for (std::size_t k = 0; k < sum_.size(); ++k) {
      error_[k] += forget_ * (sum_[k] - error_[k]);
      sum_[k] = 0.0;
    }
    for (std::size_t k = 1; k < sum_.size(); ++k) {
      ratio_[k] += gather_ * (std::log(ratio(k)) - ratio_[k]);
    }
    weigh();
  }

 private:
  struct Other {
    std::vector<Learner*> learners;
    std::vector<Proof> proofs;
    double odds;
    int valves;
    bool out = false;
  };

  void trust(int which) {
    Other& other = others_[std::size_t(which)];
    for (std::size_t j = 0; j < other.proofs.size(); ++j) {
      other.proofs[j].trust(other.learners[j]->rls().theta());
    }
  }

  double ratio(std::size_t k) const {
    return (error_[k] + floor_) / (error_[0] + floor_);
  }

  void weigh() {
    const auto in = [&](std::size_t k) { return k == 0 || !others_[k - 1].out; };
    double most = weight_[0] = 0.0;
    for (std::size_t k = 1; k < weight_.size(); ++k) {
      others_[k - 1].out |= ratio(k) > window_;
      weight_[k] = others_[k - 1].odds - 0.5 * errors_ * (std::log(ratio(k)) + ratio_[k]);
      if (in(k)) most = std::max(most, weight_[k]);
    }
    double sum = 0.0;
    for (std::size_t k = 0; k < weight_.size(); ++k) {
      sum += weight_[k] = in(k) ? std::exp(weight_[k] - most) : 0.0;
    }
    for (double& weight : weight_) weight /= sum;
  }

  double forget_, gather_, errors_, floor_, window_;
  std::vector<Other> others_;
  // Values of the map in use, then of each contender.
  std::vector<double> weight_, error_, sum_, ratio_, said_;
};

}  // namespace leglab::feedforward

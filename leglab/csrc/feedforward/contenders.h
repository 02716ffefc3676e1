// Maps that a change may have led to, learned beside the one that knows nothing of it.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "feedforward/proof.h"

namespace leglab::feedforward {

struct ContenderSettings {
  double contest_time = 0.0;    // time constant of mean squared errors [s]
  double contest_gather = 0.0;  // the same of the logarithms of their ratios [s]
  double contest_errors = 0.0;  // independent errors that each of both has
  double contest_floor = 0.0;   // squared error of a joint that is noise [square of full speed]
  double contest_window = 0.0;  // mean squared error, over that of the map without, at which one is out
};

// Bayesian model averaging (Hoeting et al. 1999) of maps that are linear in their parameters: each
// predicts every sample before it learns it, and counts by the likelihood of its errors, whose
// variance nobody knows: odds ratio^(-errors/2), with the ratio of mean squared errors to those of
// the map that knows nothing, of now and, as a geometric mean, of what has been. One that predicts
// much worse than that map (Occam's window; Madigan and Raftery 1994) is out for good: it learns as
// well, and would come back where the motion is easy.
template <class Learner>
class Contenders {
 public:
  // sample: from one learned sample to the next [s].
  Contenders(const ContenderSettings& settings, double sample, std::size_t joints)
      : forget_(std::min(1.0, sample / settings.contest_time)),
        gather_(std::min(1.0, sample / settings.contest_gather)), errors_(settings.contest_errors),
        floor_(settings.contest_floor * double(joints)), window_(settings.contest_window) {}

  // Forgets all but the map that knows nothing.
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

  // With log odds, the mean squared error that it would have made until now over that of the map
  // without it, and the place of the state that it takes the valves to have.
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

  // All others are out.
  void only(int which) {
    for (std::size_t k = 0; k < others_.size(); ++k) others_[k].out |= int(k) != which;
    weigh();
  }

  // A contender has other parameters now; `error` as of `add`.
  void revise(int which, double error) {
    const std::size_t k = std::size_t(which) + 1;
    error_[k] = error * error_[0];
    ratio_[k] = 0.0;
    others_[k - 1].out = false;
    trust(which);
    weigh();
  }

  // Prediction of a joint by all, `own` that of the map without a contender.
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

  // The parts of what `used` has returned last, of the map without a contender first.
  const std::vector<double>& said() const { return said_; }

  // A sample of a joint, and the error of the map without a contender. `found_with` valves.
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

  // All joints of a sample have been taken.
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
  // Of the map without a contender, and of each contender.
  std::vector<double> weight_, error_, sum_, ratio_, said_;
};

}  // namespace leglab::feedforward

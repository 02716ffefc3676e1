// The paper's B-spline network with local instantaneous learning (Eqs. 9 to 15).
#pragma once

#include <cstdint>

#include "identification/basis.h"
#include "identification/workspace.h"

namespace leglab::identification {

template <class T>
struct BsnnSettings {
  static constexpr int max_inputs = 8;
  int inputs = 1;
  QuadraticBasis<T> basis[max_inputs];
  T learning_constant[max_inputs] = {};  // eta of Eq. 12, eta_1j of Eq. 15
  T output_learning_constant = T(0);     // eta_2 of Eq. 14
  bool two_layers = false;               // Eq. 13: sum of w2_j NN_j; needed for several inputs
  bool bias = true;                      // b of Eq. 10
  bool saturation = true;                // factor (1 - |w|)

  int padded() const {
    int sum = 0;
    for (int j = 0; j < inputs; ++j) sum += basis[j].padded();
    return sum;
  }
};

template <class T>
class Bsnn {
 public:
  struct Tally {
    std::int64_t clipped;     // inputs outside the knots while learning
    std::int64_t violations;  // steps whose learning constant broke the bound of Eq. 21
    T largest_contraction;    // largest eta N^T (N (1 - |W|)), which Eq. 21 requires to be below 2
    T bias;
    T learning_scale;            // factor on the learning constants; 1 without a gain schedule
  };

  void layout(Workspace& workspace, const BsnnSettings<T>& settings) {
    settings_ = settings;
    weights_ = workspace.take<T>(settings.padded());
    output_weights_ = workspace.take<T>(settings.inputs);
    branch_ = workspace.take<T>(settings.inputs);
    local_ = workspace.take<LocalBasis<T>>(settings.inputs);
    tally_ = workspace.take<Tally>(1);
    if (workspace.measuring()) return;
    for (int j = 0; j < settings.inputs; ++j) output_weights_[j] = T(1);
    tally_->learning_scale = T(1);
  }

  const BsnnSettings<T>& settings() const { return settings_; }
  // Weights of one input, basis[input].count of them.
  T* weights(int input) {
    T* w = weights_;
    for (int j = 0; j < input; ++j) w += settings_.basis[j].padded();
    return w + settings_.basis[input].offset;
  }
  T* output_weights() { return output_weights_; }
  T& bias() { return tally_->bias; }
  const Tally& tally() const { return *tally_; }
  void scale_learning(T factor) { tally_->learning_scale = factor; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const Tally& t = *tally_;
    const bool counts = t.clipped >= 0 && t.violations >= 0;
    const bool numbers = is_finite(t.bias) && is_finite(t.learning_scale) &&
                         t.largest_contraction >= T(0);
    const bool weights = all_finite(weights_, settings_.padded()) &&
                         all_finite(output_weights_, settings_.inputs);
    if (!counts || !numbers || !weights) return "weight or count of the network";
    for (int j = 0; j < settings_.inputs; ++j) {
      const int first = local_[j].first;
      if (first < 0 || first > settings_.basis[j].padded() - 3) return "place of a spline";
    }
    return nullptr;
  }

  // Returns the network output (Eqs. 10 and 13); stores the local basis for adapt().
  T output(const T* u) {
    T sum = settings_.bias ? tally_->bias : T(0);
    const T* w = weights_;
    for (int j = 0; j < settings_.inputs; ++j) {
      local_[j] = settings_.basis[j].evaluate_padded(u[j]);
      branch_[j] = dot(w + local_[j].first, local_[j].value);
      sum += settings_.two_layers ? output_weights_[j] * branch_[j] : branch_[j];
      w += settings_.basis[j].padded();
    }
    return sum;
  }

  // Does one learning step at the input of the last output(); error is target - output.
  void adapt(T error) {
    if (!is_finite(error)) return;
    T contraction = T(0);
    T* w = weights_;
    for (int j = 0; j < settings_.inputs; ++j) {
      const T share = settings_.two_layers ? output_weights_[j] : T(1);
      const T eta = settings_.learning_constant[j] * tally_->learning_scale;
      contraction += share * share * move(w + local_[j].first, local_[j].value, 3, eta, share * error);
      w += settings_.basis[j].padded();
      tally_->clipped += local_[j].clipped;
    }
    if (settings_.two_layers) {
      const T eta = settings_.output_learning_constant * tally_->learning_scale;
      for (int j = 0; j < settings_.inputs; ++j) {
        contraction += move(output_weights_ + j, branch_ + j, 1, eta, error);
      }
    }
    if (settings_.bias) {
      const T one = T(1);
      const T eta = settings_.learning_constant[0] * tally_->learning_scale;
      contraction += move(&tally_->bias, &one, 1, eta, error);
    }
    tally_->violations += !(contraction < T(2));
    tally_->largest_contraction = larger(tally_->largest_contraction, contraction);
  }

 private:
  static T dot(const T* w, const T* value) {
    return w[0] * value[0] + w[1] * value[1] + w[2] * value[2];
  }

  // Applies Eq. 12 (14, 15) to `count` weights; returns their share of Eq. 21's sum, computed with
  // the weights before the step. The factor (1 - |w|) keeps |w| < 1 only while |eta N e| < 1. Otherwise
  // a single outlier could move w outside permanently, so |eta N e| is limited to just below one. |w| is
  // limited to just below one as well, because at |w| = 1 the factor is zero and w could not change.
  T move(T* w, const T* value, int count, T eta, T error) const {
    constexpr T limit = T(1) - T(1) / T(1024), most = T(1) - T(1) / T(1 << 20);
    T sum = T(0);
    for (int i = 0; i < count; ++i) {
      const T pull = eta * value[i], step = pull * error;
      if (settings_.saturation) {
        const T room = T(1) - magnitude(w[i]);
        sum += pull * value[i] * room;
        const T moved = w[i] + (step > limit ? limit : step > -limit ? step : -limit) * room;
        w[i] = moved > most ? most : moved > -most ? moved : -most;
      } else {
        sum += pull * value[i];
        if (is_finite(w[i] + step)) w[i] += step;
      }
    }
    return sum;
  }

  BsnnSettings<T> settings_;
  T* weights_ = nullptr;
  T* output_weights_ = nullptr;
  T* branch_ = nullptr;
  LocalBasis<T>* local_ = nullptr;
  Tally* tally_ = nullptr;
};

}  // namespace leglab::identification

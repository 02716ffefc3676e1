// Output-error stage: simulation of the model and sensitivities of its output to the parameters
// (recursive prediction error method, Ljung and Soderstrom 1983).
#pragma once

#include <cstdint>

#include "identification/features.h"

namespace leglab::identification {

template <class T>
class OutputError {
 public:
  static constexpr T window = T(500);  // samples of the mean square

  struct State {
    std::int64_t resynchronised;
    std::int64_t samples;
    T mean_square;  // mean square of the simulation error, taken before the sample is learned
    bool running;
  };

  void layout(Workspace& workspace, const Structure<T>& structure) {
    depth_ = structure.depth();
    parameters_ = structure.parameters();
    width_ = parameters_ + structure.weights();
    features_.layout(workspace, structure);
    past_ = workspace.take<T>(depth_ + 1);
    slope_ = workspace.take<T>(depth_ + 1);
    psi_ = workspace.take<T>(width_ * (depth_ + 1));
    state_ = workspace.take<State>(1);
  }

  State& state() { return *state_; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid. The
  // simulated values may be anything: a simulation that diverges is restarted.
  const char* fault() const {
    const State& s = *state_;
    const bool sound = s.resynchronised >= 0 && s.samples >= 0 && is_finite(s.mean_square) &&
                       s.mean_square >= T(0) && is_flag(s.running);
    return sound ? features_.fault() : "simulation";
  }

  // Returns sensitivities of the simulated output at this sample: to theta, then to the weights.
  const T* sensitivity() const { return psi_; }

  // Restarts the simulation from the measured past.
  void synchronise(const History<T>& measured) {
    for (int k = 0; k <= depth_; ++k) past_[k] = measured.output[k];
    for (int i = 0; i < width_ * (depth_ + 1); ++i) psi_[i] = T(0);
    state_->running = true;
  }

  // Returns the simulated output at this sample; fills sensitivity():
  // psi(t) = phi(t) + sum_k d y(t) / d y(t - k) psi(t - k).
  T simulate(const History<T>& measured, const T* theta, const T* weights) {
    const History<T> own{measured.depth, past_, measured.inputs};
    features_.template build<true>(own, weights);
    features_.output_slopes(theta, own, slope_);
    for (int k = depth_; k > 0; --k) {
      for (int i = 0; i < width_; ++i) psi_[k * width_ + i] = psi_[(k - 1) * width_ + i];
    }
    for (int i = 0; i < parameters_; ++i) psi_[i] = features_.phi()[i];
    features_.weight_slopes(theta, psi_ + parameters_);
    for (int k = 1; k <= depth_; ++k) {
      if (slope_[k] == T(0)) continue;
      for (int i = 0; i < width_; ++i) psi_[i] += slope_[k] * psi_[k * width_ + i];
    }
    return features_.predict(theta);
  }

  void score(T error) {
    const T squared = error * error;
    if (!is_finite(squared)) return;
    State& s = *state_;
    ++s.samples;
    const T share = larger(T(1) / window, T(1) / static_cast<T>(s.samples));
    s.mean_square += share * (squared - s.mean_square);
  }

  void remember(T y) {
    past_[0] = y;
    push(past_, depth_, y);
  }

 private:
  int depth_ = 0;
  int parameters_ = 0;
  int width_ = 0;
  Features<T> features_;
  T* past_ = nullptr;
  T* slope_ = nullptr;
  T* psi_ = nullptr;  // [lag][parameter]
  State* state_ = nullptr;
};

}  // namespace leglab::identification

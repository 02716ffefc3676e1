// Identifier of a state-space model with static curves. An extended Kalman predictor estimates the
// state; recursive least squares on the predictor's sensitivities estimates the parameters
// (recursive prediction error method, Ljung 1979, "Asymptotic behavior of the extended Kalman
// filter as a parameter estimator").
#pragma once

#include "identification/guard.h"
#include "identification/rls.h"
#include "identification/spline_narx.h"
#include "identification/state_space.h"

namespace leglab::identification {

template <class T>
struct SplineStateSpaceSettings {
  StateStructure<T> structure;
  Scale<T> output;
  Scale<T> input[GuardSettings<T>::max_inputs];
  int delay[GuardSettings<T>::max_inputs] = {};
  RlsSettings<T> rls;
  GuardSettings<T> guard;
  T noise = T(1e-4);          // variance of the output's error (scaled)
  T process_noise = T(0);     // variance added to each state per sample; 0: no disturbances
  bool held = false;          // whether the free run is clamped to the limits below (scaled)
  T lower = T(-1e30);
  T upper = T(1e30);
};

template <class T>
class SplineStateSpace {
 public:
  struct State {
    std::int64_t learned;
    T expected;  // prediction for the sample of the next remember() (scaled)
  };

  void layout(Workspace& workspace, const SplineStateSpaceSettings<T>& settings) {
    settings_ = settings;
    const StateStructure<T>& s = settings.structure;
    parameters_ = s.parameters();
    settings_.guard.inputs = s.inputs;
    deepest_ = 0;
    for (int j = 0; j < s.inputs; ++j) deepest_ = larger(deepest_, settings.delay[j]);
    settings_.guard.memory = deepest_;
    rls_.layout(workspace, parameters_);
    guard_.layout(workspace);
    guard_.configure(settings_.guard);
    model_.layout(workspace, s, parameters_);
    x_ = workspace.take<T>(s.states);
    kept_ = workspace.take<T>((deepest_ + 1) * s.inputs);
    past_ = workspace.take<T>((deepest_ + 1) * s.inputs);
    covariance_ = workspace.take<T>(s.states * s.states);
    product_ = workspace.take<T>(s.states * s.states);
    gain_ = workspace.take<T>(s.states);
    sensitivity_ = workspace.take<T>(s.states * parameters_);
    psi_ = workspace.take<T>(parameters_);
    state_ = workspace.take<State>(1);
    if (workspace.measuring()) return;
    rls_.start(settings_.rls);
    forget_state();
  }

  const SplineStateSpaceSettings<T>& settings() const { return settings_; }
  int parameters() const { return parameters_; }
  int inputs() const { return settings_.structure.inputs; }
  Rls<T>& rls() { return rls_; }
  Guard<T>& guard() { return guard_; }
  const State& state() const { return *state_; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const int n = settings_.structure.states;
    if (state_->learned < 0 || !is_finite(state_->expected)) return "count of samples";
    if (!all_finite(x_, n) || !all_finite(covariance_, n * n)) return "state";
    if (!all_finite(past_, (deepest_ + 1) * inputs())) return "past input";
    if (!all_finite(sensitivity_, n * parameters_)) return "sensitivity";
    if (const char* fault = rls_.fault()) return fault;
    return guard_.fault();
  }

  // Takes the sample (u(t), y(t)); returns the a-priori prediction of y(t).
  T update(const T* input, T y, bool present = true) {
    T u[GuardSettings<T>::max_inputs];
    for (int j = 0; j < inputs(); ++j) u[j] = input[j];
    const Sample verdict = guard_.judge(u, y, present);
    const bool measured = verdict == Sample::learned || verdict == Sample::frozen ||
                          verdict == Sample::recovering || verdict == Sample::saturated;
    if (!measured) lose_state(input, u);
    const T prediction = expect(u);
    const T error = settings_.output.apply(y) - prediction;
    const bool follows = !guard_.state().frozen;
    model_.linearise(rls_.theta());
    if (follows) model_.propagate(rls_.theta(), sensitivity_, psi_);
    // If the measured output is unusable, the state follows the model alone.
    const T variance = advance(error, measured);
    if (follows && measured) {
      for (int i = 0; i < settings_.structure.states; ++i) {
        T* row = sensitivity_ + i * parameters_;
        for (int p = 0; p < parameters_; ++p) row[p] -= gain_[i] * psi_[p];
      }
    }
    if (verdict == Sample::learned) {
      ++state_->learned;
      // The more of an error the state's uncertainty explains, the less it tells of the parameters.
      rls_.update(psi_, error, {}, variance / settings_.noise);
    }
    return settings_.output.undo(prediction);
  }

  // Predicts without learning; remember() then takes the value to be used as y(t). For validation and
  // free run on a copy of the workspace.
  T predict_next(const T* u) {
    const T own = expect(u);
    state_->expected = settings_.held ? clamp(own, settings_.lower, settings_.upper) : own;
    return settings_.output.undo(state_->expected);
  }
  void remember(T y) {
    model_.linearise(rls_.theta());
    advance(settings_.output.apply(y) - state_->expected, true);
  }

  // Predicts the next output for an input without storing it; changes nothing.
  T peek(const T* u) {
    const int count = (deepest_ + 1) * inputs();
    for (int i = 0; i < count; ++i) kept_[i] = past_[i];
    const T prediction = expect(u);
    for (int i = 0; i < count; ++i) past_[i] = kept_[i];
    return settings_.output.undo(prediction);
  }

 private:
  T expect(const T* u) {
    T late[GuardSettings<T>::max_inputs];
    for (int j = 0; j < inputs(); ++j) {
      T* past = past_ + j * (deepest_ + 1);
      push(past, deepest_, settings_.input[j].apply(u[j]));
      late[j] = past[settings_.delay[j]];
    }
    return model_.evaluate(rls_.theta(), x_, late);
  }

  // Makes the state unknown if an input is missing or bad, because another recording may follow.
  void lose_state(const T* input, const T* used) {
    for (int j = 0; j < inputs(); ++j) {
      if (input[j] == used[j]) continue;
      forget_covariance();
      for (int i = 0; i < settings_.structure.states * parameters_; ++i) sensitivity_[i] = T(0);
      return;
    }
  }

  // Advances the state and its covariance from t to t + 1, after `linearise`; returns the variance
  // of the prediction error.
  T advance(T error, bool measured) {
    const int n = settings_.structure.states;
    const T* j = model_.jacobian();
    const T* c = model_.output_slope();
    multiply(j, covariance_, product_, n);  // J P
    T spread = settings_.noise;
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < n; ++k) spread += c[i] * covariance_[i * n + k] * c[k];
    }
    for (int i = 0; i < n; ++i) {
      gain_[i] = T(0);
      for (int k = 0; measured && k < n; ++k) gain_[i] += product_[i * n + k] * c[k] / spread;
    }
    bool sound = true;
    for (int i = 0; i < n; ++i) {
      const T next = measured ? model_.next()[i] + gain_[i] * error : model_.next()[i];
      x_[i] = clamp(next, -settings_.structure.reach, settings_.structure.reach);
      for (int k = 0; k <= i; ++k) {
        T sum = i == k ? settings_.process_noise : T(0);
        for (int l = 0; l < n; ++l) sum += product_[i * n + l] * j[k * n + l];
        sum -= gain_[i] * spread * gain_[k];
        covariance_[i * n + k] = covariance_[k * n + i] = sum;
      }
      sound &= covariance_[i * n + i] >= T(0) && all_finite(covariance_ + i * n, n);
    }
    if (!sound) forget_covariance();
    return spread;
  }

  static void multiply(const T* a, const T* b, T* out, int n) {
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < n; ++k) {
        T sum = T(0);
        for (int l = 0; l < n; ++l) sum += a[i * n + l] * b[l * n + k];
        out[i * n + k] = sum;
      }
    }
  }

  // Resets to an unknown state: zero, with the covariance of its range.
  void forget_state() {
    for (int i = 0; i < settings_.structure.states; ++i) x_[i] = T(0);
    forget_covariance();
  }
  void forget_covariance() {
    const int n = settings_.structure.states;
    for (int i = 0; i < n * n; ++i) covariance_[i] = i % (n + 1) == 0 ? T(1) : T(0);
  }

  SplineStateSpaceSettings<T> settings_;
  int parameters_ = 0;
  int deepest_ = 0;
  Rls<T> rls_;
  Guard<T> guard_;
  StateSpace<T> model_;
  T* x_ = nullptr;
  T* past_ = nullptr;
  T* kept_ = nullptr;
  T* covariance_ = nullptr;
  T* product_ = nullptr;
  T* gain_ = nullptr;
  T* sensitivity_ = nullptr;  // d x(t) / d theta, (states, parameters)
  T* psi_ = nullptr;
  State* state_ = nullptr;
};

}  // namespace leglab::identification

// The deployed identifier: a NARX model, linear in its parameters, of lags, splines of lags and a
// Hammerstein input, learned by recursive least squares and optionally by its simulation error.
#pragma once

#include "identification/guard.h"
#include "identification/output_error.h"
#include "identification/poles.h"
#include "identification/rls.h"

namespace leglab::identification {

// Declared range of a signal, which is scaled to [-1, 1] before all computations.
template <class T>
struct Scale {
  T centre = T(0);
  T half_range = T(1);

  T apply(T x) const { return (x - centre) / half_range; }
  T undo(T x) const { return centre + half_range * x; }
};

template <class T>
struct SplineNarxSettings {
  Structure<T> structure;  // knots in scaled units
  Scale<T> output;
  Scale<T> input[GuardSettings<T>::max_inputs];
  RlsSettings<T> rls;
  GuardSettings<T> guard;
  int output_error_after = 0;       // learned samples until the output-error stage; 0: never
  T resynchronise_above = T(0.5);   // simulation error that restarts the simulation (scaled)
  T pole_limit = T(0);              // largest pole radius of the lags of y; 0: no limit
  bool held = false;  // whether the simulated output is clamped to the limits below (scaled)
  T lower = T(-1e30);
  T upper = T(1e30);
};

template <class T>
class SplineNarx {
 public:
  static constexpr T weight_limit = T(10);

  struct State {
    std::int64_t learned;
    std::int64_t clipped;    // spline evaluations outside their knots while learning
    std::int64_t projected;  // samples after which the poles were moved inside the limit
  };

  void layout(Workspace& workspace, const SplineNarxSettings<T>& settings) {
    settings_ = settings;
    const Structure<T>& structure = settings.structure;
    parameters_ = structure.parameters();
    weight_count_ = structure.weights();
    past_.depth = structure.depth();
    settings_.guard.inputs = structure.inputs;
    settings_.guard.memory = past_.depth;
    rls_.layout(workspace, parameters_);
    guard_.layout(workspace);
    guard_.configure(settings_.guard);
    features_.layout(workspace, structure);
    past_.output = workspace.take<T>(past_.depth + 1);
    past_.inputs = workspace.take<T>((past_.depth + 1) * structure.inputs);
    kept_ = workspace.take<T>((past_.depth + 1) * structure.inputs);
    weights_ = workspace.take<T>(weight_count_);
    weight_slope_ = workspace.take<T>(weight_count_);
    poles_ = workspace.take<T>(4 * past_.depth);
    state_ = workspace.take<State>(1);
    if (settings.output_error_after > 0) simulation_.layout(workspace, structure);
    if (workspace.measuring()) return;
    rls_.start(settings_.rls);
    start_weights();
    // Nothing is learned until samples have replaced the zeros of the empty history, because least
    // squares would keep equations with these zeros for the whole pass.
    guard_.state().dirty = past_.depth;
  }

  const SplineNarxSettings<T>& settings() const { return settings_; }
  int parameters() const { return parameters_; }
  int weight_count() const { return weight_count_; }
  int inputs() const { return settings_.structure.inputs; }
  T* weights() { return weights_; }
  Rls<T>& rls() { return rls_; }
  Guard<T>& guard() { return guard_; }
  const State& state() const { return *state_; }
  // Regressor of the last sample, or of a later peek().
  const T* regressor() const { return features_.phi(); }
  bool refines() const { return settings_.output_error_after > 0; }
  OutputError<T>& simulation() { return simulation_; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const State& s = *state_;
    if (s.learned < 0 || s.clipped < 0 || s.projected < 0) return "count of samples";
    if (!all_finite(past_.output, past_.depth + 1)) return "past output";
    if (!all_finite(past_.inputs, (past_.depth + 1) * inputs())) return "past input";
    if (!all_finite(weights_, weight_count_)) return "weight";
    if (const char* fault = features_.fault()) return fault;
    if (const char* fault = refines() ? simulation_.fault() : nullptr) return fault;
    if (const char* fault = rls_.fault()) return fault;
    return guard_.fault();
  }

  // Takes the sample (u(t), y(t)); returns the a-priori prediction of y(t).
  T update(const T* input, T y, bool present = true) {
    T u[GuardSettings<T>::max_inputs];
    for (int j = 0; j < inputs(); ++j) u[j] = input[j];
    const Sample verdict = guard_.judge(u, y, present);
    const T prediction = expect(u);
    const T measured = settings_.output.apply(y);
    const bool learns = verdict == Sample::learned;
    if (learns) {
      ++state_->learned;
      state_->clipped += features_.clipped();
    }
    T own = measured;  // value that the simulation stores for y(t)
    if (refines() && simulation_.state().running) own = refine(measured, verdict);
    // It also learns if the simulation has just diverged, because a wrong model has to learn.
    if (learns && !(refines() && simulation_.state().running)) {
      learn(features_.phi(), features_.support(), measured - prediction);
    }
    if (learns && settings_.pole_limit > T(0)) project_poles(settings_.pole_limit);
    remember_scaled(measured);
    if (refines()) advance(own);
    return settings_.output.undo(prediction);
  }

  // Predicts without learning; remember() then stores the value to be used as y(t). For validation and
  // free run on a copy of the workspace.
  T predict_next(const T* u) {
    const T own = expect(u);
    const T shown = settings_.held ? clamp(own, settings_.lower, settings_.upper) : own;
    return settings_.output.undo(shown);
  }
  void remember(T y) { remember_scaled(settings_.output.apply(y)); }

  // Predicts the next output for an input without storing it; changes nothing.
  T peek(const T* u) {
    const int count = (past_.depth + 1) * inputs();
    for (int i = 0; i < count; ++i) kept_[i] = past_.inputs[i];
    const T prediction = expect(u);
    for (int i = 0; i < count; ++i) past_.inputs[i] = kept_[i];
    return settings_.output.undo(prediction);
  }

  // Scales the poles of the lags of y into the radius; returns true if they had to move.
  bool project_poles(T radius) {
    T* a = poles_;
    for (int k = 0; k < past_.depth; ++k) a[k] = T(0);
    visit_output_lags([&](int lag, T& theta) { a[lag - 1] -= theta; });
    const T g = pole_contraction(a, past_.depth, radius, poles_ + past_.depth);
    if (g == T(1)) return false;
    visit_output_lags([&](int lag, T& theta) {
      for (int k = 0; k < lag; ++k) theta *= g;
    });
    ++state_->projected;
    return true;
  }

 private:
  T expect(const T* u) {
    const int depth = past_.depth;
    for (int j = 0; j < inputs(); ++j) {
      push(past_.inputs + j * (depth + 1), depth, settings_.input[j].apply(u[j]));
    }
    features_.build(past_, weights_);
    return features_.predict(rls_.theta());
  }

  // Does a Gauss-Newton step on the simulation error and returns the simulated output; if that is
  // not usable, ends the simulation and returns the measured output.
  T refine(T measured, Sample verdict) {
    const T simulated = simulation_.simulate(past_, rls_.theta(), weights_);
    const T error = measured - simulated;
    simulation_.score(error);
    bool usable = magnitude(error) <= settings_.resynchronise_above;  // false for NaN
    const T* psi = simulation_.sensitivity();
    for (int i = 0; i < parameters_; ++i) usable &= is_finite(psi[i]);
    if (!usable) {
      ++simulation_.state().resynchronised;
      simulation_.state().running = false;
      return measured;
    }
    if (verdict != Sample::learned) return simulated;
    rls_.update(psi, error);
    move_weights(psi + parameters_, error);
    return simulated;
  }

  void learn(const T* phi, Support support, T error) {
    if (weight_count_ > 0) features_.weight_slopes(rls_.theta(), weight_slope_);
    // Gathering the nonzero entries pays only if most of the regressor is zero.
    rls_.update(phi, error, support.count * 3 <= parameters_ ? support : Support{});
    move_weights(weight_slope_, error);
  }

  // Does a gradient step along the sensitivity of the output, normalised by its power (NLMS). 0.01,
  // the square of a scaled sensitivity of 0.1, is added to the power to limit the first steps, when
  // theta is zero; of 1, 0.1, 0.01 and 0.001, 0.1 suits a dead zone and u|u| best at mu = 0.1.
  // Weights are limited, because with outliers their product with theta could grow to infinity.
  // Scaled weights need not exceed about one (the identity), as theta contains any gain.
  void move_weights(const T* slope, T error) {
    T* w = weights_;
    for (const Block<T>& block : settings_.structure) {
      const int count = block.weights();
      T power = T(0.01);
      for (int i = 0; i < count; ++i) power += slope[i] * slope[i];
      const T step = block.learning_constant * error / power;
      for (int i = 0; i < count; ++i) {
        const T moved = w[i] + step * slope[i];
        if (is_finite(moved)) w[i] = smaller(larger(moved, -weight_limit), weight_limit);
      }
      w += count;
      slope += count;
    }
  }

  void advance(T own) {
    if (simulation_.state().running) {
      simulation_.remember(own);
    } else if (state_->learned >= settings_.output_error_after) {
      simulation_.synchronise(past_);
    }
  }

  void remember_scaled(T y) {
    past_.output[0] = y;
    push(past_.output, past_.depth, y);
  }

  void start_weights() {
    T* w = weights_;
    for (const Block<T>& block : settings_.structure) {
      for (int i = 0; i < block.weights(); ++i) *w++ = block.basis.greville(i);
    }
  }

  template <class Visitor>
  void visit_output_lags(Visitor visit) {
    T* theta = rls_.theta();
    for (const Block<T>& block : settings_.structure) {
      if (block.feature == Feature::lags && block.signal == 0) {
        for (int k = 0; k < block.lags; ++k) visit(block.lag + k, theta[k]);
      }
      theta += block.count();
    }
  }

  SplineNarxSettings<T> settings_;
  int parameters_ = 0;
  int weight_count_ = 0;
  Rls<T> rls_;
  Guard<T> guard_;
  Features<T> features_;
  OutputError<T> simulation_;
  History<T> past_;
  T* kept_ = nullptr;
  T* weights_ = nullptr;
  T* weight_slope_ = nullptr;
  T* poles_ = nullptr;
  State* state_ = nullptr;
};

}  // namespace leglab::identification

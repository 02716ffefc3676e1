// Recursive least squares with the factors of the gain matrix F, and four kinds of forgetting.
#pragma once

#include <cstdint>

#include "identification/change_detector.h"
#include "identification/ud_factor.h"

namespace leglab::identification {

enum class Forgetting : int {
  none,         // Eq. 8 of the paper: never forgets
  exponential,  // constant factor
  directional,  // forgets only where the regressor excites (Kulhavy 1987)
  variable,     // factor from the error (Fortescue, Kershenbaum and Ydstie 1981)
};

template <class T>
struct RlsSettings {
  T initial_gain = T(1e4);           // F(0) = initial_gain * I
  Forgetting forgetting = Forgetting::none;
  T forgetting_factor = T(1);        // lambda; in variable forgetting the smallest lambda
  T memory = T(400);                 // N_0 of variable forgetting [samples]
  T noise_variance = T(0);           // for variable forgetting; 0: the detector's slow mean
  T gain_bound = T(1e6);             // trace(F) <= gain_bound times the number of parameters
  T restore_gain = T(1e4);           // variance of the prior of theta that is restored
  int restore_interval = 0;          // updates from one restored parameter to the next; 0: never
  ChangeSettings<T> change;
};

template <class T>
class Rls {
 public:
  struct Tally {
    std::int64_t rejected;  // updates refused because they would not have stayed finite
    std::int64_t in_a_row;  // consecutive refused updates
    std::int64_t restarts;  // resets of theta and F after too many refused updates
    T factor;               // forgetting factor of the last update
    T forgotten;            // sum of (1 - forgetting factor) since `visit` was last 0
    std::int64_t until;     // updates until the next parameter is restored
    std::int64_t visit;     // index of the parameter to restore next
  };

  void layout(Workspace& workspace, int parameters) {
    factor_.layout(workspace, parameters);
    detector_.layout(workspace);
    theta_ = workspace.take<T>(parameters);
    step_ = workspace.take<T>(parameters);
    unit_ = workspace.take<T>(parameters);
    restored_ = workspace.take<T>(parameters);
    tally_ = workspace.take<Tally>(1);
  }

  // Call once, after layout on real memory.
  void start(const RlsSettings<T>& settings) {
    settings_ = settings;
    detector_.configure(settings.change);
    factor_.reset(settings.initial_gain);
    tally_->factor = T(1);
    tally_->until = settings.restore_interval;
    watch_ = settings.change.enabled || settings.forgetting == Forgetting::variable;
  }

  int size() const { return factor_.size(); }
  T* theta() { return theta_; }
  UdFactor<T>& gain() { return factor_; }
  const Tally& tally() const { return *tally_; }
  void hold_alarm() { detector_.hold(); }
  const typename ChangeDetector<T>::State& change() const { return detector_.state(); }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const Tally& t = *tally_;
    const bool counts = t.rejected >= 0 && t.in_a_row >= 0 && t.restarts >= 0 && t.until >= 0 &&
                        t.until <= settings_.restore_interval && t.visit >= 0 && t.visit < size();
    const bool numbers = is_finite(t.factor) && is_finite(t.forgotten);
    if (!counts || !numbers || !all_finite(restored_, size())) return "count of least squares";
    if (!all_finite(theta_, size())) return "parameter";
    for (int i = 0; i < size(); ++i) {
      if (unit_[i] != T(0)) return "unit vector";
    }
    if (const char* fault = detector_.fault()) return fault;
    return factor_.fault();
  }

  T predict(const T* phi) const {
    T even = T(0), odd = T(0);
    const int n = size();
    int i = 0;
    for (; i + 1 < n; i += 2) {
      even += theta_[i] * phi[i];
      odd += theta_[i + 1] * phi[i + 1];
    }
    return i < n ? even + odd + theta_[i] * phi[i] : even + odd;
  }

  // Does one update with regressor phi and a-priori error; returns true if a change was detected.
  // `variance` is the noise variance of this sample over the noise variance of other samples.
  bool update(const T* phi, T error, Support support = {}, T variance = T(1)) {
    bool changed = false;
    T power = factor_.project(phi, support);
    const T squared = error * error;
    if (!is_finite(power) || !is_finite(squared)) {
      reject();
      return false;
    }
    if (watch_ && detector_.observe(squared)) {
      changed = true;
      const ChangeSettings<T>& change = settings_.change;
      if (change.action == OnChange::reset) factor_.reset(change.gain);
      else factor_.inflate(change.gain, settings_.gain_bound);
      power = factor_.project(phi, support);
    }
    const T denominator = forget(power, squared, variance);
    const T weight = error / denominator;
    const T* gain = factor_.gain_vector();
    const int n = size();
    T sum = T(0);  // finite only if every term is
    for (int i = 0; i < n; ++i) {
      step_[i] = theta_[i] + gain[i] * weight;
      sum += step_[i];
    }
    if (!is_finite(sum)) {
      reject();
      return changed;
    }
    tally_->in_a_row = 0;
    for (int i = 0; i < n; ++i) theta_[i] = step_[i];
    if (settings_.restore_interval > 0) restore();
    return changed;
  }

 private:
  // Restores the forgotten information of the prior (theta = 0 with variance restore_gain), for one
  // parameter i per call, by an artificial observation theta_i = 0 (Gunnarsson 1996, CDC, 2551). So F
  // stays bounded, and theta returns to the prior in directions without excitation.
  void restore() {
    Tally& tally = *tally_;
    tally.forgotten += T(1) - tally.factor;
    if (--tally.until > 0) return;
    tally.until = settings_.restore_interval;
    const int i = int(tally.visit), n = size();
    const T lost = tally.forgotten - restored_[i];
    restored_[i] = tally.forgotten;
    if (++tally.visit == n) {
      tally.visit = 0;
      for (int k = 0; k < n; ++k) restored_[k] -= tally.forgotten;
      tally.forgotten = T(0);
    }
    if (!(lost > T(0))) return;
    unit_[i] = T(1);
    const T variance = settings_.restore_gain / lost;
    const T power = factor_.project(unit_, Support{&i, 1});
    unit_[i] = T(0);
    factor_.update(variance, T(1), T(1), settings_.gain_bound);
    const T weight = -theta_[i] / (variance + power);
    const T* gain = factor_.gain_vector();
    for (int k = 0; k < n; ++k) theta_[k] += gain[k] * weight;
  }

  // Counts a refused update; resets after too many, because the errors of huge parameters overflow.
  void reject() {
    constexpr std::int64_t patience = 10;
    ++tally_->rejected;
    if (++tally_->in_a_row < patience) return;
    for (int i = 0; i < size(); ++i) theta_[i] = T(0);
    factor_.reset(settings_.initial_gain);
    tally_->in_a_row = 0;
    ++tally_->restarts;
  }

  // Updates F; returns the divisor of the gain F phi.
  T forget(T power, T squared, T variance) {
    const T one = T(1);
    T factor = one;
    switch (settings_.forgetting) {
      case Forgetting::none: break;
      case Forgetting::exponential: factor = settings_.forgetting_factor; break;
      case Forgetting::directional: {
        const T lost = (one - settings_.forgetting_factor) * variance;
        const T beta = settings_.forgetting_factor - lost / power;
        // Without excitation nothing is forgotten, because 1 / power would overflow.
        const bool excited = power > T(1e-12);
        factor_.update(variance, excited ? beta : T(0), one, settings_.gain_bound);
        return variance + power;
      }
      case Forgetting::variable: {
        const T noise = settings_.noise_variance > T(0) ? settings_.noise_variance
                                                        : detector_.state().slow;
        const T information = (one + power) * settings_.memory * noise;
        if (information > T(0)) factor = one - squared / information;
        factor = larger(factor, settings_.forgetting_factor);
        break;
      }
    }
    tally_->factor = factor;
    factor_.update(factor * variance, one, one / factor, settings_.gain_bound);
    return factor * variance + power;
  }

  RlsSettings<T> settings_;
  UdFactor<T> factor_;
  ChangeDetector<T> detector_;
  bool watch_ = false;
  T* theta_ = nullptr;
  T* step_ = nullptr;
  T* unit_ = nullptr;      // a unit vector, zero between uses
  T* restored_ = nullptr;  // `forgotten` when each parameter was last restored
  Tally* tally_ = nullptr;
};

}  // namespace leglab::identification

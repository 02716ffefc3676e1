// Detection of changes of the machine from the squared a-priori error.
#pragma once

#include <cstdint>

#include "identification/scalar.h"
#include "identification/workspace.h"

namespace leglab::identification {

enum class OnChange : int { reset, inflate };

template <class T>
struct ChangeSettings {
  bool enabled = false;
  int fast_window = 20;   // samples of the fast mean
  int slow_window = 500;  // samples of the slow mean
  T ratio = T(3);         // a fast mean above ratio times the slow mean is a change
  int hold_off = 200;     // samples without alarm after an alarm and after the start
  OnChange action = OnChange::reset;
  T gain = T(1e4);        // after a change least squares sets F := gain * I, or F += gain * I
};

// Fast and slow exponential means of the squared error. Until a window is full its mean is the
// plain average, so that no initial value has to be guessed.
template <class T>
class ChangeDetector {
 public:
  struct State {
    T fast, slow;
    std::int64_t samples, last_change, changes;
  };

  void layout(Workspace& workspace) { state_ = workspace.take<State>(1); }

  void configure(const ChangeSettings<T>& settings) { settings_ = settings; }

  // Takes one squared error; returns true if it shows a change. The slow mean before this sample
  // sets the threshold, so that a large error does not raise it.
  bool observe(T squared) {
    State& s = *state_;
    ++s.samples;
    const T count = static_cast<T>(s.samples);
    s.fast += larger(T(1) / static_cast<T>(settings_.fast_window), T(1) / count) *
              (squared - s.fast);
    const bool change = settings_.enabled && s.samples > settings_.hold_off &&
                        s.samples - s.last_change > settings_.hold_off &&
                        s.fast > settings_.ratio * s.slow;
    if (change) {
      s.last_change = s.samples;
      ++s.changes;
    }
    s.slow += larger(T(1) / static_cast<T>(settings_.slow_window), T(1) / count) *
              (squared - s.slow);
    return change;
  }

  // Suppresses alarms for the hold-off after a change of which the caller knows.
  void hold() { state_->last_change = state_->samples; }

  const State& state() const { return *state_; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const State& s = *state_;
    const bool counts = s.samples >= 0 && s.last_change >= 0 && s.last_change <= s.samples &&
                        s.changes >= 0 && s.changes <= s.samples;
    const bool means = is_finite(s.fast) && is_finite(s.slow) && s.fast >= T(0) && s.slow >= T(0);
    return counts && means ? nullptr : "change detector";
  }

 private:
  ChangeSettings<T> settings_;
  State* state_ = nullptr;
};

}  // namespace leglab::identification

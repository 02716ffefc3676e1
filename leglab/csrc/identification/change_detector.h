// Watches the squared a-priori error and says when the machine has changed.
#pragma once

#include <cstdint>

#include "identification/scalar.h"
#include "identification/workspace.h"

namespace leglab::identification {

enum class OnChange : int { reset, inflate };

template <class T>
struct ChangeSettings {
  bool enabled = false;
  int fast_window = 20;   // samples of the quick mean
  int slow_window = 500;  // samples of the slow mean
  T ratio = T(3);         // quick above ratio times slow: a change
  int hold_off = 200;     // samples without a second alarm, also after the start
  OnChange action = OnChange::reset;
  T gain = T(1e4);        // least squares takes F := gain * I, or F += gain * I, on a change
};

// Quick and slow exponential means of the squared error. Until a window is full its mean is the
// plain average, so that no starting value has to be guessed.
template <class T>
class ChangeDetector {
 public:
  struct State {
    T fast, slow;
    std::int64_t samples, last_change, changes;
  };

  void layout(Workspace& workspace) { state_ = workspace.take<State>(1); }

  void configure(const ChangeSettings<T>& settings) { settings_ = settings; }

  // Takes one squared error; true where it shows a change. The slow mean of before this
  // sample is the measure, or a large error would hide itself.
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

  // No alarm for the hold-off from now on: who calls knows of the change.
  void hold() { state_->last_change = state_->samples; }

  const State& state() const { return *state_; }

  // What a state read from outside cannot be; nullptr where it is sound.
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

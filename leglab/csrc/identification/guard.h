// Guard that decides whether a sample may be learned.
#pragma once

#include <cstdint>

#include "identification/scalar.h"
#include "identification/workspace.h"

namespace leglab::identification {

// Outcome of a sample; also the index of its counter.
enum class Sample : int {
  learned,
  frozen,       // good, but adaptation is switched off
  recovering,   // good, but the regressor still holds a bad sample
  dropped,      // marked as missing by the caller
  not_finite,   // NaN or infinite
  implausible,  // outside the plausible range of the signal
  saturated,    // input at or beyond its limits
  stuck,        // output unchanged for stuck_samples although an input moved
  count,
};

template <class T>
struct GuardSettings {
  static constexpr int max_inputs = 40;
  int inputs = 1;
  T output_centre = T(0);
  T output_limit = T(0);  // largest plausible distance of y from its centre; 0: no limit
  T input_centre[max_inputs] = {};
  T input_limit[max_inputs] = {};
  int stuck_samples = 0;  // equal outputs that count as stuck; 0: never
  int memory = 0;         // samples a bad value stays in the regressor
  bool saturates = false;  // whether the limits below apply
  T lower[max_inputs] = {};
  T upper[max_inputs] = {};
};

template <class T>
class Guard {
 public:
  struct State {
    std::int64_t tally[static_cast<int>(Sample::count)];
    std::int64_t unchanged;   // samples since the output last changed
    std::int64_t dirty;       // samples until the regressor holds only good values
    T output;                 // last good output, replaces a bad one
    T input[GuardSettings<T>::max_inputs];
    bool input_moved;         // whether an input changed since the output last changed
    bool frozen;
  };

  void layout(Workspace& workspace) { state_ = workspace.take<State>(1); }

  void configure(const GuardSettings<T>& settings) {
    settings_ = settings;
    // "No limit" is stored as the largest number, so that one comparison rejects NaN and infinity.
    constexpr T any = sizeof(T) == 4 ? T(3.4e38) : T(1.7e308);
    if (!(settings_.output_limit > T(0))) settings_.output_limit = any;
    for (T& limit : settings_.input_limit) limit = limit > T(0) ? limit : any;
  }

  State& state() { return *state_; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const State& s = *state_;
    for (const std::int64_t count : s.tally) {
      if (count < 0) return "count of samples";
    }
    const bool counts = s.unchanged >= 0 && s.dirty >= 0 && s.dirty <= settings_.memory;
    if (!counts || !is_flag(s.input_moved) || !is_flag(s.frozen)) return "count of samples";
    const bool numbers = is_finite(s.output) && all_finite(s.input, settings_.inputs);
    return numbers ? nullptr : "last good sample";
  }

  // Classifies a sample; replaces bad values, which must not enter the history, by the last good ones.
  Sample judge(T* u, T& y, bool present) {
    State& s = *state_;
    Sample verdict = present ? Sample::learned : Sample::dropped;
    for (int j = 0; j < settings_.inputs; ++j) {
      if (!present || !(magnitude(u[j] - settings_.input_centre[j]) <= settings_.input_limit[j])) {
        if (present) verdict = is_finite(u[j]) ? Sample::implausible : Sample::not_finite;
        u[j] = s.input[j];
        continue;
      }
      s.input_moved |= u[j] != s.input[j];
      s.input[j] = u[j];
      if (settings_.saturates && (u[j] <= settings_.lower[j] || u[j] >= settings_.upper[j])) {
        if (verdict == Sample::learned) verdict = Sample::saturated;
        u[j] = u[j] <= settings_.lower[j] ? settings_.lower[j] : settings_.upper[j];
      }
    }
    if (!present || !(magnitude(y - settings_.output_centre) <= settings_.output_limit)) {
      if (present && !is_finite(y)) verdict = Sample::not_finite;
      if (verdict == Sample::learned) verdict = Sample::implausible;
      y = s.output;
    } else {
      if (settings_.stuck_samples > 0) watch(y, verdict);
      s.output = y;
    }
    if (verdict != Sample::learned) {
      s.dirty = settings_.memory;
    } else if (s.dirty > 0) {
      --s.dirty;
      verdict = Sample::recovering;
    } else if (s.frozen) {
      verdict = Sample::frozen;
    }
    ++s.tally[static_cast<int>(verdict)];
    return verdict;
  }

 private:
  void watch(T y, Sample& verdict) {
    State& s = *state_;
    if (y != s.output) {
      s.unchanged = 0;
      s.input_moved = false;
    } else if (++s.unchanged >= settings_.stuck_samples && s.input_moved &&
               verdict == Sample::learned) {
      verdict = Sample::stuck;
    }
  }

  GuardSettings<T> settings_;
  State* state_ = nullptr;
};

}  // namespace leglab::identification

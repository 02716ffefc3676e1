// Notices a change from the samples of a learner, sums them up, and fits the faults of a bank.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "monitor/error_watch.h"
#include "monitor/fault_fit.h"
#include "monitor/moments.h"
#include "monitor/recent_samples.h"

namespace leglab::monitor {

struct MonitorSettings {
  WatchSettings watch;
  double passing = 0.0;      // right after an onset samples do not count [s]
  double independent = 0.0;  // errors that differ independently, in the odds of two faults
  double discrepancy = 0.0;  // share of the error that a right fault leaves
  int blocks = 1;            // that are kept to look back at
  int most_samples = 1;      // in a block
  int most_curves = 1;       // in a bank
  int most_keys = 1;         // faults and elements in a bank
};

// What a bank says of a change.
struct Finding {
  int curve = 0;        // that fits best
  double size = 0.0;    // its size, and the change of size that costs one more
  double spread = 0.0;
  double cost = 0.0;    // weighted sum of squared errors with it and
  double without = 0.0; // without
  double noise = 0.0;   // what it would be of a machine that had not changed
  double chance = 0.0;  // of its fault and element among all
};

// Samples or curves that are taken at once where time does not matter.
constexpr int everything = std::numeric_limits<int>::max();

// Takes blocks of samples. With an alarm it opens a case: samples from the onset on are summed up,
// and `look` asks a bank what happened. Sums and looks are made in pieces as small as there is
// time for, with the same results.
template <class Shift>
class FaultMonitor {
 public:
  FaultMonitor(int joints, int parameters, const MonitorSettings& settings)
      : settings_(settings), watch_(joints, settings.watch),
        recent_(joints, parameters, settings.blocks, settings.most_samples),
        sums_(joints, parameters), seen_(sums_),
        fit_(joints, parameters, settings.most_curves), chances_(std::size_t(settings.most_keys)),
        base_(std::size_t(joints * parameters)), mean_(std::size_t(joints)), used_(mean_),
        weight_(mean_) {}

  // Forgets everything; without alarms for so many samples.
  void reset(double wait) {
    recent_.clear();
    close(wait);
  }

  // Ends the case and begins to learn what errors are normal.
  void close(double wait) {
    open_ = false;
    watch_.start(wait);
  }

  bool open() const { return open_; }
  double onset() const { return onset_; }                     // of the case [s]
  const double* base() const { return base_.data(); }         // map before it, (joints, parameters)
  const double* normal() const { return watch_.normal(); }    // mean square errors, (joints)
  const Moments& sums() const { return sums_; }               // of its samples
  const Moments& seen() const { return seen_; }               // of the look, about the base
  const RecentSamples& recent() const { return recent_; }

  // Blocks before the case's onset are from `recent().begin()` to this one; one at least.
  long first_after() const { return first_after_; }

  // Takes a block (samples, joints, parameters + 3) that ends at `time` [s], of at most
  // `most_samples`, and the map then, (joints, parameters). Returns whether it opens a case.
  bool take(double time, const double* samples, int count, const double* parameters) {
    // What waits is summed up before it is overwritten.
    if (open_ && recent_.end() - waiting_ == recent_.blocks()) sum_block(everything);
    recent_.push(time, samples, count, parameters);
    measure(samples, count);
    const bool alarm = watch_.take(time, mean_.data(), used_.data());
    if (open_) return false;
    if (!alarm) {
      watch_.learn(mean_.data(), used_.data());
      return false;
    }
    open_case();
    return true;
  }

  // Adds so many of the case's samples to its sums that are not there yet; true once all are.
  bool sum(int samples) {
    while (open_ && waiting_ < recent_.end() && samples > 0) samples -= sum_block(samples);
    return !open_ || waiting_ == recent_.end();
  }

  // Begins to fit the curves of a bank to the sums as they are now.
  void begin_look(const FaultCurve<Shift>* curves, int count, int keys) {
    curves_ = curves;
    keys_ = keys;
    seen_ = sums_;
    seen_.take_off(base_.data());
    noise_ = 0.0;
    for (int j = 0; j < seen_.joints(); ++j) {
      const double mean = seen_.power(j) / std::max(seen_.count(j), 1.0);
      const double left = settings_.discrepancy * settings_.discrepancy * mean;
      weight_[std::size_t(j)] = 1.0 / std::max(watch_.normal()[j] + left, 1e-300);
      noise_ += weight_[std::size_t(j)] * seen_.count(j) * watch_.normal()[j];
    }
    fit_.begin(curves, count, seen_, weight_.data());
  }

  // Fits so many curves more; true once all are fitted.
  bool look(int curves) { return fit_.advance(curves); }

  const FaultFit<Shift>& fit() const { return fit_; }            // of the look
  const double* chance() const { return chances_.data(); }       // after `finding`, (keys)
  int keys() const { return keys_; }

  // The result of a look that is done.
  Finding finding() {
    const int best = fit_.best();
    chances(curves_, fit_.curves(), fit_.cost(), settings_.watch.correlation,
            settings_.independent, noise_, chances_.data(), keys_);
    return {best, fit_.size()[best], fit_.spread()[best], fit_.cost()[best], fit_.without(), noise_,
            chances_[std::size_t(curves_[best].key)]};
  }

 private:
  // Mean square errors of a block and the samples in them.
  void measure(const double* row, int count) {
    std::fill(mean_.begin(), mean_.end(), 0.0);
    std::fill(used_.begin(), used_.end(), 0.0);
    const int parameters = sums_.parameters();
    for (int k = 0; k < count; ++k) {
      for (std::size_t j = 0; j < mean_.size(); ++j, row += sums_.width()) {
        mean_[j] += row[parameters + 1] * row[parameters + 1];
        used_[j] += row[parameters + 2];
      }
    }
    for (std::size_t j = 0; j < mean_.size(); ++j) mean_[j] /= std::max(used_[j], 1.0);
  }

  void open_case() {
    onset_ = recent_.onset(watch_.since(), watch_.normal(), settings_.watch.sample_period);
    first_after_ = recent_.begin();
    while (first_after_ < recent_.end() && recent_.block(first_after_).time <= onset_) {
      ++first_after_;
    }
    first_after_ = std::max(first_after_, recent_.begin() + 1);
    std::copy_n(recent_.parameters(first_after_ - 1), base_.size(), base_.begin());
    sums_.clear();
    open_ = true;
    waiting_ = recent_.begin();
    waiting_sample_ = 0;
  }

  // Adds up to `most` samples of the block that waits; returns their number, those left out not
  // counted.
  int sum_block(int most) {
    const RecentSamples::Block& block = recent_.block(waiting_);
    const double period = settings_.watch.sample_period;
    while (waiting_sample_ < block.count &&
           !(block.time - period * (block.count - 1 - waiting_sample_) >=
             onset_ + settings_.passing)) {
      ++waiting_sample_;
    }
    const int number = std::min(block.count - waiting_sample_, most);
    const int row = sums_.joints() * sums_.width();
    sums_.add(recent_.samples(waiting_) + waiting_sample_ * row, number);
    waiting_sample_ += number;
    if (waiting_sample_ == block.count) {
      ++waiting_;
      waiting_sample_ = 0;
    }
    return number;
  }

  MonitorSettings settings_;
  ErrorWatch watch_;
  RecentSamples recent_;
  Moments sums_, seen_;
  FaultFit<Shift> fit_;
  const FaultCurve<Shift>* curves_ = nullptr;
  int keys_ = 0;
  std::vector<double> chances_, base_, mean_, used_, weight_;
  bool open_ = false;
  double onset_ = 0.0, noise_ = 0.0;
  long first_after_ = 0, waiting_ = 0;  // blocks; the next one to be summed up
  int waiting_sample_ = 0;              // and its next sample
};

}  // namespace leglab::monitor

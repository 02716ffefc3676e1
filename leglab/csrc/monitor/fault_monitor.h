// Detection of a change from a learner's samples, and moments (sums of products) of later samples.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "monitor/error_watch.h"
#include "monitor/moments.h"
#include "monitor/recent_samples.h"

namespace leglab::monitor {

struct MonitorSettings : WatchSettings {
  double passing = 0.0;  // time after an onset during which samples are skipped [s]
  int blocks = 1;        // number of recent blocks that are kept
  int most_samples = 1;  // largest number of samples in a block
};

// Number of samples that stands for no limit.
constexpr int everything = std::numeric_limits<int>::max();

// Watch over blocks of samples. An alarm starts the examination of a suspected change (a "case"): `sum`
// accumulates moments of the samples after the onset, with the same result for any number of calls.
class FaultMonitor {
 public:
  FaultMonitor(int joints, int parameters, const MonitorSettings& settings)
      : settings_(settings), watch_(joints, settings),
        recent_(joints, parameters, settings.blocks, settings.most_samples),
        sums_(joints, parameters), seen_(sums_), base_(std::size_t(joints * parameters)),
        mean_(std::size_t(joints)), used_(mean_) {}

  // Forgets everything; there is no alarm during the next `wait` samples.
  void reset(double wait) {
    recent_.clear();
    close(wait);
  }

  // Ends the examination of a change and restarts learning of the normal errors.
  void close(double wait) {
    open_ = false;
    watch_.start(wait);
  }

  bool open() const { return open_; }
  double onset() const { return onset_; }                     // estimated time of the change [s]
  const double* base() const { return base_.data(); }         // map before change, (joints, parameters)
  const double* normal() const { return watch_.normal(); }    // normal mean square errors, (joints)
  const RecentSamples& recent() const { return recent_; }

  // Number of the first block after the change; at least one kept block precedes that block.
  long first_after() const { return first_after_; }

  // Takes a block of at most `most_samples` rows of `KeptSamples`, which ends at `time` [s], and
  // the map's parameters at that time, (joints, parameters). Returns whether an examination begins.
  bool take(double time, const double* samples, int count, const double* parameters) {
    // The new block would overwrite the next block to accumulate, which is thus accumulated first.
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

  // Accumulates up to `samples` more samples after the onset; returns true once all are included.
  bool sum(int samples) {
    while (open_ && waiting_ < recent_.end() && samples > 0) samples -= sum_block(samples);
    return !open_ || waiting_ == recent_.end();
  }

  // Returns the moments so far, about the map before the change; they are valid until the next call.
  const Moments& look() {
    seen_ = sums_;
    seen_.take_off(base_.data());
    return seen_;
  }

 private:
  // Computes the mean square errors of a block and their numbers of samples.
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
    onset_ = recent_.onset(watch_.since(), watch_.normal(), settings_.sample_period);
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

  // Accumulates up to `most` samples of block `waiting_`; returns the number of accumulated samples.
  int sum_block(int most) {
    const RecentSamples::Block& block = recent_.block(waiting_);
    const double period = settings_.sample_period;
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
  std::vector<double> base_, mean_, used_;
  bool open_ = false;
  double onset_ = 0.0;
  long first_after_ = 0, waiting_ = 0;  // blocks: first after the onset, next to accumulate
  int waiting_sample_ = 0;              // next sample of block `waiting_`
};

}  // namespace leglab::monitor

// Ring buffer of the latest learned samples in blocks.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "monitor/moments.h"

namespace leglab::monitor {

// Blocks are numbered from 0; the latest `blocks` of them are kept.
class RecentSamples {
 public:
  struct Block {
    double time = 0.0;  // time of the last sample [s]
    int count = 0;      // number of samples
  };

  // most_samples: largest number of samples in a block.
  RecentSamples(int joints, int parameters, int blocks, int most_samples)
      : joints_(joints), parameters_(parameters), capacity_(blocks), most_(most_samples),
        blocks_(std::size_t(blocks)),
        samples_(std::size_t(blocks * most_samples * joints * width())),
        maps_(std::size_t(blocks * joints * parameters)) {}

  void clear() { next_ = 0; }

  int most_samples() const { return most_; }
  int blocks() const { return capacity_; }
  long begin() const { return std::max(next_ - capacity_, 0L); }
  long end() const { return next_; }

  const Block& block(long number) const { return blocks_[slot(number)]; }

  // Samples of a block, (samples, joints, parameters + 3).
  const double* samples(long number) const {
    return samples_.data() + slot(number) * std::size_t(most_ * joints_ * width());
  }

  // Parameters of the map at the end of a block, (joints, parameters).
  const double* parameters(long number) const {
    return maps_.data() + slot(number) * std::size_t(joints_ * parameters_);
  }

  // Adds a block and drops the oldest one if the buffer is full.
  void push(double time, const double* samples, int count, const double* parameters) {
    const std::size_t at = slot(next_++);
    blocks_[at] = {time, count};
    const std::size_t row = std::size_t(joints_ * width());
    std::copy_n(samples, std::size_t(count) * row, samples_.data() + at * std::size_t(most_) * row);
    const std::size_t map = std::size_t(joints_ * parameters_);
    std::copy_n(parameters, map, maps_.data() + at * map);
  }

  // Maximum-likelihood estimate of the time of a change [s] (Hinkley 1970, Biometrika 57, 1),
  // within the blocks after `since` [s]; `since` if the errors do not rise. Errors have variances
  // `normal`, (joints), before the change, and these times a fitted factor of at least 1 after it.
  double onset(double since, const double* normal, double sample_period) const {
    long first = begin();
    while (first < end() && !(block(first).time > since)) ++first;
    double before = 0.0, after = 0.0, count = 0.0;
    for (long number = end() - 1; number >= first; --number) {
      const Sums own = sums(number, normal);
      after += own.ratio;
      count += own.count;
    }
    double best = -std::numeric_limits<double>::infinity(), found = since;
    for (long number = first; number < end(); ++number) {
      const double level = std::max(after / std::max(count, 1.0), 1.0);
      const double likelihood = -(before + count * (std::log(level) + 1.0));
      if (likelihood > best) {
        best = likelihood;
        found = block(number).time - block(number).count * sample_period;
      }
      const Sums own = sums(number, normal);
      before += own.ratio;
      after -= own.ratio;
      count -= own.count;
    }
    return found;
  }

 private:
  struct Sums {
    double ratio = 0.0, count = 0.0;  // sum of squared errors over normal variance; number of samples
  };

  int width() const { return parameters_ + behind_regressor; }
  std::size_t slot(long number) const { return std::size_t(number % capacity_); }

  Sums sums(long number, const double* normal) const {
    Sums out;
    const double* row = samples(number);
    for (int k = 0; k < block(number).count; ++k) {
      for (int j = 0; j < joints_; ++j, row += width()) {
        const double error = row[parameters_ + 1];
        out.ratio += error * error / std::max(normal[j], 1e-300);
        out.count += row[parameters_ + 2];
      }
    }
    return out;
  }

  int joints_, parameters_, capacity_, most_;
  std::vector<Block> blocks_;
  std::vector<double> samples_, maps_;
  long next_ = 0;
};

}  // namespace leglab::monitor

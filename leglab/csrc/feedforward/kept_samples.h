// The latest learned samples, for who looks at them now and then.
#pragma once

#include <algorithm>
#include <vector>

namespace leglab::feedforward {

// (kept, joints, parameters + 3): a regressor, its output, the a-priori error, and 1; only zeros
// where the sample taught that joint nothing.
class KeptSamples {
 public:
  // Keeps so many samples at most from now on; 0 keeps none.
  void keep(int samples, int joints, int parameters) {
    capacity_ = samples;
    count_ = 0;
    joints_ = joints;
    width_ = parameters + 3;
    rows_.assign(std::size_t(samples * joints * width_), 0.0);
  }

  bool any() const { return count_ < capacity_; }
  int count() const { return count_; }
  int width() const { return width_; }
  const double* rows() const { return rows_.data(); }
  void drop() { count_ = 0; }

  // A joint's part of the sample that `next` ends; `regressor` is null where it taught nothing.
  void put(int joint, const double* regressor, double output, double error) {
    double* row = rows_.data() + std::size_t((count_ * joints_ + joint) * width_);
    std::fill_n(row, width_, 0.0);
    if (!regressor) return;
    std::copy_n(regressor, width_ - 3, row);
    row[width_ - 3] = output;
    row[width_ - 2] = error;
    row[width_ - 1] = 1.0;
  }

  void next() {
    if (any()) ++count_;
  }

 private:
  std::vector<double> rows_;
  int capacity_ = 0, count_ = 0, joints_ = 0, width_ = 0;
};

}  // namespace leglab::feedforward

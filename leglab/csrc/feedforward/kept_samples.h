// Buffer of learned samples for a reader (fault and health monitor) that empties it block by block.
#pragma once

#include <algorithm>
#include <vector>

namespace leglab::feedforward {

// Array (samples, joints, parameters + 3). The row of a sample and joint holds regressor, output,
// a-priori error and 1, or only zeros if the joint did not learn the sample.
class KeptSamples {
 public:
  // Empties the buffer and sets its capacity to `samples`; 0 keeps none.
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

  // Writes a joint's row of the sample that `next` will complete; null `regressor`: not learned.
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

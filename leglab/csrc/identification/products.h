// Sum of the outer products of many vectors, computed in tiles that stay in registers.
#pragma once

#include <cstddef>
#include <vector>

#include "identification/wide.h"

namespace leglab::identification {

// Sums of psi_i psi_j for i < width, j < columns <= width; for i < columns only with j <= i.
template <class T>
class Products {
 public:
  explicit Products(int width = 0, int columns = 0)
      : width_(width), columns_(columns), stride_(padded(width)), across_(padded(columns)),
        sum_(std::size_t(stride_) * std::size_t(across_)),
        waiting_(std::size_t(batch) * std::size_t(stride_)) {}

  void clear() {
    for (T& value : sum_) value = T(0);
    rows_ = 0;
  }

  void add(const T* psi) {
    T* row = waiting_.data() + rows_ * stride_;
    for (int i = 0; i < width_; ++i) row[i] = psi[i];
    if (++rows_ == batch) add_waiting();
  }

  // Writes the sums, (width, columns), with both triangles of the square i, j < columns.
  void write(T* out) {
    add_waiting();
    for (int i = 0; i < width_; ++i) {
      for (int j = 0; j < columns_; ++j) {
        const bool below = i >= columns_ || j <= i;
        *out++ = sum_[std::size_t(below ? i * across_ + j : j * across_ + i)];
      }
    }
  }

 private:
  static constexpr int batch = 16;  // vectors whose products are added at once
  static int padded(int count) { return (count + lanes - 1) / lanes * lanes; }

  void add_waiting() {
    add_products(sum_.data(), waiting_.data(), rows_, stride_, across_);
    rows_ = 0;
  }

  int width_, columns_, stride_, across_, rows_ = 0;
  std::vector<T> sum_, waiting_;
};

}  // namespace leglab::identification

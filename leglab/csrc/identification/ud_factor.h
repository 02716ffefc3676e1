// Gain matrix F = U D U^T of recursive least squares, kept as its factors (Bierman 1976).
#pragma once

#include "identification/scalar.h"
#include "identification/workspace.h"

namespace leglab::identification {

// Which regressors are not zero; index == nullptr means all of them.
struct Support {
  const int* index = nullptr;  // increasing
  int count = 0;
};

// U is unit upper triangular, its columns packed one behind the other; D is positive. F is
// symmetric positive definite by construction: no rounding can undo it, and what
// keeps D above `floor` and the columns below a bound only ever changes positive factors.
template <class T>
class UdFactor {
 public:
  // Smallest entry of D: far below any useful gain, far above underflow of its products.
  static constexpr T floor = sizeof(T) == 4 ? T(1e-24) : T(1e-100);

  void layout(Workspace& workspace, int n) {
    n_ = n;
    u_ = workspace.take<T>(n * (n - 1) / 2);
    d_ = workspace.take<T>(n);
    f_ = workspace.take<T>(n);
    v_ = workspace.take<T>(n);
    b_ = workspace.take<T>(n);
  }

  void reset(T gain) {
    for (int i = 0; i < n_ * (n_ - 1) / 2; ++i) u_[i] = T(0);
    for (int i = 0; i < n_; ++i) d_[i] = gain;
  }

  int size() const { return n_; }
  const T* upper() const { return u_; }
  const T* diagonal() const { return d_; }
  const T* gain_vector() const { return b_; }  // F phi of the last update, before it

  // Computes f = U^T phi and v = D f; returns phi^T F phi.
  T project(const T* phi, Support support) {
    first_ = 0;
    if (support.index == nullptr) return dispatch_project(phi);
    if (support.count == 0) {
      first_ = n_;
      return T(0);
    }
    first_ = support.index[0];
    T power = T(0);
    int below = 0;  // nonzero regressors with an index below j
    for (int j = first_; j < n_; ++j) {
      const T* column = u_ + j * (j - 1) / 2;
      T sum = T(0);
      for (int k = 0; k < below; ++k) sum += column[support.index[k]] * phi[support.index[k]];
      if (below < support.count && support.index[below] == j) {
        sum += phi[j];
        ++below;
      }
      f_[j] = sum;
      v_[j] = d_[j] * sum;
      power += f_[j] * v_[j];
    }
    return power;
  }

  // F <- (F - beta F phi phi^T F / (alpha + beta phi^T F phi)) * scale after project(phi).
  // beta may be negative (directional forgetting) as long as alpha + beta phi^T F phi stays
  // positive. With bound > 0 every column's share of the trace is kept within it.
  void update(T alpha, T beta, T scale, T bound) {
    switch (n_) {
      case 6: return rotate<6>(alpha, beta, scale, bound);
      case 7: return rotate<7>(alpha, beta, scale, bound);
      default: return rotate<0>(alpha, beta, scale, bound);
    }
  }

  // F <- F + amount I, as n rank-one updates (Agee and Turner 1972).
  void inflate(T amount) {
    for (int m = 0; m < n_; ++m) {
      for (int i = 0; i < m; ++i) b_[i] = T(0);
      b_[m] = T(1);
      T c = amount;
      for (int j = m; j >= 0 && c > T(0); --j) {
        const T old = d_[j];
        d_[j] = old + c * b_[j] * b_[j];
        const T ratio = c * b_[j] / d_[j];
        T* column = u_ + j * (j - 1) / 2;
        for (int i = 0; i < j; ++i) {
          b_[i] -= b_[j] * column[i];
          column[i] += ratio * b_[i];
        }
        c *= old / d_[j];
      }
    }
  }

  T trace() const {
    T sum = T(0);
    for (int j = 0; j < n_; ++j) sum += d_[j] * column_power(j);
    return sum;
  }

 private:
  T column_power(int j) const {
    const T* column = u_ + j * (j - 1) / 2;
    T sum = T(1);
    for (int i = 0; i < j; ++i) sum += column[i] * column[i];
    return sum;
  }

  T dispatch_project(const T* phi) {
    switch (n_) {
      case 6: return project_dense<6>(phi);
      case 7: return project_dense<7>(phi);
      default: return project_dense<0>(phi);
    }
  }

  // N is the number of parameters where the compiler may know it, else 0.
  template <int N>
  T project_dense(const T* phi) {
    const int n = N > 0 ? N : n_;
    T power = T(0);
    for (int j = 0; j < n; ++j) {
      const T* column = u_ + j * (j - 1) / 2;
      // Two sums: the additions of one wait for each other.
      T even = phi[j], odd = T(0);
      int i = 0;
      for (; i + 1 < j; i += 2) {
        even += column[i] * phi[i];
        odd += column[i + 1] * phi[i + 1];
      }
      if (i < j) even += column[i] * phi[i];
      f_[j] = even + odd;
      v_[j] = d_[j] * f_[j];
      power += f_[j] * v_[j];
    }
    return power;
  }

  template <int N>
  void rotate(T alpha, T beta, T scale, T bound) {
    const int n = N > 0 ? N : n_;
    T* __restrict b = b_;
    for (int i = 0; i < first_; ++i) b[i] = T(0);
    const bool grows = bound > T(0) && (scale > T(1) || beta < T(0));
    for (int j = first_; j < n; ++j) {
      T* __restrict column = u_ + j * (j - 1) / 2;
      const T v = v_[j];
      T next = alpha + beta * f_[j] * v;
      if (beta < T(0)) next = larger(next, T(0.25));  // exactly lambda (1 + r) > 0.25 at the end
      const T ratio = -beta * f_[j] / alpha;
      for (int i = 0; i < j; ++i) {
        const T old = column[i];
        column[i] = old + ratio * b[i];
        b[i] += v * old;
      }
      b[j] = v;
      d_[j] = larger(d_[j] * (scale * alpha / next), floor);
      alpha = next;
    }
    if (!grows && scale == T(1)) return;
    for (int j = 0; j < n; ++j) {
      if (j < first_) d_[j] *= scale;
      if (!grows) continue;
      const T power = column_power(j);
      if (d_[j] * power > bound) d_[j] = larger(bound / power, floor);
    }
  }

  int n_ = 0;
  int first_ = 0;
  T* u_ = nullptr;
  T* d_ = nullptr;
  T* f_ = nullptr;
  T* v_ = nullptr;
  T* b_ = nullptr;
};

}  // namespace leglab::identification

// Gain matrix F = U D U^T of recursive least squares, stored as its factors (Bierman 1976).
#pragma once

#include <utility>

#include "identification/scalar.h"
#include "identification/workspace.h"

// Compiles a second version of a function, which processors with AVX2 use. Its vectors of four do
// the same additions in the same order, so the results are bit-identical.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && __STDC_HOSTED__ && \
    !defined(__SANITIZE_ADDRESS__)
#define LEGLAB_AVX2_TOO [[gnu::target_clones("avx2", "default")]]
#else
#define LEGLAB_AVX2_TOO
#endif

namespace leglab::identification {

// Indices of the nonzero regressors; index == nullptr means all of them.
struct Support {
  const int* index = nullptr;  // increasing
  int count = 0;
};

// U is unit upper triangular, its columns packed consecutively; D is positive. So F is symmetric
// positive definite by construction, in spite of rounding. Two limits keep it so: D stays above
// `floor`, and each column's share of the trace stays below a bound.
template <class T>
class UdFactor {
 public:
  // Smallest entry of D: far below any useful gain, but far above the underflow of products of D.
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

  // Factorises a symmetric positive definite F, n times n: F = U D U^T from the last column on
  // (Bierman 1977, Factorization Methods, III.3). An entry of D that rounding would leave below the
  // floor becomes the floor.
  void assign(const T* full) {
    for (int j = n_ - 1; j >= 0; --j) {
      T* column = u_ + j * (j - 1) / 2;
      for (int i = 0; i <= j; ++i) {
        T sum = full[i * n_ + j];
        for (int k = j + 1; k < n_; ++k) {
          const T* later = u_ + k * (k - 1) / 2;
          sum -= later[i] * d_[k] * later[j];
        }
        if (i < j) column[i] = sum;
        else d_[j] = larger(sum, floor);
      }
      for (int i = 0; i < j; ++i) column[i] /= d_[j];
    }
  }

  int size() const { return n_; }
  const T* upper() const { return u_; }
  const T* diagonal() const { return d_; }
  const T* gain_vector() const { return b_; }  // F phi of the last update, with F before it

  // Computes f = U^T phi and v = D f; returns phi^T F phi.
  T project(const T* phi, Support support) {
    first_ = 0;
    if (support.index == nullptr) {
      return n_ == 6 ? project_all<6>(phi) : n_ == 7 ? project_all<7>(phi) : project_many(phi);
    }
    first_ = support.count > 0 ? support.index[0] : n_;
    T power = T(0);
    int below = 0;  // nonzero regressors with an index below j
    for (int j = first_; j < n_; ++j) {
      const T* column = u_ + j * (j - 1) / 2;
      T even = T(0), odd = T(0);
      int k = 0;
      for (; k + 1 < below; k += 2) {
        even += column[support.index[k]] * phi[support.index[k]];
        odd += column[support.index[k + 1]] * phi[support.index[k + 1]];
      }
      if (k < below) even += column[support.index[k]] * phi[support.index[k]];
      if (below < support.count && support.index[below] == j) {
        even += phi[j];
        ++below;
      }
      f_[j] = even + odd;
      v_[j] = d_[j] * f_[j];
      power += f_[j] * v_[j];
    }
    return power;
  }

  // F <- (F - beta F phi phi^T F / (alpha + beta phi^T F phi)) * scale after project(phi).
  // beta may be negative (directional forgetting) as long as alpha + beta phi^T F phi stays
  // positive. If F may have grown, every column's share of the trace is limited to `bound`.
  void update(T alpha, T beta, T scale, T bound) {
    Sweep sweep{alpha, beta, scale, T(1) / alpha, false};
    if (n_ == 6 && first_ == 0) rotate<6>(sweep);
    else if (n_ == 7 && first_ == 0) rotate<7>(sweep);
    else rotate_many(sweep);
    // The first two conditions let F grow in exact arithmetic, the last two only by rounding.
    if (scale > T(1) || beta < T(0) || sweep.floored || sweep.alpha > T(1e8)) limit(bound);
  }

  // F <- F + amount I, as n rank-one updates (Agee and Turner 1972), within the bound.
  void inflate(T amount, T bound) {
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
    limit(bound);
  }

  // Names the invalid part of a factor read from outside; returns nullptr if it is valid.
  const char* fault() const {
    if (!all_finite(u_, n_ * (n_ - 1) / 2) || !all_finite(d_, n_)) return "gain";
    for (int i = 0; i < n_; ++i) {
      if (!(d_[i] > T(0))) return "gain";
    }
    return nullptr;
  }

  T trace() const {
    T sum = T(0);
    for (int j = 0; j < n_; ++j) sum += d_[j] * column_power(j);
    return sum;
  }

 private:
  // Returns first + sum_i a_i b_i by `sums` partial sums, because additions to one sum are sequential.
  template <int sums>
  [[gnu::always_inline]] static T dot(T first, const T* a, const T* b, int count) {
    T sum[sums] = {first};
    int i = 0;
    for (; i + sums - 1 < count; i += sums) {
      for (int k = 0; k < sums; ++k) sum[k] += a[i + k] * b[i + k];
    }
    for (; i < count; ++i) sum[0] += a[i] * b[i];
    if constexpr (sums == 2) return sum[0] + sum[1];
    else return (sum[0] + sum[1]) + (sum[2] + sum[3]);
  }

  T column_power(int j) const {
    const T* column = u_ + j * (j - 1) / 2;
    return dot<4>(T(1), column, column, j);
  }

  // Calls step for each column; unrolled if the compiler knows their number N (N > 0).
  template <int N, class Step>
  [[gnu::always_inline]] void each_column(Step step) const {
    if constexpr (N > 0) {
      [&]<int... J>(std::integer_sequence<int, J...>) {
        (step(J), ...);
      }(std::make_integer_sequence<int, N>());
    } else {
      for (int j = first_; j < n_; ++j) step(j);
    }
  }

  // Reduces a column's entry of D if the column's share of the trace is beyond the bound. An entry that
  // is then below the floor or not finite is set to the floor, and the column of U to zero.
  void limit(T bound) {
    for (int j = 0; j < n_; ++j) {
      const T power = column_power(j);
      if (d_[j] * power <= bound) continue;
      d_[j] = bound / power;
      if (d_[j] >= floor) continue;
      d_[j] = floor;
      T* column = u_ + j * (j - 1) / 2;
      for (int i = 0; i < j; ++i) column[i] = T(0);
    }
  }

  template <int N>
  [[gnu::always_inline]] T project_all(const T* phi) {
    T power = T(0);
    each_column<N>([&](int j) __attribute__((always_inline)) {
      f_[j] = dot<(N > 0 ? 2 : 4)>(phi[j], u_ + j * (j - 1) / 2, phi, j);
      v_[j] = d_[j] * f_[j];
      power += f_[j] * v_[j];
    });
    return power;
  }

  // Running state of one update: alpha of the columns done so far, and its inverse.
  struct Sweep {
    T alpha, beta, scale, inverse;
    bool floored;  // whether an entry of D was raised to the floor
  };

  // Returns the factor on b that is to be added to column j of U; advances the sweep and D.
  [[gnu::always_inline]] T turn(Sweep& sweep, int j) {
    const T f = sweep.beta * f_[j];
    const T ratio = -f * sweep.inverse;
    T next = sweep.alpha + f * v_[j];
    // In exact arithmetic the last alpha is lambda (1 + phi^T F phi) > 0.25 if beta < 0.
    if (sweep.beta < T(0)) next = larger(next, T(0.25));
    sweep.inverse = T(1) / next;
    const T d = d_[j] * (sweep.scale * sweep.alpha * sweep.inverse);
    sweep.floored |= d < floor;
    d_[j] = larger(d, floor);
    sweep.alpha = next;
    return ratio;
  }

  template <int N>
  [[gnu::always_inline]] void rotate(Sweep& sweep) {
    T few[N + 1];  // b of N columns, which stays in registers
    T* __restrict b = N > 0 ? few : b_;
    for (int i = 0; N == 0 && i < first_; ++i) {
      b[i] = T(0);
      d_[i] *= sweep.scale;
    }
    each_column<N>([&](int j) __attribute__((always_inline)) {
      T* __restrict column = u_ + j * (j - 1) / 2;
      const T v = v_[j], ratio = turn(sweep, j);
      for (int i = 0; i < j; ++i) {
        const T old = column[i];
        column[i] = old + ratio * b[i];
        b[i] += v * old;
      }
      b[j] = v;
    });
    for (int i = 0; i < N; ++i) b_[i] = few[i];
  }

  LEGLAB_AVX2_TOO T project_many(const T* phi) { return project_all<0>(phi); }
  LEGLAB_AVX2_TOO void rotate_many(Sweep& sweep) { rotate<0>(sweep); }

  int n_ = 0;
  int first_ = 0;
  T* u_ = nullptr;
  T* d_ = nullptr;
  T* f_ = nullptr;
  T* v_ = nullptr;
  T* b_ = nullptr;
};

}  // namespace leglab::identification

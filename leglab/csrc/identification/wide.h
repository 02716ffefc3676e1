// Sums over long arrays, with wide instructions where the machine has them.
#pragma once

namespace leglab::identification {

// Each element is computed by itself and nothing is fused, so the bits are the same without.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && __STDC_HOSTED__ && \
    !defined(__SANITIZE_ADDRESS__)
#define LEGLAB_WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define LEGLAB_WIDE
#endif

// to += factor * from.
LEGLAB_WIDE inline void add_scaled(double* __restrict to, const double* __restrict from,
                                   double factor, int count) {
  for (int i = 0; i < count; ++i) to[i] += factor * from[i];
}

// The same in other arithmetic.
template <class T>
void add_scaled(T* __restrict to, const T* __restrict from, T factor, int count) {
  for (int i = 0; i < count; ++i) to[i] += factor * from[i];
}

// to[i, j] += factors[i] * factors[j], of which the first square is a lower triangle.
LEGLAB_WIDE inline void add_products(double* __restrict to, const double* __restrict factors,
                                     int rows, int columns) {
  for (int i = 0; i < rows; ++i, to += columns) {
    const int last = i < columns ? i + 1 : columns;
    const double factor = factors[i];
    for (int j = 0; j < last; ++j) to[j] += factor * factors[j];
  }
}

// to[i, j] += sum_k rows[k, i] * rows[k, j] of four rows, lower triangle of a square of `width`.
LEGLAB_WIDE inline void add_four_products(double* __restrict to, const double* __restrict rows,
                                          int width) {
  const double *a = rows, *b = a + width, *c = b + width, *d = c + width;
  for (int i = 0; i < width; ++i, to += width) {
    const double p = a[i], q = b[i], r = c[i], s = d[i];
    for (int j = 0; j <= i; ++j) to[j] += (p * a[j] + q * b[j]) + (r * c[j] + s * d[j]);
  }
}

}  // namespace leglab::identification

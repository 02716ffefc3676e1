// Sums over long arrays, with wide vector instructions if the processor has them.
#pragma once

namespace leglab::identification {

// Elements are computed separately and no operations are fused, so all versions are bit-identical.
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

// to += sum_k factors[k] * from[k], of rows of `count`.
LEGLAB_WIDE inline void add_rows(double* __restrict to, const double* __restrict from,
                                 const double* factors, int rows, int count) {
  for (int k = 0; k < rows; ++k, from += count) {
    const double factor = factors[k];
    if (factor == 0.0) continue;
    for (int i = 0; i < count; ++i) to[i] += factor * from[i];
  }
}

// Sets values beyond a bound, and NaN, to zero.
LEGLAB_WIDE inline void drop_beyond(double bound, double* values, int count) {
  for (int i = 0; i < count; ++i) {
    values[i] = values[i] < bound && values[i] > -bound ? values[i] : 0.0;
  }
}

// Versions of add_rows and drop_beyond for types other than double.
template <class T>
void add_rows(T* to, const T* from, const T* factors, int rows, int count) {
  for (int i = 0; i < rows * count; ++i) to[i % count] += factors[i / count] * from[i];
}
template <class T>
void drop_beyond(T bound, T* values, int count) {
  for (int i = 0; i < count; ++i) {
    if (!(values[i] < bound && values[i] > -bound)) values[i] = T(0);
  }
}

constexpr int lanes = 8;  // doubles in a cache line
using Lanes [[gnu::vector_size(lanes * sizeof(double)), gnu::aligned(8), gnu::may_alias]] = double;

// to[i, j] += sum_k from[k, i] * from[k, j] over `count` rows of `width`, i < width, j < columns,
// for the tiles that contain a pair with j <= i. Widths are multiples of `lanes`.
LEGLAB_WIDE inline void add_products(double* to, const double* from, int count, int width,
                                     int columns) {
  for (int i = 0; i < width; i += 4) {
    for (int j = 0; j < columns && j < i + 4; j += lanes) {
      Lanes* a = reinterpret_cast<Lanes*>(to + i * columns + j);
      Lanes* b = reinterpret_cast<Lanes*>(to + (i + 1) * columns + j);
      Lanes* c = reinterpret_cast<Lanes*>(to + (i + 2) * columns + j);
      Lanes* d = reinterpret_cast<Lanes*>(to + (i + 3) * columns + j);
      Lanes p = *a, q = *b, r = *c, s = *d;
      const double* row = from;
      for (int k = 0; k < count; ++k, row += width) {
        const Lanes own = *reinterpret_cast<const Lanes*>(row + j);
        p += row[i] * own;
        q += row[i + 1] * own;
        r += row[i + 2] * own;
        s += row[i + 3] * own;
      }
      *a = p, *b = q, *c = r, *d = s;
    }
  }
}

}  // namespace leglab::identification

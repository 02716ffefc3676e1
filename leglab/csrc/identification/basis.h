// Quadratic B-splines on increasing knots, evaluated locally: at most three are not zero.
#pragma once

#include "identification/scalar.h"

namespace leglab::identification {

// Continuation of a basis outside its knots.
enum class Outside : int {
  clamp,      // the value at the nearest end
  linear,     // tangent at the nearest end
  quadratic,  // polynomial of the outermost interval
};

// Values of the splines first, first + 1 and first + 2 at one input; all others are zero.
template <class T>
struct LocalBasis {
  int first;
  int clipped;  // 1 where the input was outside the knots
  T value[3];
  T slope[3] = {};  // d value / d input; filled by evaluate<true>
};

// Basis over p knots. The full basis (offset 0, p + 1 splines) extends the knots by two on each
// side and sums to one on all of [lower, upper]; the basis of the paper (offset 2, p - 3
// splines, Eq. 9) keeps only the splines whose support lies within the knots.
template <class T>
struct QuadraticBasis {
  const T* knots = nullptr;  // p + 4 extended knots, increasing; owned by the caller
  int knot_count = 0;        // p
  int count = 0;             // splines
  int offset = 0;            // full splines dropped on each side
  T inverse_spacing = 0;     // 1 / knot distance; 0 if the knots are not equidistant
  Outside outside = Outside::clamp;
  bool printed = false;         // whether the middle piece of Eq. 9 is as printed, (u - k_i + dk)

  T lower() const { return knots[2]; }
  T upper() const { return knots[knot_count + 1]; }

  // Greville abscissa i; with these as weights, a network with the full basis is the identity.
  T greville(int i) const { return (knots[i + offset + 1] + knots[i + offset + 2]) / T(2); }

  // Length of an array of weights with `offset` unused entries at each end; see evaluate_padded.
  int padded() const { return count + 2 * offset; }

  template <bool Slope = false>
  LocalBasis<T> evaluate(T u) const {
    LocalBasis<T> local;
    evaluate<Slope>(u, local);
    return local;
  }

  // Writes in place, because a copy of the struct would stall on the fields that were just written.
  template <bool Slope = false>
  void evaluate(T u, LocalBasis<T>& local) const {
    locate<Slope>(u, local);
    if (offset != 0) fold<Slope>(local);
  }

  // Variant of evaluate without branches that depend on the input: `first` counts from the padding,
  // and dropped splines have value zero.
  LocalBasis<T> evaluate_padded(T u) const {
    LocalBasis<T> local;
    locate<false>(u, local);
    local.first += offset;
    for (int k = 0; k < 3; ++k) {
      const int i = local.first + k;
      local.value[k] = (i >= offset) & (i < offset + count) ? local.value[k] : T(0);
    }
    return local;
  }

 private:
  template <bool Slope>
  void locate(T u, LocalBasis<T>& local) const {
    // NaN (a diverged simulation) maps to the lower end: the interval must be valid for any u.
    const T nearest = !(u >= lower()) ? lower() : (upper() < u ? upper() : u);
    local.clipped = nearest != u;
    int interval;  // nearest lies in [knots[interval + 2], knots[interval + 3])
    const bool outside_slope = local.clipped && outside == Outside::linear;
    const T inside = outside == Outside::quadratic ? u : nearest;
    if (inverse_spacing > T(0)) {
      const T s = (nearest - lower()) * inverse_spacing;
      interval = smaller(static_cast<int>(s), knot_count - 2);
      T x = s - static_cast<T>(interval);
      if (inside != nearest) x += (inside - nearest) * inverse_spacing;
      const T rest = T(1) - x;
      local.value[0] = rest * rest * T(0.5);
      local.value[1] = T(0.5) + x * rest;
      local.value[2] = x * x * T(0.5);
      if (printed) local.value[1] += T(2) - x;
      if (Slope || outside_slope) {
        local.slope[0] = -rest * inverse_spacing;
        local.slope[1] = (rest - x) * inverse_spacing;
        local.slope[2] = x * inverse_spacing;
        if (printed) local.slope[1] -= inverse_spacing;
      }
    } else {
      interval = search(nearest);
      const T* t = knots + interval + 1;
      const T gap = t[2] - t[1];
      const T left = T(1) / ((t[2] - t[0]) * gap), right = T(1) / ((t[3] - t[1]) * gap);
      const T up = inside - t[1], down = t[2] - inside;
      local.value[0] = down * down * left;
      local.value[1] = (inside - t[0]) * down * left + (t[3] - inside) * up * right;
      local.value[2] = up * up * right;
      if (Slope || outside_slope) {
        local.slope[0] = T(-2) * down * left;
        local.slope[2] = T(2) * up * right;
        local.slope[1] = -(local.slope[0] + local.slope[2]);
      }
    }
    if (outside_slope) {
      for (int k = 0; k < 3; ++k) local.value[k] += local.slope[k] * (u - inside);
    } else if (Slope && local.clipped && outside == Outside::clamp) {
      for (int k = 0; k < 3; ++k) local.slope[k] = T(0);
    }
    local.first = interval - offset;
  }

  // Returns the last interval whose left knot is not above u; the outermost is closed on the right.
  int search(T u) const {
    int low = 0, high = knot_count - 1;
    while (high - low > 1) {
      const int middle = (low + high) / 2;
      if (knots[middle + 2] <= u) low = middle; else high = middle;
    }
    return low;
  }

  // Drops the splines that the basis of the paper lacks, so that `first` to `first + 2` are valid.
  template <bool Slope>
  void fold(LocalBasis<T>& local) const {
    const int shift = local.first < 0 ? -local.first
                      : local.first > count - 3 ? count - 3 - local.first : 0;
    if (shift == 0) return;
    T value[3] = {0, 0, 0}, slope[3] = {0, 0, 0};
    for (int k = 0; k < 3; ++k) {
      const int from = k + shift;
      if (from < 0 || from > 2) continue;
      value[k] = local.value[from];
      if (Slope) slope[k] = local.slope[from];
    }
    for (int k = 0; k < 3; ++k) {
      local.value[k] = value[k];
      if (Slope) local.slope[k] = slope[k];
    }
    local.first += shift;
  }
};

// Makes a basis over `p` knots; `extended` needs p + 4 entries and must outlive the basis.
template <class T>
QuadraticBasis<T> make_basis(const T* knots, int p, T* extended, bool full) {
  // Adds two knots at each end, at the distance of the two outermost knots.
  for (int i = 0; i < p; ++i) extended[i + 2] = knots[i];
  const T head = knots[1] - knots[0], tail = knots[p - 1] - knots[p - 2];
  extended[1] = knots[0] - head;
  extended[0] = knots[0] - T(2) * head;
  extended[p + 2] = knots[p - 1] + tail;
  extended[p + 3] = knots[p - 1] + T(2) * tail;
  constexpr T tolerance = sizeof(T) == 4 ? T(1e-4) : T(1e-9);  // relative to a knot distance
  const T mean = (knots[p - 1] - knots[0]) / static_cast<T>(p - 1), inverse = T(1) / mean;
  bool equidistant = true;
  for (int i = 1; i < p; ++i) {
    equidistant &= magnitude(knots[i] - knots[i - 1] - mean) <= tolerance * mean;
  }
  QuadraticBasis<T> basis;
  basis.knots = extended;
  basis.knot_count = p;
  basis.offset = full ? 0 : 2;
  basis.count = full ? p + 1 : p - 3;
  // If 1/spacing is infinite (very close knots), a product cannot give the index: it is searched.
  basis.inverse_spacing = equidistant && is_finite(inverse) ? inverse : T(0);
  return basis;
}

}  // namespace leglab::identification

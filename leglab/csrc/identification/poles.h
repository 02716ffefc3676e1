// Stability of z^n + a_1 z^(n-1) + ... + a_n, and projection of its roots into a circle.
#pragma once

#include "identification/scalar.h"

namespace leglab::identification {

// Tests whether all roots lie strictly inside |z| < radius: Schur-Cohn step-down on the polynomial
// scaled by the radius. `scratch` needs 2 n entries.
template <class T>
bool poles_within(const T* a, int n, T radius, T* scratch) {
  T* p = scratch;
  T* q = scratch + n;
  T power = T(1);
  for (int i = 0; i < n; ++i) {
    power *= radius;
    p[i] = a[i] / power;
    if (!is_finite(p[i])) return false;
  }
  for (int m = n; m > 0; --m) {
    const T reflection = p[m - 1];
    if (!(magnitude(reflection) < T(1))) return false;
    const T rest = T(1) - reflection * reflection;
    for (int i = 0; i < m - 1; ++i) q[i] = (p[i] - reflection * p[m - 2 - i]) / rest;
    for (int i = 0; i < m - 1; ++i) p[i] = q[i];
  }
  return true;
}

// Returns the largest factor g <= 1 for which the roots times g lie inside the radius, exactly 1 if
// no root has to move. Coefficients a_i g^i have the roots times g. `scratch` needs 3 n entries.
template <class T>
T pole_contraction(const T* a, int n, T radius, T* scratch) {
  if (poles_within(a, n, radius, scratch)) return T(1);
  T low = T(0), high = T(1);
  for (int step = 0; step < (sizeof(T) == 4 ? 24 : 50); ++step) {
    const T g = (low + high) / T(2);
    T power = T(1);
    for (int i = 0; i < n; ++i) {
      power *= g;
      scratch[2 * n + i] = a[i] * power;
    }
    if (poles_within(scratch + 2 * n, n, radius, scratch)) low = g; else high = g;
  }
  return low;
}

}  // namespace leglab::identification

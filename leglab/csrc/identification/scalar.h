// Arithmetic helpers that need no standard library, so that the core compiles freestanding.
#pragma once

namespace leglab::identification {

template <class T>
constexpr T magnitude(T x) {
  return x < T(0) ? -x : x;
}

template <class T>
constexpr T smaller(T a, T b) {
  return b < a ? b : a;
}

template <class T>
constexpr T larger(T a, T b) {
  return a < b ? b : a;
}

// NaN and the infinities are the only values whose difference with themselves is not zero.
template <class T>
constexpr bool is_finite(T x) {
  return x - x == T(0);
}

}  // namespace leglab::identification

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

// Clamps x to [lower, upper]; NaN becomes the lower end.
template <class T>
constexpr T clamp(T x, T lower, T upper) {
  return x > lower ? smaller(x, upper) : lower;
}

// Tests x: NaN and the infinities are the only values whose difference with themselves is not zero.
template <class T>
constexpr bool is_finite(T x) {
  return x - x == T(0);
}

// Tests whether all of `count` values are finite.
template <class T>
constexpr bool all_finite(const T* values, int count) {
  for (int i = 0; i < count; ++i) {
    if (!is_finite(values[i])) return false;
  }
  return true;
}

// Tests whether a flag read from outside is the byte 0 or 1, because other bytes are undefined as bool.
inline bool is_flag(const bool& flag) {
  return *reinterpret_cast<const unsigned char*>(&flag) <= 1;
}

// Shifts the newest value into past[0 .. depth]. The carried value keeps compilers from calling
// memmove, which is slower for a few values.
template <class T>
void push(T* past, int depth, T newest) {
  for (int k = 0; k <= depth; ++k) {
    const T old = past[k];
    past[k] = newest;
    newest = old;
  }
}

}  // namespace leglab::identification

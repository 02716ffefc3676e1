// NumPy arrays as arguments and results of the bindings, and checks of their sizes.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <initializer_list>
#include <utility>
#include <vector>

namespace leglab::bindings {

namespace nb = nanobind;

// Row-major array, accessed in place.
template <class T>
using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu>;
using Input = Array<const double>;
using Output = Array<double>;
using Index = Array<const std::int64_t>;

// New array owned by NumPy.
using Made = nb::ndarray<nb::numpy, double>;

inline Made array_of(std::vector<double> values, std::initializer_list<std::size_t> shape) {
  auto* kept = new std::vector<double>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  return Made(kept->data(), shape, owner);
}

// Throws unless every array has `size` values.
template <class... Arrays>
void require_size(std::size_t size, const Arrays&... arrays) {
  if (((arrays.size() != size) || ...)) throw nb::value_error("arrays of different shapes");
}

// Throws unless all indices `places` are within an array of `size` values.
inline void require_inside(const Index& places, std::size_t size) {
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (places.data()[i] < 0 || std::size_t(places.data()[i]) >= size) {
      throw nb::index_error("index outside the array");
    }
  }
}

}  // namespace leglab::bindings

// Reads the front-end's settings (frozen dataclasses, already validated) into the core's.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <deque>
#include <stdexcept>
#include <string>
#include <vector>

#include "identification/bsnn_arx.h"
#include "identification/spline_narx.h"

namespace leglab::bindings {

namespace nb = nanobind;
namespace id = leglab::identification;

template <class V>
V get(nb::handle settings, const char* name) {
  return nb::cast<V>(settings.attr(name));
}

// Position of a string field among its choices, in the order of the core's enumeration.
inline int choice(nb::handle settings, const char* name, std::initializer_list<const char*> all) {
  const auto value = get<std::string>(settings, name);
  int i = 0;
  for (const char* candidate : all) {
    if (value == candidate) return i;
    ++i;
  }
  throw std::invalid_argument(std::string(name) + ": unknown choice " + value);
}

// Memory that the core's settings point into; a deque never moves what it holds.
template <class T>
struct Store {
  std::deque<std::vector<T>> knots;
  std::vector<id::Block<T>> blocks;
};

template <class T>
id::QuadraticBasis<T> read_basis(nb::handle settings, Store<T>& store) {
  std::vector<T> knots;
  for (double k : get<std::vector<double>>(settings, "knots")) knots.push_back(T(k));
  auto& extended = store.knots.emplace_back(knots.size() + 4);
  const bool full = choice(settings, "kind", {"paper", "full"}) == 1;
  auto basis = id::make_basis<T>(knots.data(), int(knots.size()), extended.data(), full);
  basis.outside =
      static_cast<id::Outside>(choice(settings, "outside", {"clamp", "linear", "quadratic"}));
  basis.printed = choice(settings, "middle_piece", {"corrected", "printed"}) == 1;
  return basis;
}

template <class T>
id::RlsSettings<T> read_rls(nb::handle settings) {
  id::RlsSettings<T> out;
  out.initial_gain = T(get<double>(settings, "initial_gain"));
  out.forgetting = static_cast<id::Forgetting>(
      choice(settings, "forgetting", {"none", "exponential", "directional", "variable"}));
  out.forgetting_factor = T(get<double>(settings, "forgetting_factor"));
  out.memory = T(get<double>(settings, "memory"));
  out.noise_variance = T(get<double>(settings, "noise_variance"));
  out.gain_bound = T(get<double>(settings, "gain_bound"));
  out.restore_gain = T(get<double>(settings, "restore_gain"));
  out.restore_interval = get<int>(settings, "restore_interval");
  const nb::object change = settings.attr("change");
  if (change.is_none()) return out;
  out.change.enabled = true;
  out.change.fast_window = get<int>(change, "fast_window");
  out.change.slow_window = get<int>(change, "slow_window");
  out.change.ratio = T(get<double>(change, "ratio"));
  out.change.hold_off = get<int>(change, "hold_off");
  out.on_change = static_cast<id::OnChange>(choice(change, "action", {"reset", "inflate"}));
  out.change_gain = T(get<double>(change, "gain"));
  return out;
}

template <class T>
id::GuardSettings<T> read_guard(nb::handle settings) {
  id::GuardSettings<T> out;
  out.stuck_samples = get<int>(settings, "stuck_samples");
  const auto limits = get<std::vector<std::vector<double>>>(settings, "input_limits");
  out.saturates = !limits.empty();
  for (std::size_t j = 0; j < limits.size() && j < std::size(out.lower); ++j) {
    out.lower[j] = T(limits[j].at(0));
    out.upper[j] = T(limits[j].at(1));
  }
  return out;
}

template <class T>
id::BsnnSettings<T> read_network(nb::handle settings, Store<T>& store) {
  id::BsnnSettings<T> out;
  const nb::object bases = settings.attr("basis");
  const auto constants = get<std::vector<double>>(settings, "learning_constant");
  out.inputs = int(nb::len(bases));
  for (int j = 0; j < out.inputs; ++j) {
    out.basis[j] = read_basis<T>(bases[j], store);
    out.learning_constant[j] = T(constants.at(j));
  }
  out.two_layers = get<bool>(settings, "two_layers");
  out.output_learning_constant = T(get<double>(settings, "output_learning_constant"));
  out.bias = get<bool>(settings, "bias");
  out.saturation = get<bool>(settings, "saturation");
  return out;
}

template <class T>
id::BsnnArxSettings<T> read_settings(nb::handle settings, Store<T>& store,
                                     const id::BsnnArx<T>*) {
  id::BsnnArxSettings<T> out;
  out.na = get<int>(settings, "na");
  out.nb = get<int>(settings, "nb");
  out.nk = get<int>(settings, "nk");
  out.network = read_network<T>(settings.attr("network"), store);
  out.rls = read_rls<T>(settings.attr("rls"));
  out.guard = read_guard<T>(settings.attr("guard"));
  out.guard.output_limit = T(get<double>(settings, "output_limit"));
  out.opening = T(get<double>(settings, "opening"));
  out.fading = T(get<double>(settings, "fading"));
  return out;
}

template <class T>
id::Block<T> read_block(nb::handle settings, Store<T>& store) {
  id::Block<T> out;
  out.feature = static_cast<id::Feature>(
      choice(settings, "feature", {"lags", "constant", "spline", "hammerstein"}));
  out.signal = get<int>(settings, "signal");
  out.lag = get<int>(settings, "lag");
  out.lags = get<int>(settings, "lags");
  out.factor_signal = get<int>(settings, "factor_signal");
  out.factor_lag = get<int>(settings, "factor_lag");
  out.learning_constant = T(get<double>(settings, "learning_constant"));
  const nb::object basis = settings.attr("basis");
  if (!basis.is_none()) out.basis = read_basis<T>(basis, store);
  return out;
}

template <class T>
id::Scale<T> read_scale(nb::handle signal) {
  return {T(get<double>(signal, "centre")), T(get<double>(signal, "half_range"))};
}

template <class T>
id::SplineNarxSettings<T> read_settings(nb::handle settings, Store<T>& store,
                                        const id::SplineNarx<T>*) {
  id::SplineNarxSettings<T> out;
  for (nb::handle block : settings.attr("blocks")) {
    store.blocks.push_back(read_block<T>(block, store));
  }
  const nb::object inputs = settings.attr("inputs");
  out.structure = {store.blocks.data(), int(store.blocks.size()), int(nb::len(inputs))};
  out.output = read_scale<T>(settings.attr("output"));
  for (int j = 0; j < out.structure.inputs; ++j) out.input[j] = read_scale<T>(inputs[j]);
  out.rls = read_rls<T>(settings.attr("rls"));
  out.guard = read_guard<T>(settings.attr("guard"));
  out.output_error_after = get<int>(settings, "output_error_after");
  const T plausible = T(get<double>(settings, "plausible_range"));
  out.guard.output_centre = out.output.centre;
  out.guard.output_limit = plausible * out.output.half_range;
  for (int j = 0; j < out.structure.inputs; ++j) {
    out.guard.input_centre[j] = out.input[j].centre;
    out.guard.input_limit[j] = plausible * out.input[j].half_range;
  }
  out.resynchronise_above =
      T(get<double>(settings, "resynchronise_above")) / out.output.half_range;
  out.pole_limit = T(get<double>(settings, "pole_limit"));
  return out;
}

}  // namespace leglab::bindings

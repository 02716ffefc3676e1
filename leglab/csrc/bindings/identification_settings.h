// Conversion of the front-end's settings (validated frozen dataclasses) to the core's settings.
#pragma once

#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <deque>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "bindings/arrays.h"
#include "identification/bsnn_arx.h"
#include "identification/spline_narx.h"
#include "identification/spline_state_space.h"

namespace leglab::bindings {

namespace id = leglab::identification;

inline nb::object look_up(nb::handle settings, const char* name) { return settings.attr(name); }
inline nb::object look_up(const nb::dict& settings, const char* name) { return settings[name]; }

// Reads a field; a dictionary holds numbers as arrays, which are read row by row.
template <class V, class Settings>
V get(const Settings& settings, const char* name) {
  if constexpr (std::is_same_v<V, std::vector<double>> && std::is_same_v<Settings, nb::dict>) {
    const auto array = nb::cast<Input>(look_up(settings, name));
    return {array.data(), array.data() + array.size()};
  } else if constexpr (std::is_same_v<V, float>) {
    return float(nb::cast<double>(look_up(settings, name)));
  } else {
    return nb::cast<V>(look_up(settings, name));
  }
}

// Fills fields of `out` from fields of the same name in `settings`, an object or a dictionary.
#define LEGLAB_READ(name) out.name = get<decltype(out.name)>(settings, #name);
#define LEGLAB_READ_2(a, b) LEGLAB_READ(a) LEGLAB_READ(b)
#define LEGLAB_READ_3(a, ...) LEGLAB_READ(a) LEGLAB_READ_2(__VA_ARGS__)
#define LEGLAB_READ_4(a, ...) LEGLAB_READ(a) LEGLAB_READ_3(__VA_ARGS__)

// Index of a string field among its choices, in the order of the core's enumeration.
template <class Enum>
Enum choice(nb::handle settings, const char* name, std::initializer_list<const char*> all) {
  const auto value = get<std::string>(settings, name);
  const auto found = std::find(all.begin(), all.end(), value);
  if (found == all.end()) throw std::invalid_argument(std::string(name) + ": unknown choice " + value);
  return static_cast<Enum>(found - all.begin());
}

// Storage that the core's settings point into; a deque, because it never moves its elements.
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
  const bool full = choice<int>(settings, "kind", {"paper", "full"}) == 1;
  auto basis = id::make_basis<T>(knots.data(), int(knots.size()), extended.data(), full);
  basis.outside = choice<id::Outside>(settings, "outside", {"clamp", "linear", "quadratic"});
  basis.printed = choice<int>(settings, "middle_piece", {"corrected", "printed"}) == 1;
  return basis;
}

template <class T>
id::ChangeSettings<T> read_change(nb::handle settings) {
  id::ChangeSettings<T> out;
  out.enabled = !settings.is_none();
  if (!out.enabled) return out;
  LEGLAB_READ_3(fast_window, slow_window, ratio)
  LEGLAB_READ_2(hold_off, gain)
  out.action = choice<id::OnChange>(settings, "action", {"reset", "inflate"});
  return out;
}

template <class T>
id::RlsSettings<T> read_rls(nb::handle settings) {
  id::RlsSettings<T> out;
  LEGLAB_READ_3(initial_gain, forgetting_factor, memory)
  LEGLAB_READ_4(noise_variance, gain_bound, restore_gain, restore_interval)
  out.forgetting = choice<id::Forgetting>(settings, "forgetting",
                                          {"none", "exponential", "directional", "variable"});
  out.change = read_change<T>(settings.attr("change"));
  return out;
}

template <class T>
id::GuardSettings<T> read_guard(nb::handle settings) {
  id::GuardSettings<T> out;
  LEGLAB_READ(stuck_samples)
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
  LEGLAB_READ_4(two_layers, output_learning_constant, bias, saturation)
  return out;
}

template <class T>
id::BsnnArxSettings<T> read_settings(nb::handle settings, Store<T>& store,
                                     const id::BsnnArx<T>*) {
  id::BsnnArxSettings<T> out;
  LEGLAB_READ_3(na, nb, nk)
  LEGLAB_READ_2(opening, fading)
  out.network = read_network<T>(settings.attr("network"), store);
  out.rls = read_rls<T>(settings.attr("rls"));
  out.guard = read_guard<T>(settings.attr("guard"));
  out.guard.output_limit = get<T>(settings, "output_limit");
  return out;
}

template <class T>
id::Block<T> read_block(nb::handle settings, Store<T>& store) {
  id::Block<T> out;
  out.feature =
      choice<id::Feature>(settings, "feature", {"lags", "constant", "spline", "hammerstein", "term"});
  out.curve = choice<id::Curve>(settings, "curve", {"power", "hinge", "sign"});
  LEGLAB_READ_4(degree, at, width, change)
  LEGLAB_READ_3(signal, lag, lags)
  LEGLAB_READ_3(factor_signal, factor_lag, learning_constant)
  const nb::object basis = settings.attr("basis");
  if (!basis.is_none()) out.basis = read_basis<T>(basis, store);
  return out;
}

template <class T>
id::Scale<T> read_scale(nb::handle settings) {
  id::Scale<T> out;
  LEGLAB_READ_2(centre, half_range)
  return out;
}

// Settings common to all identifiers: scales of the signals, least squares, guard and limits.
template <class T, template <class> class Settings>
void read_common(nb::handle settings, Settings<T>& out) {
  const nb::object inputs = settings.attr("inputs");
  out.output = read_scale<T>(settings.attr("output"));
  for (int j = 0; j < out.structure.inputs; ++j) out.input[j] = read_scale<T>(inputs[j]);
  out.rls = read_rls<T>(settings.attr("rls"));
  out.guard = read_guard<T>(settings.attr("guard"));
  const nb::object limits = settings.attr("free_run_limits");
  out.held = !limits.is_none();
  if (out.held) {
    const auto ends = nb::cast<std::vector<double>>(limits);
    out.lower = out.output.apply(T(ends.at(0)));
    out.upper = out.output.apply(T(ends.at(1)));
  }
  const T plausible = get<T>(settings, "plausible_range");
  out.guard.output_centre = out.output.centre;
  out.guard.output_limit = plausible * out.output.half_range;
  for (int j = 0; j < out.structure.inputs; ++j) {
    out.guard.input_centre[j] = out.input[j].centre;
    out.guard.input_limit[j] = plausible * out.input[j].half_range;
  }
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
  read_common(settings, out);
  LEGLAB_READ_3(output_error_after, resynchronise_above, pole_limit)
  out.resynchronise_above /= out.output.half_range;
  return out;
}

template <class T>
id::SplineStateSpaceSettings<T> read_settings(nb::handle settings, Store<T>& store,
                                              const id::SplineStateSpace<T>*) {
  id::SplineStateSpaceSettings<T> out;
  const nb::object structure = settings.attr("structure");
  const nb::object inputs = settings.attr("inputs");
  out.structure.inputs = int(nb::len(inputs));
  out.structure.states = get<int>(structure, "states");
  out.structure.curves = get<int>(structure, "curves");
  out.structure.basis = read_basis<T>(structure.attr("basis"), store);
  const auto delays = get<std::vector<int>>(structure, "delays");
  for (int j = 0; j < out.structure.inputs; ++j) out.delay[j] = delays.at(std::size_t(j));
  read_common(settings, out);
  out.noise = get<T>(structure, "noise");
  LEGLAB_READ(process_noise)
  return out;
}

}  // namespace leglab::bindings

// Order of each model's parameters, and each model's diagnostics, for the bank of models.
#pragma once

#include <cmath>

#include "bindings/identification_settings.h"

namespace leglab::bindings {

// Parameters in the order theta, first-layer weights, bias, second-layer weights.
template <class T, class Visitor>
void visit_parameters(id::BsnnArx<T>& model, Visitor&& visit) {
  for (int i = 0; i < model.parameters(); ++i) visit(model.rls().theta()[i]);
  auto& network = model.network();
  const auto& settings = network.settings();
  for (int j = 0; j < settings.inputs; ++j) {
    for (int i = 0; i < settings.basis[j].count; ++i) visit(network.weights(j)[i]);
  }
  if (settings.bias) visit(network.bias());
  if (settings.two_layers) {
    for (int j = 0; j < settings.inputs; ++j) visit(network.output_weights()[j]);
  }
}

template <class T, class Visitor>
void visit_parameters(id::SplineNarx<T>& model, Visitor&& visit) {
  for (int i = 0; i < model.parameters(); ++i) visit(model.rls().theta()[i]);
  for (int i = 0; i < model.weight_count(); ++i) visit(model.weights()[i]);
}

template <class T, class Visitor>
void visit_parameters(id::SplineStateSpace<T>& model, Visitor&& visit) {
  for (int i = 0; i < model.parameters(); ++i) visit(model.rls().theta()[i]);
}

// Counts of learned and rejected samples, and the state of the least squares.
template <class Model>
nb::dict describe_learning(Model& model) {
  static constexpr const char* names[] = {"learned",    "frozen",      "recovering", "dropped",
                                          "not_finite", "implausible", "saturated",  "stuck"};
  static_assert(std::size(names) == std::size_t(id::Sample::count));
  nb::dict out;
  for (std::size_t i = 0; i < std::size(names); ++i) out[names[i]] = model.guard().state().tally[i];
  auto& rls = model.rls();
  out["changes"] = rls.change().changes;
  out["rejected"] = rls.tally().rejected;
  out["restarts"] = rls.tally().restarts;
  out["forgetting_factor"] = double(rls.tally().factor);
  out["fast_error"] = double(rls.change().fast);
  out["slow_error"] = double(rls.change().slow);
  out["gain_trace"] = double(rls.gain().trace());
  return out;
}

template <class T>
nb::dict describe(id::BsnnArx<T>& model) {
  nb::dict out = describe_learning(model);
  const auto& tally = model.network().tally();
  out["clipped"] = tally.clipped;
  out["bound_violations"] = tally.violations;
  out["largest_contraction"] = double(tally.largest_contraction);
  out["openness"] = double(model.openness());
  return out;
}

template <class T>
nb::dict describe(id::SplineNarx<T>& model) {
  nb::dict out = describe_learning(model);
  out["clipped"] = model.state().clipped;
  out["projected"] = model.state().projected;
  out["resynchronised"] = 0;
  if (model.refines()) {
    const auto& simulation = model.simulation().state();
    out["resynchronised"] = simulation.resynchronised;
    out["simulation_rms"] =
        std::sqrt(double(simulation.mean_square)) * double(model.settings().output.half_range);
  }
  return out;
}

template <class T>
nb::dict describe(id::SplineStateSpace<T>& model) {
  return describe_learning(model);
}

}  // namespace leglab::bindings

// Parameters of each model in order, and its diagnostics, for the bank.
#pragma once

#include <cmath>

#include "bindings/identification_settings.h"

namespace leglab::bindings {

// Parameters in the order theta, first-layer weights, bias, second-layer weights.
template <class T, class Visitor>
void visit_parameters(id::Bsnn<T>& network, Visitor&& visit) {
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
void visit_parameters(id::BsnnArx<T>& model, Visitor&& visit) {
  for (int i = 0; i < model.parameters(); ++i) visit(model.rls().theta()[i]);
  visit_parameters(model.network(), visit);
}

template <class T, class Visitor>
void visit_parameters(id::SplineNarx<T>& model, Visitor&& visit) {
  for (int i = 0; i < model.parameters(); ++i) visit(model.rls().theta()[i]);
  for (int i = 0; i < model.weight_count(); ++i) visit(model.weights()[i]);
}

template <class T>
nb::dict describe_samples(const id::Guard<T>& guard) {
  static constexpr const char* names[] = {"learned",    "frozen",      "recovering", "dropped",
                                          "not_finite", "implausible", "saturated",  "stuck"};
  static_assert(std::size(names) == std::size_t(id::Sample::count));
  nb::dict out;
  for (std::size_t i = 0; i < std::size(names); ++i) out[names[i]] = guard.state().tally[i];
  return out;
}

template <class T>
void describe_rls(const id::Rls<T>& rls, nb::dict& out) {
  out["changes"] = rls.change().changes;
  out["rejected"] = rls.tally().rejected;
  out["restarts"] = rls.tally().restarts;
  out["forgetting_factor"] = double(rls.tally().factor);
  out["fast_error"] = double(rls.change().fast);
  out["slow_error"] = double(rls.change().slow);
  out["gain_trace"] = double(rls.gain().trace());
}

template <class T>
void describe_network(const id::Bsnn<T>& network, nb::dict& out) {
  out["clipped"] = network.tally().clipped;
  out["bound_violations"] = network.tally().violations;
  out["largest_contraction"] = double(network.tally().largest_contraction);
}

template <class T>
nb::dict describe(id::BsnnArx<T>& model) {
  nb::dict out = describe_samples(model.guard());
  describe_rls(model.rls(), out);
  describe_network(model.network(), out);
  out["openness"] = double(model.openness());
  return out;
}

template <class T>
nb::dict describe(id::SplineNarx<T>& model) {
  nb::dict out = describe_samples(model.guard());
  describe_rls(model.rls(), out);
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

}  // namespace leglab::bindings

// The paper's model: a B-spline network feeding an ARX model, both learning on every sample
// (Algorithm 1).
#pragma once

#include "identification/bsnn.h"
#include "identification/guard.h"
#include "identification/poles.h"
#include "identification/rls.h"

namespace leglab::identification {

template <class T>
struct BsnnArxSettings {
  int na = 3;  // past outputs, n of Eq. 1
  int nb = 3;  // past network outputs, m of Eq. 1
  int nk = 1;  // smallest lag of the network outputs [samples]; 1 in Eq. 3
  BsnnSettings<T> network;
  RlsSettings<T> rls;
  GuardSettings<T> guard;
  // Learning constants are multiplied by 1 + opening * g; g is 1 at the start and after a
  // detected change and fades with time constant fading [samples]. 0: constant, as printed.
  T opening = T(0);
  T fading = T(300);
};

template <class T>
class BsnnArx {
 public:
  void layout(Workspace& workspace, const BsnnArxSettings<T>& settings) {
    settings_ = settings;
    settings_.guard.inputs = settings.network.inputs;
    settings_.guard.memory = larger(settings.na, settings.nb + settings.nk - 1);
    parameters_ = settings.na + settings.nb;
    network_.layout(workspace, settings.network);
    rls_.layout(workspace, parameters_);
    guard_.layout(workspace);
    guard_.configure(settings_.guard);
    openness_ = workspace.take<T>(1);
    phi_ = workspace.take<T>(parameters_);
    delayed_ = workspace.take<T>(settings.nk + settings.nb);
    poles_ = workspace.take<T>(3 * settings.na);
    if (workspace.measuring()) return;
    rls_.start(settings_.rls);
    *openness_ = T(1);
  }

  Bsnn<T>& network() { return network_; }
  Rls<T>& rls() { return rls_; }
  Guard<T>& guard() { return guard_; }
  int parameters() const { return parameters_; }
  int inputs() const { return settings_.network.inputs; }
  T openness() const { return *openness_; }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    if (!is_finite(*openness_)) return "openness";
    if (!all_finite(phi_, settings_.na)) return "past output";
    if (const char* fault = network_.fault()) return fault;
    if (const char* fault = rls_.fault()) return fault;
    return guard_.fault();
  }

  // Takes the sample (u(t), y(t)); returns the a-priori prediction of y(t). If only a prediction
  // is wanted, y may be NaN: the sample is then not learned.
  T update(const T* input, T y) {
    T u[GuardSettings<T>::max_inputs];
    for (int j = 0; j < settings_.network.inputs; ++j) u[j] = input[j];
    const Sample verdict = guard_.judge(u, y, true);
    const T n = network_.output(u);
    const T prediction = predict(n);
    if (verdict == Sample::learned) {
      const bool changed = rls_.update(phi_, y - prediction);
      if (settings_.opening > T(0)) schedule(changed);
      network_.adapt(y - n);
    }
    remember(y);
    return prediction;
  }

  // predict_next(), followed by remember(), acts as update() without adaptation and without checks of y,
  // for validation and free run on a copy of the workspace.
  T predict_next(const T* u) { return predict(network_.output(u)); }
  void remember(T y) { push(phi_, settings_.na - 1, -y); }

  // Predicts the next output for an input without storing it; changes nothing.
  T peek(const T* u) {
    const T n = network_.output(u);
    for (int i = 0; i < settings_.nb; ++i) {
      const int lag = settings_.nk + i;
      phi_[settings_.na + i] = lag == 0 ? n : delayed_[lag - 1];
    }
    return rls_.predict(phi_);
  }

  // Scales the poles of the ARX model into the radius; returns true if they had to move.
  bool project_poles(T radius) {
    T* a = rls_.theta();
    const T g = pole_contraction(a, settings_.na, radius, poles_);
    T power = T(1);
    for (int i = 0; i < settings_.na; ++i) {
      power *= g;
      a[i] *= power;
    }
    return g != T(1);
  }

 private:
  T predict(T n) {
    push(delayed_, settings_.nk + settings_.nb - 1, n);
    for (int i = 0; i < settings_.nb; ++i) phi_[settings_.na + i] = delayed_[settings_.nk + i];
    return rls_.predict(phi_);
  }

  void schedule(bool changed) {
    T& g = *openness_;
    g = changed ? T(1) : g * (T(1) - T(1) / settings_.fading);
    network_.scale_learning(T(1) + settings_.opening * g);
  }

  BsnnArxSettings<T> settings_;
  int parameters_ = 0;
  Bsnn<T> network_;
  Rls<T> rls_;
  Guard<T> guard_;
  T* openness_ = nullptr;  // g, see `opening` in the settings
  T* phi_ = nullptr;
  T* delayed_ = nullptr;  // n(t), n(t-1), ...
  T* poles_ = nullptr;    // scratch
};

}  // namespace leglab::identification

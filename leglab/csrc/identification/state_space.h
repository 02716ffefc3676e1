// State-space model with static curves inside: a linear system in feedback with splines of
// combinations of its states and inputs (nonlinear LFR; Schoukens and Toth 2020, "On the
// initialization of nonlinear LFR model identification with the best linear approximation"):
//   x(t + 1) = A x(t) + B u(t) + sum_c w_c f_c(z_c)       z_c = v_c' [x(t); u(t)]
//   y(t)     = C x(t) + D u(t) + d + sum_c o_c f_c(z_c)   f_c = sum_i e_ci N_i
// theta has A, B, C, D, d, then v, w, o, e of each curve, matrices by rows.
#pragma once

#include "identification/basis.h"
#include "identification/wide.h"
#include "identification/workspace.h"

namespace leglab::identification {

template <class T>
struct StateStructure {
  static constexpr T reach = T(2);  // limit of the states, which are within 1 in training data
  int states = 1;
  int inputs = 1;
  int curves = 0;
  QuadraticBasis<T> basis;  // of every curve, over [-1, 1]

  int signals() const { return states + inputs; }
  int linear() const { return states * signals() + signals() + 1; }
  int curve() const { return signals() + states + 1 + basis.count; }
  int parameters() const { return linear() + curves * curve(); }
};

// One step and its sensitivities in `width` columns: to the parameters, then to the caller's.
template <class T>
class StateSpace {
 public:
  void layout(Workspace& workspace, const StateStructure<T>& structure, int width) {
    s_ = structure;
    width_ = width;
    signals_ = workspace.take<T>(s_.signals());
    next_ = workspace.take<T>(s_.states);
    held_ = workspace.take<bool>(s_.states);
    local_ = workspace.take<LocalBasis<T>>(s_.curves);
    value_ = workspace.take<T>(s_.curves);
    slope_ = workspace.take<T>(s_.curves);
    jacobian_ = workspace.take<T>(s_.states * s_.states);
    output_ = workspace.take<T>(s_.states);
    former_ = workspace.take<T>(s_.states * width);
  }

  const StateStructure<T>& structure() const { return s_; }
  const T* next() const { return next_; }
  // d x(t + 1) / d x(t), by rows, and d y(t) / d x(t); after `linearise`.
  const T* jacobian() const { return jacobian_; }
  const T* output_slope() const { return output_; }

  // Returns y(t); next() then has x(t + 1).
  T evaluate(const T* theta, const T* x, const T* u) {
    const int n = s_.states, m = s_.signals();
    for (int i = 0; i < n; ++i) signals_[i] = x[i];
    for (int j = 0; j < s_.inputs; ++j) signals_[n + j] = u[j];
    const T* a = theta;
    const T* b = a + n * n;
    const T* c = b + n * s_.inputs;
    for (int i = 0; i < n; ++i) {
      next_[i] = dot(a + i * n, signals_, n) + dot(b + i * s_.inputs, signals_ + n, s_.inputs);
    }
    T y = c[m] + dot(c, signals_, m);
    const T* curve = theta + s_.linear();
    for (int k = 0; k < s_.curves; ++k, curve += s_.curve()) {
      const T* w = curve + m;
      const T* e = w + n + 1;
      LocalBasis<T>& local = local_[k];
      s_.basis.template evaluate<true>(dot(curve, signals_, m), local);
      value_[k] = dot(e + local.first, local.value, 3);
      slope_[k] = dot(e + local.first, local.slope, 3);
      for (int i = 0; i < n; ++i) next_[i] += w[i] * value_[k];
      y += w[n] * value_[k];
    }
    for (int i = 0; i < n; ++i) {
      const T free = next_[i];
      next_[i] = clamp(free, -s_.reach, s_.reach);
      held_[i] = next_[i] != free;
    }
    return y;
  }

  // Computes the slopes at the sample of the last `evaluate`.
  void linearise(const T* theta) {
    const int n = s_.states, m = s_.signals();
    for (int i = 0; i < n * n; ++i) jacobian_[i] = theta[i];
    for (int i = 0; i < n; ++i) output_[i] = theta[n * m + i];
    const T* curve = theta + s_.linear();
    for (int k = 0; k < s_.curves; ++k, curve += s_.curve()) {
      const T* w = curve + m;
      for (int i = 0; i < n; ++i) {
        const T steep = w[i] * slope_[k];
        for (int j = 0; j < n; ++j) jacobian_[i * n + j] += steep * curve[j];
      }
      for (int j = 0; j < n; ++j) output_[j] += w[n] * slope_[k] * curve[j];
    }
    for (int i = 0; i < n; ++i) {
      for (int j = 0; held_[i] && j < n; ++j) jacobian_[i * n + j] = T(0);
    }
  }

  // Advances S = d x(t) / d theta, (states, width), to t + 1 in place; psi gets d y(t) / d theta.
  void propagate(const T* theta, T* sensitivity, T* psi) {
    const int n = s_.states;
    for (int i = 0; i < n * width_; ++i) former_[i] = sensitivity[i];
    for (int i = 0; i <= n; ++i) {
      T* row = i < n ? sensitivity + i * width_ : psi;
      for (int p = 0; p < width_; ++p) row[p] = T(0);
      if (i == n || !held_[i]) direct(theta, i, row);
      add_rows(row, former_, i < n ? jacobian_ + i * n : output_, n, width_);
      drop_beyond(T(1e12), row, width_);  // larger sensitivities, of an unstable model, are useless
    }
  }

 private:
  static T dot(const T* a, const T* b, int count) {
    T sum = T(0);
    for (int i = 0; i < count; ++i) sum += a[i] * b[i];
    return sum;
  }

  // Adds the direct derivative of next state i, or of the output (i = states), by the parameters.
  void direct(const T* theta, int i, T* row) {
    const int n = s_.states, m = s_.signals();
    if (i < n) {
      for (int j = 0; j < n; ++j) row[i * n + j] += signals_[j];
      for (int j = 0; j < s_.inputs; ++j) row[n * n + i * s_.inputs + j] += signals_[n + j];
    } else {
      for (int j = 0; j < m; ++j) row[n * m + j] += signals_[j];
      row[n * m + m] += T(1);
    }
    const T* curve = theta + s_.linear();
    T* own = row + s_.linear();
    for (int k = 0; k < s_.curves; ++k, curve += s_.curve(), own += s_.curve()) {
      const T weight = curve[m + i];
      for (int j = 0; j < m; ++j) own[j] += weight * slope_[k] * signals_[j];
      own[m + i] += value_[k];
      T* e = own + m + n + 1 + local_[k].first;
      for (int l = 0; l < 3; ++l) e[l] += weight * local_[k].value[l];
    }
  }

  StateStructure<T> s_;
  int width_ = 0;
  T* signals_ = nullptr;  // x, then u
  T* next_ = nullptr;
  bool* held_ = nullptr;  // whether each state is clamped
  LocalBasis<T>* local_ = nullptr;
  T* value_ = nullptr;  // of each curve
  T* slope_ = nullptr;
  T* jacobian_ = nullptr;
  T* output_ = nullptr;
  T* former_ = nullptr;
};

}  // namespace leglab::identification

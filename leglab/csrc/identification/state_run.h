// Simulation of a state-space model over a stretch of a record from an initial state, and the sums
// for a Gauss-Newton step.
#pragma once

#include <cstddef>
#include <vector>

#include "identification/products.h"
#include "identification/state_space.h"

namespace leglab::identification {

// Sums over samples, with psi = d y / d (theta, x0, g). g are the spline weights of a candidate curve,
// all zero: first for the curve's effect on each state, then for its effect on the output.
template <class T>
struct StateSums {
  Products<T> products;     // (width, width): sum of psi_i psi_j
  std::vector<T> gradient;  // (width): sum of psi_i (y measured - y)
  T error = T(0);           // sum of squared errors
  std::size_t count = 0;    // number of samples
};

template <class T>
class StateRun {
 public:
  // `further`: weights of states and inputs in the argument of a candidate curve, or nullptr; owned
  // by the caller.
  StateRun(const StateStructure<T>& structure, T lower, T upper, const T* further)
      : further_(further), lower_(lower), upper_(upper) {
    width_ = structure.parameters() + structure.states;
    if (further != nullptr) width_ += (structure.states + 1) * structure.basis.count;
    Workspace measuring;
    lay_out(measuring, structure);
    block_.resize(measuring.used() / sizeof(Line) + 1);
    Workspace workspace(block_[0].bytes);
    lay_out(workspace, structure);
    sums_.products = Products<T>(width_, width_);
    sums_.gradient.resize(std::size_t(width_));
  }

  int width() const { return width_; }
  StateSums<T>& sums() { return sums_; }

  // Simulates `length` samples of inputs (length, inputs) from the state x0; y may have gaps (NaN).
  // Writes the states, (length, states), unless `states` is nullptr.
  void run(const T* u, const T* y, int length, const T* theta, const T* x0, bool sensitivities,
           T* states = nullptr) {
    clear();
    const StateStructure<T>& s = model_.structure();
    const int n = s.states;
    for (int i = 0; i < n; ++i) x_[i] = x0[i];
    for (int i = 0; i < n * width_; ++i) sensitivity_[i] = T(0);
    for (int i = 0; i < n; ++i) sensitivity_[i * width_ + s.parameters() + i] = T(1);
    for (int t = 0; t < length; ++t) {
      for (int i = 0; states != nullptr && i < n; ++i) states[t * n + i] = x_[i];
      const T free = model_.evaluate(theta, x_, u + t * s.inputs);
      const T own = clamp(free, lower_, upper_);
      if (sensitivities) {
        model_.linearise(theta);
        model_.propagate(theta, sensitivity_, psi_);
        if (further_ != nullptr) add_further(x_, u + t * s.inputs, psi_);
      }
      const T error = y[t] - own;
      if (is_finite(error)) {
        sums_.error += error * error;
        ++sums_.count;
        if (sensitivities && own == free) {
          add_scaled(sums_.gradient.data(), psi_, error, width_);
          sums_.products.add(psi_);
        }
      }
      for (int i = 0; i < n; ++i) x_[i] = model_.next()[i];
    }
  }

 private:
  struct alignas(Workspace::alignment) Line {
    std::byte bytes[Workspace::alignment];
  };

  // Adds the direct effects of the candidate curve's weights at this sample.
  void add_further(const T* x, const T* u, T* psi) {
    const StateStructure<T>& s = model_.structure();
    T z = T(0);
    for (int i = 0; i < s.states; ++i) z += further_[i] * x[i];
    for (int j = 0; j < s.inputs; ++j) z += further_[s.states + j] * u[j];
    const LocalBasis<T> local = s.basis.evaluate(z);
    const int first = s.parameters() + s.states + local.first;
    for (int i = 0; i <= s.states; ++i) {
      T* row = i < s.states ? sensitivity_ + i * width_ : psi;
      for (int k = 0; k < 3; ++k) row[first + i * s.basis.count + k] += local.value[k];
    }
  }

  void clear() {
    sums_.products.clear();
    for (T& value : sums_.gradient) value = T(0);
    sums_.error = T(0);
    sums_.count = 0;
  }

  void lay_out(Workspace& workspace, const StateStructure<T>& structure) {
    model_.layout(workspace, structure, width_);
    x_ = workspace.take<T>(structure.states);
    sensitivity_ = workspace.take<T>(structure.states * width_);
    psi_ = workspace.take<T>(width_);
  }

  int width_ = 0;
  const T* further_;
  T lower_, upper_;
  std::vector<Line> block_;
  StateSpace<T> model_;
  T* x_ = nullptr;
  T* sensitivity_ = nullptr;
  T* psi_ = nullptr;
  StateSums<T> sums_;
};

}  // namespace leglab::identification

// Regressor of a model that is linear in its parameters, made of blocks of features.
#pragma once

#include "identification/basis.h"
#include "identification/ud_factor.h"
#include "identification/workspace.h"

namespace leglab::identification {

enum class Feature : int {
  lags,         // x(t - lag), x(t - lag - 1), ...
  constant,     // 1
  spline,       // N_i(x(t - lag)), optionally times another signal at a lag
  hammerstein,  // n(t - lag), n(t - lag - 1), ... with n = sum_i w_i N_i(x)
  term,         // g(x(t - lag)), optionally of the change of x and times another signal at a lag
};

// g of a term, with d = x - at.
enum class Curve : int {
  power,  // x^degree
  hinge,  // max(d, 0)
  sign,   // q / (q + 1/2) with s = |d| / width and q = s (s + 1/2), and the sign of d
};

// Signal 0 is the output, whose lags start at 1; signals 1, 2, ... are the inputs.
template <class T>
struct Block {
  Feature feature = Feature::constant;
  int signal = 0;
  int lag = 0;
  int lags = 1;  // number of lags, for lags and hammerstein
  QuadraticBasis<T> basis;
  int factor_signal = -1;  // for spline and term; -1: none
  int factor_lag = 0;
  T learning_constant = T(0);  // for hammerstein
  Curve curve = Curve::power;  // for term, like all fields below
  int degree = 1;
  T at = T(0);
  T width = T(1);
  bool change = false;  // whether the argument of g is x(t - lag) - x(t - lag - 1)

  int count() const {
    return feature == Feature::spline ? basis.count : feature == Feature::constant ? 1 : lags;
  }
  int locals() const {
    const bool one = feature == Feature::spline || feature == Feature::term;
    return one ? 1 : feature == Feature::hammerstein ? lags : 0;
  }
  int weights() const { return feature == Feature::hammerstein ? basis.count : 0; }
  int deepest() const {
    const int last = feature == Feature::constant ? 0
                     : feature == Feature::spline ? lag : lag + lags - 1 + change;
    return factor_signal >= 0 ? larger(last, factor_lag) : last;
  }

  // Computes g and its slope at x.
  void bend(T x, T& value, T& slope) const {
    const T d = x - at;
    switch (curve) {
      case Curve::power:
        slope = T(degree);
        for (int k = 1; k < degree; ++k) slope *= x;
        value = slope * x / T(degree);
        break;
      case Curve::hinge:
        slope = d > T(0) ? T(1) : T(0);
        value = slope * d;
        break;
      case Curve::sign: {
        const T s = magnitude(d) / width, q = s * (s + T(0.5)), share = T(0.5) / (q + T(0.5));
        value = d < T(0) ? share - T(1) : T(1) - share;
        slope = T(2) * share * share * (T(2) * s + T(0.5)) / width;
        break;
      }
    }
  }
};

template <class T>
struct Structure {
  const Block<T>* blocks = nullptr;  // owned by the caller
  int block_count = 0;
  int inputs = 1;

  const Block<T>* begin() const { return blocks; }
  const Block<T>* end() const { return blocks + block_count; }

  int parameters() const { return sum(&Block<T>::count); }
  int weights() const { return sum(&Block<T>::weights); }
  int locals() const { return sum(&Block<T>::locals); }
  // Number of past samples: the largest lag in use.
  int depth() const {
    int most = 1;
    for (const Block<T>& block : *this) most = larger(most, block.deepest());
    return most;
  }

 private:
  int sum(int (Block<T>::*measure)() const) const {
    int total = 0;
    for (const Block<T>& block : *this) total += (block.*measure)();
    return total;
  }
};

// Past of all signals: x(t - lag) at [lag].
template <class T>
struct History {
  int depth = 0;
  T* output = nullptr;  // [0] is not used
  T* inputs = nullptr;

  T at(int signal, int lag) const {
    return signal == 0 ? output[lag] : inputs[(signal - 1) * (depth + 1) + lag];
  }
};

template <class T>
class Features {
 public:
  void layout(Workspace& workspace, const Structure<T>& structure) {
    structure_ = structure;
    phi_ = workspace.take<T>(structure.parameters());
    local_ = workspace.take<LocalBasis<T>>(structure.locals());
    support_ = workspace.take<int>(structure.parameters());
  }

  const T* phi() const { return phi_; }
  Support support() const { return {support_, nonzero_}; }

  // Number of splines in the last build whose input was outside their knots.
  int clipped() const { return clipped_; }

  // Fills the regressor; `weights`: weights of the hammerstein blocks.
  template <bool Slopes = false>
  void build(const History<T>& past, const T* weights) {
    LocalBasis<T>* local = local_;
    int at = 0, nonzero = 0;
    const auto set = [&](int index, T value) {
      phi_[index] = value;
      support_[nonzero++] = index;
    };
    clipped_ = 0;
    for (const Block<T>& block : structure_) {
      const QuadraticBasis<T>& basis = block.basis;
      switch (block.feature) {
        case Feature::constant: set(at, T(1)); break;
        case Feature::lags:
          for (int k = 0; k < block.lags; ++k) set(at + k, past.at(block.signal, block.lag + k));
          break;
        case Feature::spline: {
          for (int i = 0; i < 3; ++i) phi_[at + local->first + i] = T(0);
          basis.template evaluate<Slopes>(past.at(block.signal, block.lag), *local);
          clipped_ += local->clipped;
          const T factor =
              block.factor_signal < 0 ? T(1) : past.at(block.factor_signal, block.factor_lag);
          for (int i = 0; i < 3; ++i) set(at + local->first + i, local->value[i] * factor);
          ++local;
          break;
        }
        case Feature::hammerstein:
          for (int k = 0; k < block.lags; ++k, ++local) {
            basis.evaluate(past.at(block.signal, block.lag + k), *local);
            clipped_ += local->clipped;
            T sum = T(0);
            for (int i = 0; i < 3; ++i) sum += weights[local->first + i] * local->value[i];
            set(at + k, sum);
          }
          weights += basis.count;
          break;
        case Feature::term: {
          T x = past.at(block.signal, block.lag);
          if (block.change) x -= past.at(block.signal, block.lag + 1);
          block.bend(x, local->value[0], local->slope[0]);
          const T factor =
              block.factor_signal < 0 ? T(1) : past.at(block.factor_signal, block.factor_lag);
          set(at, local->value[0] * factor);
          ++local;
          break;
        }
      }
      at += block.count();
    }
    nonzero_ = nonzero;
  }

  // Names the invalid part of a state read from outside; returns nullptr if the state is valid.
  const char* fault() const {
    const LocalBasis<T>* local = local_;
    for (const Block<T>& block : structure_) {
      for (int k = 0; k < block.locals(); ++k, ++local) {
        if (block.feature == Feature::term) continue;
        if (local->first < 0 || local->first > block.basis.count - 3) return "place of a spline";
      }
    }
    return nullptr;
  }

  // Returns theta^T phi.
  T predict(const T* theta) const {
    T sum = T(0);
    for (int k = 0; k < nonzero_; ++k) sum += theta[support_[k]] * phi_[support_[k]];
    return sum;
  }

  // Writes d (theta^T phi) / d y(t - lag) at [lag], for lag 1 ... depth; after build<true>.
  void output_slopes(const T* theta, const History<T>& past, T* slope) const {
    for (int k = 0; k <= past.depth; ++k) slope[k] = T(0);
    const LocalBasis<T>* local = local_;
    for (const Block<T>& block : structure_) {
      if (block.feature == Feature::lags && block.signal == 0) {
        for (int k = 0; k < block.lags; ++k) slope[block.lag + k] += theta[k];
      } else if (block.feature == Feature::spline) {
        T rise = T(0), value = T(0);
        for (int i = 0; i < 3; ++i) {
          rise += theta[local->first + i] * local->slope[i];
          value += theta[local->first + i] * local->value[i];
        }
        const bool plain = block.factor_signal < 0;
        if (block.signal == 0) {
          slope[block.lag] += plain ? rise : rise * past.at(block.factor_signal, block.factor_lag);
        }
        if (block.factor_signal == 0) slope[block.factor_lag] += value;
      } else if (block.feature == Feature::term) {
        const bool plain = block.factor_signal < 0;
        if (block.signal == 0) {
          const T factor = plain ? T(1) : past.at(block.factor_signal, block.factor_lag);
          const T rise = theta[0] * local->slope[0] * factor;
          slope[block.lag] += rise;
          if (block.change) slope[block.lag + 1] -= rise;
        }
        if (block.factor_signal == 0) slope[block.factor_lag] += theta[0] * local->value[0];
      }
      theta += block.count();
      local += block.locals();
    }
  }

  // Writes d (theta^T phi) / d weights of the hammerstein blocks.
  void weight_slopes(const T* theta, T* slope) const {
    const LocalBasis<T>* local = local_;
    for (const Block<T>& block : structure_) {
      if (block.feature == Feature::hammerstein) {
        for (int i = 0; i < block.basis.count; ++i) slope[i] = T(0);
        for (int k = 0; k < block.lags; ++k) {
          for (int i = 0; i < 3; ++i) slope[local[k].first + i] += theta[k] * local[k].value[i];
        }
        slope += block.basis.count;
      }
      theta += block.count();
      local += block.locals();
    }
  }

 private:
  Structure<T> structure_;
  int nonzero_ = 0;
  int clipped_ = 0;
  T* phi_ = nullptr;
  LocalBasis<T>* local_ = nullptr;
  int* support_ = nullptr;
};

}  // namespace leglab::identification

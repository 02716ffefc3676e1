// Best-fitting magnitude of every fault of a bank, and the probabilities of the faults.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "monitor/moments.h"

namespace leglab::monitor {

// Shifts of a map's parameters due to one fault, piecewise linear in the fault's magnitude. The
// arrays are constants of the caller, possibly in read-only memory. `Shift` is double or float.
template <class Shift>
struct FaultCurve {
  int nodes = 0;                  // number of tabulated magnitudes (nodes), the healthy one first
  const double* sizes = nullptr;  // magnitudes, strictly monotone, (nodes)
  const Shift* shifts = nullptr;  // for all nodes but the healthy one, (nodes - 1, joints, parameters)
};

// Weighted least squares fit of every fault's magnitude, for a few curves per call of `advance`. On
// a linear piece D(t) = D_0 + t (D_1 - D_0) of a curve the cost sum_j w_j sum (y - phi D_j(t))^2,
// with the outputs y, regressors phi and weight w_j of joint j, is a parabola in t. So the minimum
// within [0, 1] has a closed form.
template <class Shift>
class FaultFit {
 public:
  // most_curves: largest number of curves of a bank.
  FaultFit(int joints, int parameters, int most_curves)
      : weight_(std::size_t(joints)), packed_(std::size_t(parameters * together)),
        size_(std::size_t(most_curves)), spread_(size_), cost_(size_) {}

  // Starts a fit. moments: of outputs minus predictions of the map before the fault; normal: mean
  // squared errors before it, (joints); discrepancy: see `Moments::weight`; joint: the only joint
  // used, or -1 for all. Curves and moments must not change until `advance` returns true.
  void begin(const FaultCurve<Shift>* curves, int count, const Moments& moments,
             const double* normal, double discrepancy, int joint = -1) {
    curves_ = curves;
    count_ = count;
    done_ = 0;
    moments_ = &moments;
    without_ = noise_ = 0.0;
    for (int j = 0; j < moments.joints(); ++j) {
      const bool counts = joint < 0 || j == joint;
      const double weight = counts ? moments.weight(j, normal[j], discrepancy) : 0.0;
      weight_[std::size_t(j)] = weight;
      without_ += weight * moments.power(j);
      noise_ += weight * moments.count(j) * normal[j];
    }
  }

  // Fits the next `curves` curves; returns true once all are fitted.
  bool advance(int curves) {
    for (; curves > 0 && done_ < count_; --curves, ++done_) fit(curves_[done_], std::size_t(done_));
    return done_ == count_;
  }

  int curves() const { return count_; }
  double without() const { return without_; }  // weighted sum of squared errors without any fault
  double noise() const { return noise_; }      // expected value of `without()` for an unchanged machine
  const double* size() const { return size_.data(); }
  const double* spread() const { return spread_.data(); }  // change of magnitude that adds 1 to the cost
  const double* cost() const { return cost_.data(); }      // weighted squared errors with the fault

  // Index of the curve that fits best.
  int best() const {
    return int(std::min_element(cost_.begin(), cost_.begin() + count_) - cost_.begin());
  }

 private:
  static constexpr int together = 4;  // number of nodes whose `Forms` are computed at a time

  // Weighted sums over the joints for neighbouring nodes k with shifts D_k: of D_k' c, of D_k' G D_k
  // and of D_k' G D_{k+1}, with the joint's correlation c and information G (`Moments`).
  struct Forms {
    double linear[together] = {}, square[together] = {}, cross[together] = {};
  };

  void fit(const FaultCurve<Shift>& curve, std::size_t place) {
    const int shifted = curve.nodes - 1;
    double best = -std::numeric_limits<double>::infinity();
    double linear = 0.0, square = 0.0;  // forms at a piece's first node; 0 at the healthy node
    for (int first = 0; first < shifted;) {
      // The last node of the previous group is repeated for its cross form with the next node.
      const int lead = first > 0 ? 1 : 0;
      const int number = std::min(shifted - first + lead, together);
      const Forms forms = forms_of(curve, first - lead, number);
      for (int k = lead; k < number; ++k) {
        const double cross = k > 0 ? forms.cross[k - 1] : 0.0;
        const double rise = forms.linear[k] - linear - (cross - square);
        const double bend = std::max(square - 2.0 * cross + forms.square[k], 1e-300);
        const double share = std::clamp(rise / bend, 0.0, 1.0);
        const double gain = 2.0 * (linear + share * (forms.linear[k] - linear)) -
                            (square + 2.0 * share * (cross - square) + share * share * bend);
        if (gain > best) {
          best = gain;
          const double* end = curve.sizes + first + (k - lead) + 1;
          const double width = end[0] - end[-1];
          size_[place] = end[-1] + share * width;
          spread_[place] = std::abs(width) / std::sqrt(bend);
        }
        linear = forms.linear[k];
        square = forms.square[k];
      }
      first += number - lead;
    }
    cost_[place] = std::max(without_ - best, 0.0);
  }

  Forms forms_of(const FaultCurve<Shift>& curve, int first, int number) {
    Forms sum;
    for (int joint = 0; joint < moments_->joints(); ++joint) {
      if (weight_[std::size_t(joint)] == 0.0 || !pack(curve, first, number, joint)) continue;
      switch (number) {
        case 1: add_forms<1>(joint, sum); break;
        case 2: add_forms<2>(joint, sum); break;
        case 3: add_forms<3>(joint, sum); break;
        default: add_forms<together>(joint, sum);
      }
    }
    return sum;
  }

  // Packs a joint's shifts of some nodes as (parameters, number); returns false if all are zero.
  bool pack(const FaultCurve<Shift>& curve, int first, int number, int joint) {
    const int parameters = moments_->parameters();
    const Shift* shifts = curve.shifts + (first * moments_->joints() + joint) * parameters;
    bool any = false;
    for (int k = 0; k < number; ++k, shifts += moments_->joints() * parameters) {
      for (int i = 0; i < parameters; ++i) {
        packed_[std::size_t(i * number + k)] = double(shifts[i]);
        any |= shifts[i] != Shift(0);
      }
    }
    return any;
  }

  // For vectors d and e, d' G d = 2 d' U d and d' G e = d' U e + e' U d, with U the upper triangle of G
  // with half its diagonal. So one half of G is multiplied once per node. The function is not inlined,
  // because its sums would then run out of registers.
  template <int number>
  [[gnu::noinline]] void add_forms(int joint, Forms& sum) const {
    const int parameters = moments_->parameters();
    const double weight = weight_[std::size_t(joint)];
    const double* row = moments_->information(joint);
    const double* correlation = moments_->correlation(joint);
    Forms own;
    const auto add = [&](int i, const double* image) {
      const double* shift = packed_.data() + i * number;
      for (int k = 0; k < number; ++k) {
        own.linear[k] += shift[k] * correlation[i];
        own.square[k] += shift[k] * image[k];
        if (k > 0) own.cross[k - 1] += shift[k - 1] * image[k] + shift[k] * image[k - 1];
      }
    };
    int i = 0;
    for (; i + 1 < parameters; row += 2 * (parameters - i) - 1, i += 2) {
      // Two rows of U are multiplied at a time, so that each shift is read once for both.
      const double* next = row + parameters - i - 1;
      const double* shift = packed_.data() + i * number;
      double image[number], image_next[number];
      for (int k = 0; k < number; ++k) {
        image[k] = 0.5 * row[0] * shift[k] + row[1] * shift[number + k];
        image_next[k] = 0.5 * next[1] * shift[number + k];
      }
      for (int j = 2; j < parameters - i; ++j) {
        for (int k = 0; k < number; ++k) {
          image[k] += row[j] * shift[j * number + k];
          image_next[k] += next[j] * shift[j * number + k];
        }
      }
      add(i, image);
      add(i + 1, image_next);
    }
    if (i < parameters) {
      const double* shift = packed_.data() + i * number;
      double image[number];
      for (int k = 0; k < number; ++k) image[k] = 0.5 * row[0] * shift[k];
      add(i, image);
    }
    for (int k = 0; k < number; ++k) {
      sum.linear[k] += weight * own.linear[k];
      sum.square[k] += 2.0 * weight * own.square[k];
      sum.cross[k] += weight * own.cross[k];
    }
  }

  const FaultCurve<Shift>* curves_ = nullptr;
  int count_ = 0, done_ = 0;
  const Moments* moments_ = nullptr;
  double without_ = 0.0, noise_ = 0.0;
  std::vector<double> weight_, packed_, size_, spread_, cost_;
};

// Relative uncertainty of the noise's share of a cost.
constexpr double noise_doubt = 0.2;

// Computes the probability of every key, (keys), from the least cost among the curves with that
// key. The residual of the best fault is partly noise, which averages out with more samples, and
// partly model error, which does not. Noise gives a likelihood of known variance. Model error gives
// one of unknown variance, cost^(-n/2) with n = `independent` errors. For each key, of these two
// the likelihood closer to the best key's is used; for n = 0, the likelihood of noise.
// correlation: number of correlated samples with the information of one. noise: part of every cost due
// to noise, clipped to the least cost; subtracted before the unknown variance is estimated, because the
// noise of joints without information would otherwise hide differences.
// key: number that identifies the fault and element of a cost.
inline void chances(const double* cost, const int* key, int count, double correlation,
                    double independent, double noise, double* chance, int keys) {
  std::fill_n(chance, keys, std::numeric_limits<double>::infinity());
  for (int i = 0; i < count; ++i) chance[key[i]] = std::min(chance[key[i]], cost[i]);
  const double least = *std::min_element(chance, chance + keys);
  noise = std::min(noise, least);
  const auto beyond = [noise](double value) {
    return value - noise + std::max(noise_doubt * noise, 1e-300);
  };
  double sum = 0.0;
  for (int k = 0; k < keys; ++k) {
    double unlikely = (chance[k] - least) / (2.0 * correlation);
    if (independent > 0.0) {
      const double structure = 0.5 * independent * std::log(beyond(chance[k]) / beyond(least));
      unlikely = std::min(unlikely, structure);
    }
    chance[k] = std::exp(-unlikely);
    sum += chance[k];
  }
  for (int k = 0; k < keys; ++k) chance[k] /= sum;
}

}  // namespace leglab::monitor

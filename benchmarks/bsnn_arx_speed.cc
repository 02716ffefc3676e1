// Time per sample of the paper's model (8 splines, na = nb = 3): the core against a bare loop of
// the same arithmetic. A library for bsnn_arx_speed.py, which takes the times.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "identification/bsnn_arx.h"

namespace id = leglab::identification;

namespace {

// Everything fixed at compile time, nothing guarded, the gain as a full matrix (Eqs. 5 to 12).
struct Bare {
  double theta[6] = {}, gain[6][6] = {}, phi[6] = {}, w[12] = {}, bias = 0.1;
  Bare() {
    for (int i = 0; i < 6; ++i) gain[i][i] = 5.6;
    for (int i = 2; i < 10; ++i) w[i] = 0.1;
  }
  double update(double u, double y) {
    const double s = std::clamp(u, 0.0, 0.8) * 12.5;
    const int interval = std::min(int(s), 9);
    const double x = s - interval, r = 1 - x;
    double value[3] = {0.5 * r * r, 0.5 + x * r, 0.5 * x * x}, n = bias;
    for (int k = 0; k < 3; ++k) {
      const int i = interval + k;  // two unused weights at each end
      value[k] = (i >= 2) & (i < 10) ? value[k] : 0;
      n += w[i] * value[k];
    }
    phi[5] = phi[4];
    phi[4] = phi[3];
    phi[3] = n;
    // One sample later than Eq. 3: the arithmetic is the same.
    double prediction = 0, power = 0, spread[6];
    for (int i = 0; i < 6; ++i) prediction += theta[i] * phi[i];
    for (int i = 0; i < 6; ++i) {
      spread[i] = 0;
      for (int j = 0; j < 6; ++j) spread[i] += gain[i][j] * phi[j];
    }
    for (int i = 0; i < 6; ++i) power += spread[i] * phi[i];
    const double scale = 1 / (1 + power), error = y - prediction;
    for (int i = 0; i < 6; ++i) {
      const double k = spread[i] * scale;
      for (int j = 0; j < 6; ++j) gain[i][j] -= k * spread[j];
      theta[i] += k * error;
    }
    for (int k = 0; k < 3; ++k) {
      const int i = interval + k;
      w[i] += 0.14 * value[k] * (y - n) * (1 - std::abs(w[i]));
    }
    bias += 0.14 * (y - n) * (1 - std::abs(bias));
    phi[2] = phi[1];
    phi[1] = phi[0];
    phi[0] = -y;
    return prediction;
  }
};

template <class T>
struct Core {
  Core(int splines, int na, int nb) : extended(std::size_t(splines) + 7) {
    std::vector<T> knots;
    for (int i = 0; i < splines + 3; ++i) knots.push_back(T(0.8) * T(i) / T(splines + 2));
    id::BsnnArxSettings<T> settings;
    settings.na = na;
    settings.nb = nb;
    settings.network.basis[0] =
        id::make_basis<T>(knots.data(), splines + 3, extended.data(), false);
    settings.network.learning_constant[0] = T(0.14);
    settings.rls.initial_gain = T(5.6);
    id::Workspace measure;
    model.layout(measure, settings);
    block = static_cast<std::byte*>(std::aligned_alloc(64, (measure.used() + 63) / 64 * 64));
    id::Workspace workspace(block);
    model.layout(workspace, settings);
  }
  ~Core() { std::free(block); }
  double update(double u, double y) {
    const T input = T(u);
    return double(model.update(&input, T(y)));
  }
  std::vector<T> extended;
  std::byte* block;
  id::BsnnArx<T> model;
};

template <class Model>
double pass(Model& model, const double* u, const double* y, int samples) {
  double sum = 0;
  for (int t = 0; t < samples; ++t) sum += model.update(u[t], y[t]);
  return sum;
}

}  // namespace

// One pass over the samples with a fresh model; the sum of predictions keeps the work alive.
extern "C" double bare(const double* u, const double* y, int samples) {
  Bare model;
  return pass(model, u, y, samples);
}

extern "C" double core_double(const double* u, const double* y, int samples, int splines,
                              int parameters) {
  Core<double> model(splines, parameters / 2, parameters / 2);
  return pass(model, u, y, samples);
}

extern "C" double core_float(const double* u, const double* y, int samples, int splines,
                             int parameters) {
  Core<float> model(splines, parameters / 2, parameters / 2);
  return pass(model, u, y, samples);
}

// Dense recursive least squares (Eqs. 6 to 8) over given regressors, (samples, count), and no more.
extern "C" double bare_rls(const double* phi, const double* y, int samples, int count) {
  std::vector<double> theta(count), spread(count), gain(std::size_t(count) * count);
  for (int i = 0; i < count; ++i) gain[std::size_t(i) * count + i] = 1e4;
  double sum = 0;
  for (int t = 0; t < samples; ++t) {
    const double* x = phi + std::size_t(t) * count;
    double prediction = 0, power = 0;
    for (int i = 0; i < count; ++i) {
      const double* row = gain.data() + std::size_t(i) * count;
      double along = 0;
      for (int j = 0; j < count; ++j) along += row[j] * x[j];
      spread[i] = along;
      prediction += theta[i] * x[i];
      power += along * x[i];
    }
    const double scale = 1 / (1 + power), error = y[t] - prediction;
    for (int i = 0; i < count; ++i) {
      double* row = gain.data() + std::size_t(i) * count;
      const double k = spread[i] * scale;
      for (int j = 0; j < count; ++j) row[j] -= k * spread[j];
      theta[i] += k * error;
    }
    sum += prediction;
  }
  return sum;
}

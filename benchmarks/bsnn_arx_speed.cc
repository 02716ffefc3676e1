// Time per sample of the paper's model (8 splines, na = nb = 3): the core against a bare loop of
// the same arithmetic, and the core's cost against the number of splines and of parameters.
// Prints lines "name size nanoseconds"; run by bsnn_arx_speed.py.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <random>
#include <vector>

#include "identification/bsnn_arx.h"

namespace id = leglab::identification;

namespace {

constexpr int samples = 20000;

struct Data {
  std::vector<double> u, y;
};

Data make_data() {
  std::mt19937 generator(1);
  std::uniform_real_distribution<double> uniform(0.0, 0.8);
  Data data{std::vector<double>(samples), std::vector<double>(samples)};
  for (int t = 0; t < samples; ++t) {
    data.u[t] = uniform(generator);
    data.y[t] = t < 2 ? 0 : 1.2 * data.y[t - 1] - 0.5 * data.y[t - 2] + 0.1 * std::tanh(data.u[t]);
  }
  return data;
}

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

double sink = 0;

// Least of several passes: what disturbs a pass can only make it slower.
template <class Make>
double nanoseconds(const Data& data, Make make, int passes = 15) {
  double best = 1e300;
  for (int pass = 0; pass < passes; ++pass) {
    auto model = make();
    const auto start = std::chrono::steady_clock::now();
    for (int t = 0; t < samples; ++t) sink += model->update(data.u[t], data.y[t]);
    const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - start;
    best = std::min(best, spent.count() / samples);
  }
  return best;
}

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

}  // namespace

int main() {
  const Data data = make_data();
  for (int repeat = 0; repeat < 3; ++repeat) {
    std::printf("bare 6 %.2f\n", nanoseconds(data, [] { return std::make_unique<Bare>(); }));
    std::printf("core_double 6 %.2f\n",
                nanoseconds(data, [] { return std::make_unique<Core<double>>(8, 3, 3); }));
    std::printf("core_float 6 %.2f\n",
                nanoseconds(data, [] { return std::make_unique<Core<float>>(8, 3, 3); }));
  }
  for (int splines : {8, 16, 32, 64, 128, 256, 512}) {
    std::printf("splines %d %.2f\n", splines, nanoseconds(data, [&] {
                  return std::make_unique<Core<double>>(splines, 3, 3);
                }, 5));
  }
  for (int n : {4, 6, 8, 12, 16, 24, 32, 48, 64, 96}) {
    std::printf("rls %d %.2f\n", n, nanoseconds(data, [&] {
                  return std::make_unique<Core<double>>(8, n / 2, n / 2);
                }, 5));
  }
  return sink == 42 ? 1 : 0;
}

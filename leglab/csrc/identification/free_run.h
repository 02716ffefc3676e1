// Free run of a model over stretches of a record, each started from measured samples, and the sums
// for a Gauss-Newton step and for the ranking of candidate features.
#pragma once

#include <cstddef>
#include <vector>

#include "identification/features.h"
#include "identification/products.h"

namespace leglab::identification {

// Scaled signals: the output, which may have gaps (NaN), and the inputs, concatenated.
template <class T>
struct Record {
  const T* output = nullptr;
  const T* inputs = nullptr;
  int samples = 0;
};

// Sums over samples, with psi = d y / d theta of the simulated output y. theta has `width`
// parameters: those of the model, then those of candidate features, which are zero.
template <class T>
struct Sums {
  Products<T> products;     // (width, parameters): sum of psi_i psi_j
  std::vector<T> gradient;  // (width): sum of psi_i (y measured - y)
  std::vector<T> squares;   // lower triangles of sum of psi_i psi_j within each candidate block
  T error = T(0);           // sum of squared errors
  std::size_t count = 0;    // number of samples
};

template <class T>
class FreeRun {
 public:
  FreeRun(const Structure<T>& model, const Structure<T>& further, T lower, T upper)
      : model_(model), further_(further), lower_(lower), upper_(upper) {
    depth_ = larger(model.depth(), further.depth());
    parameters_ = model.parameters();
    width_ = parameters_ + further.parameters();
    Workspace measuring;
    lay_out(measuring);
    block_.resize(measuring.used() / sizeof(Line) + 1);
    Workspace workspace(block_[0].bytes);
    lay_out(workspace);
    std::size_t triangles = 0;
    for (const Block<T>& block : further_) triangles += triangle(block.count());
    sums_.squares.resize(triangles);
    sums_.products = Products<T>(width_, parameters_);
    sums_.gradient.resize(std::size_t(width_));
  }

  int depth() const { return depth_; }
  int width() const { return width_; }
  int parameters() const { return parameters_; }
  Sums<T>& sums() { return sums_; }

  void clear() {
    sums_.products.clear();
    for (auto* part : {&sums_.gradient, &sums_.squares}) {
      for (T& value : *part) value = T(0);
    }
    sums_.error = T(0);
    sums_.count = 0;
  }

  // Simulates samples start ... start + length - 1 (start >= depth) and adds to the sums; the sums of
  // psi grow only if `sensitivities` is true.
  void run(const Record<T>& record, int start, int length, const T* theta, bool sensitivities) {
    const int inputs = model_.inputs;
    for (int k = 1; k <= depth_; ++k) past_.output[k] = record.output[start - k];
    for (int j = 0; j < inputs; ++j) {
      for (int k = 1; k <= depth_; ++k) {
        past_.inputs[j * (depth_ + 1) + k - 1] = record.inputs[j * record.samples + start - k];
      }
    }
    for (int i = 0; i < (depth_ + 1) * width_; ++i) psi_[i] = T(0);
    newest_ = 0;
    for (int t = start; t < start + length; ++t) {
      for (int j = 0; j < inputs; ++j) {
        push(past_.inputs + j * (depth_ + 1), depth_, record.inputs[j * record.samples + t]);
      }
      const T own = step(theta, sensitivities);
      const T error = record.output[t] - own;
      if (is_finite(error)) {
        sums_.error += error * error;
        ++sums_.count;
        if (sensitivities) add(error);
      }
      past_.output[0] = own;
      push(past_.output, depth_, own);
    }
  }

 private:
  struct alignas(Workspace::alignment) Line {
    std::byte bytes[Workspace::alignment];
  };
  static std::size_t triangle(int n) { return std::size_t(n) * std::size_t(n + 1) / 2; }

  void lay_out(Workspace& workspace) {
    features_.layout(workspace, model_);
    further_features_.layout(workspace, further_);
    past_.depth = depth_;
    past_.output = workspace.take<T>(depth_ + 1);
    past_.inputs = workspace.take<T>((depth_ + 1) * model_.inputs);
    slope_ = workspace.take<T>(depth_ + 1);
    psi_ = workspace.take<T>(width_ * (depth_ + 1));
  }

  // Returns the model's output at this sample; fills its sensitivities:
  // psi(t) = phi(t) + sum_k d y(t) / d y(t - k) psi(t - k), zero if the output is clamped.
  T step(const T* theta, bool sensitivities) {
    if (sensitivities) features_.template build<true>(past_, nullptr);
    else features_.build(past_, nullptr);
    const T free = features_.predict(theta);
    const T own = clamp(free, lower_, upper_);
    if (!sensitivities) return own;
    newest_ = newest_ == 0 ? depth_ : newest_ - 1;
    T* psi = psi_ + newest_ * width_;
    if (own != free) {
      for (int i = 0; i < width_; ++i) psi[i] = T(0);
      return own;
    }
    features_.output_slopes(theta, past_, slope_);
    for (int i = 0; i < parameters_; ++i) psi[i] = features_.phi()[i];
    if (width_ > parameters_) {
      further_features_.build(past_, nullptr);
      for (int i = parameters_; i < width_; ++i) psi[i] = further_features_.phi()[i - parameters_];
    }
    // Adds the rows of the ring buffer after the newest one, then the rows before it.
    const int after = depth_ - newest_;
    add_rows(psi, psi + width_, slope_ + 1, after, width_);
    add_rows(psi, psi_, slope_ + 1 + after, newest_, width_);
    drop_beyond(T(1e12), psi, width_);  // larger sensitivities, of an unstable model, are useless
    return own;
  }

  void add(T error) {
    const T* psi = psi_ + newest_ * width_;
    add_scaled(sums_.gradient.data(), psi, error, width_);
    sums_.products.add(psi);
    const T* own = psi + parameters_;
    T* squares = sums_.squares.data();
    for (const Block<T>& block : further_) {
      const int count = block.count();
      for (int i = 0; i < count; ++i) {
        for (int j = 0; j <= i; ++j) *squares++ += own[i] * own[j];
      }
      own += count;
    }
  }

  Structure<T> model_, further_;
  T lower_, upper_;
  int depth_ = 0, parameters_ = 0, width_ = 0, newest_ = 0;
  std::vector<Line> block_;
  Features<T> features_, further_features_;
  History<T> past_;
  T* slope_ = nullptr;
  T* psi_ = nullptr;  // [row][parameter], a ring buffer of rows
  Sums<T> sums_;
};

}  // namespace leglab::identification

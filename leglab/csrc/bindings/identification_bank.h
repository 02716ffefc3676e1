// A bank of identifiers of the same structure, one per joint, as one Python object.
#pragma once

#include <cstring>
#include <memory>
#include <new>
#include <string>

#include "bindings/identification_models.h"

namespace leglab::bindings {

template <class Model, class Settings, class T>
class Bank {
 public:
  Bank(nb::object settings, int joints) {
    settings_ = read_settings(settings, store_, static_cast<const Model*>(nullptr));
    id::Workspace measure;
    Model().layout(measure, settings_);
    stride_ = (measure.used() + id::Workspace::alignment - 1) / id::Workspace::alignment;
    block_ = std::make_unique<Line[]>(stride_ * std::size_t(joints));
    models_.resize(std::size_t(joints));
    for (int j = 0; j < joints; ++j) {
      id::Workspace workspace(memory() + std::size_t(j) * stride_ * sizeof(Line));
      models_[std::size_t(j)].layout(workspace, settings_);
    }
  }

  // A bank cannot be copied, because its models point into its memory block and its settings.
  Bank(const Bank&) = delete;
  Bank& operator=(const Bank&) = delete;

  double update(double u, double y) {
    const T input = T(u);
    return double(models_[0].update(&input, T(y)));
  }

  // Takes one sample of every joint; with a single joint u has all its inputs and y is one number.
  void update_many(Input u, Input y, Output prediction) {
    if (u.size() != models_.size() * inputs() || y.size() != models_.size()) {
      throw nb::type_error("wrong number of values");
    }
    sweep(u.data(), y.data(), prediction.data(), 1);
  }
  double update_row(Input u, double y) {
    if (models_.size() != 1 || u.size() != inputs()) throw nb::type_error("wrong size");
    double prediction;
    sweep(u.data(), &y, &prediction, 1);
    return prediction;
  }

  // Predicts the next output for inputs u, (joints, inputs), without taking a sample.
  void peek(Input u, Output prediction) {
    T input[id::GuardSettings<T>::max_inputs];
    for (std::size_t j = 0; j < models_.size(); ++j) {
      for (std::size_t i = 0; i < inputs(); ++i) input[i] = T(u.data()[j * inputs() + i]);
      prediction.data()[j] = double(models_[j].peek(input));
    }
  }

  // u: (samples, joints, inputs), y and prediction: (samples, joints).
  void run(Input u, Input y, Output prediction) {
    nb::gil_scoped_release release;
    sweep(u.data(), y.data(), prediction.data(), int(y.shape(0)));
  }

  // As `run`, but also writes every joint's parameters after each sample: (samples, joints, count).
  void run_recorded(Input u, Input y, Output prediction, Output trajectory) {
    double* to = trajectory.data();
    for (std::size_t t = 0; t < y.shape(0); ++t) {
      const std::size_t at = t * models_.size();
      sweep(u.data() + at * inputs(), y.data() + at, prediction.data() + at, 1);
      for (Model& model : models_) to = copy_parameters(model, to);
    }
  }

  // Predicts with frozen parameters; afterwards the history and all other state are restored.
  // The first `given` predictions are the measured outputs. Then the history takes the model's
  // predictions in a free run, otherwise the measured outputs (prediction one step ahead).
  void simulate(Input u, Input y, Output prediction, int given, bool free_run) {
    const nb::bytes before = state();
    const int samples = int(prediction.shape(0));
    const std::size_t joints = models_.size(), width = inputs();
    T input[id::GuardSettings<T>::max_inputs];
    for (std::size_t j = 0; j < joints; ++j) {
      for (int t = 0; t < samples; ++t) {
        const std::size_t at = std::size_t(t) * joints + j;
        for (std::size_t i = 0; i < width; ++i) input[i] = T(u.data()[at * width + i]);
        T predicted = models_[j].predict_next(input);
        if (t < given) predicted = T(y.data()[at]);
        prediction.data()[at] = double(predicted);
        models_[j].remember(free_run || t < given ? predicted : T(y.data()[at]));
      }
    }
    set_state(before);
  }

  void freeze(bool frozen) {
    for (auto& model : models_) model.guard().state().frozen = frozen;
  }
  bool frozen() { return models_[0].guard().state().frozen; }

  nb::bytes state() const {
    return nb::bytes(reinterpret_cast<const char*>(block_.get()), state_size());
  }
  std::size_t state_size() const { return stride_ * models_.size() * sizeof(Line); }
  void set_state(nb::bytes state) {
    if (state.size() != state_size()) throw std::invalid_argument("state of another size");
    std::memcpy(block_.get(), state.c_str(), state_size());
  }
  // Sets a state read from outside; an invalid state is rejected without changing anything.
  void load_state(nb::bytes state) {
    const nb::bytes before = this->state();
    set_state(state);
    for (std::size_t j = 0; j < models_.size(); ++j) {
      if (const char* fault = models_[j].fault()) {
        set_state(before);
        throw std::invalid_argument(std::string(fault) + " of joint " + std::to_string(j));
      }
    }
  }

  int parameter_count() {
    int count = 0;
    visit_parameters(models_[0], [&](T&) { ++count; });
    return count;
  }
  // Parameters of all joints, (joints, parameters).
  Made parameters() {
    const std::size_t count = std::size_t(parameter_count());
    std::vector<double> out(models_.size() * count);
    double* to = out.data();
    for (Model& model : models_) to = copy_parameters(model, to);
    return array_of(std::move(out), {models_.size(), count});
  }
  void set_parameters(Input in) {
    const double* from = in.data();
    for (Model& model : models_) visit_parameters(model, [&](T& value) { value = T(*from++); });
  }

  // Full gain matrix of the least squares of one joint, (n, n).
  Made gain(int joint) {
    const auto& factor = models_[std::size_t(joint)].rls().gain();
    const int n = factor.size();
    std::vector<double> out;
    const auto u = [&](int i, int j) {
      return i == j ? 1.0 : i > j ? 0.0 : double(factor.upper()[j * (j - 1) / 2 + i]);
    };
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        double sum = 0;
        for (int k = std::max(i, j); k < n; ++k) sum += u(i, k) * double(factor.diagonal()[k]) * u(j, k);
        out.push_back(sum);
      }
    }
    return array_of(std::move(out), {std::size_t(n), std::size_t(n)});
  }
  void hold_alarm(int joint) { models_[std::size_t(joint)].rls().hold_alarm(); }
  void set_gain(int joint, Input in) {
    auto& factor = models_[std::size_t(joint)].rls().gain();
    const std::size_t n = std::size_t(factor.size());
    if (in.size() != n * n) throw nb::value_error("wrong number of values");
    const std::vector<T> full(in.data(), in.data() + n * n);
    factor.assign(full.data());
  }

  bool project_poles(double radius) {
    bool moved = false;
    for (auto& model : models_) {
      if constexpr (requires { model.project_poles(T(radius)); }) {
        moved |= model.project_poles(T(radius));
      }
    }
    return moved;
  }

  nb::dict diagnostics(int joint) { return describe(models_[std::size_t(joint)]); }

  std::vector<Model*> models() {
    std::vector<Model*> out;
    for (Model& model : models_) out.push_back(&model);
    return out;
  }
  std::size_t inputs() const { return std::size_t(models_[0].inputs()); }

 private:
  struct alignas(id::Workspace::alignment) Line {
    std::byte bytes[id::Workspace::alignment];
  };
  std::byte* memory() { return reinterpret_cast<std::byte*>(block_.get()); }

  void sweep(const double* u, const double* y, double* prediction, int samples) {
    const std::size_t width = inputs();
    for (int t = 0; t < samples; ++t) {
      for (auto& model : models_) {
        if constexpr (std::is_same_v<T, double>) {
          *prediction++ = model.update(u, *y++);
        } else {
          T input[id::GuardSettings<T>::max_inputs];
          for (std::size_t i = 0; i < width; ++i) input[i] = T(u[i]);
          *prediction++ = double(model.update(input, T(*y++)));
        }
        u += width;
      }
    }
  }

  static double* copy_parameters(Model& model, double* out) {
    visit_parameters(model, [&](T& value) { *out++ = double(value); });
    return out;
  }

  Settings settings_;
  Store<T> store_;
  std::size_t stride_ = 0;
  std::unique_ptr<Line[]> block_;
  std::vector<Model> models_;
};

}  // namespace leglab::bindings

// Python module rigs._native.rough_bench: the simulator of the rough self-test.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <stdexcept>
#include <string>

#include "rough_bench.h"

namespace nb = nanobind;

namespace leglab::bindings {
namespace {

using studies::RoughParameters;
using Values = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

RoughParameters parameters(const nb::dict& values) {
  RoughParameters p;
  for (const auto& [key, value] : values) {
    const std::string name = nb::cast<const char*>(key);
    double* place = nullptr;
#define X(field, nominal) \
  if (name == #field) place = &p.field;
    LEGLAB_ROUGH_PARAMETERS(X)
#undef X
    if (!place) throw nb::key_error(name.c_str());
    *place = nb::cast<double>(value);
  }
  return p;
}

nb::dict nominal() {
  const RoughParameters p;
  nb::dict values;
#define X(field, nominal) values[#field] = p.field;
  LEGLAB_ROUGH_PARAMETERS(X)
#undef X
  return values;
}

nb::object array(const std::vector<double>& values) {
  double* data = new double[values.size()];
  std::copy(values.begin(), values.end(), data);
  nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<1>>(data, {values.size()}, owner));
}

nb::tuple tuple(const studies::RoughTrace& trace) {
  return nb::make_tuple(array(trace.position), array(trace.command), array(trace.pressure_a),
                        array(trace.pressure_b));
}

void check_steps(double period, int steps) {
  if (!(period > 0.0) || steps < 1) throw nb::value_error("period and steps must be positive");
}

nb::tuple follow(const nb::dict& values, Values reference, Values position_noise, Values noise_a,
                 Values noise_b, double period, int steps) {
  check_steps(period, steps);
  const std::size_t count = reference.size();
  if (count < 2 || position_noise.size() != count || noise_a.size() != count ||
      noise_b.size() != count) {
    throw nb::value_error("arrays of different shapes");
  }
  const RoughParameters p = parameters(values);
  studies::RoughTrace trace;
  {
    nb::gil_scoped_release release;
    trace = studies::run(p, period, steps, reference.data(), nullptr, position_noise.data(),
                         noise_a.data(), noise_b.data(), count);
  }
  return tuple(trace);
}

nb::tuple play(const nb::dict& values, double angle, Values command, double period, int steps) {
  check_steps(period, steps);
  if (command.size() < 2) throw nb::value_error("a command needs two samples or more");
  const std::size_t count = command.size();
  const std::vector<double> zero(count, 0.0), start(count, angle);
  return tuple(studies::run(parameters(values), period, steps, start.data(), command.data(),
                            zero.data(), zero.data(), zero.data(), count));
}

nb::object derivative(const nb::dict& values, double t, Values state, double command) {
  if (state.size() != studies::kStates) throw nb::value_error("wrong number of states");
  studies::RoughVector y;
  std::copy(state.data(), state.data() + state.size(), y.begin());
  const auto d = studies::RoughEquations(parameters(values)).derivative(t, y, command);
  return array({d.begin(), d.end()});
}

// From a state through a held command: the states after each step, one row a step.
nb::object integrate(const nb::dict& values, Values state, double command, double step, int count) {
  if (state.size() != studies::kStates) throw nb::value_error("wrong number of states");
  const studies::RoughEquations equations(parameters(values));
  studies::RoughVector y;
  std::copy(state.data(), state.data() + state.size(), y.begin());
  std::vector<double> rows;
  for (int i = 0; i < count; ++i) {
    y = equations.step(i * step, y, command, step);
    rows.insert(rows.end(), y.begin(), y.end());
  }
  return array(rows);
}

nb::object rest(const nb::dict& values, double angle) {
  const auto y = studies::RoughEquations(parameters(values)).rest(angle);
  return array({y.begin(), y.end()});
}

// A bench that a closed loop steps from outside.
class Plant {
 public:
  Plant(const nb::dict& values, double step) : core_(parameters(values), step) {
    if (!(step > 0.0)) throw nb::value_error("the step must be positive");
  }
  void start(double angle) { core_.start(angle); }
  void change(const nb::dict& values) { core_.change(parameters(values)); }
  double advance(double command, int steps) {
    core_.advance(command, steps);
    return core_.seen(0.0);
  }

 private:
  studies::RoughPlant core_;
};

}  // namespace

NB_MODULE(rough_bench, module) {
  nb::class_<Plant>(module, "Plant")
      .def(nb::init<nb::dict, double>(), nb::arg("parameters"), nb::arg("step"))
      .def("start", &Plant::start, nb::arg("angle"))
      .def("change", &Plant::change, nb::arg("parameters"))
      .def("advance", &Plant::advance, nb::arg("command"), nb::arg("steps"));
  module.def("nominal", &nominal);
  module.def("follow", &follow, nb::arg("parameters"), nb::arg("reference"),
             nb::arg("position_noise"), nb::arg("noise_a"), nb::arg("noise_b"), nb::arg("period"),
             nb::arg("steps"));
  module.def("play", &play, nb::arg("parameters"), nb::arg("angle"), nb::arg("command"),
             nb::arg("period"), nb::arg("steps"));
  module.def("derivative", &derivative, nb::arg("parameters"), nb::arg("time"), nb::arg("state"),
             nb::arg("command"));
  module.def("integrate", &integrate, nb::arg("parameters"), nb::arg("state"), nb::arg("command"),
             nb::arg("step"), nb::arg("count"));
  module.def("rest", &rest, nb::arg("parameters"), nb::arg("angle"));
}

}  // namespace leglab::bindings

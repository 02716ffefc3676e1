// Python module leglab._native.identification: banks of identifiers, and feed-forward with them.
#include "bindings/identification_bank.h"

namespace leglab::bindings {

void bind_feedforward(nb::module_& module);  // feedforward.cc

namespace {

template <class B>
void bind_bank(nb::module_& module, const char* name) {
  nb::class_<B>(module, name)
      .def(nb::init<nb::object, int>(), nb::arg("settings"), nb::arg("joints"))
      .def("update", &B::update, nb::arg("u"), nb::arg("y"))
      .def("update_row", &B::update_row)
      .def("update_many", &B::update_many)
      .def("peek", &B::peek)
      .def("run", &B::run)
      .def("run_recorded", &B::run_recorded)
      .def("simulate", &B::simulate)
      .def("freeze", &B::freeze)
      .def_prop_ro("frozen", &B::frozen)
      .def("state", &B::state)
      .def("set_state", &B::set_state)
      .def("load_state", &B::load_state)
      .def_prop_ro("parameter_count", &B::parameter_count)
      .def("parameters", &B::parameters)
      .def("set_parameters", &B::set_parameters)
      .def("gain", &B::gain)
      .def("hold_alarm", &B::hold_alarm)
      .def("set_gain", &B::set_gain)
      .def("project_poles", &B::project_poles)
      .def("diagnostics", &B::diagnostics)
      .def_prop_ro("inputs", &B::inputs);
}

template <class T>
using BsnnArxBank = Bank<id::BsnnArx<T>, id::BsnnArxSettings<T>, T>;

template <class T>
using SplineNarxBank = Bank<id::SplineNarx<T>, id::SplineNarxSettings<T>, T>;

template <class T>
using SplineStateSpaceBank = Bank<id::SplineStateSpace<T>, id::SplineStateSpaceSettings<T>, T>;

}  // namespace

// Increase this number whenever the memory layout of any identifier changes; saved files contain it.
constexpr int state_version = 3;

NB_MODULE(identification, module) {
  module.attr("STATE_VERSION") = state_version;
  bind_bank<BsnnArxBank<double>>(module, "BsnnArx64");
  bind_bank<BsnnArxBank<float>>(module, "BsnnArx32");
  bind_bank<SplineNarxBank<double>>(module, "SplineNarx64");
  bind_bank<SplineNarxBank<float>>(module, "SplineNarx32");
  bind_bank<SplineStateSpaceBank<double>>(module, "SplineStateSpace64");
  bind_bank<SplineStateSpaceBank<float>>(module, "SplineStateSpace32");
  bind_feedforward(module);
}

}  // namespace leglab::bindings

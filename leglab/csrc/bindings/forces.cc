// Python module leglab._native.forces: forces of a MuJoCo model at instants of a motion; Python creates
// and owns the model. A diagnosis needs some million instants, and a loop in Python would take four
// times as long as MuJoCo itself.
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <new>

#include "bindings/arrays.h"
#include "bindings/quiet.h"

namespace leglab::bindings {
namespace {

// Rows of the results, one per instant; rejects rows of a wrong width.
struct Rows {
  double* first = nullptr;
  std::size_t width = 0;

  Rows(nb::dict out, const char* name, std::size_t moments, int size) : width(std::size_t(size)) {
    if (!out.contains(name)) return;
    auto array = nb::cast<Output>(out[name]);
    require_size(moments * width, array);
    first = array.data();
  }

  void put(std::size_t moment, const double* from) const {
    if (first) std::copy_n(from, width, first + moment * width);
  }
};

void at_moments(std::uintptr_t address, Input states, Input commands, Input accelerations,
                nb::dict out) {
  const mjModel* model = reinterpret_cast<const mjModel*>(address);
  const std::size_t moments = states.ndim() == 2 ? states.shape(0) : 0;
  const std::size_t nv = std::size_t(model->nv), nu = std::size_t(model->nu);
  const std::size_t size = std::size_t(mj_stateSize(model, mjSTATE_FULLPHYSICS));
  require_size(moments * size, states);
  require_size(moments * nu, commands);
  require_size(moments * nv, accelerations);
  const Rows lacking(out, "lacking", moments, model->nv), load(out, "load", moments, model->nv);
  const Rows bias(out, "bias", moments, model->nv), length(out, "length", moments, model->nu);
  const Rows speed(out, "speed", moments, model->nu), pull(out, "pull", moments, model->nu);
  const Rows inertia(out, "inertia", moments, model->nv * model->nv);

  const Quiet quiet;
  const nb::gil_scoped_release release;
  const std::unique_ptr<mjData, void (*)(mjData*)> owner(mj_makeData(model), mj_deleteData);
  if (!owner) throw std::bad_alloc();
  mjData* data = owner.get();
  for (std::size_t i = 0; i < moments; ++i) {
    mj_setState(model, data, states.data() + i * size, mjSTATE_FULLPHYSICS);
    std::copy_n(commands.data() + i * nu, nu, data->ctrl);
    const double* wanted = accelerations.data() + i * nv;
    const bool free = std::any_of(wanted, wanted + nv, [](double a) { return std::isnan(a); });
    mj_fwdPosition(model, data);
    mj_fwdVelocity(model, data);
    mj_fwdActuation(model, data);
    if (inertia.first) mj_fullM(model, data, inertia.first + i * inertia.width);
    load.put(i, data->qfrc_actuator);
    bias.put(i, data->qfrc_bias);
    length.put(i, data->actuator_length);
    speed.put(i, data->actuator_velocity);
    pull.put(i, data->actuator_force);
    if (!lacking.first) continue;
    if (free) {
      mj_fwdAcceleration(model, data);
      mj_fwdConstraint(model, data);
    }
    for (std::size_t k = 0; k < nv; ++k) {
      if (!std::isnan(wanted[k])) data->qacc[k] = wanted[k];
    }
    // Load-dependent friction uses the actuator forces of the previous step, which are known by now.
    mj_inverseSkip(model, data, mjSTAGE_POS, 1);
    double* left = lacking.first + i * nv;
    for (std::size_t k = 0; k < nv; ++k) left[k] = data->qfrc_inverse[k] - data->qfrc_actuator[k];
  }
}

}  // namespace

NB_MODULE(forces, module) {
  module.def("at_moments", &at_moments, nb::arg("model"), nb::arg("states"), nb::arg("commands"),
             nb::arg("accelerations"), nb::arg("out"));
}

}  // namespace leglab::bindings

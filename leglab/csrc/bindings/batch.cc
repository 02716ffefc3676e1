// Python module leglab._native.batch: control periods of many machines, in threads. A machine is a
// MuJoCo model and its data, which Python creates and owns. This module steps the machines and
// writes the next period's sensor readings and reference into arrays with one row per machine.
//
// Each thread has one mjData, into which it copies a machine's state and back. The states of hundreds
// of machines fit into the caches; with their whole mjData a step would take twice as long. Derived
// quantities in a machine's data (body positions, forces) are not updated. All models would not fit
// into the caches either, so machines with equal models are stepped with one copy of the model.
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <new>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/quiet.h"
#include "loop/sensing.h"
#include "loop/threads.h"

namespace leglab::bindings {
namespace {

struct Shape {
  int to_sample, to_command;  // time steps from command to sample, and from sample to command
  double speed_limit;         // joint speed at which a simulation counts as diverged [rad/s or m/s]
  loop::SensingSettings sensing;
};

// Inputs of one episode of one machine; rows are control periods.
struct Series {
  Input noise, shift, pressure_noise;      // (periods, joints) twice, (periods, pressures)
  Array<const bool> lost;                  // (periods, joints)
  Input position, velocity, acceleration;  // of the reference, (periods + ahead, joints)
};

bool same(const mjModel& a, const mjModel& b) {
  return a.nbuffer == b.nbuffer && std::memcmp(a.buffer, b.buffer, std::size_t(a.nbuffer)) == 0 &&
         std::memcmp(&a.opt, &b.opt, sizeof a.opt) == 0 &&
         std::memcmp(&a.stat, &b.stat, sizeof a.stat) == 0;
}

struct Machine {
  const mjModel* own = nullptr;    // the machine's model, which a scenario may change
  const mjModel* model = nullptr;  // model to step: `own` or the common copy
  mjData* data = nullptr;
  Series series;
  std::unique_ptr<loop::Sensing> sensing;
  std::vector<double> sample, pressures;
  std::size_t row = 0;
};

class Batch {
 public:
  Batch(std::size_t machines, int threads, nb::dict timing, Index qpos, Index dof, Input centre,
        Input half, Index pressures, std::int64_t supply, Index preview, nb::dict out)
      : shape_{nb::cast<int>(timing["to_sample"]), nb::cast<int>(timing["to_command"]),
               nb::cast<double>(timing["speed_limit"]),
               {qpos.size(), nb::cast<int>(timing["counts"]), nb::cast<double>(timing["gain"]),
                nb::cast<double>(timing["keep"])}},
        qpos_(std::move(qpos)), dof_(std::move(dof)), centre_(std::move(centre)),
        half_(std::move(half)), pressures_(std::move(pressures)), supply_(supply),
        preview_(std::move(preview)), joints_(qpos_.size()), machines_(machines),
        threads_(std::max(threads, 1)) {
    const auto rows = [&](const char* name, std::size_t width) {
      auto array = nb::cast<Output>(out[name]);
      require_size(machines * width, array);
      return array;
    };
    measured_ = rows("position", joints_);
    speed_ = rows("velocity", joints_);
    measured_pressure_ = rows("pressure", pressures_.size() + (pressures_.size() > 0));
    true_position_ = rows("true_position", joints_);
    true_velocity_ = rows("true_velocity", joints_);
    wanted_position_ = rows("reference_position", joints_);
    wanted_velocity_ = rows("reference_velocity", joints_);
    wanted_acceleration_ = rows("reference_acceleration", joints_);
    observation_ = nb::cast<Array<float>>(out["observation"]);
    diverged_ = nb::cast<Array<bool>>(out["diverged"]);
    require_size(joints_, dof_, centre_, half_);
    require_size(machines, diverged_);
    if (observation_.ndim() != 2 || observation_.shape(0) != machines ||
        observation_.shape(1) < written()) {
      throw nb::value_error("observations of another shape");
    }
  }

  // Begins an episode of a machine, whose model and data are in the initial state of a run.
  void start(std::size_t i, std::uintptr_t model, std::uintptr_t data, Input noise, Input shift,
             Array<const bool> lost, Input pressure_noise, Input position, Input velocity,
             Input acceleration) {
    Machine& m = machines_.at(i);
    m.own = reinterpret_cast<const mjModel*>(model);
    m.data = reinterpret_cast<mjData*>(data);
    if (!common_) common_.reset(mj_copyModel(nullptr, m.own));
    if (!common_) throw std::bad_alloc();
    choose_model(m);
    m.series = {noise, shift, pressure_noise, lost, position, velocity, acceleration};
    const std::size_t periods = noise.size() / joints_;
    require_size(periods * joints_, noise, shift, lost);
    require_size(periods * pressures_.size(), pressure_noise);
    require_size(position.size() / joints_ * joints_, position, velocity, acceleration);
    while (scratch_.size() < threads_.size()) {
      scratch_.emplace_back(mj_makeData(m.model), mj_deleteData);
      if (!scratch_.back()) throw std::bad_alloc();
    }
    require_inside(qpos_, std::size_t(m.model->nq));
    require_inside(dof_, std::size_t(m.model->nv));
    require_inside(pressures_, std::size_t(m.model->npluginstate));
    if (std::size_t(m.model->nu) != joints_) throw nb::value_error("another number of controls");
    const std::size_t at = i * joints_;
    m.sensing = std::make_unique<loop::Sensing>(shape_.sensing, measured_.data() + at,
                                                speed_.data() + at);
    m.sample.resize(joints_);
    m.pressures.resize(pressures_.size());
    m.row = 0;
    diverged_.data()[i] = false;
    sample(m, m.data);
    m.sensing->start(m.sample.data(), disturbance(m));
    look(i);
  }

  // Steps machines not flagged in `rests`, with commands (machines, joints), and begins their next
  // period. Machines flagged in `late` are measured later, after a change of their parameters.
  void step(Input commands, Array<const bool> late, Array<const bool> rests) {
    const std::size_t n = machines_.size();
    require_size(n * joints_, commands);
    require_size(n, late, rests);
    for (std::size_t i = 0; i < n; ++i) {
      if (!rests.data()[i] && (!machines_[i].sensing || !left(machines_[i]))) {
        throw nb::index_error("an episode that is over, or was not begun");
      }
    }
    const Quiet quiet;
    const nb::gil_scoped_release release;
    threads_.each(n, [&](std::size_t i, std::size_t thread) {
      if (i + threads_.size() < n) prefetch(machines_[i + threads_.size()]);
      if (rests.data()[i]) return;
      advance(i, commands.data() + i * joints_, scratch_[thread].get());
      if (!diverged_.data()[i] && !late.data()[i]) measure(i);
    });
  }

  // Measures a `late` machine after its parameters have changed.
  void measure_late(std::size_t i) {
    choose_model(machines_.at(i));
    measure(i);
  }

 private:
  // Reads the sensors of the present period and writes a machine's rows.
  void measure(std::size_t i) {
    Machine& m = machines_[i];
    const std::size_t at = i * joints_;
    m.sensing->read(m.sample.data(), disturbance(m));
    const std::size_t count = m.pressures.size();
    double* pressure = measured_pressure_.data() + i * (count + 1);
    for (std::size_t k = 0; k < count; ++k) {
      pressure[k] = m.pressures[k] + m.series.pressure_noise.data()[m.row * count + k];
    }
    if (count) pressure[count] = m.data->plugin_state[supply_];
    wanted(m.series.position, m.row, wanted_position_, at);
    wanted(m.series.velocity, m.row, wanted_velocity_, at);
    wanted(m.series.acceleration, m.row, wanted_acceleration_, at);

    float* out = observation_.data() + i * observation_.shape(1);
    const auto put = [&](const double* from, std::size_t number) {
      for (std::size_t k = 0; k < number; ++k) *out++ = float(from[k]);
    };
    put(measured_.data() + at, joints_);
    put(speed_.data() + at, joints_);
    if (count) put(pressure, count + 1);
    put(wanted_position_.data() + at, joints_);
    put(wanted_velocity_.data() + at, joints_);
    put(wanted_acceleration_.data() + at, joints_);
    for (std::size_t k = 0; k < preview_.size(); ++k) {
      put(row(m.series.position, m.row + std::size_t(preview_.data()[k])), joints_);
    }
  }

  void choose_model(Machine& m) const { m.model = same(*m.own, *common_) ? common_.get() : m.own; }

  std::size_t written() const {
    const std::size_t pressures = pressures_.size() ? pressures_.size() + 1 : 0;
    return joints_ * (5 + preview_.size()) + pressures;
  }

  bool left(const Machine& m) const { return (m.row + 1) * joints_ < m.series.noise.size(); }

  const double* row(const Input& from, std::size_t number) const {
    const std::size_t last = from.size() / joints_ - 1;
    return from.data() + std::min(number, last) * joints_;
  }

  void wanted(const Input& from, std::size_t number, Output& to, std::size_t at) const {
    std::copy_n(row(from, number), joints_, to.data() + at);
  }

  loop::Disturbance disturbance(const Machine& m) const {
    const std::size_t first = m.row * joints_;
    // The first reading is never lost, because no earlier reading could be repeated.
    const bool* lost = m.row > 0 ? m.series.lost.data() + first : nullptr;
    return {m.series.noise.data() + first, m.series.shift.data() + first, lost};
  }

  void sample(Machine& m, const mjData* data) const {
    for (std::size_t j = 0; j < joints_; ++j) m.sample[j] = data->qpos[qpos_.data()[j]];
    for (std::size_t k = 0; k < m.pressures.size(); ++k) {
      m.pressures[k] = data->plugin_state[pressures_.data()[k]];
    }
  }

  // Prefetches the plugin state, most of a machine's state, while another machine steps.
  static void prefetch(const Machine& m) {
    if (!m.model) return;
    constexpr int line = 64 / sizeof(mjtNum);
    for (int k = 0; k < int(m.model->npluginstate); k += line) {
      __builtin_prefetch(m.data->plugin_state + k, 1);
    }
  }

  void advance(std::size_t i, const double* command, mjData* data) {
    Machine& m = machines_[i];
    for (std::size_t j = 0; j < joints_; ++j) {
      const double u = std::clamp(command[j], -1.0, 1.0);
      m.data->ctrl[j] = centre_.data()[j] + half_.data()[j] * u;
    }
    mj_copyState(m.model, m.data, data, mjSTATE_INTEGRATION);
    for (int k = 0; k < shape_.to_sample; ++k) mj_step(m.model, data);
    sample(m, data);
    for (int k = 0; k < shape_.to_command; ++k) mj_step(m.model, data);
    mj_copyState(m.model, data, m.data, mjSTATE_INTEGRATION);
    ++m.row;
    look(i);
  }

  // Writes the true motion, and whether the simulation diverged (also for NaN).
  void look(std::size_t i) {
    const Machine& m = machines_[i];
    const double* v = m.data->qvel;
    diverged_.data()[i] = !std::all_of(v, v + m.model->nv, [this](double speed) {
      return std::abs(speed) < shape_.speed_limit;
    });
    for (std::size_t j = 0; j < joints_; ++j) {
      true_position_.data()[i * joints_ + j] = m.data->qpos[qpos_.data()[j]];
      true_velocity_.data()[i * joints_ + j] = v[dof_.data()[j]];
    }
  }

  Shape shape_;
  Index qpos_, dof_;
  Input centre_, half_;
  Index pressures_;
  std::int64_t supply_;
  Index preview_;
  std::size_t joints_;
  Output measured_, speed_, measured_pressure_, true_position_, true_velocity_;
  Output wanted_position_, wanted_velocity_, wanted_acceleration_;
  Array<float> observation_;
  Array<bool> diverged_;
  std::vector<Machine> machines_;
  std::unique_ptr<mjModel, void (*)(mjModel*)> common_{nullptr, mj_deleteModel};
  std::vector<std::unique_ptr<mjData, void (*)(mjData*)>> scratch_;  // one per thread
  loop::Threads threads_;
};

}  // namespace

NB_MODULE(batch, module) {
  nb::class_<Batch>(module, "Batch")
      .def(nb::init<std::size_t, int, nb::dict, Index, Index, Input, Input, Index,
                    std::int64_t, Index, nb::dict>(),
           nb::arg("machines"), nb::arg("threads"), nb::arg("timing"), nb::arg("qpos"),
           nb::arg("dof"), nb::arg("centre"), nb::arg("half"), nb::arg("pressures"),
           nb::arg("supply"), nb::arg("preview"), nb::arg("out"))
      .def("start", &Batch::start, nb::arg("machine"), nb::arg("model"), nb::arg("data"),
           nb::arg("noise"), nb::arg("shift"), nb::arg("lost"), nb::arg("pressure_noise"),
           nb::arg("position"), nb::arg("velocity"), nb::arg("acceleration"))
      .def("step", &Batch::step, nb::arg("commands"), nb::arg("late"), nb::arg("rests"))
      .def("measure", &Batch::measure_late, nb::arg("machine"));
}

}  // namespace leglab::bindings

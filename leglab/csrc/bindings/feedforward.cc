// Adaptive feed-forward and valve maps of leglab._native.identification. The banks of learners of
// the same module are in another source file, so that the two compile independently.
#include <nanobind/stl/array.h>

#include "bindings/identification_bank.h"
#include "feedforward/adaptive.h"
#include "loop/threads.h"

namespace leglab::bindings {
namespace {

namespace ff = feedforward;

using SplineNarxBank64 = Bank<id::SplineNarx<double>, id::SplineNarxSettings<double>, double>;

using Numbers = std::vector<double>;

// Valve tables of all joints, with the storage of the values that they point to.
class ValveTables {
 public:
  explicit ValveTables(const nb::dict& parts)
      : commands_(get<Numbers>(parts, "command")), shares_(get<Numbers>(parts, "share")) {
    const Numbers start = get<Numbers>(parts, "start"), spacing = get<Numbers>(parts, "spacing");
    tables_.resize(start.size());
    for (std::size_t j = 0; j < tables_.size(); ++j) {
      ff::ValveTable& table = tables_[j];
      table.columns = int(shares_.size());
      table.rows = int(commands_.size() / (tables_.size() * shares_.size()));
      table.start = start[j];
      table.spacing = spacing[j];
      table.speed = shares_.data();
      table.commands = commands_.data() + j * std::size_t(table.rows * table.columns);
    }
  }

  ValveTables(const ValveTables&) = delete;
  ValveTables& operator=(const ValveTables&) = delete;

  const std::vector<ff::ValveTable>& tables() const { return tables_; }
  std::size_t joints() const { return tables_.size(); }

 private:
  Numbers commands_, shares_;
  std::vector<ff::ValveTable> tables_;
};

// Commands by calibrated valve maps; beyond the ends of a map, the commands at its ends.
class ValveMaps {
 public:
  explicit ValveMaps(const nb::dict& parts) : tables_(parts), full_speed_(get<Numbers>(parts, "full_speed")) {}

  void command(Input position, Input velocity, Output out) const {
    const auto& tables = tables_.tables();
    require_size(tables.size(), position, velocity, out);
    for (std::size_t j = 0; j < tables.size(); ++j) {
      const double share = std::clamp(velocity.data()[j] / full_speed_[j], -1.0, 1.0);
      out.data()[j] = tables[j].command(position.data()[j], share);
    }
  }

 private:
  ValveTables tables_;
  Numbers full_speed_;
};

// Data sheets of all joints' valves and cylinders; none if the settings have no "lever".
std::vector<ff::PressureValve> read_valves(const nb::dict& parts) {
  std::vector<ff::PressureValve> out;
  if (!parts.contains("lever")) return out;
  const Numbers lever = get<Numbers>(parts, "lever"), piston = get<Numbers>(parts, "piston");
  const std::size_t joints = get<Numbers>(parts, "stroke").size(), rows = lever.size() / joints;
  for (std::size_t j = 0; j < joints; ++j) {
    ff::CylinderSheet sheet;
    const auto row = [&](const Numbers& table) {
      return Numbers(table.begin() + std::ptrdiff_t(j * rows),
                     table.begin() + std::ptrdiff_t((j + 1) * rows));
    };
    sheet.lever = row(lever);
    sheet.piston = row(piston);
#define LEGLAB_SHEET(name) sheet.name = get<Numbers>(parts, #name)[j];
    LEGLAB_SHEET(area_a) LEGLAB_SHEET(area_b) LEGLAB_SHEET(dead_volume_a)
    LEGLAB_SHEET(dead_volume_b) LEGLAB_SHEET(stroke) LEGLAB_SHEET(orifice_gain)
    LEGLAB_SHEET(laminar_transition_pressure) LEGLAB_SHEET(lap) LEGLAB_SHEET(edge_rounding)
    LEGLAB_SHEET(supply_pressure) LEGLAB_SHEET(tank_pressure) LEGLAB_SHEET(bulk_modulus)
    LEGLAB_SHEET(entrained_air) LEGLAB_SHEET(polytropic_index) LEGLAB_SHEET(full_speed)
    LEGLAB_SHEET(position_start) LEGLAB_SHEET(position_step)
#undef LEGLAB_SHEET
    out.emplace_back(std::move(sheet));
  }
  return out;
}

ff::AdaptiveSettings read_adaptive(const nb::dict& settings) {
  ff::AdaptiveSettings out;
  LEGLAB_READ_4(control_period, interval, stop_time, limit)
  LEGLAB_READ_4(rate_limit, least_speed, saturation, greatest_acceleration)
  LEGLAB_READ_2(forward, supervised)
  LEGLAB_READ_3(trust_time, margin, noise)
  LEGLAB_READ_3(settle_time, proof_time, proof_horizon)
  LEGLAB_READ_2(proof_doubt, proof_noise)
  LEGLAB_READ_3(contest_time, contest_gather, contest_errors)
  LEGLAB_READ_2(contest_floor, contest_window)
  LEGLAB_READ_3(turn, state_step, state_time)
  LEGLAB_READ_2(state_doubt, state_noise)
  LEGLAB_READ_3(learn_lower, learn_upper, bandwidth)
  LEGLAB_READ_2(position_gain, velocity_gain)
  return out;
}

ff::MotionScale read_motion_scale(const nb::dict& settings) {
  ff::MotionScale out;
  LEGLAB_READ_3(centre, half_range, full_speed)
  LEGLAB_READ_2(acceleration, jerk)
  return out;
}

// `parts` holds the settings of leglab.control.feedforward.adaptive's `AdaptiveFeedforward`, its valve
// tables and values computed from both, as arrays and numbers by name; the front-end has checked them.
class Feedforward : ValveTables, public ff::AdaptiveFeedforward {
 public:
  explicit Feedforward(const nb::dict& parts)
      : ValveTables(parts),
        AdaptiveFeedforward(
            read_adaptive(parts), {read_motion_scale(parts), get<bool>(parts, "products")},
            {int(joints()), get<Numbers>(parts, "kernel")},
            {int(joints()), get<double>(parts, "control_period"), get<double>(parts, "lead"),
             get<double>(parts, "position_delay"), get<double>(parts, "velocity_delay")},
            tables(), read_valves(parts)) {}

  using ValveTables::joints;

  // The banks must outlive this object: Python keeps references to them. `loads` maps motion to load.
  void reset(SplineNarxBank64& bank, SplineNarxBank64* loads, SplineNarxBank64* slopes) {
    if (with_pressures() != (loads != nullptr)) throw nb::value_error("loads go with data sheets");
    const auto learners = [](SplineNarxBank64* some) {
      return some ? some->models() : std::vector<Learner*>{};
    };
    AdaptiveFeedforward::reset(bank.models(), learners(loads), learners(slopes));
  }

  // Rows of `out`, (5, joints): command, feed-forward, feedback, error of the model, and 1 if the
  // calibration replaces the learned map.
  void step(double time, Input measured, Input measured_velocity, Input position, Input velocity,
            Input acceleration, Output out, nb::object pressure_a, nb::object pressure_b,
            double supply_pressure) {
    const std::size_t n = joints();
    require_size(n, measured, measured_velocity, position, velocity, acceleration);
    require_size(reported * n, out);
    ff::Pressures pressures;
    Input a, b;
    if (with_pressures()) {
      a = nb::cast<Input>(pressure_a);
      b = nb::cast<Input>(pressure_b);
      require_size(n, a, b);
      pressures = {a.data(), b.data(), supply_pressure};
    }
    step(time, measured.data(), measured_velocity.data(),
         {position.data(), velocity.data(), acceleration.data()}, out.data(), pressures);
  }

  // Does the same as the other `step` without checks of sizes; `out` is (reported, joints).
  void step(double time, const double* measured, const double* measured_velocity,
            const ff::Reference& reference, double* out, const ff::Pressures& pressures) {
    const std::size_t n = joints();
    AdaptiveFeedforward::step(time, measured, measured_velocity, reference,
                              {out, out + n, out + 2 * n, out + 3 * n, out + 4 * n}, pressures);
  }

  static constexpr std::size_t reported = 5;

  // `valves` has shape (joints, 5), or is empty for the state in use.
  void propose(SplineNarxBank64& bank, double odds, double error, Input valves) {
    AdaptiveFeedforward::propose(bank.models(), odds, error, shapes(valves).data());
  }
  void revise(int contender, double error, Input valves) {
    AdaptiveFeedforward::revise(contender, error, shapes(valves).data());
  }
  std::vector<ff::ValveShape> valves() const {
    std::vector<ff::ValveShape> out;
    for (std::size_t j = 0; j < joints(); ++j) out.push_back(valve(j));
    return out;
  }
  int kept_count() const { return kept().count(); }

  // Moves the kept samples to the first rows of `out`, (capacity, joints, parameters + 3), and returns
  // their number.
  int take_kept(Output out) {
    ff::KeptSamples& kept = this->kept();
    const std::size_t count = std::size_t(kept.count()) * joints() * std::size_t(kept.width());
    if (out.size() < count) throw nb::value_error("too few rows for the kept samples");
    std::copy_n(kept.rows(), count, out.data());
    const int number = kept.count();
    kept.drop();
    return number;
  }

  void take_sent(Input command) {
    require_size(joints(), command);
    sent(command.data());
  }

 private:
  std::vector<ff::ValveShape> shapes(Input values) const {
    std::vector<ff::ValveShape> out(values.size() / std::tuple_size_v<ff::ValveShape>);
    if (values.size()) require_size(joints() * std::tuple_size_v<ff::ValveShape>, values);
    std::copy_n(values.data(), values.size(), out.empty() ? nullptr : out[0].data());
    return out;
  }
};

// Feed-forwards of many machines, stepped together in threads.
class Team {
 public:
  explicit Team(int threads) : threads_(std::max(threads, 1)) {}

  // Computes a control period of the machines whose indices in the arrays are `rows`: time
  // (machines,), pressures (machines, 2 joints + 1) or empty, the other arrays (machines, joints).
  // `sent` holds the last commands. Writes the results of `Feedforward::step` to `outs`, and their
  // command and feed-forward to the arrays.
  void step(const std::vector<Feedforward*>& cores, const std::vector<Output>& outs, Index rows,
            Input time, Input sent, Input measured, Input measured_velocity, Input position,
            Input velocity, Input acceleration, Input pressures, Output command,
            Output feedforward) {
    const std::size_t machines = time.size(), n = machines ? measured.size() / machines : 0;
    require_size(machines * n, sent, measured, measured_velocity, position, velocity, acceleration,
                 command, feedforward);
    require_size(cores.size(), outs, rows);
    require_inside(rows, machines);
    const std::size_t width = pressures.size() ? 2 * n + 1 : 0;
    for (std::size_t k = 0; k < cores.size(); ++k) {
      if (cores[k]->joints() != n) throw nb::value_error("machines of different joints");
      require_size(Feedforward::reported * n, outs[k]);
      if (cores[k]->with_pressures()) require_size(machines * (2 * n + 1), pressures);
    }
    const nb::gil_scoped_release release;
    threads_.each(cores.size(), [&](std::size_t k, std::size_t) {
      const std::size_t i = std::size_t(rows.data()[k]), at = i * n;
      const double* p = pressures.data() + i * width;
      double* out = outs[k].data();
      cores[k]->sent(sent.data() + at);
      cores[k]->step(time.data()[i], measured.data() + at, measured_velocity.data() + at,
                     {position.data() + at, velocity.data() + at, acceleration.data() + at}, out,
                     cores[k]->with_pressures() ? ff::Pressures{p, p + n, p[2 * n]}
                                                : ff::Pressures{});
      std::copy_n(out, n, command.data() + at);
      std::copy_n(out + n, n, feedforward.data() + at);
    });
  }

 private:
  loop::Threads threads_;
};

}  // namespace

void bind_feedforward(nb::module_& module) {
  nb::class_<Feedforward>(module, "Feedforward")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("reset", &Feedforward::reset, nb::arg("bank"), nb::arg("loads").none() = nb::none(),
           nb::arg("slopes").none() = nb::none(), nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(),
           nb::keep_alive<1, 4>())
      .def("step",
           nb::overload_cast<double, Input, Input, Input, Input, Input, Output, nb::object,
                             nb::object, double>(&Feedforward::step),
           nb::arg("time"), nb::arg("measured"),
           nb::arg("measured_velocity"), nb::arg("position"), nb::arg("velocity"),
           nb::arg("acceleration"), nb::arg("out"), nb::arg("pressure_a").none() = nb::none(),
           nb::arg("pressure_b").none() = nb::none(), nb::arg("supply_pressure") = 0.0)
      .def("sent", &Feedforward::take_sent)
      .def("keep", &Feedforward::keep)
      .def("kept", &Feedforward::kept_count)
      .def("take_kept", &Feedforward::take_kept)
      .def("freeze", &Feedforward::freeze)
      .def("propose", &Feedforward::propose, nb::arg("bank"), nb::arg("odds"), nb::arg("error"),
           nb::arg("valves"), nb::keep_alive<1, 2>())
      .def("valves", &Feedforward::valves)
      .def("revise", &Feedforward::revise, nb::arg("contender"), nb::arg("error"), nb::arg("valves"))
      .def("only", &Feedforward::only, nb::arg("contender"))
      .def("settle", &Feedforward::settle, nb::arg("winner"))
      .def("shares", &Feedforward::shares);
  nb::class_<Team>(module, "Team")
      .def(nb::init<int>(), nb::arg("threads"))
      .def("step", &Team::step, nb::arg("cores"), nb::arg("outs"), nb::arg("rows"),
           nb::arg("time"), nb::arg("sent"), nb::arg("measured"), nb::arg("measured_velocity"),
           nb::arg("position"), nb::arg("velocity"), nb::arg("acceleration"),
           nb::arg("pressures"), nb::arg("command"), nb::arg("feedforward"));
  nb::class_<ValveMaps>(module, "ValveMaps")
      .def(nb::init<nb::dict>(), nb::arg("parts"))
      .def("command", &ValveMaps::command);
}

}  // namespace leglab::bindings

// nanobind module of the hydraulics core: parameter tables, fluid laws, friction, spool and supply
// along a known motion, the continuous model and the fixed-step scheme on a free mass.
#include <cstring>
#include <span>

#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "bindings/arrays.h"
#include "hydraulics/continuous.h"
#include "hydraulics/supply.h"
#include "plugin/tables.h"

namespace leglab::bindings {
namespace {

using namespace hydraulics;

using Vector = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using ConstVector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using ConstMatrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

nb::list rows(std::span<const ParameterSpec> specs) {
  nb::list out;
  for (const auto& s : specs) {
    out.append(nb::make_tuple(s.name, s.unit, s.nominal, s.minimum, s.maximum, s.minimum_allowed,
                              s.description));
  }
  return out;
}

nb::list rows(std::span<const StateSpec> specs) {
  nb::list out;
  for (const auto& s : specs) out.append(nb::make_tuple(s.name, s.unit, s.description));
  return out;
}

void require(std::size_t got, std::size_t wanted, const char* what) {
  if (got != wanted) {
    throw nb::value_error((std::string(what) + " needs " + std::to_string(wanted) + " values, got " +
                           std::to_string(got)).c_str());
  }
}

template <class Table>
typename Table::Parameters parameters_of(const double* values, std::size_t count) {
  require(count, Table::parameter_count, Table::plugin);
  typename Table::Parameters p;
  std::memcpy(&p, values, sizeof p);
  return p;
}

// Steady sliding friction g at every sample by the law of a plugin. `carried` is the sum of the gauge
// pressures for the seals of a cylinder, and the joint's load for the friction of a joint.
void sliding_friction(const std::string& plugin, ConstVector parameters, ConstVector velocity,
                      ConstVector carried, ConstVector time, Vector out) {
  require_size(out.size(), velocity, carried, time);
  const auto fill = [&](auto law) {
    for (std::size_t k = 0; k < out.shape(0); ++k) {
      out.data()[k] = law(velocity.data()[k], carried.data()[k], time.data()[k]);
    }
  };
  if (plugin == CylinderTable::plugin) {
    const auto p = parameters_of<CylinderTable>(parameters.data(), parameters.shape(0));
    fill([&](double v, double pressures, double) { return bristle_level(p, v, pressures); });
  } else {
    const auto p = parameters_of<FrictionTable>(parameters.data(), parameters.shape(0));
    fill([&](double v, double load, double now) { return FrictionLevel::at(p, v, load, now).sliding; });
  }
}

// LuGre bristle deflection before each sample of a motion, zero at the start; velocity and steady
// friction are held over each sample.
void bristle(ConstVector velocity, ConstVector level, double sigma_0, double dt, Vector out) {
  require_size(velocity.size(), level, out);
  double z = 0;
  for (std::size_t k = 0; k < velocity.shape(0); ++k) {
    out.data()[k] = z;
    z = advance_bristle(z, velocity.data()[k], level.data()[k], sigma_0, dt);
  }
}

// Spool position and velocity at every sample of held commands, initially at rest at the first command.
void spool(ConstVector command, double natural_frequency, double damping_ratio, double dt, Matrix out) {
  require(out.shape(0), command.shape(0), "out rows");
  require(out.shape(1), 2, "out columns");
  const auto transition = SpoolTransition::over(dt, natural_frequency, damping_ratio);
  double x = command.shape(0) > 0 ? command.data()[0] : 0.0, v = 0;
  for (std::size_t k = 0; k < command.shape(0); ++k) {
    out.data()[2 * k] = x;
    out.data()[2 * k + 1] = v;
    transition.advance(command.data()[k], x, v);
  }
}

// Output of a play of full width `width`, initially in its middle (Krasnosel'skii and Pokrovskii
// 1989).
void play(ConstVector samples, double width, Vector out) {
  require_size(samples.size(), out);
  const double half = 0.5 * width;
  double value = out.shape(0) > 0 ? samples.data()[0] : 0.0;
  for (std::size_t k = 0; k < out.shape(0); ++k) {
    const double sample = samples.data()[k];
    value = std::min(std::max(value, sample - half), sample + half);
    out.data()[k] = value;
  }
}

// Supply pressure at every sample of a known motion, initially the compensator's set pressure.
// Rows of `parameters`, `spools`, `caps` and `rods` are the cylinders on this supply; spool and gauge
// pressures are interpolated linearly between samples.
void supply_pressure(ConstVector supply, ConstMatrix parameters, ConstMatrix spools, ConstMatrix caps,
                     ConstMatrix rods, double dt, std::int64_t substeps, Vector out) {
  const std::size_t cylinders = parameters.shape(0), samples = out.shape(0);
  const auto p = parameters_of<SupplyTable>(supply.data(), supply.shape(0));
  for (const ConstMatrix& series : {spools, caps, rods}) {
    require(series.shape(0), cylinders, "rows of series");
    require(series.shape(1), samples, "columns of series");
  }
  if (substeps < 1) throw nb::value_error("substeps must be at least 1");
  std::vector<CylinderParameters> own(cylinders);
  std::vector<CylinderCoefficients> coefficients;
  for (std::size_t i = 0; i < cylinders; ++i) {
    const std::size_t width = parameters.shape(1);
    own[i] = parameters_of<CylinderTable>(parameters.data() + i * width, width);
    coefficients.push_back(CylinderCoefficients::from(own[i]));
  }
  SupplyState s{};
  s.pressure_ = p.supply_pressure_;
  s.started_ = 1.0;
  const double step = dt / double(substeps);
  for (std::size_t k = 0; k < samples; ++k) {
    out.data()[k] = supply_pressure_now(p, s);
    if (k + 1 == samples) break;
    for (std::int64_t j = 0; j < substeps; ++j) {
      const double share = (double(j) + 0.5) / double(substeps);
      double demand = 0;
      for (std::size_t i = 0; i < cylinders; ++i) {
        const auto now = [&](const ConstMatrix& series) {
          const double* row = series.data() + i * samples;
          return row[k] + share * (row[k + 1] - row[k]);
        };
        const CylinderCoefficients& c = coefficients[i];
        demand += flows_at(c, {}, Edges::at(own[i], c, now(spools)), supply_pressure_now(p, s),
                           own[i].tank_pressure_, now(caps), now(rods)).supply;
      }
      advance_supply(p, demand, step, s);
    }
  }
}

// One cylinder, defined by its parameters in table order.
class CylinderModel {
 public:
  explicit CylinderModel(ConstVector parameters) {
    p_ = parameters_of<CylinderTable>(parameters.data(), parameters.shape(0));
    const std::string wrong = contradiction(p_);
    if (!wrong.empty()) throw nb::value_error(wrong.c_str());
    c_ = CylinderCoefficients::from(p_);
    oil_ = OilCondition::from(p_, c_);
  }

  void derivative(ConstVector state, double command, double supply_pressure, double mass, double load,
                  bool blocked, Vector out) const {
    require(state.shape(0), kContinuousCount, "state");
    require(out.shape(0), kContinuousCount, "out");
    continuous_derivative(p_, c_, oil_, {command, supply_pressure, mass, load, blocked}, state.data(),
                          out.data());
  }

  // Valve flows [m^3/s] into A and B and the leakage A -> B at steady pressures.
  std::tuple<double, double, double> flows(double spool, double supply_pressure, double pa, double pb) const {
    const CylinderFlows f =
        flows_at(c_, oil_, Edges::at(p_, c_, spool), supply_pressure, p_.tank_pressure_, pa, pb);
    return {f.a - f.leak - f.leak_a, f.b + f.leak - f.leak_b, f.leak};
  }

  // Runs the plugin's scheme on a free mass, with commands held over each step.
  // `out` has shape (n, 6): x, v, pA, pB, spool, bristle after each step.
  void simulate(ConstVector commands, double timestep, double supply_pressure, double mass, double load,
                double x0, double v0, double pa0, double pb0, Matrix out) const {
    require(out.shape(0), commands.shape(0), "out rows");
    require(out.shape(1), 6, "out columns");
    CylinderParameters p = p_;
    OilCondition oil = oil_;
    const StepCoefficients step = StepCoefficients::from(p, timestep);
    CylinderState s{};
    s.pressure_a_ = pa0;
    s.pressure_b_ = pb0;
    double x = x0, v = v0;
    for (std::size_t i = 0; i < commands.shape(0); ++i) {
      if (p.thermal_capacity_ > 0 || p.seal_wear_rate_ > 0) oil = OilCondition::from(p, c_);
      const Chambers k = chambers_at(p, c_, s, x);
      const PistonForces f = piston_forces(p, c_, oil, s, k, x, v, timestep / mass);
      const double next = v + timestep * (f.total() - load) / mass;
      advance_cylinder(p, c_, step, oil, k, {x, v, next, f.total(), f.pressure - f.total(), mass},
                       commands.data()[i], supply_pressure, s);
      v = next;
      x += timestep * v;
      const double row[6] = {x, v, s.pressure_a_, s.pressure_b_, s.spool_position_, s.bristle_};
      std::memcpy(out.data() + 6 * i, row, sizeof row);
    }
  }

  std::tuple<double, double> areas() const { return {c_.area_a, c_.area_b}; }
  std::tuple<double, double> volumes(double x) const {
    const Volumes v = Volumes::at(p_, c_, x);
    return {v.a, v.b};
  }
  double bulk_modulus(double gauge) const {
    return c_.oil.expand(std::max(gauge + kAtmosphere, kPressureFloor)).bulk_modulus();
  }
  double pressure_at(double relative_volume, double guess) const {
    return c_.oil.solve(relative_volume, guess + kAtmosphere).p - kAtmosphere;
  }
  double relative_volume(double gauge) const {
    return c_.oil.expand(std::max(gauge + kAtmosphere, kPressureFloor)).w;
  }
  double kinematic_viscosity(double celsius) const { return c_.viscosity.kinematic(celsius); }
  std::tuple<double, double, double, double> condition() const {
    return {oil_.internal_leakage, oil_.external_leakage_a, oil_.external_leakage_b, oil_.viscous};
  }
  double steady_friction(double v, double pa, double pb) const {
    if (v == 0) return 0;
    return std::copysign(bristle_level(p_, v, pa + pb), v) + oil_.viscous_at(v) * v;
  }

 private:
  CylinderParameters p_;
  CylinderCoefficients c_;
  OilCondition oil_;
};

}  // namespace

NB_MODULE(hydraulics, m) {
  m.def("parameter_tables", [] {
    nb::dict tables;
    for (const auto& t : plugin::kTables) {
      tables[t.plugin] = nb::make_tuple(rows(t.parameters), rows(t.states),
                                        std::vector<std::string>(t.texts.begin(), t.texts.end()));
    }
    return tables;
  });
  m.def("unit_at_slide", &plugin::unit_at_slide);
  m.def("sliding_friction", &sliding_friction);
  m.def("bristle", &bristle);
  m.def("play", &play);
  m.def("spool", &spool);
  m.def("supply_pressure", &supply_pressure);
  nb::class_<CylinderModel>(m, "CylinderModel")
      .def(nb::init<ConstVector>())
      .def("derivative", &CylinderModel::derivative)
      .def("simulate", &CylinderModel::simulate)
      .def("flows", &CylinderModel::flows)
      .def("areas", &CylinderModel::areas)
      .def("volumes", &CylinderModel::volumes)
      .def("bulk_modulus", &CylinderModel::bulk_modulus)
      .def("relative_volume", &CylinderModel::relative_volume)
      .def("pressure_at", &CylinderModel::pressure_at)
      .def("kinematic_viscosity", &CylinderModel::kinematic_viscosity)
      .def("condition", &CylinderModel::condition)
      .def("steady_friction", &CylinderModel::steady_friction);
}

}  // namespace leglab::bindings

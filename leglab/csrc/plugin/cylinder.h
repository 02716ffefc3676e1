// Actuator plugin `leglab.cylinder`: servovalve, cylinder, seals and oil of one joint.
#pragma once

#include <vector>

#include "hydraulics/play.h"
#include "hydraulics/step.h"
#include "plugin/lifecycle.h"

namespace leglab::plugin {

// In addition to the plugin state it keeps MuJoCo's ids, the outputs of the latest `compute`, and
// coefficients, which are computed anew whenever the parameters differ from `seen_`.
class Cylinder : public Instance<hydraulics::CylinderTable> {
 public:
  using Instance::slots;

  Cylinder(const mjModel* m, int instance);

  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d);
  void advance(const mjModel* m, mjData* d);
  void visualize(const mjModel* m, mjData* d, mjvScene* scene);

  // Chambers at the present lengths and amounts of oil; solved again only if these have changed.
  const hydraulics::Chambers& observe(const mjModel* m, mjData* d);
  // Piston position [m] at the latest `observe`.
  double piston_position() const { return x_; }

 private:
  void refresh(const mjModel* m, const hydraulics::CylinderParameters& p);
  double supply_pressure(const mjModel* m, mjData* d, const hydraulics::CylinderParameters& p) const;
  double effective_mass(const mjModel* m, mjData* d);
  void check_timestep(const mjModel* m) const;

  int actuator_ = -1;
  int supply_ = -1;    // instance of leglab.supply
  int residual_ = -1;  // instance of leglab.residual that adds to the command

  hydraulics::CylinderParameters seen_{};
  double seen_timestep_ = 0;
  hydraulics::CylinderCoefficients coefficients_{};
  hydraulics::StepCoefficients step_{};
  hydraulics::OilCondition oil_{};

  struct Observed {
    double x, pressure_a, pressure_b, amount_a, amount_b;
  };
  static constexpr Observed kNothing{__builtin_nan(""), 0, 0, 0, 0};
  Observed observed_ = kNothing;  // inputs for which `chambers_` were solved
  hydraulics::Chambers chambers_{};
  hydraulics::PistonForces forces_{};
  hydraulics::PlayStep play_{};
  double oil_spring_ = 0;  // stiffness of both chambers at the latest `compute` [N/m]
  double moved_ = 0;       // mass of the piston, plus the mechanism's if in contact with it [kg]
  double x_ = 0, v_ = 0, mass_ = 0, command_ = 0;
  std::vector<double> half_solved_;  // scratch, shape (nv,), zero between uses
};

}  // namespace leglab::plugin

// Passive plugin `leglab.residual`: a learned static force on a joint, or command offset of a cylinder.
#pragma once

#include <array>
#include <vector>

#include "plugin/lifecycle.h"

namespace leglab::plugin {

// bound(scale (s_1(position) + s_2(velocity) + s_3(load) + s_4(command))) with cubic B-splines s_i. Each
// input is clamped to the range of its knots, so that the splines do not extrapolate. The plugin state
// holds the coefficients after the named states, variable by variable.
class Residual : public Instance<ResidualTable> {
 public:
  static constexpr std::size_t kInputs = 4;
  static constexpr std::array<const char*, kInputs> kNames{"position", "velocity", "load", "command"};
  using Inputs = std::array<double, kInputs>;

  Residual(const mjModel* m, int instance);
  void reset(mjtNum* plugin_state) const;
  void compute(const mjModel* m, mjData* d);
  void advance(const mjModel* m, mjData* d);

  // The scaled and bounded sum of the splines at given inputs.
  double at(const mjModel* m, const mjData* d, const Inputs& inputs) const;

  // Instance that acts on a cylinder, -1 if no instance does; rejects several instances.
  static int of_cylinder(const mjModel* m, int actuator);
  // Length of the plugin state: parameters, states and coefficients.
  static int state_count(const mjModel* m, int instance);

 private:
  struct Spline {
    std::vector<double> knots;         // clamped: outermost knots with multiplicity four
    std::vector<double> coefficients;  // from MJCF; the plugin state holds the coefficients in use
  };
  static Spline spline_attribute(const mjModel* m, int instance, const char* variable);

  std::array<Spline, kInputs> splines_;
  int qpos_ = -1, dof_ = -1;  // addresses of the joint; -1 at a cylinder
  int actuator_ = -1;         // actuator whose command is an input of the joint's force
};

}  // namespace leglab::plugin

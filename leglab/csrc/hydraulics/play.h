// Play between rod end and pin, within which piston and mechanism move independently.
#pragma once

#include "cylinder.h"

namespace leglab::hydraulics {

inline constexpr double kFlankDamping = 0.5;  // damping ratio of a flank in contact, with reduced mass

// Position of the piston relative to its pin. Before the first step, and after a change of the
// play, the piston is in contact with the flank towards which the pressures push.
inline double play_offset(const CylinderParameters& p, const CylinderCoefficients& c,
                          const CylinderState& s) {
  if (p.play_ == 0.0) return 0.0;
  if (s.seated_play_ == p.play_) return s.play_offset_;
  return std::copysign(0.5 * p.play_, s.pressure_a_ * c.area_a - s.pressure_b_ * c.area_b);
}

struct PlayStep {
  double transmitted;  // force of the piston on the mechanism [N]
  double closing;      // velocity of piston minus pin after the step [m/s]
};

// One implicit step of the flank between the piston, driven by `force`, and the mechanism of the
// effective mass `mass`, driven by `load`. The oil is a spring `oil` [N/m]. This spring is
// implicit, because an explicit one would make the light piston oscillate within the play. It acts
// on the relative velocity of piston and pin, so that it adds nothing while a flank is in contact.
inline PlayStep play_step(const CylinderParameters& p, double offset, double v_piston, double v_pin,
                          double force, double load, double mass, double oil, double h) {
  const double reduced = 1.0 / (1.0 / p.piston_mass_ + 1.0 / mass);
  const double half = 0.5 * p.play_, k = p.play_stiffness_;
  const double c = 2.0 * kFlankDamping * std::sqrt(k * reduced);
  const double free = v_piston + h * force / p.piston_mass_ - (v_pin + h * load / mass);
  const double held = 1.0 + h * h * oil / p.piston_mass_;
  const double reach = offset + h * free / held;
  const double side = reach > half ? 1.0 : reach < -half ? -1.0 : 0.0;
  if (side != 0.0) {
    const double pressed = offset - side * half;
    const double closing = (free - h / reduced * k * pressed) / (held + h / reduced * (c + k * h));
    const double transmitted = k * (pressed + h * closing) + c * closing;
    if (transmitted * side > 0.0) return {transmitted, closing};
  }
  return {0.0, free / held};
}

}  // namespace leglab::hydraulics

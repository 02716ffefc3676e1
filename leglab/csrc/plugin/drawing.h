// Shapes that the plugins add to a scene, because geoms of a model cannot follow the plugin state.
#pragma once

#include <mujoco/mujoco.h>

namespace leglab::plugin {

// Computes the first and last point of a spatial tendon; returns false for other tendons.
bool tendon_ends(const mjModel* m, const mjData* d, int tendon, mjtNum base[3], mjtNum end[3]);

// A hydraulic cylinder between its pins [m]: barrel of `length` from the base, rod to the end.
// `level` in [0, 1], drawn from blue to red, is the cap-side pressure over the supply pressure.
void draw_cylinder(mjvScene* scene, const mjtNum base[3], const mjtNum end[3], double bore,
                   double rod, double length, double level);

// A spring-damper strut between its pins: damper tube, coil that stretches, end plates.
void draw_strut(mjvScene* scene, const mjtNum base[3], const mjtNum end[3]);

}  // namespace leglab::plugin

// Compiled for a Cortex-M4 without exceptions, run-time types or an operating system: shows that
// the identification core needs neither a heap nor a hosted standard library. Never run.
#include "identification/bsnn_arx.h"
#include "identification/spline_narx.h"
#include "identification/spline_state_space.h"

namespace id = leglab::identification;

namespace {

alignas(id::Workspace::alignment) std::byte memory[65536];

template <class T>
T run_bsnn_arx(T u, T y) {
  static T knots[11], extended[15];
  for (int i = 0; i < 11; ++i) knots[i] = T(0.08) * static_cast<T>(i);
  id::BsnnArxSettings<T> settings;
  settings.network.basis[0] = id::make_basis<T>(knots, 11, extended, false);
  settings.network.learning_constant[0] = T(0.14);
  settings.rls.forgetting = id::Forgetting::variable;
  settings.rls.change.enabled = true;
  id::BsnnArx<T> model;
  id::Workspace workspace(memory);
  model.layout(workspace, settings);
  const T prediction = model.update(&u, y);
  model.project_poles(T(0.99));
  return prediction + model.predict_next(&u);
}

template <class T>
T run_spline_narx(T u, T y) {
  static T knots[5] = {-1, T(-0.1), 0, T(0.1), 1}, extended[9];
  static id::Block<T> blocks[4];
  blocks[0].feature = id::Feature::spline;
  blocks[0].lag = 1;
  blocks[0].basis = id::make_basis<T>(knots, 5, extended, true);
  blocks[1].feature = id::Feature::hammerstein;
  blocks[1].signal = 1;
  blocks[1].lags = 3;
  blocks[1].basis = blocks[0].basis;
  blocks[1].learning_constant = T(0.1);
  blocks[2].feature = id::Feature::lags;
  blocks[2].lag = 1;
  blocks[2].lags = 3;
  id::SplineNarxSettings<T> settings;
  settings.structure = {blocks, 4, 1};
  settings.rls.forgetting = id::Forgetting::directional;
  settings.rls.forgetting_factor = T(0.99);
  settings.rls.change.action = id::OnChange::inflate;
  settings.output_error_after = 300;
  settings.pole_limit = T(0.99);
  id::SplineNarx<T> model;
  id::Workspace workspace(memory);
  model.layout(workspace, settings);
  return model.update(&u, y);
}

template <class T>
T run_state_space(T u, T y) {
  static T knots[5] = {-1, T(-0.5), 0, T(0.5), 1}, extended[9];
  id::SplineStateSpaceSettings<T> settings;
  settings.structure.states = 2;
  settings.structure.curves = 1;
  settings.structure.basis = id::make_basis<T>(knots, 5, extended, true);
  settings.delay[0] = 2;
  id::SplineStateSpace<T> model;
  id::Workspace workspace(memory);
  model.layout(workspace, settings);
  return model.update(&u, y) + model.predict_next(&u);
}

}  // namespace

extern "C" double identify_double(double u, double y) {
  return run_bsnn_arx(u, y) + run_spline_narx(u, y) + run_state_space(u, y);
}
extern "C" float identify_float(float u, float y) {
  return run_bsnn_arx(u, y) + run_spline_narx(u, y) + run_state_space(u, y);
}

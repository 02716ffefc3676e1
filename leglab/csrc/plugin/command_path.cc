#include "plugin/command_path.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace leglab::plugin {
namespace {

constexpr hydraulics::ParameterSpec kMaxDelay[] = {
    {"max_delay", "s", 0.05, 0.0, 1.0, true, "longest delay that may be set"}};

// Number of past commands needed to interpolate at `max_delay`.
int history_length(const mjModel* m, int instance) {
  double max_delay;
  read_parameters(m, instance, kMaxDelay, &max_delay);
  return static_cast<int>(std::ceil(max_delay / m->opt.timestep - 1e-9)) + 1;
}

// Play operator: the output trails the input by half the width (Krasnosel'skii and Pokrovskii 1989).
double play(double before, double input, double width) {
  return std::clamp(before, input - 0.5 * width, input + 0.5 * width);
}

// Dead band followed by a gain, with the half width and gain of the input's sign.
double passed(double input, double half_width, double gain) {
  return gain * std::copysign(std::max(std::abs(input) - half_width, 0.0), input);
}

}  // namespace

int CommandPath::state_count(const mjModel* m, int instance) {
  return kStateCount + history_length(m, instance);
}

CommandPath::CommandPath(const mjModel* m, int instance)
    : Instance(m, instance),
      history_(m->plugin_statenum[instance] - kStateCount),
      actuator_(actuator_attribute(m, instance)) {}

void CommandPath::reset(mjtNum* plugin_state) const {
  Instance::reset(plugin_state);
  std::fill_n(plugin_state + kStateCount, history_, 0.0);
}

CommandPath::Signal CommandPath::pass(const mjModel* m, const mjData* d, double command) const {
  const auto [p, s] = slots(m, d);
  const mjtNum* past = this->past(m, d);
  const double h = m->opt.timestep;
  const bool started = s.started_ != 0.0;  // if not, all past commands equal the first one

  // MuJoCo holds a command over a step, so that the delayed command's mean over a step is an
  // interpolation of two commands.
  const double steps = p.delay_ / h;
  const int whole = static_cast<int>(steps);
  if (!(steps >= 0) || whole + 1 > history_) {
    refuse(m, instance_, "attribute 'delay' = " + number(p.delay_) + " s; allowed: [0, " +
                             number((history_ - 1) * h) + "] s (attribute max_delay)");
  }
  const auto held = [&](int age) { return age == 0 || !started ? command : past[age - 1]; };
  const double share = steps - whole;
  double u = held(whole);
  if (share > 0.0) u += share * (held(whole + 1) - u);

  u = p.gain_ * u + p.bias_;
  const double behind_play = started ? play(s.play_output_, u, p.hysteresis_) : u;
  const bool positive = behind_play > 0.0;
  const double width = p.dead_band_ + (positive ? p.dead_band_positive_ : p.dead_band_negative_);
  const double x = passed(behind_play, width, positive ? p.gain_positive_ : p.gain_negative_);
  if (p.time_constant_ == 0.0) return {behind_play, x, x};
  // Mean over the step of the exact first-order response.
  const double before = started ? s.lag_output_ : x;
  const double ratio = h / p.time_constant_;
  return {behind_play, x, x - (before - x) * std::expm1(-ratio) / ratio};
}

void CommandPath::compute(const mjModel* m, mjData* d, int capability) {
  if (capability == mjPLUGIN_PASSIVE) return;  // declared only so that a body may refer to the plugin
  if (!applied_) apply(m, d);
  applied_ = false;
}

void CommandPath::apply_ahead(const mjModel* m, mjData* d) {
  apply(m, d);
  applied_ = true;
}

void CommandPath::apply(const mjModel* m, mjData* d) const {
  if (actuator_.disabled(m)) return;
  const Parameters& p = slots(m, d).parameters;
  const int id = actuator_.id;
  const double command = actuator_.command(m, d);
  const double output = pass(m, d, command).output, change = output - command;
  mjtNum& force = d->actuator_force[actuator_.output];
  if (change != 0.0) {
    if (m->actuator_dyntype[id] == mjDYN_NONE) {
      force += actuator_.gain(m, d) * change;
    } else {
      const double tau = m->actuator_dyntype[id] == mjDYN_INTEGRATOR
                             ? 1.0
                             : std::max(mjMINVAL, m->actuator_dynprm[mjNDYN * id]);
      d->act_dot[m->actuator_actadr[id] + m->actuator_actnum[id] - 1] += change / tau;
    }
  }
  if (p.servo_dead_band_ != 0.0) {
    if (!actuator_.position_servo(m)) {
      refuse(m, instance_, "attribute 'servo_dead_band' = " + number(p.servo_dead_band_) +
                               "; allowed: 0 for what is no position servo");
    }
    // A servo's force is its gain times the error of its position, plus damping.
    const double goal = m->actuator_dyntype[id] == mjDYN_NONE ? output : actuator_.activation(m, d);
    const double error = goal - d->actuator_length[actuator_.output];
    force -= actuator_.gain(m, d) * std::clamp(error, -p.servo_dead_band_, p.servo_dead_band_);
  }
  if (p.actuator_gain_ != 1.0) force *= p.actuator_gain_;
}

void CommandPath::advance(const mjModel* m, mjData* d) {
  const auto [p, s] = slots(m, d);
  mjtNum* past = this->past(m, d);
  const double command = actuator_.command(m, d);
  const Signal signal = pass(m, d, command);
  const double before = s.started_ != 0.0 ? s.lag_output_ : signal.lag_input;
  const double decay = p.time_constant_ == 0.0 ? 0.0 : std::exp(-m->opt.timestep / p.time_constant_);
  if (s.started_ == 0.0) std::fill(past, past + history_, command);
  std::memmove(past + 1, past, (history_ - 1) * sizeof *past);
  past[0] = command;
  s.play_output_ = signal.play;
  s.lag_output_ = signal.lag_input + (before - signal.lag_input) * decay;
  s.started_ = 1.0;
}

mjPLUGIN_LIB_INIT(leglab_command_path) { register_plugin<CommandPath>(mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE); }

}  // namespace leglab::plugin

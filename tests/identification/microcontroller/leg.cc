// bsnn_arx of the whole leg, and the monitor that names faults, for a Cortex-M7 with double
// precision: six joints of 47 parameters, as `controllers/bsnn_arx_bank.py` sets them up. An emulator
// calls `setup`, then `plant`, `period` and parts of the monitor in turn; it counts what each takes.
// Memory is taken once, in `setup`, and never given back.
#include <cmath>
#include <cstddef>
#include <new>
#include <vector>

#include "feedforward/adaptive.h"
#include "monitor/fault_fit.h"
#include "monitor/fault_monitor.h"

namespace ff = leglab::feedforward;
namespace id = leglab::identification;
namespace mon = leglab::monitor;

namespace {

constexpr int joints = 6, inputs = 2 + 5 * joints, window = 15, rows = 15, columns = 25;

alignas(16) std::byte heap[786432];
std::size_t taken = 0;

alignas(16) std::byte learner_memory[joints][32768];

struct Leg {
  ff::AdaptiveFeedforward core;
  id::SplineNarx<double> learners[joints];
};
Leg* leg = nullptr;

// Curves of the bank, sizes of one, and learned samples from one block to the next.
constexpr int most_curves = 128, most_nodes = 8, block = 5;
mon::FaultMonitor* monitor = nullptr;
mon::FaultFit<float>* fit = nullptr;
mon::FaultCurve<float> curves[most_curves];

double time = 0.0;
double measured[joints], measured_velocity[joints];
double reference[joints], reference_velocity[joints], reference_acceleration[joints];
double out[5][joints];

// Tables of a valve that is linear, in a bent grid.
double shares[columns], commands[joints][rows * columns];
id::Block<double> blocks[2 + inputs];
double velocity_extended[15], position_extended[8];

double ramp(int i, int count) { return -1.0 + 2.0 * i / (count - 1); }

}  // namespace

// The host fills these from the package before `setup`: they are the settings that the simulated leg
// has.
extern "C" {
double kernel[4 * window], velocity_knots[11], position_knots[4], prior[inputs];
double forgetting_factor;
// The bank: sizes of each curve, how many, the number of its fault and element, and shifts of all
// curves one behind the other. On the controller it is constant and lies in flash.
double bank_sizes[most_curves * most_nodes], bank_nodes[most_curves];
int bank_group[most_curves];
float bank_shifts[384 * joints * 47];
unsigned bank_curves, bank_keys;
double chance[most_curves];
// Gain of the plant's cylinders; another one is a fault.
double plant_gain = 0.9;
// The host reads these.
unsigned heap_bytes, learner_bytes, monitor_bytes, late_bytes, parameters;
double last_error;
double time_now, block_parameters[joints * 47];
const double* block_samples;
unsigned kept, case_open, look_done;
double onset, found[7];
}

void* operator new(std::size_t bytes) {
  void* place = heap + taken;
  taken += (bytes + 15) / 16 * 16;
  return place;
}
void operator delete(void*) noexcept {}
void operator delete(void*, std::size_t) noexcept {}

// What the library calls where it would throw.
namespace std {
void __throw_length_error(const char*) { for (;;) {} }
void __throw_bad_alloc() { for (;;) {} }
void __throw_bad_array_new_length() { for (;;) {} }
}  // namespace std

extern "C" void setup() {
  const double h = 0.002;
  for (int c = 0; c < columns; ++c) shares[c] = ramp(c, columns);
  std::vector<ff::ValveTable> tables(joints);
  for (int j = 0; j < joints; ++j) {
    for (int r = 0; r < rows; ++r) {
      for (int c = 0; c < columns; ++c) {
        commands[j][r * columns + c] = (0.7 + 0.02 * r) * shares[c] + 0.05 * shares[c] * shares[c] * shares[c];
      }
    }
    tables[std::size_t(j)] = {rows, columns, -1.0, 2.0 / (rows - 1), shares, commands[j]};
  }
  const std::vector<double> one(joints, 1.0);
  ff::AdaptiveSettings settings;
  settings.control_period = h;
  settings.interval = 2;
  settings.stop_time = 1e30;
  settings.limit = 0.95;
  settings.rate_limit = 50.0;
  settings.least_speed = 1e-3;
  settings.saturation = 0.95;
  settings.greatest_acceleration = 1000.0;
  settings.trust_time = 0.5;
  settings.margin = 1.05;
  settings.noise = 0.2e-3;
  settings.settle_time = 0.4;
  settings.proof_time = 0.15;
  settings.proof_horizon = 0.02;
  settings.proof_doubt = 0.06;
  settings.proof_noise = 0.0005;
  settings.learn_lower = std::vector<double>(joints, -2.0);
  settings.learn_upper = std::vector<double>(joints, 2.0);
  settings.bandwidth = std::vector<double>(joints, 20.0);
  settings.position_gain = std::vector<double>(joints, 3.0);
  settings.velocity_gain = std::vector<double>(joints, 0.05);
  ff::MotionScale scale{std::vector<double>(joints), one, std::vector<double>(joints, 8.0), 50.0, 2000.0};

  int b = 0;
  blocks[b].feature = id::Feature::spline;
  blocks[b].signal = 1;
  blocks[b++].basis = id::make_basis<double>(velocity_knots, 11, velocity_extended, true);
  blocks[b].feature = id::Feature::spline;
  blocks[b].signal = 5;  // q, behind v, j, v q and a
  blocks[b].basis = id::make_basis<double>(position_knots, 4, position_extended, true);
  blocks[b++].basis.outside = id::Outside::linear;
  for (int i = 2; i <= inputs; ++i) {
    if (i == 5) continue;
    blocks[b].feature = id::Feature::lags;
    blocks[b].signal = i;
    blocks[b++].lags = 1;
  }
  id::SplineNarxSettings<double> learner;
  learner.structure = {blocks, b, inputs};
  for (int i = 0; i < inputs; ++i) learner.input[i] = {0.0, 1.0 / prior[i]};
  learner.rls.initial_gain = 3.0;
  learner.rls.forgetting = id::Forgetting::variable;
  learner.rls.forgetting_factor = forgetting_factor;
  learner.rls.memory = 2000.0;
  learner.rls.noise_variance = 0.0005 * 0.0005;
  learner.rls.gain_bound = 30.0;
  learner.rls.restore_gain = 100.0;
  learner.rls.restore_interval = 1;
  learner.rls.change.enabled = true;
  learner.rls.change.ratio = 6.0;
  learner.rls.change.gain = 3.0;
  learner.rls.change.fast_window = 40;
  learner.rls.change.slow_window = 1500;
  learner.rls.change.hold_off = 1000;
  leg = new Leg{{settings, {scale, true},
                 {joints, std::vector<double>(kernel, kernel + 4 * window)},
                 {joints, h, 0.001, 0.001, 0.004}, tables}, {}};
  std::vector<ff::AdaptiveFeedforward::Learner*> all;
  for (int j = 0; j < joints; ++j) {
    id::Workspace workspace(learner_memory[j]);
    leg->learners[j].layout(workspace, learner);
    learner_bytes = unsigned(workspace.used());
    all.push_back(&leg->learners[j]);
  }
  parameters = unsigned(leg->learners[0].parameters());
  leg->core.reset(all);
  heap_bytes = unsigned(taken);

  // As bsnn_arx_bank's, but that it knows sooner what is normal.
  const mon::MonitorSettings watched{{settings.sample(), 4.0, 4.0, 20.0, 100}, 0.06, 25, block};
  monitor = new mon::FaultMonitor(joints, int(parameters), watched);
  fit = new mon::FaultFit<float>(joints, int(parameters), most_curves);
  monitor->reset(150.0);
  leg->core.keep(block);
  monitor_bytes = unsigned(taken) - heap_bytes;
  const float* shifts = bank_shifts;
  for (unsigned i = 0; i < bank_curves; ++i) {
    const int nodes = int(bank_nodes[i]);
    curves[i] = {nodes, bank_sizes + i * most_nodes, shifts};
    shifts += (nodes - 1) * joints * int(parameters);
  }
}

// Moves reference and machine by a period: each joint takes a share of its commanded speed.
extern "C" void plant() {
  time += 0.002;
  for (int j = 0; j < joints; ++j) {
    const double w = 5.2 * (1.0 + 0.13 * j), phase = w * time + j;
    reference[j] = 0.4 * std::sin(phase);
    reference_velocity[j] = 0.4 * w * std::cos(phase);
    reference_acceleration[j] = -0.4 * w * w * std::sin(phase);
    const double speed = plant_gain * 8.0 * out[0][j] / 0.85 - 0.3 * measured[j];
    measured_velocity[j] = speed;
    measured[j] += 0.002 * speed;
  }
}

extern "C" void period() {
  leg->core.step(time, measured, measured_velocity,
                 {reference, reference_velocity, reference_acceleration},
                 {out[0], out[1], out[2], out[3], out[4]});
  last_error = 0.0;
  for (int j = 0; j < joints; ++j) last_error += std::abs(out[3][j]);
  kept = unsigned(leg->core.kept().count());
  time_now = time;
}

// The monitor takes the block that the learner has kept.
extern "C" void take_block() {
  double* to = block_parameters;
  for (auto& learner : leg->learners) {
    for (int i = 0; i < int(parameters); ++i) *to++ = learner.rls().theta()[i];
  }
  block_samples = leg->core.kept().rows();
  monitor->take(time, block_samples, leg->core.kept().count(), block_parameters);
  leg->core.kept().drop();
  case_open = monitor->open();
  onset = monitor->onset();
}

extern "C" void sum_sample() { monitor->sum(1); }
extern "C" void begin_look() {
  fit->begin(curves, int(bank_curves), monitor->look(), monitor->normal(), 0.15);
}
extern "C" void fit_curve() { look_done = fit->advance(1); }

extern "C" void find() {
  const int best = fit->best();
  mon::chances(fit->cost(), bank_group, fit->curves(), 20.0, 12.0, fit->noise(), chance,
               int(bank_keys));
  const double values[] = {double(best),      fit->size()[best], fit->spread()[best],
                           fit->cost()[best], fit->without(),    fit->noise(),
                           chance[bank_group[best]]};
  for (int i = 0; i < 7; ++i) found[i] = values[i];
  late_bytes = unsigned(taken) - heap_bytes - monitor_bytes;
}

extern "C" void _exit(int) { for (;;) {} }

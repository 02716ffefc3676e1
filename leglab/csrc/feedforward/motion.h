// Motion: measured positions with smoothed derivatives, and a reference shifted in time.
#pragma once

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <vector>

namespace leglab::feedforward {

// Position and its first three derivatives of all joints: [order][joint].
using Motion = std::vector<double>;

// Window of recent positions, flows, commands and, if measured, pressures of all joints, with their
// smoothed values in its middle.
class SmoothingWindow {
 public:
  // kernel: (4, window), oldest sample first: weights for value and derivatives in the middle.
  SmoothingWindow(int joints, std::vector<double> kernel)
      : joints_(joints), window_(int(kernel.size()) / 4), kernel_(std::move(kernel)) {
    position_.resize(std::size_t(2 * window_ * joints));
    flow_ = command_ = pressure_a_ = pressure_b_ = position_;
  }

  void clear() { next_ = filled_ = 0; }
  int half() const { return window_ / 2; }  // samples from the middle to the latest
  bool full() const { return filled_ >= window_; }

  void push(const double* position, const double* flow, const double* command) {
    put(position, position_, next_);
    put(flow, flow_, next_);
    put(command, command_, next_);
    next_ = (next_ + 1) % window_;
    if (filled_ < window_) ++filled_;
  }

  // Computes motion (4, joints) and smoothed flow (joints) in the middle.
  void middle(double* motion, double* flow) const {
    for (int order = 0; order < 4; ++order) smooth(position_, order, motion + order * joints_);
    smooth(flow_, 0, flow);
  }

  // For callers that store and smooth a further series, of `size()` numbers, for the same samples.
  std::size_t size() const { return flow_.size(); }
  const double* position(int k) const { return position_.data() + row_at(k) * joints_; }
  const double* command(int k) const { return command_.data() + row_at(k) * joints_; }
  void put_at(int k, const double* sample, std::vector<double>& series) const {
    put(sample, series, row_at(k) % window_);
  }
  void put_latest(const double* sample, std::vector<double>& series) const {
    put_at(window_ - 1, sample, series);
  }
  void middle_of(const std::vector<double>& series, double* sum) const { smooth(series, 0, sum); }

  // Stores the pressures of the latest sample of `push`.
  void push_pressures(const double* a, const double* b) {
    put_latest(a, pressure_a_);
    put_latest(b, pressure_b_);
  }

  // Computes smoothed pressures and command (joints) in the middle.
  void middle_pressures(double* a, double* b, double* command) const {
    smooth(pressure_a_, 0, a);
    smooth(pressure_b_, 0, b);
    smooth(command_, 0, command);
  }

  double largest_command(int joint) const {
    double most = 0.0;
    for (int k = 0; k < window_; ++k) {
      most = std::max(most, std::abs(command_[std::size_t(k * joints_ + joint)]));
    }
    return most;
  }

 private:
  // Every sample is written twice, a window apart, so that the latest samples are contiguous.
  void put(const double* sample, std::vector<double>& series, int row) const {
    for (const int at : {row, row + window_}) {
      std::copy_n(sample, joints_, series.data() + std::size_t(at * joints_));
    }
  }

  int row_at(int k) const { return next_ + k; }  // row of sample k, the oldest first

  // Computes the derivative of an order of a series, (joints), in the middle of the window.
  void smooth(const std::vector<double>& series, int order, double* sum) const {
    const double* samples = series.data() + next_ * joints_;
    const double* weights = kernel_.data() + order * window_;
    std::fill_n(sum, joints_, 0.0);
    for (int k = 0; k < window_; ++k) {
      for (int j = 0; j < joints_; ++j) sum[j] += weights[k] * samples[k * joints_ + j];
    }
  }

  int joints_, window_;
  std::vector<double> kernel_, position_, flow_, command_, pressure_a_, pressure_b_;
  int next_ = 0, filled_ = 0;
};

// A reference shifted in time by Taylor series: forward by the lead, back by the sensors' delays.
class ReferenceMotion {
 public:
  // lead: time by which the computed motion is ahead of now; delays: ages of the measurements [s].
  ReferenceMotion(int joints, double period, double lead, double position_delay,
                  double velocity_delay)
      : joints_(joints), rate_(1.0 / period), lead_(lead), position_delay_(position_delay),
        velocity_delay_(velocity_delay), last_(std::size_t(joints)) {}

  void clear() { started_ = false; }

  // Computes the motion `lead` from now, (4, joints), and the reference at the measurements' time.
  void take(const double* position, const double* velocity, const double* acceleration,
            double* motion, double* seen_position, double* seen_velocity) {
    for (int j = 0; j < joints_; ++j) {
      const double x = position[j], v = velocity[j], a = acceleration[j];
      const double jerk = started_ ? rate_ * (a - last_[std::size_t(j)]) : 0.0;
      last_[std::size_t(j)] = a;
      const double t = lead_;
      motion[j] = x + t * (v + t * (a / 2 + t * jerk / 6));
      motion[joints_ + j] = v + t * (a + t * jerk / 2);
      motion[2 * joints_ + j] = a + t * jerk;
      motion[3 * joints_ + j] = jerk;
      const double p = -position_delay_, q = -velocity_delay_;
      seen_position[j] = x + p * (v + p * (a / 2 + p * jerk / 6));
      seen_velocity[j] = v + q * (a + q * jerk / 2);
    }
    started_ = true;
  }

 private:
  int joints_;
  double rate_, lead_, position_delay_, velocity_delay_;
  std::vector<double> last_;
  bool started_ = false;
};

}  // namespace leglab::feedforward

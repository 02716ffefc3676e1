// Inputs of each joint's learned map, computed from the motion of all joints.
#pragma once

#include <cmath>
#include <vector>

namespace leglab::feedforward {

// Ranges that scale the motion to magnitudes of about one.
struct MotionScale {
  std::vector<double> centre, half_range;  // of positions [rad]
  std::vector<double> full_speed;          // [rad/s]
  double acceleration = 1.0, jerk = 1.0;   // full scale [rad/s^2], [rad/s^3]
};

// Inputs of joint i from position q and its derivatives v, a, j: v_i, j_i, v_i q_i and, for all k in
// cyclic order from i, a_k, q_k, |v_i| a_k, |v_i| q_k and, for k != i, v_k. A linear map omits products.
class InverseMap {
 public:
  InverseMap(MotionScale scale, bool products)
      : scale_(std::move(scale)), joints_(int(scale_.full_speed.size())), products_(products),
        q_(scale_.full_speed.size()), v_(q_), a_(q_), j_(q_) {}

  int joints() const { return joints_; }
  int inputs() const { return products_ ? 2 + 5 * joints_ : 1 + 3 * joints_; }
  const std::vector<double>& speed() const { return scale_.full_speed; }

  // Scales and stores a motion, (4, joints), from which `inputs` computes the inputs of one joint.
  void take(const double* motion) {
    for (int k = 0; k < joints_; ++k) {
      const std::size_t i = std::size_t(k);
      q_[i] = (motion[k] - scale_.centre[i]) / scale_.half_range[i];
      v_[i] = motion[joints_ + k] / scale_.full_speed[i];
      a_[i] = motion[2 * joints_ + k] / scale_.acceleration;
      j_[i] = motion[3 * joints_ + k] / scale_.jerk;
    }
  }

  double share(int joint) const { return v_[std::size_t(joint)]; }

  double largest_share() const {
    double most = 0.0;
    for (const double v : v_) most = std::abs(v) > most || v != v ? std::abs(v) : most;
    return most;
  }

  // Computes the inputs of a joint; own: the joint's v_i, as a share of full speed.
  void inputs(int joint, double own, double* out) const {
    const std::size_t i = std::size_t(joint);
    const double speed = std::abs(own);
    *out++ = own;
    *out++ = j_[i];
    if (products_) *out++ = own * q_[i];
    for (int other = 0; other < joints_; ++other) {
      const std::size_t k = std::size_t((joint + other) % joints_);
      *out++ = a_[k];
      *out++ = q_[k];
      if (other) *out++ = v_[k];
      if (products_) {
        *out++ = speed * a_[k];
        *out++ = speed * q_[k];
      }
    }
  }

 private:
  MotionScale scale_;
  int joints_;
  bool products_;
  std::vector<double> q_, v_, a_, j_;
};

}  // namespace leglab::feedforward

// Moments (sums of products) of learned samples for least squares.
#pragma once

#include <algorithm>
#include <vector>

namespace leglab::monitor {

// Number of values after the regressor in the row of a sample and joint: output, a-priori error and 1.
// The row is all zeros if the joint did not learn the sample (`feedforward/kept_samples.h`).
constexpr int behind_regressor = 3;

// Sums over samples for every joint: phi phi' (information), phi y (correlation), y^2 (power) and 1
// (count), with regressor phi and output y. Of the information the upper triangle is stored by rows.
class Moments {
 public:
  Moments(int joints, int parameters)
      : joints_(joints), parameters_(parameters), triangle_(parameters * (parameters + 1) / 2),
        information_(std::size_t(joints * triangle_)),
        correlation_(std::size_t(joints * parameters)), power_(std::size_t(joints)), count_(power_),
        product_(std::size_t(parameters)) {}

  int joints() const { return joints_; }
  int parameters() const { return parameters_; }
  int width() const { return parameters_ + behind_regressor; }

  // Sums of one joint.
  const double* information(int joint) const { return information_.data() + joint * triangle_; }
  const double* correlation(int joint) const { return correlation_.data() + joint * parameters_; }
  double power(int joint) const { return power_[std::size_t(joint)]; }
  double count(int joint) const { return count_[std::size_t(joint)]; }

  void clear() {
    for (auto* sums : {&information_, &correlation_, &power_, &count_}) {
      std::fill(sums->begin(), sums->end(), 0.0);
    }
  }

  // Adds samples (samples, joints, width). The sums are bit-identical however the samples are divided
  // among calls.
  void add(const double* samples, int number) {
    const int stride = joints_ * width();
    for (int joint = 0; joint < joints_; ++joint) {
      const double* row = samples + joint * width();
      int left = number;
      for (; left >= together; left -= together, row += together * stride) {
        add_rows<together>(joint, row, stride);
      }
      for (; left > 0; --left, row += stride) add_rows<1>(joint, row, stride);
    }
  }

  // Weight of a joint's squared errors: inverse of the mean squared error with the true fault, which
  // is `normal` + (`discrepancy` x RMS output)^2 because of errors of the nominal model.
  double weight(int joint, double normal, double discrepancy) const {
    const double left = discrepancy * discrepancy * (power(joint) / std::max(count(joint), 1.0));
    return 1.0 / std::max(normal + left, 1e-300);
  }

  // Subtracts the predictions of a map with these parameters (joints, parameters) from the outputs.
  void take_off(const double* parameters) {
    for (int joint = 0; joint < joints_; ++joint, parameters += parameters_) {
      const double* row = information(joint);
      std::fill(product_.begin(), product_.end(), 0.0);
      double* product = product_.data();
      for (int i = 0; i < parameters_; row += parameters_ - i, ++i) {
        product[i] += row[0] * parameters[i];
        for (int j = i + 1; j < parameters_; ++j) {
          product[i] += row[j - i] * parameters[j];
          product[j] += row[j - i] * parameters[i];
        }
      }
      double* correlation = correlation_.data() + joint * parameters_;
      double less = 0.0;
      for (int i = 0; i < parameters_; ++i) {
        less += (2.0 * correlation[i] - product[i]) * parameters[i];
        correlation[i] -= product[i];
      }
      double& power = power_[std::size_t(joint)];
      power = std::max(power - less, 0.0);
    }
  }

 private:
  // Number of samples added to the information at a time: the monitor's default number per block.
  static constexpr int together = 5;

  template <int rows>
  void add_rows(int joint, const double* first, int stride) {
    if (rows == 1 && first[parameters_ + 2] == 0.0) return;
    const double* x[rows];
    for (int k = 0; k < rows; ++k) x[k] = first + k * stride;
    double* __restrict sum = information_.data() + joint * triangle_;
    double* __restrict correlation = correlation_.data() + joint * parameters_;
    for (int i = 0; i < parameters_; sum += parameters_ - i, ++i) {
      double own[rows];
      bool shown = false;
      for (int k = 0; k < rows; ++k) shown |= (own[k] = x[k][i]) != 0.0;
      if (!shown) continue;  // usually a basis function of a spline that is zero in all rows
      for (int j = i; j < parameters_; ++j) {
        double value = sum[j - i];
        for (int k = 0; k < rows; ++k) value += own[k] * x[k][j];
        sum[j - i] = value;
      }
      for (int k = 0; k < rows; ++k) correlation[i] += own[k] * x[k][parameters_];
    }
    double power = power_[std::size_t(joint)], count = count_[std::size_t(joint)];
    for (int k = 0; k < rows; ++k) {
      power += x[k][parameters_] * x[k][parameters_];
      count += x[k][parameters_ + 2];
    }
    power_[std::size_t(joint)] = power;
    count_[std::size_t(joint)] = count;
  }

  int joints_, parameters_, triangle_;
  std::vector<double> information_, correlation_, power_, count_;
  std::vector<double> product_;  // information times a map's parameters
};

}  // namespace leglab::monitor

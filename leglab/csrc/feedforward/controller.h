// The adaptive feed-forward beside a PD loop: what one control period does, all joints at once.
#pragma once

#include "feedforward/adaptive.h"

namespace leglab::feedforward {

struct Feedback {
  std::vector<double> position_gain, velocity_gain;  // [1/rad], [s/rad], with the valve's sign
};

// What one period gives; arrays of one value a joint.
struct Period {
  double *command, *feedforward, *feedback;
  double* error;     // of the model at its last sample [share of full speed]
  double* fallback;  // 1 where the calibration stands in
};

// u = feed-forward + PD on the reference as old as the measurement it is held against.
class Controller {
 public:
  Controller(AdaptiveFeedforward feedforward, Feedback feedback)
      : feedforward_(std::move(feedforward)), feedback_(std::move(feedback)),
        seen_position_(feedback_.position_gain.size()), seen_velocity_(seen_position_) {}

  void reset(std::vector<AdaptiveFeedforward::Learner*> learners) {
    feedforward_.reset(std::move(learners));
  }

  // Takes positions and velocities measured now, NaN where there are none: there the command is
  // the feed-forward alone.
  void step(double time, const double* position, const double* velocity, const Reference& reference,
            const Period& out) {
    feedforward_.step(time, position, reference, out.feedforward, seen_position_.data(),
                      seen_velocity_.data());
    for (std::size_t j = 0; j < seen_position_.size(); ++j) {
      const double proportional =
          feedback_.position_gain[j] * (seen_position_[j] - position[j]);
      const double derivative = feedback_.velocity_gain[j] * (seen_velocity_[j] - velocity[j]);
      out.feedback[j] = proportional + derivative;
      const double sum = out.feedforward[j] + out.feedback[j];
      out.command[j] = std::isfinite(sum) ? sum : out.feedforward[j];
      out.error[j] = feedforward_.error()[j];
      out.fallback[j] = feedforward_.fallback()[j];
    }
    feedforward_.sent(out.command);
  }

  // Takes the command that was sent, where it is not what `step` gave.
  void sent(const double* command) { feedforward_.sent(command); }

 private:
  AdaptiveFeedforward feedforward_;
  Feedback feedback_;
  std::vector<double> seen_position_, seen_velocity_;
};

}  // namespace leglab::feedforward

// Suppression of MuJoCo's clock and warnings.
#pragma once

#include <mujoco/mujoco.h>

namespace leglab::bindings {

// During its lifetime, MuJoCo reads no clock and writes no warnings to its log file; the caller
// checks for the causes of warnings itself.
class Quiet {
 public:
  Quiet() : clock_(mjcb_time), warning_(mju_user_warning) {
    mjcb_time = nullptr;
    mju_user_warning = [](const char*) {};
  }
  ~Quiet() {
    mjcb_time = clock_;
    mju_user_warning = warning_;
  }
  Quiet(const Quiet&) = delete;
  Quiet& operator=(const Quiet&) = delete;

 private:
  mjfTime clock_;
  void (*warning_)(const char*);
};

}  // namespace leglab::bindings

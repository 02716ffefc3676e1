// Plays of several widths between the command of a valve and its spool.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "feedforward/motion.h"

namespace leglab::feedforward {

// Follows where spools are if the valves have a play of a width (Krasnosel'skii and Pokrovskii 1989);
// of width 0 where the commands are. A command reaches the spool half a width late, so the inverse of
// a play adds half its width in the direction in which the command moves.
class Plays {
 public:
  // Widths beside 0 and the change that counts as a turn, both in valve command.
  Plays(std::vector<double> widths, double turn, const SmoothingWindow& window, std::size_t joints)
      : widths_(std::move(widths)), turn_(turn), windows_(widths_.size(), window) {
    widths_.insert(widths_.begin(), 0.0);
    spool_.assign(widths_.size(), std::vector<double>(joints));
    flow_ = spool_;
    direction_ = last_ = spool_[0];
  }

  int count() const { return int(widths_.size()); }
  double width(int play) const { return widths_[std::size_t(play)]; }

  void reset() {
    for (auto& spool : spool_) std::fill(spool.begin(), spool.end(), 0.0);
    std::fill(direction_.begin(), direction_.end(), 0.0);
    std::fill(last_.begin(), last_.end(), 0.0);
    clear();
  }

  // The windows begin anew.
  void clear() {
    for (auto& window : windows_) window.clear();
  }

  // Takes the commands that were sent, and what flow each position of a spool gives now.
  template <class Flow>
  void take(const double* position, const double* sent, const Flow& flow) {
    for (std::size_t k = 0; k < widths_.size(); ++k) {
      const double half = 0.5 * widths_[k];
      for (std::size_t j = 0; j < direction_.size(); ++j) {
        double& spool = spool_[k][j];
        spool = std::clamp(spool, sent[j] - half, sent[j] + half);
        flow_[k][j] = flow(j, spool);
      }
      if (k > 0) windows_[k - 1].push(position, flow_[k].data(), sent);
    }
  }

  const double* now(int play) const { return flow_[std::size_t(play)].data(); }

  // Flows in the window's middle; `without` are those of width 0. They stay until the next call.
  void middle(const double* without) {
    std::copy_n(without, direction_.size(), flow_[0].data());
    for (std::size_t k = 1; k < widths_.size(); ++k) windows_[k - 1].middle_flow(flow_[k].data());
  }

  // The direction, -1, 0 or 1, in which the command of a joint moves.
  double direction(std::size_t j, double command) {
    if (std::abs(command - last_[j]) > turn_) {
      direction_[j] = command > last_[j] ? 1.0 : -1.0;
      last_[j] = command;
    }
    return direction_[j];
  }

 private:
  std::vector<double> widths_;
  double turn_;
  std::vector<SmoothingWindow> windows_;  // of all widths but 0
  std::vector<std::vector<double>> spool_, flow_;
  std::vector<double> direction_, last_;
};

}  // namespace leglab::feedforward

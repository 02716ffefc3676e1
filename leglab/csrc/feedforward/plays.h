// Plays of several widths between the command of a valve and its spool.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "feedforward/motion.h"

namespace leglab::feedforward {

struct PlaySettings {
  std::vector<double> plays;  // widths that are tried, beside none [valve command]
  double turn = 0.0;          // change of a command that is a turn [valve command]
  double play_step = 0.0;     // of a width, over which it is seen what more of it would do
  double play_time = 0.0;     // time constant of a width in use; of a command's travel tenfold [s]
  double play_noise = 0.0;    // flow of that step which is noise [share of full speed]
};

// Follows where spools are if the valves have a play of a width (Krasnosel'skii and Pokrovskii 1989).
// A command reaches the spool half a width late, so the inverse of a play adds half its width in the
// direction in which the command moves. Place 0 has no play, the next ones those that are tried, and
// the last but one those in use: one of its own for each joint, found by least squares of the map's
// errors on what a little more of it would change and the map cannot tell. No play is wider than an
// eighth of the travel of its command: one that eats the command predicts any motion, since it lets
// nothing of what was sent through.
class Plays {
 public:
  // control_period, and from one learned sample to the next [s].
  Plays(const PlaySettings& settings, double control_period, double sample,
        const SmoothingWindow& window, std::size_t joints)
      : settings_(settings), settle_(std::min(1.0, sample / settings.play_time)),
        leak_(0.1 * control_period / settings.play_time) {
    const std::size_t n = settings_.plays.empty() ? 1 : settings_.plays.size() + 3;
    width_.assign(n, std::vector<double>(joints));
    spool_ = flow_ = width_;
    windows_.assign(n, window);
    last_ = direction_ = power_ = highest_ = lowest_ = width_[0];
    for (std::size_t k = 0; k < settings_.plays.size(); ++k) {
      std::fill(width_[k + 1].begin(), width_[k + 1].end(), settings_.plays[k]);
    }
  }

  bool any() const { return width_.size() > 1; }
  int used() const { return any() ? int(width_.size()) - 2 : 0; }
  double width(int play, std::size_t j) const {
    return std::min(width_[std::size_t(play)][j], widest(j));
  }

  void reset() {
    for (auto& spool : spool_) std::fill(spool.begin(), spool.end(), 0.0);
    for (auto* values : {&last_, &direction_, &power_, &highest_, &lowest_}) {
      std::fill(values->begin(), values->end(), 0.0);
    }
    use(0);
    clear();
  }

  // The windows begin anew.
  void clear() {
    for (auto& window : windows_) window.clear();
  }

  // These widths are in use from now on.
  void use(int play) {
    const std::size_t from = std::size_t(play), to = std::size_t(used());
    for (std::size_t k = to; to > 0 && k < width_.size(); ++k) {
      width_[k] = width_[from];
      spool_[k] = spool_[from];
      windows_[k] = windows_[from];
    }
    if (to > 0) further();
  }

  // Takes the commands that were sent, and what flow each position of a spool gives now.
  template <class Flow>
  void take(const double* position, const double* sent, const Flow& flow) {
    for (std::size_t j = 0; j < last_.size(); ++j) {
      const double forgotten = leak_ * (highest_[j] - lowest_[j]);
      highest_[j] = std::max(sent[j], highest_[j] - forgotten);
      lowest_[j] = std::min(sent[j], lowest_[j] + forgotten);
    }
    for (std::size_t k = 0; k < width_.size(); ++k) {
      for (std::size_t j = 0; j < last_.size(); ++j) {
        const double half = 0.5 * width(int(k), j);
        double& spool = spool_[k][j];
        spool = std::clamp(spool, sent[j] - half, sent[j] + half);
        flow_[k][j] = flow(j, spool);
      }
      windows_[k].push(position, flow_[k].data(), sent);
    }
  }

  // Takes the flows in the window's middle; they stay until the next call of `take`.
  void middle() {
    for (std::size_t k = 0; k < width_.size(); ++k) windows_[k].middle_flow(flow_[k].data());
  }

  double flow(int play, std::size_t j) const { return flow_[std::size_t(play)][j]; }

  // What a little more of the widths in use would change of the flow, by width.
  double slope(std::size_t j) const {
    return (flow_.back()[j] - flow_[flow_.size() - 2][j]) / settings_.play_step;
  }

  // The width in use of a joint, after an error of its map and the part of `slope` that the map
  // cannot tell: normalised least mean squares. Returns by how much it grew.
  double learn(std::size_t j, double error, double slope) {
    const std::size_t own = std::size_t(used());
    power_[j] += settle_ * (slope * slope - power_[j]);
    const double least = settings_.play_noise / settings_.play_step;
    const double by = settle_ * error * slope / (power_[j] + least * least);
    const double before = width_[own][j];
    width_[own][j] = std::clamp(before - by, 0.0, widest(j));
    further();
    return width_[own][j] - before;
  }

  // The direction, -1, 0 or 1, in which the command of a joint moves.
  double direction(std::size_t j, double command) {
    if (std::abs(command - last_[j]) > settings_.turn) {
      direction_[j] = command > last_[j] ? 1.0 : -1.0;
      last_[j] = command;
    }
    return direction_[j];
  }

 private:
  double widest(std::size_t j) const { return 0.125 * (highest_[j] - lowest_[j]); }

  // The last place is a little wider than what is in use.
  void further() {
    const auto& own = width_[width_.size() - 2];
    for (std::size_t j = 0; j < own.size(); ++j) width_.back()[j] = own[j] + settings_.play_step;
  }

  PlaySettings settings_;
  double settle_;  // share of its error by which a width in use moves at a sample
  double leak_;    // share by which the travel of a command is forgotten in a period
  std::vector<std::vector<double>> width_, spool_, flow_;  // by place and joint
  std::vector<SmoothingWindow> windows_;
  std::vector<double> last_, direction_, power_;
  std::vector<double> highest_, lowest_;  // commands of late
};

}  // namespace leglab::feedforward

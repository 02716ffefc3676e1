#include "plugin/drawing.h"

#include <cmath>
#include <numbers>

namespace leglab::plugin {
namespace {

struct Colour {
  float rgba[4];
  float shine;
};

constexpr Colour kCap{{0.14f, 0.15f, 0.17f, 1.0f}, 0.4f};
constexpr Colour kChrome{{0.92f, 0.93f, 0.95f, 1.0f}, 1.0f};
constexpr Colour kCoil{{0.93f, 0.38f, 0.10f, 1.0f}, 0.6f};

// A line between two pins, with the distance from the first one as coordinate [m].
class Line {
 public:
  Line(mjvScene* scene, const mjtNum base[3], const mjtNum end[3]) : scene_(scene) {
    mju_copy3(base_, base);
    mju_sub3(axis_, end, base);
    length_ = mju_normalize3(axis_);
    const mjtNum y[3] = {0, 1, 0}, z[3] = {0, 0, 1};
    mju_cross(side_, axis_, std::abs(axis_[1]) < 0.9 ? y : z);
    mju_normalize3(side_);
    mju_cross(other_, axis_, side_);
  }

  double length() const { return length_; }

  // Computes the point at distance `at` along the line, `radius` away from it at `angle`.
  void point(double at, double radius, double angle, mjtNum out[3]) const {
    mju_addScl3(out, base_, axis_, at);
    mju_addToScl3(out, side_, radius * std::cos(angle));
    mju_addToScl3(out, other_, radius * std::sin(angle));
  }

  void segment(double from, double to, double radius, const Colour& colour) const {
    mjtNum a[3], b[3];
    point(from, 0, 0, a);
    point(to, 0, 0, b);
    connect(mjGEOM_CYLINDER, a, b, radius, colour);
  }

  void connect(int type, const mjtNum a[3], const mjtNum b[3], double radius, const Colour& colour) const {
    if (scene_->ngeom >= scene_->maxgeom) return;
    mjvGeom* geom = scene_->geoms + scene_->ngeom++;
    mjv_initGeom(geom, type, nullptr, nullptr, nullptr, colour.rgba);
    mjv_connector(geom, type, radius, a, b);
    geom->category = mjCAT_DECOR;
    geom->specular = geom->shininess = colour.shine;
  }

 private:
  mjvScene* scene_;
  mjtNum base_[3], axis_[3], side_[3], other_[3];
  double length_;
};

}  // namespace

bool tendon_ends(const mjModel* m, const mjData* d, int tendon, mjtNum base[3], mjtNum end[3]) {
  const int first = d->ten_wrapadr[tendon], last = first + d->ten_wrapnum[tendon] - 1;
  if (m->wrap_type[m->tendon_adr[tendon]] == mjWRAP_JOINT || last <= first) return false;
  mju_copy3(base, d->wrap_xpos + 3 * first);
  mju_copy3(end, d->wrap_xpos + 3 * last);
  return true;
}

void draw_cylinder(mjvScene* scene, const mjtNum base[3], const mjtNum end[3], double bore,
                   double rod, double length, double level) {
  const Line line(scene, base, end);
  const float warm = static_cast<float>(level);
  const Colour paint{{0.20f + 0.62f * warm, 0.36f - 0.14f * warm, 0.66f - 0.52f * warm, 1.0f}, 0.6f};
  const double radius = 0.5 * bore + 0.0035;
  line.segment(0, 0.012, 0.45 * radius, kCap);
  line.segment(0.008, 0.016, radius + 0.0008, kCap);
  line.segment(0.016, length - 0.010, radius, paint);
  line.segment(length - 0.012, length, radius + 0.0012, kCap);
  line.segment(length, line.length(), 0.5 * rod, kChrome);
  line.segment(line.length() - 0.014, line.length() - 0.004, 0.4 * bore, kCap);
}

void draw_strut(mjvScene* scene, const mjtNum base[3], const mjtNum end[3]) {
  constexpr double radius = 0.0105, wire = 0.0018, plate = 0.018;
  constexpr int turns = 9, pieces = 10 * turns;
  const Line line(scene, base, end);
  const double start = plate, span = line.length() - 2 * plate;
  line.segment(0, line.length(), 0.004, kChrome);
  line.segment(0, 0.55 * line.length(), 0.0065, kCap);
  line.segment(start - 0.004, start, radius + wire, kCap);
  line.segment(start + span, start + span + 0.004, radius + wire, kCap);
  mjtNum a[3], b[3];
  line.point(start, radius, 0, a);
  for (int i = 1; i <= pieces; ++i) {
    const double share = static_cast<double>(i) / pieces;
    line.point(start + share * span, radius, 2 * std::numbers::pi * turns * share, b);
    line.connect(mjGEOM_CAPSULE, a, b, wire, kCoil);
    mju_copy3(a, b);
  }
}

}  // namespace leglab::plugin

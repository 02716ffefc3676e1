// Rules between the parameters of one cylinder, beyond the bounds of each.
#pragma once

#include <cmath>
#include <cstdio>
#include <string>

#include "parameters.h"

namespace leglab::hydraulics {

// Names the first parameter that contradicts another, its value and what is allowed; else empty.
inline std::string contradiction(const CylinderParameters& p) {
  const auto text = [](const char* name, double value, const char* unit, const char* rule,
                       double limit) {
    char line[200];
    std::snprintf(line, sizeof line, "attribute '%s' = %g%s is out of range; allowed: %s %g%s", name,
                  value, unit, rule, limit, unit);
    return std::string(line);
  };
  if (p.rod_ >= p.bore_) return text("rod", p.rod_, " m", "less than bore =", p.bore_);
  if (p.static_ < p.coulomb_) {
    return text("static", p.static_, " N", "at least coulomb =", p.coulomb_);
  }
  if (p.viscosity_100_ >= p.viscosity_40_) {
    return text("viscosity_100", p.viscosity_100_, " m^2/s", "less than viscosity_40 =",
                p.viscosity_40_);
  }
  if (p.substeps_ != std::floor(p.substeps_)) {
    return text("substeps", p.substeps_, "", "a whole number such as", std::ceil(p.substeps_));
  }
  return "";
}

}  // namespace leglab::hydraulics

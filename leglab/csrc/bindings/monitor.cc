// Python module leglab._native.monitor: moments (sums of products) of learned samples, fits of a
// bank of faults to moments, and the monitor that detects changes.
#include <initializer_list>
#include <string>
#include <tuple>

#include <nanobind/stl/tuple.h>

#include "bindings/identification_settings.h"
#include "monitor/fault_fit.h"
#include "monitor/fault_monitor.h"

namespace leglab::bindings {
namespace {

namespace mon = monitor;

// Formats a shape as in "(3, n)"; -1 stands for any length.
template <class Lengths>
std::string told(const Lengths& lengths) {
  std::string out;
  for (const long length : lengths) {
    out.append(out.empty() ? "(" : ", ").append(length < 0 ? "n" : std::to_string(length));
  }
  return out.append(")");
}

// Throws unless an array has the required shape; -1 stands for any length.
template <class A>
void require(const char* what, const A& array, std::initializer_list<long> shape) {
  std::vector<long> had;
  for (std::size_t i = 0; i < array.ndim(); ++i) had.push_back(long(array.shape(i)));
  const auto fits = [](long wanted, long length) { return wanted < 0 || wanted == length; };
  if (std::equal(shape.begin(), shape.end(), had.begin(), had.end(), fits)) return;
  throw nb::value_error(
      (std::string(what) + " have shape " + told(had) + ", allowed is " + told(shape)).c_str());
}

template <class Value>
Made by_joint(const mon::Moments& sums, Value value) {
  std::vector<double> out;
  for (int joint = 0; joint < sums.joints(); ++joint) out.push_back(value(joint));
  const std::size_t joints = out.size();
  return array_of(std::move(out), {joints});
}

void bind_moments(nb::module_& module) {
  using Moments = mon::Moments;
  const auto make = [](Moments* out, int joints, int parameters) {
    if (joints < 1 || parameters < 1) {
      throw nb::value_error("moments need at least one joint and one parameter");
    }
    new (out) Moments(joints, parameters);
  };
  const auto add = [](Moments& sums, Input samples) {
    require("samples", samples, {-1, sums.joints(), sums.width()});
    sums.add(samples.data(), int(samples.shape(0)));
  };
  const auto about = [](const Moments& sums, Input parameters) {
    require("parameters", parameters, {sums.joints(), sums.parameters()});
    Moments out(sums);
    out.take_off(parameters.data());
    return out;
  };
  const auto weight = [](const Moments& sums, Input normal, double discrepancy) {
    require("mean square errors", normal, {sums.joints()});
    return by_joint(sums, [&](int j) { return sums.weight(j, normal.data()[j], discrepancy); });
  };
  const auto information = [](const Moments& sums) {
    const std::size_t joints = std::size_t(sums.joints()), n = std::size_t(sums.parameters());
    std::vector<double> out(joints * n * n);
    for (std::size_t k = 0; k < joints; ++k) {
      const double* from = sums.information(int(k));
      double* full = out.data() + k * n * n;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = i; j < n; ++j) full[i * n + j] = full[j * n + i] = *from++;
      }
    }
    return array_of(std::move(out), {joints, n, n});
  };
  const auto correlation = [](const Moments& sums) {
    const std::size_t joints = std::size_t(sums.joints()), n = std::size_t(sums.parameters());
    const double* from = sums.correlation(0);
    return array_of({from, from + joints * n}, {joints, n});
  };
  const auto power = [](const Moments& sums) {
    return by_joint(sums, [&](int joint) { return sums.power(joint); });
  };
  const auto count = [](const Moments& sums) {
    return by_joint(sums, [&](int joint) { return sums.count(joint); });
  };
  nb::class_<Moments>(module, "Moments")
      .def("__init__", make, nb::arg("joints"), nb::arg("parameters"))
      .def("add", add, nb::arg("samples"))
      .def("about", about, nb::arg("parameters"))
      .def("weight", weight, nb::arg("normal"), nb::arg("discrepancy"))
      .def_prop_ro("information", information, nb::rv_policy::move)
      .def_prop_ro("correlation", correlation, nb::rv_policy::move)
      .def_prop_ro("power", power, nb::rv_policy::move)
      .def_prop_ro("count", count, nb::rv_policy::move);
}

// Probability of every key (fault and element) from the costs and keys of all curves.
Made chances(Input cost, std::vector<int> keys, double correlation, double independent,
              double noise) {
  require("costs", cost, {long(keys.size())});
  if (keys.empty() || *std::min_element(keys.begin(), keys.end()) < 0) {
    throw nb::value_error("chances need a key of every cost, from 0 on");
  }
  std::vector<double> out(std::size_t(*std::max_element(keys.begin(), keys.end()) + 1));
  mon::chances(cost.data(), keys.data(), int(keys.size()), correlation, independent, noise,
               out.data(), int(out.size()));
  const std::size_t count = out.size();
  return array_of(std::move(out), {count});
}

// Curves of a bank of faults, and the arrays that the curves point into.
class Bank {
 public:
  // sizes: magnitudes of every curve, (nodes); shifts: (nodes, joints, parameters).
  Bank(std::vector<Input> sizes, std::vector<Input> shifts)
      : sizes_(std::move(sizes)), shifts_(std::move(shifts)) {
    const std::size_t count = sizes_.size();
    if (count == 0 || shifts_.size() != count || shifts_[0].ndim() != 3) {
      throw nb::value_error("curves need sizes and shifts (nodes, joints, parameters) each");
    }
    joints_ = int(shifts_[0].shape(1));
    parameters_ = int(shifts_[0].shape(2));
    for (std::size_t i = 0; i < count; ++i) {
      require("sizes", sizes_[i], {-1});
      require("shifts", shifts_[i], {long(sizes_[i].shape(0)), joints_, parameters_});
      if (sizes_[i].shape(0) < 2) throw nb::value_error("a curve needs two sizes");
      curves_.push_back({int(sizes_[i].shape(0)), sizes_[i].data(),
                         shifts_[i].data() + joints_ * parameters_});
    }
  }

  // Arguments as in `FaultFit::begin`. Returns magnitudes, spreads and costs of all curves, the cost
  // without any fault, and the cost expected from noise alone.
  nb::tuple fit(const mon::Moments& sums, Input normal, double discrepancy, int joint) const {
    if (sums.joints() != joints_ || sums.parameters() != parameters_) {
      throw nb::value_error("moments and bank differ in joints or parameters");
    }
    require("mean square errors", normal, {joints_});
    const std::size_t count = curves_.size();
    mon::FaultFit<double> fit(joints_, parameters_, int(count));
    fit.begin(curves_.data(), int(count), sums, normal.data(), discrepancy, joint);
    fit.advance(int(count));
    const auto of = [count](const double* values) {
      return array_of({values, values + count}, {count});
    };
    return nb::make_tuple(of(fit.size()), of(fit.spread()), of(fit.cost()), fit.without(),
                          fit.noise());
  }

 private:
  std::vector<Input> sizes_, shifts_;
  std::vector<mon::FaultCurve<double>> curves_;
  int joints_ = 0, parameters_ = 0;
};

mon::MonitorSettings read_monitor(const nb::dict& settings) {
  mon::MonitorSettings out;
  LEGLAB_READ_3(sample_period, error_ratio, alarm)
  LEGLAB_READ_2(correlation, slow_window)
  LEGLAB_READ_3(passing, blocks, most_samples)
  return out;
}

// `settings` holds the fields of csrc/monitor/fault_monitor.h; the front-end has checked them.
class FaultMonitor : public mon::FaultMonitor {
 public:
  FaultMonitor(int joints, int parameters, const nb::dict& settings)
      : mon::FaultMonitor(joints, parameters, read_monitor(settings)), joints_(joints),
        parameters_(parameters) {}

  bool take(double time, Input samples, Input parameters) {
    require("samples", samples, {-1, joints_, parameters_ + mon::behind_regressor});
    require("parameters", parameters, {joints_, parameters_});
    const int count = int(samples.shape(0)), most = recent().most_samples();
    if (count < 1 || count > most) {
      throw nb::value_error(("a block of " + std::to_string(count) + " samples, allowed are 1 to " +
                             std::to_string(most)).c_str());
    }
    return mon::FaultMonitor::take(time, samples.data(), count, parameters.data());
  }

  Made map() const {
    const std::size_t joints = std::size_t(joints_), parameters = std::size_t(parameters_);
    return array_of({base(), base() + joints * parameters}, {joints, parameters});
  }
  Made normal_errors() const {
    return array_of({normal(), normal() + joints_}, {std::size_t(joints_)});
  }
  mon::Moments sums() {
    if (!open()) throw nb::value_error("no case is open");
    return look();
  }

  // Regressors of the kept blocks before the suspected change, (n, joints, parameters).
  Made regressors_before() const {
    std::vector<double> out;
    if (!open()) throw nb::value_error("no case is open");
    for (long number = recent().begin(); number < first_after(); ++number) {
      const double* row = recent().samples(number);
      for (int i = 0; i < recent().block(number).count * joints_; ++i) {
        out.insert(out.end(), row, row + parameters_);
        row += parameters_ + mon::behind_regressor;
      }
    }
    const std::size_t joints = std::size_t(joints_), parameters = std::size_t(parameters_);
    const std::size_t samples = out.size() / (joints * parameters);
    return array_of(std::move(out), {samples, joints, parameters});
  }

 private:
  int joints_, parameters_;
};

}  // namespace

NB_MODULE(monitor, module) {
  bind_moments(module);
  nb::class_<Bank>(module, "Bank")
      .def(nb::init<std::vector<Input>, std::vector<Input>>(), nb::arg("sizes"), nb::arg("shifts"))
      .def("fit", &Bank::fit, nb::arg("moments"), nb::arg("normal"), nb::arg("discrepancy"),
           nb::arg("joint") = -1);
  module.def("chances", &chances, nb::arg("cost"), nb::arg("keys"), nb::arg("correlation"),
             nb::arg("independent"), nb::arg("noise"));
  nb::class_<FaultMonitor>(module, "Monitor")
      .def(nb::init<int, int, nb::dict>(), nb::arg("joints"), nb::arg("parameters"),
           nb::arg("settings"))
      .def("reset", &FaultMonitor::reset, nb::arg("wait"))
      .def("close", &FaultMonitor::close, nb::arg("wait"))
      .def_prop_ro("open", &FaultMonitor::open)
      .def_prop_ro("onset", &FaultMonitor::onset)
      .def("take", &FaultMonitor::take, nb::arg("time"), nb::arg("samples"), nb::arg("parameters"))
      .def("base", &FaultMonitor::map)
      .def("normal", &FaultMonitor::normal_errors)
      .def("look", &FaultMonitor::sums)
      .def("regressors_before", &FaultMonitor::regressors_before)
      .def("sum", &FaultMonitor::sum, nb::arg("samples") = mon::everything);
}

}  // namespace leglab::bindings

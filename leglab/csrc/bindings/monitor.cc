// Python module leglab._native.monitor: sums of learned samples, fits of a bank of faults, and the
// monitor that notices changes.
#include <initializer_list>
#include <string>
#include <tuple>

#include <nanobind/stl/tuple.h>

#include "bindings/identification_settings.h"
#include "monitor/fault_monitor.h"

namespace leglab::bindings {
namespace {

namespace mon = monitor;

using Array = nb::ndarray<nb::numpy, double>;

// "(3, n)" of a shape; -1 is any length.
template <class Lengths>
std::string told(const Lengths& lengths) {
  std::string out;
  for (const long length : lengths) {
    out.append(out.empty() ? "(" : ", ").append(length < 0 ? "n" : std::to_string(length));
  }
  return out.append(")");
}

// Throws unless an array has the shape that is needed; -1 is any length.
template <class A>
void require(const char* what, const A& array, std::initializer_list<long> shape) {
  std::vector<long> had;
  for (std::size_t i = 0; i < array.ndim(); ++i) had.push_back(long(array.shape(i)));
  const auto fits = [](long wanted, long length) { return wanted < 0 || wanted == length; };
  if (std::equal(shape.begin(), shape.end(), had.begin(), had.end(), fits)) return;
  throw nb::value_error(
      (std::string(what) + " have shape " + told(had) + ", allowed is " + told(shape)).c_str());
}

Array array_of(std::vector<double> values, std::initializer_list<std::size_t> shape) {
  auto* kept = new std::vector<double>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  return Array(kept->data(), shape, owner);
}

// The sums, as a value.
class Moments {
 public:
  Moments(int joints, int parameters) : sums_(positive(joints), positive(parameters)) {}
  explicit Moments(const mon::Moments& sums) : sums_(sums) {}

  const mon::Moments& sums() const { return sums_; }

  void add(Input samples) {
    require("samples", samples, {-1, sums_.joints(), sums_.width()});
    sums_.add(samples.data(), int(samples.shape(0)));
  }

  Moments about(Input parameters) const {
    require("parameters", parameters, {sums_.joints(), sums_.parameters()});
    Moments out(sums_);
    out.sums_.take_off(parameters.data());
    return out;
  }

  Array information() const {
    const std::size_t joints = std::size_t(sums_.joints()), n = std::size_t(sums_.parameters());
    std::vector<double> out(joints * n * n);
    for (std::size_t k = 0; k < joints; ++k) {
      const double* from = sums_.information(int(k));
      double* full = out.data() + k * n * n;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = i; j < n; ++j) full[i * n + j] = full[j * n + i] = *from++;
      }
    }
    return array_of(std::move(out), {joints, n, n});
  }
  Array correlation() const {
    const std::size_t joints = std::size_t(sums_.joints()), n = std::size_t(sums_.parameters());
    const double* from = sums_.correlation(0);
    return array_of({from, from + joints * n}, {joints, n});
  }
  Array power() const {
    return by_joint([this](int joint) { return sums_.power(joint); });
  }
  Array count() const {
    return by_joint([this](int joint) { return sums_.count(joint); });
  }

 private:
  static int positive(int count) {
    if (count < 1) throw nb::value_error("moments need at least one joint and one parameter");
    return count;
  }

  template <class Value>
  Array by_joint(Value value) const {
    std::vector<double> out;
    for (int joint = 0; joint < sums_.joints(); ++joint) out.push_back(value(joint));
    const std::size_t joints = out.size();
    return array_of(std::move(out), {joints});
  }

  mon::Moments sums_;
};

// Curves of a bank, which point into arrays that it keeps.
class Bank {
 public:
  // Of every curve its sizes (nodes), its shifts (nodes, joints, parameters), and the number of its
  // fault and element.
  Bank(std::vector<Input> sizes, std::vector<Input> shifts, std::vector<int> keys)
      : sizes_(std::move(sizes)), shifts_(std::move(shifts)) {
    const std::size_t count = sizes_.size();
    if (count == 0 || shifts_.size() != count || keys.size() != count || shifts_[0].ndim() != 3) {
      throw nb::value_error("curves need sizes, shifts (nodes, joints, parameters) and a key each");
    }
    joints_ = int(shifts_[0].shape(1));
    parameters_ = int(shifts_[0].shape(2));
    for (std::size_t i = 0; i < count; ++i) {
      require("sizes", sizes_[i], {-1});
      require("shifts", shifts_[i], {long(sizes_[i].shape(0)), joints_, parameters_});
      if (sizes_[i].shape(0) < 2 || keys[i] < 0) throw nb::value_error("a curve needs two sizes");
      curves_.push_back({int(sizes_[i].shape(0)), sizes_[i].data(),
                         shifts_[i].data() + joints_ * parameters_, keys[i]});
      keys_ = std::max(keys_, keys[i] + 1);
    }
  }

  const mon::FaultCurve<double>* curves() const { return curves_.data(); }
  int count() const { return int(curves_.size()); }
  int joints() const { return joints_; }
  int parameters() const { return parameters_; }
  int keys() const { return keys_; }

  // Rows of `out`: size, spread and cost, each (curves). Returns the cost without any fault.
  double fit(const Moments& moments, Input weight, Output out) const {
    const mon::Moments& sums = moments.sums();
    if (sums.joints() != joints_ || sums.parameters() != parameters_) {
      throw nb::value_error("moments and bank differ in joints or parameters");
    }
    require("weights", weight, {joints_});
    require("results", out, {3, count()});
    mon::FaultFit<double> fit(joints_, parameters_, count());
    fit.begin(curves(), count(), sums, weight.data());
    fit.advance(count());
    double* row = out.data();
    for (const double* values : {fit.size(), fit.spread(), fit.cost()}) {
      row = std::copy_n(values, count(), row);
    }
    return fit.without();
  }

  void chances(Input cost, double correlation, double independent, double noise, Output out) const {
    require("costs", cost, {count()});
    require("chances", out, {keys_});
    mon::chances(curves(), count(), cost.data(), correlation, independent, noise, out.data(), keys_);
  }

 private:
  std::vector<Input> sizes_, shifts_;
  std::vector<mon::FaultCurve<double>> curves_;
  int joints_ = 0, parameters_ = 0, keys_ = 0;
};

mon::WatchSettings read_watch(const nb::dict& settings) {
  mon::WatchSettings out;
  LEGLAB_READ_3(sample_period, error_ratio, alarm)
  LEGLAB_READ_2(correlation, slow_window)
  return out;
}

mon::MonitorSettings read_monitor(const nb::dict& settings) {
  mon::MonitorSettings out;
  out.watch = read_watch(settings);
  LEGLAB_READ_3(passing, independent, discrepancy)
  LEGLAB_READ_4(blocks, most_samples, most_curves, most_keys)
  return out;
}

// `settings` are the fields of csrc/monitor/fault_monitor.h; the front-end has checked them.
class FaultMonitor {
 public:
  FaultMonitor(int joints, int parameters, const nb::dict& settings)
      : settings_(read_monitor(settings)), joints_(joints), parameters_(parameters),
        core_(joints, parameters, settings_) {}

  void reset(double wait) { core_.reset(wait); }
  void close(double wait) { core_.close(wait); }
  bool open() const { return core_.open(); }
  double onset() const { return core_.onset(); }

  bool take(double time, Input samples, Input parameters) {
    require("samples", samples, {-1, joints_, parameters_ + mon::behind_regressor});
    require("parameters", parameters, {joints_, parameters_});
    const int count = int(samples.shape(0));
    if (count < 1 || count > settings_.most_samples) {
      throw nb::value_error(("a block of " + std::to_string(count) + " samples, allowed are 1 to " +
                             std::to_string(settings_.most_samples))
                                .c_str());
    }
    return core_.take(time, samples.data(), count, parameters.data());
  }

  bool sum(int samples) { return core_.sum(samples); }

  Array base() const { return map(core_.base()); }
  Array normal() const {
    return array_of({core_.normal(), core_.normal() + joints_}, {std::size_t(joints_)});
  }
  Moments seen() const { return Moments(core_.seen()); }

  // Regressors of the blocks before the case's onset, (n, joints, parameters).
  Array regressors_before() const {
    std::vector<double> out;
    if (!core_.open()) throw nb::value_error("no case is open");
    const auto& recent = core_.recent();
    for (long number = recent.begin(); number < core_.first_after(); ++number) {
      const double* row = recent.samples(number);
      for (int i = 0; i < recent.block(number).count * joints_; ++i) {
        out.insert(out.end(), row, row + parameters_);
        row += parameters_ + mon::behind_regressor;
      }
    }
    const std::size_t joints = std::size_t(joints_), parameters = std::size_t(parameters_);
    const std::size_t samples = out.size() / (joints * parameters);
    return array_of(std::move(out), {samples, joints, parameters});
  }

  // The look keeps the bank.
  void begin_look(nb::object kept) {
    const Bank& bank = nb::cast<const Bank&>(kept);
    if (!core_.open()) throw nb::value_error("no case is open");
    if (bank.joints() != joints_ || bank.parameters() != parameters_) {
      throw nb::value_error("monitor and bank differ in joints or parameters");
    }
    if (bank.count() > settings_.most_curves || bank.keys() > settings_.most_keys) {
      throw nb::value_error("the bank has more curves than the monitor has room for");
    }
    bank_ = std::move(kept);
    core_.begin_look(bank.curves(), bank.count(), bank.keys());
  }

  bool look(int curves) {
    if (!bank_.is_valid()) throw nb::value_error("no look was begun");
    return core_.look(curves);
  }

  // Cost without any fault and that of noise; sizes, spreads and costs of all curves, and chances of
  // all keys.
  nb::tuple finding() {
    if (!look(0)) throw nb::value_error("the look is not done");
    const mon::Finding found = core_.finding();
    const std::size_t curves = std::size_t(core_.fit().curves());
    const auto of = [](const double* values, std::size_t count) {
      return array_of({values, values + count}, {count});
    };
    return nb::make_tuple(found.without, found.noise, of(core_.fit().size(), curves),
                          of(core_.fit().spread(), curves), of(core_.fit().cost(), curves),
                          of(core_.chance(), std::size_t(core_.keys())));
  }

 private:
  Array map(const double* from) const {
    const std::size_t joints = std::size_t(joints_), parameters = std::size_t(parameters_);
    return array_of({from, from + joints * parameters}, {joints, parameters});
  }

  mon::MonitorSettings settings_;
  int joints_, parameters_;
  mon::FaultMonitor<double> core_;
  nb::object bank_;  // whose curves the look points to
};

}  // namespace

NB_MODULE(monitor, module) {
  nb::class_<Moments>(module, "Moments")
      .def(nb::init<int, int>(), nb::arg("joints"), nb::arg("parameters"))
      .def("add", &Moments::add, nb::arg("samples"))
      .def("about", &Moments::about, nb::arg("parameters"))
      .def_prop_ro("information", &Moments::information, nb::rv_policy::move)
      .def_prop_ro("correlation", &Moments::correlation, nb::rv_policy::move)
      .def_prop_ro("power", &Moments::power, nb::rv_policy::move)
      .def_prop_ro("count", &Moments::count, nb::rv_policy::move);
  nb::class_<Bank>(module, "Bank")
      .def(nb::init<std::vector<Input>, std::vector<Input>, std::vector<int>>(), nb::arg("sizes"),
           nb::arg("shifts"), nb::arg("keys"))
      .def("fit", &Bank::fit, nb::arg("moments"), nb::arg("weight"), nb::arg("out"))
      .def("chances", &Bank::chances, nb::arg("cost"), nb::arg("correlation"),
           nb::arg("independent"), nb::arg("noise"), nb::arg("out"));
  nb::class_<FaultMonitor>(module, "Monitor")
      .def(nb::init<int, int, nb::dict>(), nb::arg("joints"), nb::arg("parameters"),
           nb::arg("settings"))
      .def("reset", &FaultMonitor::reset, nb::arg("wait"))
      .def("close", &FaultMonitor::close, nb::arg("wait"))
      .def_prop_ro("open", &FaultMonitor::open)
      .def_prop_ro("onset", &FaultMonitor::onset)
      .def("take", &FaultMonitor::take, nb::arg("time"), nb::arg("samples"), nb::arg("parameters"))
      .def("base", &FaultMonitor::base)
      .def("normal", &FaultMonitor::normal)
      .def("seen", &FaultMonitor::seen)
      .def("regressors_before", &FaultMonitor::regressors_before)
      .def("sum", &FaultMonitor::sum, nb::arg("samples") = mon::everything)
      .def("begin_look", &FaultMonitor::begin_look, nb::arg("bank"))
      .def("look", &FaultMonitor::look, nb::arg("curves") = mon::everything)
      .def("finding", &FaultMonitor::finding);
}

}  // namespace leglab::bindings

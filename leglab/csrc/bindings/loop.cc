// Python module leglab._native.loop: array operations of a closed loop in every control period. Its
// objects keep references to the arrays of their construction and access them in place.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>

#include "bindings/arrays.h"
#include "loop/sensing.h"

namespace leglab::bindings {
namespace {

void gather(const Output& from, const Index& index, double* to) {
  for (std::size_t i = 0; i < index.size(); ++i) to[i] = from.data()[index.data()[i]];
}

// Encoders that sample at one instant and are read at the start of the next period.
class Readings {
 public:
  // noise, shift, lost: (periods, joints); position, velocity: (joints,), written by `read`.
  Readings(Output positions, Index joints, Output noise, Output shift, Array<bool> lost, int counts,
           double gain, double keep, Output position, Output velocity)
      : positions_(std::move(positions)), joints_(std::move(joints)), noise_(std::move(noise)),
        shift_(std::move(shift)), lost_(std::move(lost)), position_(std::move(position)),
        velocity_(std::move(velocity)), sample_(joints_.size()),
        sensing_({joints_.size(), counts, gain, keep}, position_.data(), velocity_.data()) {
    require_inside(joints_, positions_.size());
    require_size(noise_.size() / joints_.size() * joints_.size(), noise_, shift_, lost_);
    require_size(joints_.size(), position_, velocity_);
  }

  void sample() { gather(positions_, joints_, sample_.data()); }

  // True positions of the last sample plus the noise of the period `period`, (joints,).
  void noisy(std::size_t period, Output out) const {
    const double* noise = noise_.data() + at(period);
    require_size(sample_.size(), out);
    for (std::size_t j = 0; j < sample_.size(); ++j) out.data()[j] = sample_[j] + noise[j];
  }

  void start() { sensing_.start(sample_.data(), disturbance(0)); }
  void read(std::size_t period) { sensing_.read(sample_.data(), disturbance(period)); }

 private:
  std::size_t at(std::size_t period) const {
    const std::size_t first = period * sample_.size();
    if (first >= noise_.size()) throw nb::index_error("no such period");
    return first;
  }

  loop::Disturbance disturbance(std::size_t period) const {
    const std::size_t first = at(period);
    return {noise_.data() + first, shift_.data() + first, lost_.data() + first};
  }

  Output positions_;
  Index joints_;
  Output noise_, shift_;
  Array<bool> lost_;
  Output position_, velocity_;
  std::vector<double> sample_;
  loop::Sensing sensing_;
};

// Copies selected values of one array to rows of another.
class Rows {
 public:
  Rows(Output from, Index index, Output rows)
      : from_(std::move(from)), index_(std::move(index)), rows_(std::move(rows)) {
    require_inside(index_, from_.size());
    if (rows_.ndim() != 2 || rows_.shape(1) != index_.size()) {
      throw nb::value_error("rows of another length");
    }
  }

  void take(std::size_t row) {
    if (row >= rows_.shape(0)) throw nb::index_error("no such row");
    gather(from_, index_, rows_.data() + row * index_.size());
  }

 private:
  Output from_;
  Index index_;
  Output rows_;
};

// Copies the arrays of a dictionary to rows while the dictionary contains the same array objects.
class Reports {
 public:
  // rows: for each array, in the dictionary's order, the destination: (number of rows, array size).
  Reports(nb::dict reports, std::vector<Output> rows) {
    if (rows.size() != reports.size()) throw nb::value_error("as many rows as reports are needed");
    std::size_t i = 0;
    for (auto [key, value] : reports) {
      Input from;
      if (!nb::try_cast(value, from, false) || from.ndim() != 1 || rows[i].ndim() != 2 ||
          rows[i].shape(1) != from.size()) {
        throw nb::value_error("a report is no row of numbers");
      }
      entries_.push_back(
          {nb::borrow(key), nb::borrow(value), std::move(from), std::move(rows[i++])});
    }
  }

  // Writes a row; returns false, without writing, if the dictionary contains other keys or arrays.
  bool take(nb::dict reports, std::size_t row) {
    if (reports.size() != entries_.size()) return false;
    std::size_t i = 0;
    for (auto [key, value] : reports) {
      const Entry& entry = entries_[i++];
      if (!key.is(entry.key) || !value.is(entry.value)) return false;
    }
    for (const Entry& entry : entries_) {
      if (row >= entry.rows.shape(0)) throw nb::index_error("no such row");
    }
    for (Entry& entry : entries_) {
      std::copy_n(entry.from.data(), entry.from.size(),
                  entry.rows.data() + row * entry.from.size());
    }
    return true;
  }

 private:
  struct Entry {
    nb::object key, value;
    Input from;
    Output rows;
  };
  std::vector<Entry> entries_;
};

// Writes centre + half range x command to an array, with commands clipped to [-1, 1]. Returns
// false, without writing, if the commands are not an array of the right number of finite numbers.
class Drives {
 public:
  Drives(Output to, Input centre, Input half)
      : to_(std::move(to)), centre_(std::move(centre)), half_(std::move(half)) {
    require_size(to_.size(), centre_, half_);
  }

  bool send(nb::object command) {
    Input values;
    if (!nb::try_cast(command, values) || values.ndim() != 1 || values.size() != to_.size()) {
      return false;
    }
    const double* from = values.data();
    if (!std::all_of(from, from + to_.size(), [](double u) { return std::isfinite(u); })) {
      return false;
    }
    for (std::size_t i = 0; i < to_.size(); ++i) {
      to_.data()[i] = centre_.data()[i] + half_.data()[i] * std::clamp(from[i], -1.0, 1.0);
    }
    return true;
  }

 private:
  Output to_;
  Input centre_, half_;
};

}  // namespace

NB_MODULE(loop, module) {
  nb::class_<Readings>(module, "Readings")
      .def(nb::init<Output, Index, Output, Output, Array<bool>, int, double, double, Output,
                    Output>(),
           nb::arg("positions"), nb::arg("joints"), nb::arg("noise"), nb::arg("shift"),
           nb::arg("lost"), nb::arg("counts"), nb::arg("gain"), nb::arg("keep"),
           nb::arg("position"), nb::arg("velocity"))
      .def("sample", &Readings::sample)
      .def("noisy", &Readings::noisy)
      .def("start", &Readings::start)
      .def("read", &Readings::read);
  nb::class_<Rows>(module, "Rows")
      .def(nb::init<Output, Index, Output>(), nb::arg("source"), nb::arg("index"), nb::arg("rows"))
      .def("take", &Rows::take);
  nb::class_<Reports>(module, "Reports")
      .def(nb::init<nb::dict, std::vector<Output>>())
      .def("take", &Reports::take);
  nb::class_<Drives>(module, "Drives")
      .def(nb::init<Output, Input, Input>(), nb::arg("target"),
           nb::arg("centre"), nb::arg("half"))
      .def("send", &Drives::send, nb::arg("command").none());
}

}  // namespace leglab::bindings

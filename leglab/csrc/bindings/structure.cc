// Python module leglab._native.structure: free runs (simulations) of models, to select a structure.
#include <nanobind/stl/tuple.h>

#include "bindings/identification_settings.h"
#include "identification/free_run.h"
#include "identification/state_run.h"

namespace leglab::bindings {
namespace {

// A model (SplineNarx `settings` without Hammerstein), candidate features (`further`) and a record.
class Runs {
 public:
  Runs(nb::handle settings, nb::handle further, Input u, Input y)
      : model_(read_settings<double>(settings, store_, static_cast<const id::SplineNarx<double>*>(nullptr))), samples_(int(y.size())) {
    for (nb::handle block : further) further_blocks_.push_back(read_block<double>(block, store_));
    const int inputs = model_.structure.inputs;
    require_size(std::size_t(samples_) * std::size_t(inputs), u);
    for (std::size_t t = 0; t < y.size(); ++t) output_.push_back(model_.output.apply(y.data()[t]));
    for (int j = 0; j < inputs; ++j) {
      for (int t = 0; t < samples_; ++t) {
        inputs_.push_back(model_.input[j].apply(u.data()[std::size_t(t * inputs + j)]));
      }
    }
    const id::Structure<double> further_structure{further_blocks_.data(),
                                                  int(further_blocks_.size()), inputs};
    run_.emplace(model_.structure, further_structure, model_.lower, model_.upper);
  }

  int depth() const { return run_->depth(); }

  // Sums over the stretches (start, length); see free_run.h.
  nb::tuple sums(Input theta, Index starts, Index lengths, bool sensitivities) {
    require_size(std::size_t(run_->parameters()), theta);
    require_size(starts.size(), lengths);
    {
      nb::gil_scoped_release release;
      run_->clear();
      for (std::size_t k = 0; k < starts.size(); ++k) {
        run_->run(record(), check(starts.data()[k], lengths.data()[k]), int(lengths.data()[k]),
                  theta.data(), sensitivities);
      }
    }
    auto& found = run_->sums();
    const std::size_t width = std::size_t(run_->width()), own = std::size_t(run_->parameters());
    std::vector<double> products(width * own);
    found.products.write(products.data());
    return nb::make_tuple(found.error, found.count, array_of(std::move(products), {width, own}),
                          array_of(found.gradient, {width}),
                          array_of(found.squares, {found.squares.size()}));
  }

 private:
  id::Record<double> record() const { return {output_.data(), inputs_.data(), samples_}; }

  int check(std::int64_t start, std::int64_t length) const {
    if (start < run_->depth() || length < 1 || start + length > samples_) {
      throw std::out_of_range("stretch outside the record");
    }
    return int(start);
  }

  Store<double> store_;
  id::SplineNarxSettings<double> model_;
  std::vector<id::Block<double>> further_blocks_;
  int samples_;
  std::vector<double> output_, inputs_;
  std::optional<id::FreeRun<double>> run_;
};

// A state-space model, the argument of a candidate curve (`further`, empty without one), and segments
// of records; `settings` are a SplineStateSpace's. Inputs are delayed; before the first sample they
// equal the first sample. In theta the initial states of all segments follow the parameters.
class StateRuns {
 public:
  // segments: for each the inputs, the outputs, and the index of the segment's first sample in both.
  StateRuns(nb::handle settings, nb::list segments, Input further)
      : model_(read_settings<double>(settings, store_,
                                     static_cast<const id::SplineStateSpace<double>*>(nullptr))),
        further_(further.data(), further.data() + further.size()),
        run_(model_.structure, model_.lower, model_.upper,
             further_.empty() ? nullptr : further_.data()) {
    for (nb::handle one : segments) {
      const auto [u, y, first] = nb::cast<std::tuple<Input, Input, std::size_t>>(one);
      add(u, y, first);
    }
  }

  // Error, number of samples, and the sums over all segments; see state_run.h. In psi the weights of
  // the candidate curve follow the initial states.
  nb::tuple sums(Input theta, bool sensitivities) {
    const std::size_t n = std::size_t(model_.structure.states), count = parameters();
    const std::size_t own = std::size_t(run_.width()), width = own + n * (segments_.size() - 1);
    require_size(count + n * segments_.size(), theta);
    std::vector<double> products(sensitivities ? width * width : 0), part(own * own);
    std::vector<double> gradient(sensitivities ? width : 0);
    double error = 0.0;
    std::size_t samples = 0;
    {
      nb::gil_scoped_release release;
      for (std::size_t k = 0; k < segments_.size(); ++k) {
        simulate(k, theta, sensitivities);
        auto& found = run_.sums();
        error += found.error;
        samples += found.count;
        if (!sensitivities) continue;
        found.products.write(part.data());
        const auto place = [&](std::size_t i) {
          return i < count ? i : i < count + n ? i + k * n : i + (segments_.size() - 1) * n;
        };
        for (std::size_t i = 0; i < own; ++i) {
          gradient[place(i)] += found.gradient[i];
          double* row = products.data() + place(i) * width;
          for (std::size_t j = 0; j < own; ++j) row[place(j)] += part[i * own + j];
        }
      }
    }
    const std::size_t side = sensitivities ? width : 0;
    return nb::make_tuple(error, samples, array_of(std::move(products), {side, side}),
                          array_of(std::move(gradient), {side}));
  }

  // States of all segments, concatenated, (samples, states).
  Made states(Input theta) {
    const std::size_t n = std::size_t(model_.structure.states);
    require_size(parameters() + n * segments_.size(), theta);
    std::size_t samples = 0;
    for (const Segment& segment : segments_) samples += segment.output.size();
    std::vector<double> out(samples * n);
    double* at = out.data();
    for (std::size_t k = 0; k < segments_.size(); ++k) {
      simulate(k, theta, false, at);
      at += segments_[k].output.size() * n;
    }
    return array_of(std::move(out), {samples, n});
  }

 private:
  struct Segment {
    std::vector<double> output, inputs;  // scaled, (length), (length, inputs)
  };

  std::size_t parameters() const { return std::size_t(model_.structure.parameters()); }

  void add(const Input& u, const Input& y, std::size_t first) {
    const std::size_t inputs = std::size_t(model_.structure.inputs);
    require_size(y.size() * inputs, u);
    Segment segment;
    for (std::size_t t = first; t < y.size(); ++t) {
      segment.output.push_back(model_.output.apply(y.data()[t]));
      for (std::size_t j = 0; j < inputs; ++j) {
        const std::size_t late = std::size_t(model_.delay[j]), at = t < late ? 0 : t - late;
        segment.inputs.push_back(model_.input[j].apply(u.data()[at * inputs + j]));
      }
    }
    segments_.push_back(std::move(segment));
  }

  void simulate(std::size_t k, const Input& theta, bool sensitivities, double* states = nullptr) {
    const Segment& segment = segments_[k];
    const double* x0 = theta.data() + parameters() + k * std::size_t(model_.structure.states);
    run_.run(segment.inputs.data(), segment.output.data(), int(segment.output.size()),
             theta.data(), x0, sensitivities, states);
  }

  Store<double> store_;
  id::SplineStateSpaceSettings<double> model_;
  std::vector<Segment> segments_;
  std::vector<double> further_;
  id::StateRun<double> run_;
};

}  // namespace

NB_MODULE(structure, module) {
  nb::class_<StateRuns>(module, "StateRuns")
      .def(nb::init<nb::handle, nb::list, Input>(), nb::arg("settings"), nb::arg("segments"),
           nb::arg("further"))
      .def("sums", &StateRuns::sums, nb::arg("theta"), nb::arg("sensitivities"))
      .def("states", &StateRuns::states, nb::arg("theta"));
  nb::class_<Runs>(module, "Runs")
      .def(nb::init<nb::handle, nb::handle, Input, Input>(), nb::arg("settings"),
           nb::arg("further"), nb::arg("u"), nb::arg("y"))
      .def_prop_ro("depth", &Runs::depth)
      .def("sums", &Runs::sums, nb::arg("theta"), nb::arg("starts"), nb::arg("lengths"),
           nb::arg("sensitivities"));
}

}  // namespace leglab::bindings

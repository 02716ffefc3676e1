// Python module leglab._native.structure: free runs from many starts, for the choice of a structure.
#include "bindings/identification_settings.h"
#include "identification/free_run.h"
#include "identification/state_run.h"

namespace leglab::bindings {
namespace {

// A model, further features, and one record; `settings` are of a SplineNarx without Hammerstein.
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

  // Sums over the stretches (start, length); see free_run.h. Products of the model's own
  // parameters are symmetric.
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
    const auto& found = run_->sums();
    const std::size_t width = std::size_t(run_->width()), own = std::size_t(run_->parameters());
    std::vector<double> products = found.products;
    for (std::size_t i = 0; i < own; ++i) {
      for (std::size_t j = i + 1; j < own; ++j) products[i * own + j] = products[j * own + i];
    }
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

// A state-space model, the argument of a further curve or none (empty), and one record; `settings`
// are of a SplineStateSpace. Inputs are delayed; before the record they are as in its first sample.
class StateRuns {
 public:
  StateRuns(nb::handle settings, Input u, Input y, Input further)
      : model_(read_settings<double>(settings, store_,
                                     static_cast<const id::SplineStateSpace<double>*>(nullptr))),
        further_(further.data(), further.data() + further.size()),
        run_(model_.structure, model_.lower, model_.upper,
             further_.empty() ? nullptr : further_.data()) {
    const std::size_t inputs = std::size_t(model_.structure.inputs);
    require_size(y.size() * inputs, u);
    for (std::size_t t = 0; t < y.size(); ++t) {
      output_.push_back(model_.output.apply(y.data()[t]));
      for (std::size_t j = 0; j < inputs; ++j) {
        const std::size_t late = std::size_t(model_.delay[j]);
        inputs_.push_back(model_.input[j].apply(u.data()[(t < late ? 0 : t - late) * inputs + j]));
      }
    }
  }

  // Error, number of samples, and the sums over one stretch from the state x0; see state_run.h.
  nb::tuple sums(Input theta, Input x0, std::int64_t start, std::int64_t length,
                 bool sensitivities) {
    {
      nb::gil_scoped_release release;
      run(theta, x0, start, length, sensitivities);
    }
    const auto& found = run_.sums();
    const std::size_t width = std::size_t(run_.width());
    std::vector<double> products = found.products;
    for (std::size_t i = 0; i < width; ++i) {
      for (std::size_t j = i + 1; j < width; ++j) products[i * width + j] = products[j * width + i];
    }
    return nb::make_tuple(found.error, found.count, array_of(std::move(products), {width, width}),
                          array_of(found.gradient, {width}));
  }

  // States over one stretch from x0, (length, states).
  Made states(Input theta, Input x0, std::int64_t start, std::int64_t length) {
    const std::size_t n = std::size_t(model_.structure.states);
    std::vector<double> out(std::size_t(length) * n);
    run(theta, x0, start, length, false, out.data());
    return array_of(std::move(out), {std::size_t(length), n});
  }

 private:
  void run(Input theta, Input x0, std::int64_t start, std::int64_t length, bool sensitivities,
           double* states = nullptr) {
    require_size(std::size_t(model_.structure.parameters()), theta);
    require_size(std::size_t(model_.structure.states), x0);
    if (start < 0 || length < 1 || std::size_t(start + length) > output_.size()) {
      throw std::out_of_range("stretch outside the record");
    }
    const double* u = inputs_.data() + start * model_.structure.inputs;
    run_.run(u, output_.data() + start, int(length), theta.data(), x0.data(), sensitivities, states);
  }

  Store<double> store_;
  id::SplineStateSpaceSettings<double> model_;
  std::vector<double> output_, inputs_, further_;
  id::StateRun<double> run_;
};

}  // namespace

NB_MODULE(structure, module) {
  nb::class_<StateRuns>(module, "StateRuns")
      .def(nb::init<nb::handle, Input, Input, Input>(), nb::arg("settings"), nb::arg("u"),
           nb::arg("y"), nb::arg("further"))
      .def("sums", &StateRuns::sums, nb::arg("theta"), nb::arg("x0"), nb::arg("start"),
           nb::arg("length"), nb::arg("sensitivities"))
      .def("states", &StateRuns::states, nb::arg("theta"), nb::arg("x0"), nb::arg("start"),
           nb::arg("length"));
  nb::class_<Runs>(module, "Runs")
      .def(nb::init<nb::handle, nb::handle, Input, Input>(), nb::arg("settings"),
           nb::arg("further"), nb::arg("u"), nb::arg("y"))
      .def_prop_ro("depth", &Runs::depth)
      .def("sums", &Runs::sums, nb::arg("theta"), nb::arg("starts"), nb::arg("lengths"),
           nb::arg("sensitivities"));
}

}  // namespace leglab::bindings

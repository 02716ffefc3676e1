// Python module leglab._native.structure: free runs from many starts, for the choice of a structure.
#include "bindings/identification_settings.h"
#include "identification/free_run.h"

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

  // Free run over one stretch, in units of the output.
  Made simulate(Input theta, std::int64_t start, std::int64_t length) {
    require_size(std::size_t(run_->parameters()), theta);
    std::vector<double> out(static_cast<std::size_t>(length));
    run_->clear();
    run_->run(record(), check(start, length), int(length), theta.data(), false, out.data());
    for (double& value : out) value = model_.output.undo(value);
    return array_of(std::move(out), {static_cast<std::size_t>(length)});
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

}  // namespace

NB_MODULE(structure, module) {
  nb::class_<Runs>(module, "Runs")
      .def(nb::init<nb::handle, nb::handle, Input, Input>(), nb::arg("settings"),
           nb::arg("further"), nb::arg("u"), nb::arg("y"))
      .def_prop_ro("depth", &Runs::depth)
      .def("sums", &Runs::sums, nb::arg("theta"), nb::arg("starts"), nb::arg("lengths"),
           nb::arg("sensitivities"))
      .def("simulate", &Runs::simulate, nb::arg("theta"), nb::arg("start"), nb::arg("length"));
}

}  // namespace leglab::bindings

#pragma once

#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace odmc::python {

namespace py = pybind11;

/// Matrices as numpy holds them.
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using ConstRows = Eigen::Ref<const RowMatrix>;

/// A table: names of its columns, and the rows.
struct Columns {
  std::vector<std::string> names;
  std::vector<double> cells;  ///< row by row

  void Name(const std::string& before, const std::string& letters, const std::string& after) {
    for (const char letter : letters) names.push_back(before + letter + after);
  }
  void Add(double value) { cells.push_back(value); }
  template <typename Derived>
  void Add(const Eigen::MatrixBase<Derived>& values) {
    for (Eigen::Index i = 0; i < values.size(); ++i) cells.push_back(values[i]);
  }
  /// {name: n×1 array}.
  py::dict Arrays() const;
};

/// What a long function calls with the share done: takes the GIL, lets Ctrl-C through, calls
/// `progress` unless it is None. Refers to `progress`, which must outlive it: copies need no GIL.
std::function<void(double)> Progress(const py::object& progress);

void BindFlight(py::module_* m);
void BindModel(py::module_* m);
void BindAnalysis(py::module_* m);

}  // namespace odmc::python

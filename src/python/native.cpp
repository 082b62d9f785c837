// The compiled part of the Python package odmc; src/python/odmc is what people import.
#include <map>
#include <regex>
#include <stdexcept>
#include <string>

#include "bindings.h"

namespace odmc::python {
namespace {

/// A tool's sentence for Python: its flags as keyword arguments, "--rotor-speed-unit" as
/// rotor_speed_unit.
std::string WithKeywords(const std::string& sentence) {
  static const std::map<std::string, std::string> other = {{"end", "end_s"},
                                                           {"start", "start_s"},
                                                           {"topic", "topics"},
                                                           {"set", "options"},
                                                           {"odometry-offset", "odometry_offset_s"},
                                                           {"window", "window_s"},
                                                           {"leave-out", "leave_out_s"},
                                                           {"keyframe-rate", "keyframe_rate_hz"}};
  static const std::regex flag("--([a-z][a-z0-9-]*)");
  std::string text;
  auto from = sentence.cbegin();
  for (std::sregex_iterator it(sentence.begin(), sentence.end(), flag), end; it != end; ++it) {
    text.append(from, (*it)[0].first);
    std::string name = (*it)[1].str();
    const auto found = other.find(name);
    if (found != other.end()) name = found->second;
    for (char& c : name) c = c == '-' ? '_' : c;
    text += name;
    from = (*it)[0].second;
  }
  return text.append(from, sentence.cend());
}

}  // namespace

py::dict Columns::Arrays() const {
  py::dict arrays;
  const size_t width = names.size(), rows = width == 0 ? 0 : cells.size() / width;
  for (size_t column = 0; column < width; ++column) {
    py::array_t<double> values(static_cast<py::ssize_t>(rows));
    auto at = values.mutable_unchecked<1>();
    for (size_t row = 0; row < rows; ++row) {
      at(static_cast<py::ssize_t>(row)) = cells[row * width + column];
    }
    arrays[py::str(names[column])] = values;
  }
  return arrays;
}

std::function<void(double)> Progress(const py::object& progress) {
  return [&progress](double share) {
    const py::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    if (!progress.is_none()) progress(share);
  };
}

}  // namespace odmc::python

PYBIND11_MODULE(_native, m) {
  namespace py = pybind11;
  m.doc() = "Compiled part of odmc; import odmc instead.";
  m.attr("version") = ODMC_VERSION;
  // NOLINTNEXTLINE(performance-unnecessary-value-param): its type is pybind11's
  py::register_local_exception_translator([](std::exception_ptr thrown) {
    try {
      if (thrown) std::rethrow_exception(thrown);
    } catch (const std::invalid_argument& error) {
      PyErr_SetString(PyExc_ValueError, odmc::python::WithKeywords(error.what()).c_str());
    }
  });
  odmc::python::BindFlight(&m);
  odmc::python::BindModel(&m);
  odmc::python::BindAnalysis(&m);
}

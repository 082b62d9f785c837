#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <variant>

#include "bindings.h"
#include "flight_arguments.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/ros/flight_bag.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/plausible.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc::python {
namespace {

using Stamps = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;
using Rows = py::array_t<double, py::array::c_style | py::array::forcecast>;

constexpr double kMissing = std::numeric_limits<double>::quiet_NaN();

/// Stamps of a stream (n) [ns].
template <typename Sample>
Stamps StampsOf(const std::vector<Sample>& samples) {
  Stamps stamps(static_cast<py::ssize_t>(samples.size()));
  auto at = stamps.mutable_unchecked<1>();
  for (size_t i = 0; i < samples.size(); ++i) at(static_cast<py::ssize_t>(i)) = samples[i].stamp;
  return stamps;
}

/// One vector of each sample (n×width). @param of a Vector, or a pointer to one that may be null
template <typename Sample, typename Of>
Rows RowsOf(const std::vector<Sample>& samples, Eigen::Index width, const Of& of) {
  Rows rows({static_cast<py::ssize_t>(samples.size()), static_cast<py::ssize_t>(width)});
  auto at = rows.mutable_unchecked<2>();
  for (size_t i = 0; i < samples.size(); ++i) {
    const auto values = of(samples[i]);
    for (Eigen::Index k = 0; k < width; ++k) {
      at(static_cast<py::ssize_t>(i), k) = k < values.size() ? values[k] : kMissing;
    }
  }
  return rows;
}

Eigen::Vector3d OrMissing(const std::optional<Eigen::Vector3d>& value) {
  return value.value_or(Eigen::Vector3d::Constant(kMissing));
}

/// The same, None where no sample has it.
template <typename Sample>
py::object OptionalRows(const std::vector<Sample>& samples,
                        std::optional<Eigen::Vector3d> Sample::*member) {
  for (const Sample& sample : samples) {
    if (sample.*member) {
      return RowsOf(samples, 3, [&](const Sample& s) { return OrMissing(s.*member); });
    }
  }
  return py::none();
}

py::dict OdometryArrays(const FlightLog& log) {
  py::dict arrays;
  arrays["stamp_ns"] = StampsOf(log.odometry);
  arrays["p_WS"] = RowsOf(log.odometry, 3, [](const OdometrySample& s) { return s.p_WS; });
  arrays["q_WS"] = RowsOf(
      log.odometry, 4, [](const OdometrySample& s) -> Eigen::Vector4d { return s.q_WS.coeffs(); });
  arrays["v_WS"] = OptionalRows(log.odometry, &OdometrySample::v_WS);
  arrays["w_WS_S"] = OptionalRows(log.odometry, &OdometrySample::w_WS_S);
  return arrays;
}

py::dict ImuArrays(const FlightLog& log) {
  py::dict arrays;
  arrays["stamp_ns"] = StampsOf(log.imu);
  arrays["gyro_I"] = OptionalRows(log.imu, &ImuSample::gyro_I);
  arrays["specific_force_I"] = OptionalRows(log.imu, &ImuSample::specific_force_I);
  return arrays;
}

py::dict RotorArrays(const FlightLog& log) {
  const Eigen::Index width = log.rotors.empty() ? 0 : log.rotors.front().speed.size();
  py::dict arrays;
  arrays["stamp_ns"] = StampsOf(log.rotors);
  arrays["speed_rad_s"] = RowsOf(log.rotors, width, [](const RotorSample& s) { return s.speed; });
  arrays["model_sigma_rad_s"] = RowsOf(log.rotors, width, [&](const RotorSample& s) -> RotorVector {
    return s.model_sigma.size() > 0 ? s.model_sigma : RotorVector(RotorVector::Zero(width));
  });
  return arrays;
}

py::dict CommandArrays(const FlightLog& log) {
  const Eigen::Index width = log.commands.empty() ? 0 : log.commands.front().throttle.size();
  py::dict arrays;
  arrays["stamp_ns"] = StampsOf(log.commands);
  arrays["throttle"] =
      RowsOf(log.commands, width, [](const CommandSample& s) { return s.throttle; });
  return arrays;
}

py::dict BatteryArrays(const FlightLog& log) {
  Rows voltage(static_cast<py::ssize_t>(log.battery.size()));
  auto at = voltage.mutable_unchecked<1>();
  for (size_t i = 0; i < log.battery.size(); ++i) {
    at(static_cast<py::ssize_t>(i)) = log.battery[i].voltage_V;
  }
  py::dict arrays;
  arrays["stamp_ns"] = StampsOf(log.battery);
  arrays["voltage_V"] = voltage;
  return arrays;
}

/// One entry of StreamOptions, as Python gives it.
using MessageOption = std::variant<int, std::string, std::vector<int>>;

/// Visitor that puts entries into StreamOptions.
class MessageOptionSetter {
 public:
  explicit MessageOptionSetter(std::map<std::string, MessageOption> entries)
      : entries_(std::move(entries)) {}

  template <typename Value>
  void Field(const std::string& key, Value* value) {
    known_.push_back(key);
    const auto entry = entries_.find(key);
    if (entry == entries_.end()) return;
    const auto* given = std::get_if<Value>(&entry->second);
    if (given == nullptr) throw std::invalid_argument("messages: " + key + " is of another type");
    *value = *given;
    entries_.erase(entry);
  }

  /// @throws std::invalid_argument for an entry that no field took
  void RefuseRest() const {
    if (entries_.empty()) return;
    throw std::invalid_argument("messages: there is no '" + entries_.begin()->first +
                                "'; there are " + Listed(known_));
  }

 private:
  std::map<std::string, MessageOption> entries_;
  std::vector<std::string> known_;
};

/// Reads a flight as the tools do.
FlightLog ReadAsTools(const std::string& file, const Vehicle& vehicle, double start_s, double end_s,
                      bool mocap, const std::vector<std::string>& topics,
                      const std::string& twist_frame,
                      const std::map<std::string, MessageOption>& messages,
                      std::optional<int> pole_pairs, const std::string& odometry,
                      std::optional<double> odometry_offset_s, bool accelerometer,
                      bool from_commands, const std::string& actuator) {
  tools::FlightArguments a;
  a.start_s = start_s;
  a.end_s = end_s;
  a.pose = mocap ? PoseSource::kMocap : PoseSource::kEkf;
  a.topics = topics;
  a.bag.twist_frame = twist_frame;
  MessageOptionSetter setter(messages);
  a.bag.Visit(&setter);
  setter.RefuseRest();
  a.bag.Check(vehicle.num_rotors());
  a.pole_pairs = pole_pairs;
  a.odometry = odometry;
  a.odometry_offset_s = odometry_offset_s;
  a.accelerometer = accelerometer;
  a.from_commands = from_commands;
  a.actuator_file = actuator;
  return a.Read(file, vehicle);
}

void Write(const FlightLog& log, const std::string& file) {
  const bool bag = file.size() > 4 && file.substr(file.size() - 4) == ".bag";
  const bool csv = file.size() > 4 && file.substr(file.size() - 4) == ".csv";
  if (!bag && !csv) RefuseFile(file, "a flight's file ends in .bag or .csv");
  bag ? WriteFlightBag(log, file) : WriteFlightCsv(log, file);
}

/// The log as calibration sees it: mended by what its streams say about each other.
py::dict InspectionOf(const FlightLog& log, const Vehicle& vehicle) {
  FlightLog mended = log;
  const StreamInspection inspection = InspectRecording(vehicle, &mended);
  std::vector<std::string> sentences;
  for (const Finding& finding : inspection.findings) sentences.push_back(Sentence(finding));
  py::dict found;
  found["refusal"] = inspection.refusal;
  found["findings"] = sentences;
  found["mended"] = std::make_shared<FlightLog>(std::move(mended));
  return found;
}

Eigen::Vector3d Row(const ConstRows& rows, Eigen::Index i) { return rows.row(i).transpose(); }

std::optional<Eigen::Vector3d> RowIfFinite(const std::optional<RowMatrix>& rows, Eigen::Index i) {
  if (!rows || !rows->row(i).allFinite()) return std::nullopt;
  return Eigen::Vector3d(rows->row(i).transpose());
}

/// A flight from arrays of sound shapes (the caller's matter); the checks are those of the readers.
FlightLog FlightOf(const std::string& name, const Vehicle& vehicle,
                   const std::vector<Stamp>& odometry_ns, const ConstRows& p_WS,
                   const ConstRows& q_WS, const std::optional<RowMatrix>& v_WS,
                   const std::optional<RowMatrix>& w_WS_S, const std::vector<Stamp>& rotor_ns,
                   const ConstRows& speed, const std::vector<Stamp>& imu_ns,
                   const std::optional<RowMatrix>& gyro_I,
                   const std::optional<RowMatrix>& specific_force_I,
                   const std::vector<Stamp>& battery_ns, const std::vector<double>& voltage_V) {
  FlightLog log;
  log.file = name;
  for (size_t k = 0; k < odometry_ns.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    OdometrySample sample;
    sample.stamp = odometry_ns[k];
    sample.p_WS = Row(p_WS, i);
    sample.q_WS = Eigen::Quaterniond(q_WS(i, 3), q_WS(i, 0), q_WS(i, 1), q_WS(i, 2));
    sample.v_WS = RowIfFinite(v_WS, i);
    sample.w_WS_S = RowIfFinite(w_WS_S, i);
    if (sample.p_WS.allFinite() && sample.q_WS.coeffs().allFinite()) {
      log.odometry.push_back(sample);
    } else {
      ++log.dropped;
    }
  }
  for (size_t k = 0; k < rotor_ns.size(); ++k) {
    RotorSample sample;
    sample.stamp = rotor_ns[k];
    sample.speed = speed.row(static_cast<Eigen::Index>(k)).transpose();
    if (sample.speed.allFinite()) {
      log.rotors.push_back(sample);
    } else {
      ++log.dropped;
    }
  }
  for (size_t k = 0; k < imu_ns.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    log.imu.push_back({imu_ns[k], RowIfFinite(gyro_I, i), RowIfFinite(specific_force_I, i)});
  }
  for (size_t k = 0; k < battery_ns.size(); ++k) {
    if (std::isfinite(voltage_V[k])) log.battery.push_back({battery_ns[k], voltage_V[k]});
  }
  KeepForward(name + ": odometry", &log.odometry, &log);
  KeepForward(name + ": rotor speeds", &log.rotors, &log);
  KeepForward(name + ": imu", &log.imu, &log);
  KeepForward(name + ": battery", &log.battery, &log);
  NormaliseAttitudes(name, &log.odometry, &log);
  TakeSpeedMagnitudes(name, &log);
  WarnOfDeadRotors(name, &log);
  MendFlight(&log);
  SettleRotors(vehicle.actuator, vehicle.num_rotors(), false, &log);
  if (log.odometry.size() < 2 || log.rotors.empty()) {
    throw std::invalid_argument(name + ": no flight: " + std::to_string(log.odometry.size()) +
                                " poses and " + std::to_string(log.rotors.size()) +
                                " readings of rotor speeds");
  }
  return log;
}

}  // namespace

void BindFlight(py::module_* m) {
  py::class_<FlightLog, std::shared_ptr<FlightLog>>(*m, "FlightLog")
      .def_readonly("file", &FlightLog::file)
      .def_readonly("warnings", &FlightLog::warnings)
      .def_readonly("dropped", &FlightLog::dropped)
      .def_readonly("rotor_rms_only", &FlightLog::rotor_rms_only)
      .def("odometry", &OdometryArrays)
      .def("imu", &ImuArrays)
      .def("rotors", &RotorArrays)
      .def("commands", &CommandArrays)
      .def("battery", &BatteryArrays)
      .def("write", &Write, py::arg("file"), py::call_guard<py::gil_scoped_release>())
      .def("inspect", &InspectionOf, py::arg("vehicle"));
  m->def("read_flight", &ReadAsTools, py::arg("file"), py::arg("vehicle"), py::arg("start_s"),
         py::arg("end_s"), py::arg("mocap"), py::arg("topics"), py::arg("twist_frame"),
         py::arg("messages"), py::arg("pole_pairs"), py::arg("odometry"),
         py::arg("odometry_offset_s"), py::arg("accelerometer"), py::arg("from_commands"),
         py::arg("actuator"), py::call_guard<py::gil_scoped_release>());
  m->def("flight_of", &FlightOf, py::arg("name"), py::arg("vehicle"), py::arg("odometry_ns"),
         py::arg("p_WS"), py::arg("q_WS"), py::arg("v_WS"), py::arg("w_WS_S"), py::arg("rotor_ns"),
         py::arg("speed_rad_s"), py::arg("imu_ns"), py::arg("gyro_I"), py::arg("specific_force_I"),
         py::arg("battery_ns"), py::arg("voltage_V"), py::call_guard<py::gil_scoped_release>());
}

}  // namespace odmc::python

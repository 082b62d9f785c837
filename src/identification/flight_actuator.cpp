#include "odmc/identification/flight_actuator.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "odmc/actuator/rotor_source.h"
#include "odmc/math/statistics.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kSuspect = 0.12;    // off the median rotor
constexpr double kMostlyZero = 0.3;  // share of readings
constexpr double kTurning = 0.05;    // throttle of a rotor that must turn
constexpr double kInFlight = 0.5;    // of the throttle in flight: idling says little about a sensor

bool Contains(const std::vector<int>& all, int j) {
  return std::find(all.begin(), all.end(), j) != all.end();
}

double VoltageAt(const std::vector<BatterySample>& battery, Stamp stamp, size_t* next) {
  while (*next + 1 < battery.size() && battery[*next + 1].stamp <= stamp) ++*next;
  return battery.empty() ? kNan : battery[*next].voltage_V;
}

std::string At(Stamp stamp, const FlightLog& log) {
  const Stamp zero = log.odometry.empty() ? stamp : log.odometry.front().stamp;
  return Format("%.2f s", ToSeconds(stamp - zero));
}

// Feeds commands, battery and sensor in the order of stamps. Commands go first: they act later.
std::vector<RotorSample> Run(const FlightLog& log, RotorSource* source) {
  std::vector<RotorSample> used;
  size_t command = 0, battery = 0;
  const auto take_until = [&](Stamp stamp) {
    for (; battery < log.battery.size() && log.battery[battery].stamp <= stamp; ++battery)
      source->Add(log.battery[battery]);
  };
  const auto commands_until = [&](Stamp stamp) {
    for (; command < log.commands.size() && log.commands[command].stamp <= stamp; ++command) {
      take_until(log.commands[command].stamp);
      if (const auto modelled = source->Add(log.commands[command])) used.push_back(*modelled);
    }
  };
  // The first voltage holds for the time before it, too.
  if (!log.battery.empty()) source->Add(log.battery.front());
  if (source->from_commands()) {
    commands_until(std::numeric_limits<Stamp>::max());
    return used;
  }
  for (const RotorSample& sample : log.rotors) {
    commands_until(sample.stamp);
    if (const auto kept = source->Add(sample)) used.push_back(*kept);
  }
  return used;
}

}  // namespace

BenchRun BenchRunOf(const FlightLog& log) {
  if (log.commands.empty()) RefuseFile(log.file, "has no commands");
  BenchRun run;
  run.file = log.file;
  run.command_unit = log.command_unit;
  const auto n = static_cast<size_t>(log.commands.front().throttle.size());
  run.throttle.resize(n);
  run.speed_rad_s.resize(n);
  const Stamp zero = log.commands.front().stamp;
  size_t rotor = 0, battery = 0;
  const auto add = [&](Stamp stamp, const RotorVector& throttle, const RotorVector* speed) {
    run.t_s.push_back(ToSeconds(stamp - zero));
    if (!log.battery.empty()) run.voltage_V.push_back(VoltageAt(log.battery, stamp, &battery));
    for (size_t j = 0; j < n; ++j) {
      const auto k = static_cast<Eigen::Index>(j);
      run.throttle[j].push_back(throttle[k]);
      const double value = speed != nullptr ? (*speed)[k] : kNan;
      if (value == 0.0) ++run.zero_speed;
      run.speed_rad_s[j].push_back(value > 0.0 ? value : kNan);
    }
  };
  for (size_t i = 0; i < log.commands.size(); ++i) {
    const CommandSample& command = log.commands[i];
    while (rotor < log.rotors.size() && log.rotors[rotor].stamp < command.stamp) ++rotor;
    const bool together = rotor < log.rotors.size() && log.rotors[rotor].stamp == command.stamp;
    add(command.stamp, command.throttle, together ? &log.rotors[rotor].speed : nullptr);
    if (together) ++rotor;
    const Stamp next =
        i + 1 < log.commands.size() ? log.commands[i + 1].stamp : std::numeric_limits<Stamp>::max();
    for (; rotor < log.rotors.size() && log.rotors[rotor].stamp < next; ++rotor)
      add(log.rotors[rotor].stamp, command.throttle, &log.rotors[rotor].speed);
  }
  run.rows = static_cast<long>(run.t_s.size());
  return run;
}

std::vector<int> SuspectRotors(const FlightLog& log) {
  if (log.commands.empty() || log.rotors.empty() || log.rotor_rms_only) return {};
  const BenchRun run = BenchRunOf(log);
  const int n = run.num_motors();
  std::vector<double> typical;
  std::vector<int> suspect;
  for (int j = 0; j < n; ++j) {
    const auto& speed = run.speed_rad_s[static_cast<size_t>(j)];
    const auto& throttle = run.throttle[static_cast<size_t>(j)];
    std::vector<double> ratios;
    const double least = std::max(kTurning, kInFlight * Quantile(throttle, 0.9));
    for (size_t i = 0; i < speed.size(); ++i) {
      if (std::isfinite(speed[i]) && throttle[i] > least)
        ratios.push_back(speed[i] / std::sqrt(throttle[i]));
    }
    typical.push_back(Median(ratios));
    long turning = 0, zero = 0;
    for (const RotorSample& sample : log.rotors) {
      if (sample.speed.size() != n || sample.speed.maxCoeff() < 1.0) continue;
      ++turning;
      if (sample.speed[j] == 0.0) ++zero;
    }
    if (static_cast<double>(zero) > kMostlyZero * static_cast<double>(turning))
      suspect.push_back(j);
  }
  std::vector<double> turning;  // what a dead sensor says is no measure for others
  for (int j = 0; j < n; ++j) {
    if (!Contains(suspect, j)) turning.push_back(typical[static_cast<size_t>(j)]);
  }
  const double median = Median(turning);
  for (int j = 0; j < n && median > 0.0; ++j) {
    const double off = std::abs(typical[static_cast<size_t>(j)] / median - 1.0);
    if (off > kSuspect && !Contains(suspect, j)) suspect.push_back(j);
  }
  std::sort(suspect.begin(), suspect.end());
  return suspect;
}

Actuator ActuatorFromFlight(const FlightLog& log, const std::vector<int>& bad) {
  const BenchRun all = BenchRunOf(log);
  BenchRun sound = all;
  sound.throttle.clear();
  sound.speed_rad_s.clear();
  for (int j = 0; j < all.num_motors(); ++j) {
    if (Contains(bad, j)) continue;
    sound.throttle.push_back(all.throttle[static_cast<size_t>(j)]);
    sound.speed_rad_s.push_back(all.speed_rad_s[static_cast<size_t>(j)]);
  }
  if (sound.num_motors() < 2) RefuseFile(log.file, "fewer than two rotor-speed sensors are sound");
  const ActuatorFit fit = IdentifyActuator({sound});
  Actuator actuator;
  actuator.command_unit = fit.command_unit;
  actuator.uses_voltage = fit.uses_voltage;
  size_t next = 0;
  for (int j = 0; j < all.num_motors(); ++j) {
    actuator.motors.push_back(Contains(bad, j) ? fit.common.motor : fit.motors[next++].motor);
  }
  // A bad sensor's motor is the common one: its error counts.
  actuator.sigma_steady_rad_s = fit.common.error.steady_rad_s;
  actuator.sigma_response_rad_s = fit.common.error.response_rad_s;
  return actuator;
}

std::vector<RotorFault> SettleRotors(const std::optional<Actuator>& actuator, int num_rotors,
                                     bool from_commands, FlightLog* log) {
  if (from_commands && log->commands.empty())
    RefuseFile(log->file, "has no commands to take rotor speeds from");
  if (from_commands && !actuator) {
    throw std::invalid_argument(log->file +
                                ": rotor speeds from commands need the vehicle's actuator (see "
                                "calibrate_actuator)");
  }
  if (log->commands.empty() || log->rotor_rms_only) return {};
  std::optional<Actuator> known = actuator;
  if (!from_commands && (!known || !known->knows_dynamics)) {
    const std::vector<int> suspect = SuspectRotors(*log);
    if (suspect.empty()) return {};
    known = ActuatorFromFlight(*log, suspect);
  }
  RotorSource source(*known, num_rotors, from_commands);
  std::vector<RotorSample> used = Run(*log, &source);
  if (from_commands && used.empty()) {
    RefuseFile(log->file, std::string("no rotor speed can be had from its commands") +
                              (known->uses_voltage ? "; has it battery voltages?" : ""));
  }
  log->rotors = std::move(used);
  const std::vector<RotorFault> faults = source.TakeFaults();
  if (from_commands || !faults.empty()) ForgetDeadRotors(log);
  for (const RotorFault& fault : faults) {
    log->warnings.push_back(log->file + ": rotor" + std::to_string(fault.rotor + 1) + " from " +
                            At(fault.stamp, *log) + ": " + fault.reason +
                            (fault.failed ? "; speeds from its commands stand in" : ""));
  }
  if (source.replaced() > 0) {
    log->warnings.push_back(log->file + ": " + std::to_string(source.replaced()) +
                            " single rotor speeds far off their commands were replaced");
  }
  return faults;
}

}  // namespace odmc

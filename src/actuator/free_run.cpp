#include "odmc/actuator/free_run.h"

#include <algorithm>
#include <cmath>

#include "odmc/actuator/speed_predictor.h"

namespace odmc {
MotorSignal SignalOf(const BenchRun& run, int motor, bool uses_voltage) {
  MotorSignal signal;
  signal.t_s = run.t_s;
  signal.throttle = run.ThrottleOfMotor(motor);
  signal.speed_rad_s = run.speed_rad_s[static_cast<size_t>(motor)];
  signal.voltage_V.assign(run.size(), 1.0);
  if (!uses_voltage || run.voltage_V.empty()) return signal;
  double last = NAN;
  for (const double voltage : run.voltage_V) {
    if (std::isfinite(voltage)) {
      last = voltage;
      break;
    }
  }
  for (size_t i = 0; i < run.size(); ++i) {
    if (std::isfinite(run.voltage_V[i])) last = run.voltage_V[i];
    signal.voltage_V[i] = last;
  }
  return signal;
}

std::vector<double> FreeRun(const Motor& motor, const MotorSignal& signal,
                            std::vector<double>* steady) {
  const size_t n = signal.throttle.size();
  std::vector<double> speeds(n);
  if (steady != nullptr) steady->resize(n);
  if (signal.t_s.empty()) {
    for (size_t i = 0; i < n; ++i)
      speeds[i] = motor.SteadySpeed(signal.throttle[i], signal.voltage_V[i]);
    if (steady != nullptr) *steady = speeds;
    return speeds;
  }
  SpeedPredictor predictor(motor);
  const double ahead_s = std::max(-motor.delay_s, 0.0);  // stamps of commands may be late
  size_t told = 0;
  bool started = false;
  for (size_t i = 0; i < n; ++i) {
    const double t_s = signal.t_s[i];
    for (; told < n && (told <= i || signal.t_s[told] <= t_s + ahead_s); ++told)
      predictor.Command(signal.t_s[told], signal.throttle[told], signal.voltage_V[told]);
    if (i > 0 && t_s - signal.t_s[i - 1] > kLongestHole_s) started = false;
    if (!started && std::isfinite(signal.speed_rad_s[i])) {
      predictor.StartAt(t_s, signal.speed_rad_s[i]);
      started = true;
    }
    speeds[i] = predictor.At(t_s);
    if (steady != nullptr) (*steady)[i] = predictor.Steady();
  }
  return speeds;
}

}  // namespace odmc

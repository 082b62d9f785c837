#include <algorithm>
#include <cmath>
#include <deque>
#include <stdexcept>

#include "frame_checks.h"
#include "log_streams.h"
#include "odmc/io/data_sets.h"
#include "odmc/math/units.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Matrix3Xd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kUnitTolerance = 0.05;  // as NormaliseAttitudes()
constexpr char kDocumentedReading[] = "as named";
constexpr int kDocumentedYaw_deg = 90;
constexpr Stamp kCheckEvery = 8000000;  // 125 Hz of poses tell the frames [ns]
constexpr size_t kCheckPoses = 30000;

/// How the flight is to be read.
struct Findings {
  std::string quaternion = kDocumentedReading;
  int imu_yaw_deg = kDocumentedYaw_deg;

  std::string Text() const {
    return "quaternion " + quaternion + ", IMU yawed " + std::to_string(imu_yaw_deg) + " deg";
  }
};

std::string AtTime(Stamp stamp) { return Format("at %.6f s", ToSeconds(stamp)); }

/// IMU to body: yawed about z down, then FRD to FLU.
Vector3d FluFromImu(const Vector3d& v, int yaw_deg) {
  const double x = v.x(), y = v.y();
  switch (yaw_deg) {
    case 0:
      return {x, -y, -v.z()};
    case 90:
      return {-y, -x, -v.z()};
    case 180:
      return {-x, y, -v.z()};
    default:
      return {y, x, -v.z()};
  }
}

Matrix3Xd FluFromImu(const Matrix3Xd& v, int yaw_deg) {
  Matrix3Xd turned(3, v.cols());
  for (Eigen::Index i = 0; i < v.cols(); ++i)
    turned.col(i) = FluFromImu(Vector3d(v.col(i)), yaw_deg);
  return turned;
}

Quaterniond AttitudeOf(const BlackbirdFlight::Pose& pose, const QuaternionReading& reading) {
  return EnuFromNed(reading.Of(pose.named_q));
}

bool IsSound(const BlackbirdFlight::Pose& pose) {
  return pose.p_NED.allFinite() && pose.named_q.allFinite();
}
bool IsSound(const ImuSample& sample) {
  return sample.gyro_I && sample.gyro_I->allFinite() && sample.specific_force_I &&
         sample.specific_force_I->allFinite();
}
bool IsSound(const BlackbirdFlight::Command& command) {
  return std::all_of(command.pwm_us.begin(), command.pwm_us.end(),
                     [](double pwm) { return std::isfinite(pwm); });
}

/// Drops what is not finite or not later than what is before it.
template <typename Item>
void KeepOrdered(const std::string& name, std::vector<Item>* items, FlightLog* log) {
  RefusedSamples refusals;
  std::vector<Item> kept;
  for (Item& item : *items) {
    if (!IsSound(item) || (!kept.empty() && item.stamp <= kept.back().stamp)) {
      refusals.Add(AtTime(item.stamp));
    } else {
      kept.push_back(std::move(item));
    }
  }
  refusals.Report(log->file + ": " + name, "samples not finite or not later than the one before",
                  log);
  *items = std::move(kept);
}

void KeepUnit(std::vector<BlackbirdFlight::Pose>* poses, FlightLog* log) {
  RefusedSamples refusals;
  std::vector<BlackbirdFlight::Pose> kept;
  for (const auto& pose : *poses) {
    if (std::abs(pose.named_q.norm() - 1.0) > kUnitTolerance) {
      refusals.Add(AtTime(pose.stamp));
    } else {
      kept.push_back(pose);
    }
  }
  if (static_cast<size_t>(refusals.count) > kept.size()) {
    throw std::invalid_argument("the quaternions are not unit: " + std::to_string(refusals.count) +
                                " of " + std::to_string(poses->size()) +
                                " are off by more than 5 % (first: " + refusals.first + ")");
  }
  refusals.Report(log->file, "poses whose quaternion is not unit", log);
  *poses = std::move(kept);
}

/// Poses to check with: at least kCheckEvery apart.
std::vector<BlackbirdFlight::Pose> Sparse(const std::vector<BlackbirdFlight::Pose>& poses) {
  std::vector<BlackbirdFlight::Pose> kept;
  for (const auto& pose : poses) {
    if (!kept.empty() && pose.stamp - kept.back().stamp < kCheckEvery) continue;
    kept.push_back(pose);
    if (kept.size() == kCheckPoses) break;
  }
  return kept;
}

TimedTurns TurnsOf(const std::vector<BlackbirdFlight::Pose>& poses,
                   const QuaternionReading& reading) {
  TimedTurns turns;
  for (const auto& pose : poses) {
    turns.t_s.push_back(ToSeconds(pose.stamp - poses.front().stamp));
    turns.q.push_back(AttitudeOf(pose, reading).normalized());
  }
  return turns;
}

/// Of the gyro or the accelerometer, in the IMU's axes.
TimedVectors SignalOf(const std::vector<ImuSample>& imu, std::optional<Vector3d> ImuSample::*value,
                      Stamp zero) {
  TimedVectors signal;
  signal.values.resize(3, static_cast<Eigen::Index>(imu.size()));
  for (size_t i = 0; i < imu.size(); ++i) {
    signal.t_s.push_back(ToSeconds(imu[i].stamp - zero));
    signal.values.col(static_cast<Eigen::Index>(i)) = *(imu[i].*value);
  }
  return signal;
}

/// Columns of the spans that the IMU covers and no gap of poses widens.
std::vector<Eigen::Index> Covered(const CheckSpans& spans, const TimedVectors& gyro) {
  constexpr double kLongest_s = 0.2;
  std::vector<Eigen::Index> covered;
  for (size_t i = 0; i < spans.from_s.size(); ++i) {
    if (spans.from_s[i] >= gyro.t_s.front() && spans.to_s[i] <= gyro.t_s.back() &&
        spans.to_s[i] - spans.from_s[i] < kLongest_s) {
      covered.push_back(static_cast<Eigen::Index>(i));
    }
  }
  return covered;
}

Matrix3Xd Select(const Matrix3Xd& all, const std::vector<Eigen::Index>& columns) {
  return all(Eigen::all, columns);
}

/// With these findings, the mean specific force in the world is about (0, 0, 9.81).
void CheckGravity(const TimedTurns& turns, const TimedVectors& force, int yaw_deg) {
  Vector3d sum = Vector3d::Zero();
  double count = 0.0;
  for (size_t i = 0; i < force.t_s.size(); ++i) {
    if (force.t_s[i] < turns.t_s.front() || force.t_s[i] > turns.t_s.back()) continue;
    const auto next = std::lower_bound(turns.t_s.begin(), turns.t_s.end(), force.t_s[i]);
    const Quaterniond& q = turns.q[static_cast<size_t>(next - turns.t_s.begin())];
    sum += q * FluFromImu(Vector3d(force.values.col(static_cast<Eigen::Index>(i))), yaw_deg);
    ++count;
  }
  const Vector3d mean = sum / std::max(count, 1.0);
  if (mean.z() > 8.0 && mean.z() < 12.0 && mean.head<2>().norm() <= 3.0) return;
  throw std::invalid_argument(
      Format("the mean accelerometer reading, turned into the world, is (%.2f, %.2f, %.2f) "
             "m/s^2, not gravity upwards: the poses are not NED with z down, or the IMU is not "
             "z down",
             mean.x(), mean.y(), mean.z()));
}

/// Order of the quaternion and yaw of the IMU by the rates; gravity by the accelerometer.
Findings CheckImu(const std::vector<BlackbirdFlight::Pose>& poses,
                  const std::vector<ImuSample>& imu) {
  const Stamp zero = poses.front().stamp;
  const TimedVectors gyro = SignalOf(imu, &ImuSample::gyro_I, zero),
                     force = SignalOf(imu, &ImuSample::specific_force_I, zero);
  const CheckSpans spans = SpansOf(TurnsOf(poses, QuaternionReadings().front()).t_s);
  const std::vector<Eigen::Index> covered = Covered(spans, gyro);
  const Matrix3Xd mean = Select(MeansOver(gyro, spans), covered);
  ReadingResiduals residuals("rad/s", mean);
  std::vector<Findings> choices;
  for (const QuaternionReading& reading : QuaternionReadings()) {
    const Matrix3Xd rates = Select(RatesOver(TurnsOf(poses, reading), spans), covered);
    for (const int yaw : {90, 0, 180, 270}) {
      choices.push_back({reading.name, yaw});
      residuals.Add(choices.back().Text(), rates - FluFromImu(mean, yaw));
    }
  }
  const auto choice = [&](const std::string& text) {
    return *std::find_if(choices.begin(), choices.end(),
                         [&](const Findings& f) { return f.Text() == text; });
  };
  return choice(
      FirstAccepted(residuals.Fitting(Findings().Text(), 0.3, 0.1, "attitude against gyro"),
                    [&](const std::string& text) {
                      const Findings findings = choice(text);
                      CheckGravity(TurnsOf(poses, ReadingNamed(findings.quaternion)), force,
                                   findings.imu_yaw_deg);
                    }));
}

Findings Check(const BlackbirdFlight& flight, FlightLog* log) {
  const std::vector<BlackbirdFlight::Pose> poses = Sparse(flight.poses);
  if (poses.size() < 3)
    throw std::invalid_argument("only " + std::to_string(poses.size()) + " poses");
  if (!flight.imu.empty()) return CheckImu(poses, flight.imu);
  log->warnings.push_back(log->file + ": no IMU, only the direction of gravity is checked");
  const TimedTurns turns = TurnsOf(poses, QuaternionReadings().front());
  TimedVectors position{turns.t_s, Matrix3Xd(3, static_cast<Eigen::Index>(poses.size()))};
  for (size_t i = 0; i < poses.size(); ++i) {
    position.values.col(static_cast<Eigen::Index>(i)) = EnuFromNed(poses[i].p_NED);
  }
  CheckThrustIsUp(position, turns.q);
  return {};
}

/// Brings rotors with a stamp each to common stamps: the mean of the stamps of a message.
class RotorAligner {
 public:
  explicit RotorAligner(Stamp most_spread) : most_spread_(most_spread) {}

  void Add(const BlackbirdFlight::RotorMessage& message, std::vector<RotorSample>* samples) {
    if (histories_.empty()) histories_.resize(message.rpm.size());
    if (message.rpm.size() != histories_.size()) {
      throw std::invalid_argument("rotor speeds: " + std::to_string(message.rpm.size()) +
                                  " rotors where the first message has " +
                                  std::to_string(histories_.size()));
    }
    Push(message);
    while (!pending_.empty() && IsReached(pending_.front())) {
      const Stamp stamp = pending_.front();
      pending_.pop_front();
      const bool is_covered = std::all_of(histories_.begin(), histories_.end(),
                                          [&](const auto& h) { return h.front().stamp <= stamp; });
      if (!is_covered) {
        ++not_covered_;
        continue;
      }
      RotorSample sample{stamp, RotorVector(static_cast<Eigen::Index>(histories_.size()))};
      for (size_t j = 0; j < histories_.size(); ++j) {
        sample.speed[static_cast<Eigen::Index>(j)] = At(stamp, &histories_[j]);
      }
      samples->push_back(sample);
    }
  }

  void Report(FlightLog* log) {
    not_covered_ += static_cast<long>(pending_.size());
    Tell(spread_too_far_,
         "rotor messages left out: their stamps differ by more than " +
             std::to_string(most_spread_ / 1000000) + " ms",
         log);
    Tell(not_covered_, "rotor messages left out: no sample of every rotor on both sides", log);
  }

 private:
  struct Reading {
    Stamp stamp;
    double speed;
  };

  void Push(const BlackbirdFlight::RotorMessage& message) {
    Stamp sum = 0;
    for (size_t j = 0; j < histories_.size(); ++j) {
      auto& history = histories_[j];
      const Stamp stamp = message.stamps[j];
      sum += stamp - message.stamps.front();
      if (std::isfinite(message.rpm[j]) && (history.empty() || stamp > history.back().stamp)) {
        history.push_back({stamp, kRpm * message.rpm[j]});
      }
    }
    const auto [first, last] = std::minmax_element(message.stamps.begin(), message.stamps.end());
    const auto n = static_cast<Stamp>(message.stamps.size());
    const Stamp common = message.stamps.front() + (sum >= 0 ? sum / n : -((-sum + n - 1) / n));
    if (*last - *first > most_spread_) {
      ++spread_too_far_;
    } else if (common > newest_) {
      newest_ = common;
      pending_.push_back(common);
    } else {
      ++not_covered_;
    }
  }

  bool IsReached(Stamp stamp) const {
    return std::all_of(histories_.begin(), histories_.end(),
                       [&](const auto& h) { return !h.empty() && h.back().stamp >= stamp; });
  }

  static double At(Stamp stamp, std::deque<Reading>* history) {
    while (history->size() > 1 && (*history)[1].stamp <= stamp) history->pop_front();
    const Reading& a = history->front();
    if (a.stamp == stamp) return a.speed;
    const Reading& b = (*history)[1];
    return a.speed + (b.speed - a.speed) * static_cast<double>(stamp - a.stamp) /
                         static_cast<double>(b.stamp - a.stamp);
  }

  static void Tell(long count, const std::string& what, FlightLog* log) {
    if (count == 0) return;
    log->dropped += count;
    log->warnings.push_back(log->file + ": " + std::to_string(count) + " " + what);
  }

  Stamp most_spread_, newest_ = -1;
  std::vector<std::deque<Reading>> histories_;
  std::deque<Stamp> pending_;
  long spread_too_far_ = 0, not_covered_ = 0;
};

void AddPoses(const BlackbirdFlight& flight, const QuaternionReading& reading, FlightLog* log) {
  for (const auto& pose : flight.poses) {
    OdometrySample sample;
    sample.stamp = pose.stamp;
    sample.p_WS = EnuFromNed(pose.p_NED);
    sample.q_WS = AttitudeOf(pose, reading).normalized();
    log->odometry.push_back(sample);
  }
}

void AddImu(const BlackbirdFlight& flight, int yaw_deg, FlightLog* log) {
  for (const ImuSample& sample : flight.imu) {
    log->imu.push_back({sample.stamp, FluFromImu(*sample.gyro_I, yaw_deg),
                        FluFromImu(*sample.specific_force_I, yaw_deg)});
  }
}

void AddCommands(const BlackbirdFlight& flight, FlightLog* log) {
  log->command_unit = CommandUnit::kMicroseconds;
  for (const auto& command : flight.commands) {
    CommandSample sample{command.stamp,
                         RotorVector(static_cast<Eigen::Index>(command.pwm_us.size()))};
    for (size_t j = 0; j < command.pwm_us.size(); ++j) {
      sample.throttle[static_cast<Eigen::Index>(j)] =
          ThrottleOf(command.pwm_us[j], CommandUnit::kMicroseconds);
    }
    log->commands.push_back(sample);
  }
}

void CheckCount(size_t count, int num_rotors) {
  if (static_cast<int>(count) == num_rotors) return;
  throw std::invalid_argument("has " + std::to_string(count) + " rotors, the vehicle has " +
                              std::to_string(num_rotors));
}

void Convert(BlackbirdFlight* flight, const FlightReadOptions& options, FlightLog* log) {
  KeepOrdered("state", &flight->poses, log);
  KeepOrdered("imu", &flight->imu, log);
  KeepOrdered("pwm", &flight->commands, log);
  KeepUnit(&flight->poses, log);
  const Findings findings = Check(*flight, log);
  if (findings.Text() != Findings().Text()) {
    log->warnings.push_back(log->file + ": read with " + findings.Text() + ", as the gyro demands");
  }
  AddPoses(*flight, ReadingNamed(findings.quaternion), log);
  AddImu(*flight, findings.imu_yaw_deg, log);
  AddCommands(*flight, log);
  RotorAligner aligner(FromSeconds(options.rotor_spread_s));
  for (const auto& message : flight->rotors) aligner.Add(message, &log->rotors);
  aligner.Report(log);
  if (log->rotors.empty()) throw std::invalid_argument("no usable rotor speeds");
  CheckCount(static_cast<size_t>(log->rotors.front().speed.size()), options.num_rotors);
  for (const auto& command : flight->commands)
    CheckCount(command.pwm_us.size(), options.num_rotors);
}

}  // namespace

void ConvertBlackbird(BlackbirdFlight flight, const FlightReadOptions& options, FlightLog* log) {
  try {
    Convert(&flight, options, log);
  } catch (const std::invalid_argument& e) {
    throw std::invalid_argument(flight.path + ": " + e.what());
  }
  NormaliseAttitudes(flight.path, &log->odometry, log);
  TakeSpeedMagnitudes(log->file, log);
  WarnOfDeadRotors(log->file, log);
}

}  // namespace odmc

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "binary_file.h"
#include "blackbox_frames.h"
#include "log_streams.h"
#include "odmc/io/autopilot_logs.h"
#include "odmc/math/units.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr std::string_view kStart = "H Product:Blackbox";

// Units of the fields; INDIflight's pose is NED/FRD, gyro and accelerometer are FLU.
constexpr double kPosition_m = 1e-3, kVelocity_m_s = 1e-2, kVoltage_V = 1e-2;
constexpr double kHundredRpm = 100.0 * kRpm;

std::string Indexed(const std::string& name, int i) { return name + "[" + std::to_string(i) + "]"; }

std::vector<std::string> WantedFields(int num_rotors) {
  std::vector<std::string> names = {"vbatLatest"};
  const auto add = [&](const std::string& name, int count) {
    for (int i = 0; i < count; ++i) names.push_back(Indexed(name, i));
  };
  add("quat", 4);
  for (const char* name :
       {"pos", "vel", "gyroADCafterRpm", "gyroUnfilt", "gyroADC", "accUnfiltered", "accSmooth"}) {
    add(name, 3);
  }
  for (const char* name : {"omegaUnfiltered", "omega", "eRPM", "motor"}) add(name, num_rotors);
  return names;
}

/// Columns NAME[0..] of the frames.
class Fields {
 public:
  Fields(const BlackboxFrames& frames, const std::string& name, int count) {
    for (int i = 0; i < count; ++i) {
      const auto found = frames.values.find(Indexed(name, i));
      if (found == frames.values.end()) {
        columns_.clear();
        return;
      }
      columns_.push_back(&found->second);
    }
  }
  bool present() const { return !columns_.empty(); }
  double operator()(int i, size_t row) const { return (*columns_[static_cast<size_t>(i)])[row]; }
  Eigen::Vector3d Vector(size_t row) const {
    return {(*this)(0, row), (*this)(1, row), (*this)(2, row)};
  }

 private:
  std::vector<const std::vector<double>*> columns_;
};

/// The first of several names that the log has.
Fields FirstOf(const BlackboxFrames& frames, std::initializer_list<const char*> names, int count) {
  Fields fields(frames, "", 1);
  for (const char* name : names) {
    if (!fields.present()) fields = Fields(frames, name, count);
  }
  return fields;
}

/// Where each log in the file starts.
std::vector<size_t> Starts(std::string_view bytes) {
  std::vector<size_t> starts;
  for (size_t at = bytes.find(kStart); at != std::string_view::npos;
       at = bytes.find(kStart, at + kStart.size())) {
    starts.push_back(at);
  }
  return starts;
}

struct Decoded {
  BlackboxHeader header;
  BlackboxFrames frames;
};

/// The log of the file with most frames.
Decoded DecodeLongest(const std::string& file, std::string_view bytes, int num_rotors,
                      FlightLog* log) {
  std::vector<size_t> starts = Starts(bytes);
  if (starts.empty()) RefuseFile(file, "is no blackbox log: it has no line 'H Product:Blackbox'");
  starts.push_back(bytes.size());
  std::optional<Decoded> longest;
  size_t number = 0;
  std::string error;
  for (size_t i = 0; i + 1 < starts.size(); ++i) {
    const std::string_view part = bytes.substr(starts[i], starts[i + 1] - starts[i]);
    try {
      BlackboxHeader header(file, part);
      BlackboxFrames frames = DecodeBlackbox(header, part, WantedFields(num_rotors));
      if (longest && longest->frames.stamps.size() >= frames.stamps.size()) continue;
      longest = Decoded{std::move(header), std::move(frames)};
      longest->frames.damage.first += starts[i];
      number = i + 1;
    } catch (const std::invalid_argument& e) {
      if (error.empty()) error = e.what();
    }
  }
  if (!longest) throw std::invalid_argument(error);
  if (starts.size() > 2) {
    log->warnings.push_back(log->file + ": holds " + std::to_string(starts.size() - 1) +
                            " logs; read the longest, number " + std::to_string(number));
  }
  return std::move(*longest);
}

void Report(const std::string& file, const BlackboxFrames& frames, size_t bytes, FlightLog* log) {
  if (frames.stamps.size() < 2) {
    RefuseFile(file,
               "blackbox log: no frame can be decoded after the header" +
                   (frames.damage.places > 0
                        ? " (damaged from byte " + std::to_string(frames.damage.first) + " on)"
                        : std::string()));
  }
  ReportDamage(file, frames.damage, bytes, log);
}

void ReadPoses(const std::string& file, const Decoded& decoded, FlightPart part, FlightLog* log) {
  const BlackboxFrames& frames = decoded.frames;
  const Fields p(frames, "pos", 3), q(frames, "quat", 4), v(frames, "vel", 3);
  if (!p.present() || !q.present()) {
    if (part == FlightPart::kOnboard) return;
    RefuseFile(file,
               "this blackbox log (" + Printable(decoded.header.Text("Firmware revision"), 80) +
                   ") has no pose: fields pos[0..2], quat[0..3] are missing, Betaflight writes "
                   "none. --odometry FILE takes it from a recording beside the log (a rosbag or "
                   "CSV file of motion capture or VIO)");
  }
  log->odometry.reserve(frames.stamps.size());
  for (size_t i = 0; i < frames.stamps.size(); ++i) {
    OdometrySample sample;
    sample.stamp = frames.stamps[i];
    sample.p_WS = kPosition_m * FluFromFrd(p.Vector(i));
    const Eigen::Quaterniond q_NedFrd(q(0, i), q(1, i), q(2, i), q(3, i));  // times some 8127
    if (q_NedFrd.norm() > 0.0) sample.q_WS = NwuFromNed(q_NedFrd.normalized());
    if (q_NedFrd.norm() == 0.0) sample.q_WS.coeffs().setConstant(std::nan(""));
    if (v.present()) sample.v_WS = kVelocity_m_s * FluFromFrd(v.Vector(i));
    log->odometry.push_back(sample);
  }
}

/// Of the raw gyro, deg/s each [rad/s].
double GyroScale(const BlackboxHeader& header) {
  const bool is_fine = header.Number("blackbox_high_resolution").value_or(0) == 1;
  return (is_fine ? 0.1 : 1.0) * kDegree;
}

void ReadImu(const Decoded& decoded, FlightLog* log) {
  const BlackboxFrames& frames = decoded.frames;
  const Fields gyro = FirstOf(frames, {"gyroADCafterRpm", "gyroUnfilt", "gyroADC"}, 3);
  const Fields acc = FirstOf(frames, {"accUnfiltered", "accSmooth"}, 3);
  if (!gyro.present() && !acc.present()) return;
  const double gyro_scale = GyroScale(decoded.header);
  const auto one_g = static_cast<double>(decoded.header.Number("acc_1G").value_or(0));
  log->imu.reserve(frames.stamps.size());
  for (size_t i = 0; i < frames.stamps.size(); ++i) {
    ImuSample sample;
    sample.stamp = frames.stamps[i];
    if (gyro.present()) sample.gyro_I = gyro_scale * gyro.Vector(i);
    if (acc.present() && one_g > 0.0) {
      sample.specific_force_I = kStandardGravity_m_s2 / one_g * acc.Vector(i);
    }
    log->imu.push_back(sample);
  }
}

/// Factor to rad/s of eRPM/100, or of the firmware's own speeds where the user's poles differ.
double RotorScale(const std::string& file, const BlackboxHeader& header, bool is_electrical,
                  std::optional<int> pole_pairs) {
  const auto poles = header.Number("motor_poles");
  if (!pole_pairs && !is_electrical) return 1.0;
  if ((!poles || *poles < 2) && (is_electrical ? !pole_pairs : true)) {
    RefuseFile(file, "the header has no motor_poles; --pole-pairs says them");
  }
  const double log_pairs = poles ? 0.5 * static_cast<double>(*poles) : 0.0;
  if (!is_electrical) return log_pairs / *pole_pairs;
  return kHundredRpm / (pole_pairs ? *pole_pairs : log_pairs);
}

void ReadRotors(const std::string& file, const Decoded& decoded, const FlightReadOptions& options,
                FlightLog* log) {
  const BlackboxFrames& frames = decoded.frames;
  const int n = options.num_rotors;
  const Fields mechanical = FirstOf(frames, {"omegaUnfiltered", "omega"}, n);
  const Fields speeds = mechanical.present() ? mechanical : Fields(frames, "eRPM", n);
  if (!speeds.present()) return;
  const double scale = RotorScale(file, decoded.header, !mechanical.present(), options.pole_pairs);
  log->rotors.reserve(frames.stamps.size());
  for (size_t i = 0; i < frames.stamps.size(); ++i) {
    RotorSample sample;
    sample.stamp = frames.stamps[i];
    sample.speed.resize(n);
    for (int j = 0; j < n; ++j) sample.speed[j] = scale * speeds(j, i);
    log->rotors.push_back(sample);
  }
}

void ReadCommands(const std::string& file, const Decoded& decoded, int num_rotors, FlightLog* log) {
  int motors = 0;
  while (decoded.header.FieldNamed(Indexed("motor", motors))) ++motors;
  if (motors > 0 && motors != num_rotors) {
    RefuseFile(file, "has " + std::to_string(motors) + " motors, the vehicle has " +
                         std::to_string(num_rotors) + " rotors");
  }
  const auto low = decoded.header.Number("motorOutput", 0);
  const auto high = decoded.header.Number("motorOutput", 1);
  const Fields commands(decoded.frames, "motor", num_rotors);
  if (!commands.present() || !low || !high || *high <= *low) return;
  const double range = static_cast<double>(*high - *low);
  log->command_unit = CommandUnit::kFraction;
  for (size_t i = 0; i < decoded.frames.stamps.size(); ++i) {
    CommandSample sample{decoded.frames.stamps[i], RotorVector(num_rotors)};
    for (int j = 0; j < num_rotors; ++j) {
      sample.throttle[j] =
          std::clamp((commands(j, i) - static_cast<double>(*low)) / range, 0.0, 1.0);
    }
    log->commands.push_back(sample);
  }
}

void ReadBattery(const Decoded& decoded, FlightLog* log) {
  const auto found = decoded.frames.values.find("vbatLatest");
  if (found == decoded.frames.values.end()) return;
  for (size_t i = 0; i < decoded.frames.stamps.size(); ++i) {
    if (found->second[i] > 0.0) {
      log->battery.push_back({decoded.frames.stamps[i], kVoltage_V * found->second[i]});
    }
  }
}

}  // namespace

bool IsBlackbox(std::string_view head) { return head.substr(0, kStart.size()) == kStart; }

FlightLog ReadBlackbox(const std::string& file, const FlightReadOptions& options) {
  if (options.pose == PoseSource::kMocap) {
    RefuseFile(file,
               "--pose mocap is for CSV files and bags; a blackbox log has the observer's pose");
  }
  const std::string bytes = ReadBinary(file);
  FlightLog log;
  log.file = Printable(std::filesystem::path(file).filename().string());
  const Decoded decoded = DecodeLongest(file, bytes, options.num_rotors, &log);
  Report(file, decoded.frames, bytes.size(), &log);
  ReadPoses(file, decoded, options.part, &log);
  if (options.part != FlightPart::kPoses) {
    ReadImu(decoded, &log);
    ReadCommands(file, decoded, options.num_rotors, &log);
    ReadRotors(file, decoded, options, &log);
    ReadBattery(decoded, &log);
    if (log.rotors.empty() && log.commands.empty()) {
      RefuseFile(file,
                 "has no rotor speeds (fields omega or eRPM): switch on bidirectional DShot "
                 "(set dshot_bidir = ON) and log RPM");
    }
  }
  const std::string rate =
      "raise the blackbox rate (set blackbox_sample_rate = 1/2 or 1/4 of the "
      "control loop's rate)";
  FinishLog(file, {rate, rate, rate}, options.part, &log);
  return log;
}

}  // namespace odmc

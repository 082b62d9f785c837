#include "odmc/inspection/online_stream_corrector.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace odmc {
namespace {

constexpr double kAnotherOffset_s = 0.005, kSigmas = 3.0;

bool HasOwnStamps(const std::string& stream) {
  return stream == "rotor_speeds" || stream == "gyro" || stream == "accelerometer";
}

/// True if the flag was raised now.
bool Raise(bool now, bool* flag) { return now && !std::exchange(*flag, true); }

}  // namespace

double OnlineStreamCorrector::OffsetOf(const std::string& stream) const {
  const auto found =
      offset_s_.find(HasOwnStamps(stream) && stream != "rotor_speeds" ? "imu" : stream);
  return found == offset_s_.end() ? 0.0 : found->second;
}

bool OnlineStreamCorrector::TakeOff(const TimeOffset& offset, double left_s) {
  double& taken_s = offset_s_[offset.stream == "rotor_speeds" ? "rotor_speeds" : "imu"];
  const double offset_s = offset.compensated_s - left_s;
  if (std::abs(offset_s - taken_s) <= std::max(kAnotherOffset_s, kSigmas * offset.lag.sigma_s())) {
    return false;
  }
  taken_s = offset_s;
  return true;
}

bool OnlineStreamCorrector::Adopt(const StreamInspection& inspection) {
  findings_ = inspection.findings;
  bool is_new = false;
  double rates_s = 0.0;  // stays in rates that share the poses' stamps
  for (const TimeOffset& offset : inspection.offsets) {
    if (offset.stream == "body_rates") rates_s = offset.compensated_s;
    const double left_s = offset.against == "body_rates" ? rates_s : 0.0;
    if (offset.compensated_s == 0.0 && left_s == 0.0) continue;
    if (HasOwnStamps(offset.stream)) {
      is_new = TakeOff(offset, left_s) || is_new;
      continue;
    }
    const std::string check = offset.stream + "_offset";
    const auto told = std::find_if(findings_.begin(), findings_.end(),
                                   [&](const Finding& f) { return f.check == check; });
    if (told != findings_.end()) *told = OffsetFinding(offset, false);
  }
  is_new = Raise(inspection.drop_velocity, &dropped_.velocity) || is_new;
  is_new = Raise(inspection.drop_rates, &dropped_.rates) || is_new;
  is_new = Raise(inspection.drop_gyro, &dropped_.gyro) || is_new;
  return Raise(inspection.drop_accelerometer, &dropped_.accelerometer) || is_new;
}

void OnlineStreamCorrector::Mend(OdometrySample* sample) const {
  if (dropped_.velocity) sample->v_WS.reset();
  if (dropped_.rates) sample->w_WS_S.reset();
}

void OnlineStreamCorrector::Mend(ImuSample* sample) const {
  sample->stamp -= FromSeconds(OffsetOf("gyro"));
  if (dropped_.gyro) sample->gyro_I.reset();
  if (dropped_.accelerometer) sample->specific_force_I.reset();
}

void OnlineStreamCorrector::Mend(RotorSample* sample) const {
  sample->stamp -= FromSeconds(OffsetOf("rotor_speeds"));
}

}  // namespace odmc

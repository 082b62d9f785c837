#include "blackbird_bag.h"

#include <filesystem>
#include <utility>

#include "odmc/io/data_sets.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr char kBlackbirdState[] = "/blackbird/state", kBlackbirdRotors[] = "/blackbird/rotor_rpm",
               kBlackbirdImu[] = "/blackbird/imu", kBlackbirdPwm[] = "/blackbird/pwm";

BlackbirdFlight::RotorMessage RotorMessageOf(const std::string& file, const MessageLayout& layout,
                                             const RawMessage& m) {
  BlackbirdFlight::RotorMessage rotors;
  rotors.rpm = layout.Numbers(layout.Find("rpm[]"), m.bytes.data(), m.bytes.size());
  const bool is_stamped = layout.Has("sample_stamp[]");
  rotors.stamps = layout.Stamps(layout.Find(is_stamped ? "sample_stamp[]" : "header.stamp"),
                                m.bytes.data(), m.bytes.size());
  // Messages of the first version, and those whose list is empty, have the header's for all.
  if (is_stamped && rotors.stamps.empty()) {
    rotors.stamps = layout.Stamps(layout.Find("header.stamp"), m.bytes.data(), m.bytes.size());
  }
  if (rotors.stamps.size() == 1) rotors.stamps.resize(rotors.rpm.size(), rotors.stamps.front());
  if (rotors.rpm.empty() || rotors.rpm.size() != rotors.stamps.size()) {
    RefuseFile(file, std::to_string(rotors.stamps.size()) + " stamps for " +
                         std::to_string(rotors.rpm.size()) + " rotor speeds");
  }
  return rotors;
}

}  // namespace

bool IsBlackbird(const BagSource& bag, const BagOptions& options) {
  return options.topics.empty() && !options.uses_tf() &&
         bag.TypeOf(kBlackbirdState) == "geometry_msgs/PoseStamped";
}

FlightLog ReadBlackbirdBag(BagSource* bag, const FlightReadOptions& read) {
  FlightLog log;
  log.file = std::filesystem::path(bag->file()).filename().string();
  for (const char* topic : {kBlackbirdState, kBlackbirdRotors}) {
    if (bag->TypeOf(topic).empty() || bag->Count(topic) == 0) {
      RefuseFile(bag->file(), std::string("no messages on ") + topic + "; " + bag->Contents());
    }
  }
  BlackbirdFlight flight;
  flight.path = bag->file();
  bag->Read<OdometryInput>(
      kBlackbirdState, InputStream::kPose, 0, &log, [&](const OdometryInput& m) {
        const Eigen::Quaterniond& q = m.sample.q_WS;
        flight.poses.push_back({m.sample.stamp, m.sample.p_WS, {q.w(), q.x(), q.y(), q.z()}});
      });
  if (!bag->TypeOf(kBlackbirdImu).empty()) {
    bag->Read<ImuInput>(kBlackbirdImu, InputStream::kImu, 0, &log,
                        [&](const ImuInput& m) { flight.imu.push_back(m.sample); });
  }
  bag->ReadRaw(kBlackbirdRotors, [&](const MessageLayout& layout, const RawMessage& m) {
    flight.rotors.push_back(RotorMessageOf(bag->file(), layout, m));
  });
  bag->ReadRaw(kBlackbirdPwm, [&](const MessageLayout& layout, const RawMessage& m) {
    const auto stamps = layout.Stamps(layout.Find("header.stamp"), m.bytes.data(), m.bytes.size());
    flight.commands.push_back(
        {stamps.front(), layout.Numbers(layout.Find("pwm[]"), m.bytes.data(), m.bytes.size())});
  });
  ConvertBlackbird(std::move(flight), read, &log);
  return log;
}

}  // namespace odmc

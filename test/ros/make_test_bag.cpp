// Makes the bag a rostest plays and prints what has to come out of it, as JSON.
//
//   make_test_bag OUT.bag SECONDS plain    topics as WriteFlightBag() writes them
//   make_test_bag OUT.bag SECONDS frames   odometry thrice: /in_body, /in_world, /in_neither
//   make_test_bag OUT.bag SECONDS hover    as plain, take-off to hover after 2 s
//   make_test_bag OUT.bag SECONDS undeclared  as plain, with a quadratic drag no vehicle file has
//   make_test_bag OUT.bag SECONDS commands     motor commands, no rotor speeds
//   make_test_bag OUT.bag SECONDS late_rotors  aggressive, rotor speeds stamped 40 ms late
//   make_test_bag OUT.bag SECONDS KIND     as plain, rotor speeds in messages of packages that are
//       not installed (support/foreign_bag.h): actuators, esc_status, made_up, made_up_stamped
//   make_test_bag OUT.bag SECONDS pose_twist   odometry as TransformStamped and TwistStamped
//   make_test_bag OUT.bag SECONDS tf           odometry as tf: map -> odom (static) -> base_link
//   make_test_bag OUT.bag SECONDS esc_stamps   each rotor speed with a stamp of its own
//   make_test_bag OUT.bag SECONDS dead_sensor  motor commands; rotor 2 reads 0 from the middle on

#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <nav_msgs/Odometry.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <tf2_msgs/TFMessage.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "odmc/analysis/replay.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/inspection/stream_inspection.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/ros/flight_bag.h"
#include "odmc/ros/message_values.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/foreign_bag.h"

namespace odmc {
namespace {

const std::string kFolder = ODMC_SOURCE_DIR;
constexpr double kQuadraticDrag_kg_m = 0.05;
constexpr int kDeadRotor = 1;
constexpr double kLate_s = 0.04, kApart_s = 1e-5;

using Json = nlohmann::json;

/// The flight has motor commands.
bool IsCommanded(const std::string& kind) { return kind == "commands" || kind == "dead_sensor"; }

Json ByName(const DynamicModel& model, const ModelValues& values) {
  Json json;
  for (int i = 0; i < model.num_parameters(); ++i) {
    json[model.parameters()[i].full_name] = values[i];
  }
  return json;
}

Actuator TestActuator() { return LoadActuator(kFolder + "/test/ros/test_actuator.yaml"); }

/// What the offline estimator says of the bag, with the node's options in the rostests.
Json Offline(const std::string& bag, const std::string& kind, const BagOptions& reading = {}) {
  const Vehicle vehicle = LoadVehicle(kFolder + "/test/ros/test_quad.yaml");
  const DynamicModel model(vehicle, vehicle.effects);
  EstimatorOptions options = OfflineOptions();
  Estimator estimator(&model, options, true);
  FlightLog log = ReadFlightBag(bag, vehicle.num_rotors(), reading);
  if (IsCommanded(kind)) {
    SettleRotors(TestActuator(), vehicle.num_rotors(), kind == "commands", &log);
  }
  const ReplayResult result = Replay(log, &estimator);
  const ParameterSet set = Estimator::ToParameterSet(model, result.last.value());
  Json json;
  for (const ParameterEstimate& p : set.parameters) {
    json[p.full_name] = {
        {"value", p.value}, {"sigma", p.sigma}, {"unit", p.unit}, {"observable", p.observable}};
  }
  return json;
}

/// The odometry of `from` with its velocity in the body, in the world, and in no frame at all. The
/// messages declare the other frame: only the motion tells.
void WriteFrames(const std::string& from, const std::string& to) {
  rosbag::Bag in(from, rosbag::bagmode::Read), out(to, rosbag::bagmode::Write);
  for (const rosbag::MessageInstance& m : rosbag::View(in)) {
    const auto odometry = m.instantiate<nav_msgs::Odometry>();
    if (odometry == nullptr) {
      out.write(m.getTopic(), m.getTime(), m);
      continue;
    }
    const auto& v = odometry->twist.twist.linear;
    const auto& q = odometry->pose.pose.orientation;
    const Eigen::Vector3d v_W(v.x, v.y, v.z);
    const Eigen::Quaterniond q_WB(q.w, q.x, q.y, q.z);
    nav_msgs::Odometry message = *odometry;
    out.write("/in_neither/odometry", m.getTime(), [&] {
      message.twist.twist.linear = ToVector3({v_W.z(), -v_W.x(), v_W.y()});
      return message;
    }());
    message.twist.twist.linear = ToVector3(q_WB.conjugate() * v_W);
    out.write("/in_body/odometry", m.getTime(), message);
    message.child_frame_id = "base_link";
    message.twist.twist.linear = ToVector3(v_W);
    out.write("/in_world/odometry", m.getTime(), message);
  }
}

bool IsForeign(const std::string& kind) {
  return kind == "actuators" || kind == "esc_status" || kind == "made_up" ||
         kind == "made_up_stamped";
}

/// The odometry of `from` as a transform and a velocity in the world.
void WritePoseTwist(const std::string& from, const std::string& to) {
  rosbag::Bag in(from, rosbag::bagmode::Read), out(to, rosbag::bagmode::Write);
  for (const rosbag::MessageInstance& m : rosbag::View(in)) {
    const auto odometry = m.instantiate<nav_msgs::Odometry>();
    if (odometry == nullptr) {
      out.write(m.getTopic(), m.getTime(), m);
      continue;
    }
    geometry_msgs::TransformStamped transform;
    geometry_msgs::TwistStamped twist;
    transform.header = twist.header = odometry->header;
    transform.transform.translation = ToVector3(ToEigen(odometry->pose.pose.position));
    transform.transform.rotation = odometry->pose.pose.orientation;
    twist.twist.linear = odometry->twist.twist.linear;
    out.write("/vicon/quad", m.getTime(), transform);
    out.write("/velocity", m.getTime(), twist);
  }
}

/// The odometry of `from` as transforms, the last of them in the world.
void WriteTf(const std::string& from, const std::string& to) {
  rosbag::Bag in(from, rosbag::bagmode::Read), out(to, rosbag::bagmode::Write);
  tf2_msgs::TFMessage fixed;
  fixed.transforms.resize(1);
  fixed.transforms[0].header.frame_id = "map";
  fixed.transforms[0].child_frame_id = "odom";
  fixed.transforms[0].transform.translation.x = 5.0;
  fixed.transforms[0].transform.rotation.w = 1.0;
  bool is_first = true;
  for (const rosbag::MessageInstance& m : rosbag::View(in)) {
    if (std::exchange(is_first, false)) out.write("/tf_static", m.getTime(), fixed);
    const auto odometry = m.instantiate<nav_msgs::Odometry>();
    if (odometry == nullptr) {
      out.write(m.getTopic(), m.getTime(), m);
      continue;
    }
    tf2_msgs::TFMessage moving;
    moving.transforms.resize(1);
    moving.transforms[0].header.stamp = odometry->header.stamp;
    moving.transforms[0].header.frame_id = "odom";
    moving.transforms[0].child_frame_id = "base_link";
    const auto& p = odometry->pose.pose.position;
    moving.transforms[0].transform.translation = ToVector3(ToEigen(p));
    moving.transforms[0].transform.rotation = odometry->pose.pose.orientation;
    out.write("/tf", m.getTime(), moving);
    out.write("/tf", m.getTime(), moving);
  }
}

/// Telemetry of `from`'s rotor speeds: a header that is late by up to 2 ms, of four ESCs on a clock
/// of their own.
void WriteEscStamps(const std::string& from, const std::string& to) {
  const std::string definition =
      testing_support::With(testing_support::WithHeader("Header header\nEsc[4] escs\n"),
                            "garage_quad/Esc", "uint64 timestamp\nfloat64 rpm\n");
  constexpr Stamp kOwnStart = 123456789;
  rosbag::Bag in(from, rosbag::bagmode::Read), out(to, rosbag::bagmode::Write);
  int count = 0;
  for (const rosbag::MessageInstance& m : rosbag::View(in)) {
    const auto rotors = m.instantiate<RotorSpeeds>();
    if (rotors == nullptr) {
      out.write(m.getTopic(), m.getTime(), m);
      continue;
    }
    const Stamp stamp = FromRos(rotors->header.stamp);
    testing_support::MessageBytes bytes;
    bytes.AddHeader(stamp + 500000 * (count++ % 5), "");
    for (const double speed : rotors->angular_velocity_rad_s) {
      bytes.Add(static_cast<std::uint64_t>((stamp + kOwnStart) / 1000));
      bytes.Add(speed * 30.0 / M_PI);
    }
    out.write("/escs", m.getTime(),
              testing_support::Raw("garage_quad/Escs", "0123456789abcdef0123456789abcdee",
                                   definition, bytes));
  }
}

/// What the ESCs must have been told for the rotors to turn as they did: each command reaches the
/// speed that the rotor has when the next one begins to act.
std::vector<CommandSample> CommandsOf(const SimulatedFlight& flight, const Actuator& actuator) {
  const auto& truth = flight.truth;
  const double period_s = ToSeconds(truth.at(1).stamp - truth.at(0).stamp);
  const auto late = static_cast<size_t>(std::lround(actuator.MotorOf(0).delay_s / period_s));
  std::vector<CommandSample> commands;
  for (size_t i = 0; i + late + 1 < truth.size(); ++i) {
    const RotorVector &from = truth[i + late].rotor_speed, &to = truth[i + late + 1].rotor_speed;
    CommandSample sample{truth[i].stamp, RotorVector(from.size())};
    for (int j = 0; j < from.size(); ++j) {
      const double command =
          actuator.CommandFor(j, 0.5 * (from[j] + to[j]), (to[j] - from[j]) / period_s,
                              flight.log.battery[i].voltage_V);
      sample.throttle[j] = ThrottleOf(command, actuator.command_unit);
    }
    commands.push_back(sample);
  }
  return commands;
}

/// Gives the flight its commands and takes away a sensor or all.
Json WithCommands(const std::string& kind, SimulatedFlight* flight) {
  FlightLog& log = flight->log;
  log.commands = CommandsOf(*flight, TestActuator());
  if (kind == "commands") {
    log.rotors.clear();
    return nullptr;
  }
  const size_t half = log.rotors.size() / 2;
  for (size_t i = half; i < log.rotors.size(); ++i) log.rotors[i].speed[kDeadRotor] = 0.0;
  // WriteFlightBag() moves a flight that starts at 0 to 1 s.
  return {{"rotor", "rotor" + std::to_string(kDeadRotor + 1)},
          {"since_s", ToSeconds(log.rotors[half].stamp) + 1.0}};
}

void Run(const std::string& file, double duration_s, const std::string& kind) {
  Vehicle vehicle = LoadVehicle(kFolder + "/config/vehicles/generic.yaml");
  const bool undeclared = kind == "undeclared";
  if (undeclared) vehicle.effects.push_back("quadratic_drag");
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues truth = DefaultTruth(model);
  if (undeclared) truth[model.IndexOf("quadratic_drag.c_q")] = kQuadraticDrag_kg_m;
  SimulationOptions options;
  const bool late = kind == "late_rotors";
  if (undeclared || late) options.trajectory = "aggressive";
  if (kind == "hover") {
    options.trajectory = "hover";
    options.ground_s = 2.0;
  }
  options.duration_s = duration_s;
  options.log_rate_hz = 200.0;
  SimulatedFlight flight = Simulate(model, truth, options);
  if (late) ShiftRotors(-kLate_s, &flight.log);
  // Microseconds more or less must not put a speed before or after the pose of the same stamp.
  if (kind == "esc_stamps") ShiftRotors(-kApart_s, &flight.log);
  Json json = {{"truth", ByName(model, truth)},
               {"effects", vehicle.effects},
               {"late_s", late ? kLate_s : 0.0}};
  if (IsCommanded(kind)) json["dead_sensor"] = WithCommands(kind, &flight);
  if (kind == "frames") {
    WriteFlightBag(flight.log, file + ".plain");
    WriteFrames(file + ".plain", file);
    std::remove((file + ".plain").c_str());
  } else if (kind == "pose_twist") {
    WriteFlightBag(flight.log, file + ".plain");
    WritePoseTwist(file + ".plain", file);
    std::remove((file + ".plain").c_str());
    BagOptions reading;
    reading.topics["twist"] = "/velocity";
    json["offline"] = Offline(file, kind, reading);
  } else if (kind == "tf" || kind == "esc_stamps") {
    const std::string plain = file + ".plain";
    WriteFlightBag(flight.log, plain);
    BagOptions reading;
    if (kind == "tf") {
      WriteTf(plain, file);
      reading.odometry_tf_parent = "map";
      reading.odometry_tf_child = "base_link";
      json["offline"] = Offline(file, kind, reading);
    } else {
      WriteEscStamps(plain, file);
      reading.topics["rotor_speeds"] = "/escs";
      reading.rotor_topic_field = "escs[].rpm";
      reading.rotor_speed_unit = "rpm";
      reading.rotor_stamp_field = "escs[].timestamp";
      reading.rotor_stamp_unit = "us";
      json["offline"] = Offline(file, kind, reading);
      json["plain"] = Offline(plain, kind);  // as with odmc/RotorSpeeds
    }
    std::remove(plain.c_str());
  } else if (IsForeign(kind)) {
    const std::string plain = file + ".plain";
    WriteFlightBag(flight.log, plain);
    json["offline"] = Offline(plain, kind);  // as with odmc/RotorSpeeds
    testing_support::WriteForeign(plain, file, kind);
    std::remove(plain.c_str());
  } else {
    WriteFlightBag(flight.log, file);
    if (!undeclared && !late) json["offline"] = Offline(file, kind);
  }
  std::printf("%s\n", json.dump(2).c_str());
}

}  // namespace
}  // namespace odmc

int main(int argc, char** argv) {
  try {
    if (argc != 4)
      throw std::invalid_argument(
          "usage: make_test_bag OUT.bag SECONDS plain|hover|frames|undeclared|commands|"
          "late_rotors|actuators|esc_status|made_up|made_up_stamped|pose_twist|tf|esc_stamps|dead_"
          "sensor");
    odmc::Run(argv[1], std::atof(argv[2]), argv[3]);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "make_test_bag: %s\n", e.what());
    return 1;
  }
  return 0;
}

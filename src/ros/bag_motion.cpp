#include "bag_motion.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "finite_samples.h"
#include "odmc/ros/pose_twist.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/twist_frame.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

/// Messages before the frame of their twist is known.
using RawOdometries = std::vector<OdometryInput>;

/// The first whose pose is a number.
const OdometrySample& FirstWhole(const RawOdometries& messages) {
  const auto is_whole = [](const OdometryInput& m) {
    return m.sample.p_WS.allFinite() && m.sample.q_WS.coeffs().allFinite();
  };
  const auto first = std::find_if(messages.begin(), messages.end(), is_whole);
  return first == messages.end() ? messages.front().sample : first->sample;
}

/// Sources that know no twist leave zeros, without a mark: a vehicle that moved shows it.
bool IsLinearFilled(const RawOdometries& messages) {
  double path = 0.0;
  const OdometrySample& first = FirstWhole(messages);
  for (const OdometryInput& m : messages) {
    if (!m.linear) continue;
    if (*m.linear != Eigen::Vector3d::Zero()) return true;
    path = std::max(path, (m.sample.p_WS - first.p_WS).norm());
  }
  return path < 0.1;
}

bool IsAngularFilled(const RawOdometries& messages) {
  double turn = 0.0;
  const OdometrySample& first = FirstWhole(messages);
  for (const OdometryInput& m : messages) {
    if (!m.sample.w_WS_S) continue;
    if (*m.sample.w_WS_S != Eigen::Vector3d::Zero()) return true;
    turn = std::max(turn, m.sample.q_WS.angularDistance(first.q_WS));
  }
  return turn < 0.1;
}

/// The frame of the linear twist: as told, or found from the motion.
TwistFrame FindTwistFrame(const std::string& source, const RawOdometries& messages,
                          TwistFrame stated, FlightLog* log) {
  if (stated != TwistFrame::kUndecided) return stated;
  TwistFrameDetector detector;
  for (const OdometryInput& m : messages) {
    if (!m.linear) continue;
    detector.AddSample(m.sample.stamp, m.sample.p_WS, m.sample.q_WS.normalized(), *m.linear);
    if (detector.decided()) break;
  }
  const TwistFrameDecision& decision = detector.decision();
  if (decision.frame == TwistFrame::kNeither) {
    RefuseFile(source, "the twist fits neither frame: " + decision.Describe() +
                           "; state twist_frame if the position is at fault");
  }
  const TwistFrame frame =
      ResolveTwistFrame(decision.frame, messages.front().frame_id, messages.front().child_frame_id);
  if (decision.frame == TwistFrame::kUndecided && decision.moving_s > 1.0) {
    log->warnings.push_back(source +
                            ": the motion does not tell the frame of the twist, took the " +
                            (frame == TwistFrame::kWorld ? "world" : "body") +
                            " frame, as the message says: " + decision.Describe());
  }
  return frame;
}

/// Puts samples in order and makes them sound.
void FinishOdometry(const std::string& source, std::vector<OdometrySample>* samples,
                    FlightLog* log) {
  KeepFinite(
      source, samples, [](const OdometrySample& s) { return IsFinite(s); }, log);
  KeepForward(source, samples, log);
  NormaliseAttitudes(source, samples, log);
  if (samples->empty()) RefuseFile(source, "no usable message");
}

/// Samples with the velocity in the world, in order and sound.
std::vector<OdometrySample> SamplesOf(const std::string& source, const RawOdometries& messages,
                                      const BagOptions& options, FlightLog* log) {
  const bool has_linear = IsLinearFilled(messages), has_angular = IsAngularFilled(messages);
  if (!has_linear) log->warnings.push_back(source + ": linear twist is all zero, not used");
  if (!has_angular) log->warnings.push_back(source + ": angular twist is all zero, not used");
  const TwistFrame stated = *TwistFrameStated(options.twist_frame);
  const TwistFrame frame =
      has_linear ? FindTwistFrame(source, messages, stated, log) : TwistFrame::kBody;
  std::vector<OdometrySample> samples;
  samples.reserve(messages.size());
  for (const OdometryInput& m : messages) {
    OdometrySample sample = m.sample;
    if (has_linear && m.linear) {
      sample.v_WS = TwistInWorld(frame, sample.q_WS.normalized(), *m.linear);
    }
    if (!has_angular) sample.w_WS_S.reset();
    samples.push_back(sample);
  }
  FinishOdometry(source, &samples, log);
  return samples;
}

std::vector<OdometrySample> ReadOdometry(BagSource* bag, const std::string& topic,
                                         const BagOptions& options, FlightLog* log) {
  RawOdometries messages;
  messages.reserve(bag->Count(topic));
  bag->Read<OdometryInput>(topic, InputStream::kOdometry, 0, log,
                           [&](const OdometryInput& m) { messages.push_back(m); });
  const std::string source = bag->file() + ": " + topic;
  if (messages.empty()) RefuseFile(source, "no message");
  return SamplesOf(source, messages, options, log);
}

bool IsOlder(const OdometryInput& a, const OdometryInput& b) {
  return a.sample.stamp < b.sample.stamp;
}

/// Poses with the velocities of a topic of twists, where the user names one: nobody else knows
/// whether it is of the same source.
std::vector<OdometrySample> WithTwists(BagSource* bag, const std::string& source,
                                       RawOdometries poses, const BagOptions& options,
                                       FlightLog* log) {
  RawOdometries twists, messages;
  const bool has_twists = options.topics.count("twist") > 0;
  if (!has_twists) {
    std::vector<OdometrySample> samples;
    for (const OdometryInput& m : poses) samples.push_back(m.sample);
    FinishOdometry(source, &samples, log);
    return samples;
  }
  bag->Read<OdometryInput>(bag->TopicOf("twist"), InputStream::kTwist, 0, log,
                           [&](const OdometryInput& m) { twists.push_back(m); });
  std::stable_sort(poses.begin(), poses.end(), IsOlder);
  std::stable_sort(twists.begin(), twists.end(), IsOlder);
  PoseTwistPairing pairing(true);
  const auto take = [&messages](const RawOdometries& ready) {
    messages.insert(messages.end(), ready.begin(), ready.end());
  };
  size_t next = 0;
  for (const OdometryInput& pose : poses) {
    while (next < twists.size() && !IsOlder(pose, twists[next])) {
      take(pairing.AddTwist(twists[next++]));
    }
    take(pairing.AddPose(pose));
  }
  for (; next < twists.size(); ++next) take(pairing.AddTwist(twists[next]));
  take(pairing.Flush());
  if (messages.empty()) RefuseFile(source, "no message");
  return SamplesOf(source, messages, options, log);
}

std::vector<OdometrySample> ReadPoses(BagSource* bag, const std::string& topic,
                                      const BagOptions& options, FlightLog* log) {
  RawOdometries poses;
  bag->Read<OdometryInput>(topic, InputStream::kPose, 0, log,
                           [&](const OdometryInput& m) { poses.push_back(m); });
  return WithTwists(bag, bag->file() + ": " + topic, std::move(poses), options, log);
}

/// What tf says of the two frames, where the user names them.
std::vector<OdometrySample> ReadTfPoses(BagSource* bag, const BagOptions& options, FlightLog* log) {
  for (const char* role : {"odometry", "pose"}) {
    if (options.topics.count(role) > 0) {
      RefuseFile(bag->file(), std::string("odometry comes from tf (odometry_tf_child is ") +
                                  options.odometry_tf_child + "): --topic " + role +
                                  " is not read");
    }
  }
  return WithTwists(bag, bag->file() + ": tf",
                    bag->ReadTf(options.odometry_tf_parent, options.odometry_tf_child, log),
                    options, log);
}

}  // namespace

void ReadMotion(BagSource* bag, const FlightReadOptions& read, const BagOptions& options,
                FlightLog* log) {
  if (options.uses_tf()) {
    if (read.part != FlightPart::kOnboard) UseMocapPoses(ReadTfPoses(bag, options, log), log);
    return;
  }
  const bool poses_mapped =
      options.topics.count("pose") > 0 && options.topics.count("odometry") == 0;
  const std::string odometry_topic = poses_mapped ? "" : bag->TopicOf("odometry");
  const bool wants_poses = odometry_topic.empty() || read.pose == PoseSource::kMocap;
  const std::string pose_topic = wants_poses ? bag->TopicOf("pose") : "";
  if (wants_poses && pose_topic.empty() && read.part != FlightPart::kOnboard) {
    RefuseFile(
        bag->file(),
        "no odometry (nav_msgs/Odometry or geometry_msgs/PoseStamped, PoseWithCovarianceStamped, "
        "TransformStamped; of tf with --odometry-tf-parent and --odometry-tf-child); " +
            bag->Contents());
  }
  if (!odometry_topic.empty()) log->odometry = ReadOdometry(bag, odometry_topic, options, log);
  if (!pose_topic.empty()) UseMocapPoses(ReadPoses(bag, pose_topic, options, log), log);
}

}  // namespace odmc

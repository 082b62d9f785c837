#include "odmc/ros/topic_intake.h"

#include <ros/console.h>

#include <iterator>
#include <memory>
#include <utility>

#include "odmc/ros/conversions.h"
#include "odmc/text/printable_text.h"

namespace odmc {
namespace {

constexpr std::chrono::seconds kTfPatience(2);

}  // namespace

TopicIntake::TopicIntake(ros::NodeHandle node, const StreamOptions& options, int num_rotors,
                         bool with_commands, InputQueue* queue, Warn warn)
    : node_(std::move(node)), options_(options), queue_(queue), warn_(std::move(warn)) {
  if (options_.uses_tf()) {
    tf_odometry_.emplace(options_.odometry_tf_parent, options_.odometry_tf_child);
  }
  for (const StreamRole& role : StreamRoles()) {
    if (IsWanted(role.stream, with_commands)) Subscribe(role.stream, num_rotors);
  }
}

void TopicIntake::Stop() {
  for (ros::Subscriber& subscriber : subscribers_) subscriber.shutdown();
}

bool TopicIntake::IsWanted(InputStream stream, bool with_commands) const {
  if (stream == InputStream::kMotorCommands) return with_commands;
  if (IsTf(stream)) return tf_odometry_.has_value();
  const bool is_motion = stream == InputStream::kOdometry || stream == InputStream::kPose;
  return !is_motion || !tf_odometry_;
}

/// Topics may have messages of any type: publishers bring the definition with them.
void TopicIntake::Subscribe(InputStream stream, int num_rotors) {
  const auto reader = std::make_shared<StreamReader>(stream, options_, num_rotors);
  const boost::function<void(const ros::MessageEvent<const RawMessage>&)> callback =
      [this, stream, reader](const ros::MessageEvent<const RawMessage>& event) {
        Take(stream, *event.getConstMessage(), FromRos(event.getReceiptTime()), reader.get());
      };
  ros::SubscribeOptions options;
  const std::string topic = (IsTf(stream) ? "/" : "") + std::string(NameOf(stream));
  options.initByFullCallbackType<const ros::MessageEvent<const RawMessage>&>(topic, 2000, callback);
  options.transport_hints = ros::TransportHints().tcpNoDelay();
  subscribers_.push_back(node_.subscribe(options));
}

void TopicIntake::Take(InputStream stream, const RawMessage& message, Stamp arrival,
                       StreamReader* reader) {
  try {
    if (IsTf(stream)) return TakeTransforms(stream, message);
    std::optional<InputSample> input = reader->Read(message, arrival);
    for (const std::string& note : reader->TakeNotes()) {
      warn_(std::string(NameOf(stream)) + ": " + Printable(note));
    }
    if (!input) return queue_->CountPassedOver(stream);
    NoteStamps(stream, reader->stamp_source());
    TellOfSigns(*input);
    std::optional<InputSample> accepted = AcceptedInput(*std::move(input));
    if (!accepted) return queue_->Refuse(stream, "");
    queue_->Push(stream, Paired(stream, *std::move(accepted)));
  } catch (const std::exception& e) {
    const std::string refusal = Printable(e.what());
    ROS_WARN_THROTTLE(10.0, "%s: %s", NameOf(stream), refusal.c_str());
    queue_->Refuse(stream, refusal);
  }
}

/// Poses that a message of tf completes.
void TopicIntake::TakeTransforms(InputStream stream, const RawMessage& message) {
  std::vector<InputSample> ready;
  for (OdometryInput& pose : tf_odometry_->Read(message, stream)) {
    std::optional<InputSample> accepted = AcceptedInput(InputSample(std::move(pose)));
    if (!accepted) continue;
    for (InputSample& sample : Paired(InputStream::kPose, *std::move(accepted))) {
      ready.push_back(std::move(sample));
    }
    tf_leads_ = true;
  }
  const Clock::time_point now = Clock::now();
  if (!tf_leads_ && now - tf_described_ > kTfPatience) {
    tf_described_ = now;
    queue_->NoteRefusal(InputStream::kTf, Printable(tf_odometry_->Describe()));
  } else if (tf_leads_ && stream == InputStream::kTf) {
    NoteStamps(stream, "those of tf");
  }
  queue_->Push(stream, std::move(ready));
}

void TopicIntake::NoteStamps(InputStream stream, const std::string& stamps) {
  std::string& noted = stamps_[static_cast<size_t>(stream)];
  if (noted == stamps) return;
  noted = stamps;
  queue_->NoteStamps(stream, stamps);
  if (IsTf(stream)) queue_->NoteRefusal(stream, "");  // the frames hang together now
}

/// What is ready for the queue: poses may have to wait for the twist after them.
std::vector<InputSample> TopicIntake::Paired(InputStream stream, InputSample input) {
  if (stream != InputStream::kPose && stream != InputStream::kTwist) return {std::move(input)};
  auto& one = std::get<OdometryInput>(input);
  const bool is_pose = stream == InputStream::kPose;
  std::vector<OdometryInput> ready =
      is_pose ? pairing_.AddPose(std::move(one)) : pairing_.AddTwist(std::move(one));
  if (pairing_.is_late() && !std::exchange(told_of_late_twists_, true)) {
    warn_("twist began later than pose: its velocity is not used; start the node once both come");
  }
  return {std::make_move_iterator(ready.begin()), std::make_move_iterator(ready.end())};
}

void TopicIntake::TellOfSigns(const InputSample& input) {
  const auto* rotors = std::get_if<RotorInput>(&input);
  if (told_of_signs_ || rotors == nullptr || !(rotors->sample.speed.minCoeff() < 0.0)) return;
  told_of_signs_ = true;
  ROS_INFO(
      "rotor speeds have a sign: their magnitude is used, the direction of turning comes from "
      "the vehicle file");
}

}  // namespace odmc

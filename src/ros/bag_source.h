#pragma once

#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "odmc/ros/flight_bag.h"
#include "odmc/ros/message_values.h"
#include "odmc/ros/tf_odometry.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/refusal.h"

namespace odmc {

/// An open bag with its topics and the way they serve the roles.
class BagSource {
 public:
  BagSource(const std::string& file, const BagOptions& options);

  const std::string& file() const { return file_; }
  rosbag::Bag& bag() { return bag_; }

  /// Topic of a role; empty where the bag has none.
  std::string TopicOf(const std::string& role) const;

  /// Shows what every message of a topic says to `use`, in the order of recording.
  /// @param num_rotors  0: as many as a message has
  template <typename Input, typename Use>
  void Read(const std::string& topic, InputStream stream, int num_rotors, FlightLog* log, Use use);

  /// Type of a topic; empty where the bag has none of this name.
  std::string TypeOf(const std::string& topic) const {
    const auto found = types_.find(topic);
    return found == types_.end() ? "" : found->second;
  }

  /// Shows every message of a topic, with the layout of its type, to `use`.
  template <typename Use>
  void ReadRaw(const std::string& topic, Use use);

  /// Poses of one frame in another, from all messages of tf.
  std::vector<OdometryInput> ReadTf(const std::string& parent, const std::string& child,
                                    FlightLog* log);

  /// Number of messages of a topic.
  size_t Count(const std::string& topic) {
    return rosbag::View(bag_, rosbag::TopicQuery(topic)).size();
  }

  /// Types of all topics, for errors.
  std::string Contents() const;

 private:
  void CheckMap() const;
  std::set<std::string> KnownTopics(ForeignUse use) const;
  std::string OneOf(const std::set<std::string>& topics, const std::string& role) const;
  std::string TfTopic(InputStream stream) const;
  void AddTf(InputStream stream, TfOdometry* tf, std::vector<OdometryInput>* poses);

  std::string file_;
  const BagOptions& options_;
  rosbag::Bag bag_;
  std::map<std::string, std::string> types_;  // by topic
};

template <typename Input, typename Use>
void BagSource::Read(const std::string& topic, InputStream stream, int num_rotors, FlightLog* log,
                     Use use) {
  const std::string source = file_ + ": " + topic;
  RefusedSamples passed_over;
  long number = 0;
  try {
    StreamReader reader(stream, options_, num_rotors);
    rosbag::View view(bag_, rosbag::TopicQuery(topic));
    for (const rosbag::MessageInstance& instance : view) {
      const auto message = instance.instantiate<RawMessage>();
      if (message == nullptr) continue;
      std::optional<InputSample> input = reader.Read(*message, FromRos(instance.getTime()));
      if (input) {
        use(std::get<Input>(*input));
      } else {
        passed_over.Add("message " + std::to_string(number));
      }
      ++number;
    }
    for (const std::string& note : reader.TakeNotes()) {
      log->warnings.push_back(source + ": " + note);
    }
    const bool are_named =
        stream == InputStream::kRotorSpeeds && !options_.rotor_stamp_field.empty();
    if (are_named) log->warnings.push_back(source + ": stamps are " + reader.stamp_source());
  } catch (const std::invalid_argument& e) {
    RefuseFile(file_, "topic " + topic + ": " + e.what());
  }
  if (passed_over.count > 1) {
    passed_over.Report(source, "messages without an entry, or whose entries are not of one time",
                       log);
  }
}

template <typename Use>
void BagSource::ReadRaw(const std::string& topic, Use use) {
  try {
    std::optional<MessageLayout> layout;
    rosbag::View view(bag_, rosbag::TopicQuery(topic));
    for (const rosbag::MessageInstance& instance : view) {
      const auto message = instance.instantiate<RawMessage>();
      if (message == nullptr) continue;
      if (!layout) layout.emplace(message->type(), message->definition());
      use(*layout, *message);
    }
  } catch (const std::invalid_argument& e) {
    RefuseFile(file_, "topic " + topic + ": " + e.what());
  }
}

}  // namespace odmc

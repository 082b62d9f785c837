#include "bag_source.h"

#include <algorithm>
#include <utility>

namespace odmc {
namespace {

std::string Join(const std::set<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

/// "/a/b" and "a/b" name the same topic in a bag.
std::string WithSlash(const std::string& topic) {
  return !topic.empty() && topic[0] == '/' ? topic : "/" + topic;
}

bool EndsIn(const std::string& topic, const std::string& role) {
  const std::string name = WithSlash(topic), end = "/" + role;
  return name.size() >= end.size() && name.compare(name.size() - end.size(), end.size(), end) == 0;
}

}  // namespace

BagSource::BagSource(const std::string& file, const BagOptions& options)
    : file_(file), options_(options) {
  try {
    bag_.open(file, rosbag::bagmode::Read);
  } catch (const rosbag::BagUnindexedException&) {
    RefuseFile(file,
               "has no index: recording was cut off or the file is truncated; "
               "`rosbag reindex` rescues what is there");
  } catch (const rosbag::BagException& e) {
    RefuseFile(file, std::string("is not a bag or truncated: ") + e.what());
  }
  rosbag::View view(bag_);
  for (const rosbag::ConnectionInfo* info : view.getConnections()) {
    types_[info->topic] = info->datatype;
  }
  CheckMap();
}

std::string BagSource::Contents() const {
  std::set<std::string> topics;
  for (const auto& [topic, type] : types_) topics.insert(topic + " (" + type + ")");
  return topics.empty() ? "the bag is empty" : "the bag has " + Join(topics);
}

void BagSource::CheckMap() const {
  for (const auto& [name, topic] : options_.topics) {
    const auto role = std::find_if(StreamRoles().begin(), StreamRoles().end(),
                                   [&, key = name](const StreamRole& r) { return r.name == key; });
    if (role == StreamRoles().end()) {
      std::set<std::string> known;
      for (const StreamRole& r : StreamRoles()) known.insert(r.name);
      RefuseFile(file_, "unknown topic role '" + name + "'; known are: " + Join(known));
    }
    const std::string found = TopicOf(name), type = types_.at(found);
    if (!role->foreign && std::count(role->types.begin(), role->types.end(), type) == 0) {
      RefuseFile(file_, "topic " + found + " is a " + type + ", but " + name + " must be a " +
                            role->types.front());
    }
  }
}

std::string BagSource::TopicOf(const std::string& name) const {
  const auto mapped = options_.topics.find(name);
  if (mapped != options_.topics.end()) {
    for (const auto& [topic, type] : types_) {
      if (WithSlash(topic) == WithSlash(mapped->second)) return topic;
    }
    RefuseFile(file_, "has no topic " + mapped->second + " for " + name + "; " + Contents());
  }
  for (const StreamRole& role : StreamRoles()) {
    if (role.name != name) continue;
    for (const std::string& wanted : role.types) {
      std::set<std::string> topics;
      for (const auto& [topic, type] : types_) {
        if (type == wanted) topics.insert(topic);
      }
      if (!topics.empty()) return OneOf(topics, name);
    }
    if (role.foreign) return OneOf(KnownTopics(*role.foreign), name);
  }
  return "";
}

/// Topics whose type says what they hold.
std::set<std::string> BagSource::KnownTopics(ForeignUse use) const {
  std::set<std::string> topics;
  for (const auto& [topic, type] : types_) {
    const KnownMessage* known = FindKnown(use, type);
    if (known == nullptr || known->by_name_only) continue;
    const bool is_command = topic.find("command") != std::string::npos ||
                            topic.find("cmd") != std::string::npos ||
                            topic.find("setpoint") != std::string::npos;
    if (use != ForeignUse::kRotorSpeeds || !is_command) topics.insert(topic);
  }
  return topics;
}

/// The only one of `topics`, or the only one that is named after the role; empty if there is none.
std::string BagSource::OneOf(const std::set<std::string>& topics, const std::string& role) const {
  std::set<std::string> named;
  for (const std::string& topic : topics) {
    if (EndsIn(topic, role)) named.insert(topic);
  }
  const std::set<std::string>& candidates = named.empty() ? topics : named;
  if (candidates.empty()) return "";
  if (candidates.size() > 1) {
    RefuseFile(file_, "several topics could be " + role + ": " + Join(candidates) +
                          "; choose with --topic " + role + ":=" + *candidates.begin());
  }
  return *candidates.begin();
}

/// By the name: both topics of tf have the same type.
std::string BagSource::TfTopic(InputStream stream) const {
  const StreamRole& role = RoleOf(stream);
  if (options_.topics.count(role.name) > 0) return TopicOf(role.name);
  std::set<std::string> topics;
  for (const auto& [topic, type] : types_) {
    if (std::count(role.types.begin(), role.types.end(), type) > 0 && EndsIn(topic, role.name)) {
      topics.insert(topic);
    }
  }
  return OneOf(topics, role.name);
}

void BagSource::AddTf(InputStream stream, TfOdometry* tf, std::vector<OdometryInput>* poses) {
  const std::string topic = TfTopic(stream);
  if (topic.empty()) return;
  try {
    rosbag::View view(bag_, rosbag::TopicQuery(topic));
    for (const rosbag::MessageInstance& instance : view) {
      const auto message = instance.instantiate<RawMessage>();
      if (message == nullptr) continue;
      for (OdometryInput& pose : tf->Read(*message, stream)) poses->push_back(std::move(pose));
    }
  } catch (const std::invalid_argument& e) {
    RefuseFile(file_, "topic " + topic + ": " + e.what());
  }
}

std::vector<OdometryInput> BagSource::ReadTf(const std::string& parent, const std::string& child,
                                             FlightLog* log) {
  TfOdometry tf(parent, child);
  std::vector<OdometryInput> poses;
  AddTf(InputStream::kStaticTf, &tf, &poses);  // whenever they were recorded, they hold always
  AddTf(InputStream::kTf, &tf, &poses);
  if (poses.empty()) RefuseFile(file_, tf.Describe());
  if (tf.unmatched() > 0) {
    log->dropped += tf.unmatched();
    log->warnings.push_back(file_ + ": tf: " + std::to_string(tf.unmatched()) + " poses of " +
                            child + " dropped: the way to " + parent +
                            " has a hole at their stamps");
  }
  return poses;
}

}  // namespace odmc

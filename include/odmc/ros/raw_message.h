#pragma once

#include <ros/message_traits.h>
#include <ros/serialization.h>

#include <boost/shared_ptr.hpp>
#include <cstdint>
#include <cstring>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace odmc {

/// A message of any type as it came, with the header of its connection, which carries type, md5 and
/// definition. Subscribe to it, or instantiate it from a bag, as to any message
/// (topic_tools::ShapeShifter does so, too, but copies all three texts with every message).
struct RawMessage {
  std::vector<std::uint8_t> bytes;
  boost::shared_ptr<std::map<std::string, std::string>> connection;

  /// An entry of the connection's header; empty if there is none.
  const std::string& Header(const std::string& key) const {
    static const std::string none;
    if (connection == nullptr) return none;
    const auto found = connection->find(key);
    return found == connection->end() ? none : found->second;
  }
  const std::string& type() const { return Header("type"); }
  const std::string& md5() const { return Header("md5sum"); }
  const std::string& definition() const { return Header("message_definition"); }
};

}  // namespace odmc

namespace ros {
namespace message_traits {

template <>
struct IsMessage<odmc::RawMessage> : TrueType {};
template <>
struct IsMessage<const odmc::RawMessage> : TrueType {};

template <>
struct MD5Sum<odmc::RawMessage> {
  static const char* value() { return "*"; }
  static const char* value(const odmc::RawMessage& m) { return m.md5().c_str(); }
};

template <>
struct DataType<odmc::RawMessage> {
  static const char* value() { return "*"; }
  static const char* value(const odmc::RawMessage& m) { return m.type().c_str(); }
};

template <>
struct Definition<odmc::RawMessage> {
  static const char* value() { return ""; }
  static const char* value(const odmc::RawMessage& m) { return m.definition().c_str(); }
};

}  // namespace message_traits

namespace serialization {

template <>
struct Serializer<odmc::RawMessage> {
  template <typename Stream>
  static void read(Stream& stream, odmc::RawMessage& m) {
    const std::uint32_t length = stream.getLength();
    const std::uint8_t* begin = stream.advance(length);
    m.bytes.assign(begin, begin + length);
  }
  template <typename Stream>
  static void write(Stream& stream, const odmc::RawMessage& m) {
    if (m.bytes.empty()) return;
    std::memcpy(stream.advance(static_cast<std::uint32_t>(m.bytes.size())), m.bytes.data(),
                m.bytes.size());
  }
  static std::uint32_t serializedLength(const odmc::RawMessage& m) {
    return static_cast<std::uint32_t>(m.bytes.size());
  }
};

template <>
struct PreDeserialize<odmc::RawMessage> {
  static void notify(const PreDeserializeParams<odmc::RawMessage>& params) {
    params.message->connection = params.connection_header;
  }
};

}  // namespace serialization
}  // namespace ros

namespace odmc {

/// The message itself, of a type that is compiled in.
/// @throws std::invalid_argument where it was of another version of the type
template <typename Message>
Message DecodeMessage(const RawMessage& raw) {
  if (raw.md5() != ros::message_traits::MD5Sum<Message>::value()) {
    throw std::invalid_argument("holds another version of " + raw.type() +
                                " (its definition differs)");
  }
  // The stream reads only.
  auto* bytes = const_cast<std::uint8_t*>(raw.bytes.data());
  ros::serialization::IStream stream(bytes, static_cast<std::uint32_t>(raw.bytes.size()));
  Message message;
  ros::serialization::deserialize(stream, message);
  return message;
}

}  // namespace odmc

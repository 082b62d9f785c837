#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Builtin types of ROS messages, and messages within messages.
enum class FieldKind {
  kBool,
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64,
  kTime,
  kDuration,
  kString,
  kMessage,
};

/// A path to numbers, stamps or texts of a message: its steps in a MessageLayout.
struct FieldPath {
  /// From a message to one of its fields.
  struct Step {
    size_t field = 0;  ///< in the message it is in
    bool all = false;  ///< every entry of an array
    size_t entry = 0;  ///< else this one; 0 where the field is no array
  };
  std::string text;
  std::vector<Step> steps;
  FieldKind kind = FieldKind::kFloat64;  ///< of what lies at its end
};

/// The fields of a ROS message type as its definition says, and how they lie in a serialized
/// message. It needs no package of the type: publishers and bags bring the definition with them.
/// Nothing of a definition or a message is trusted.
class MessageLayout {
 public:
  /// @param type        "pkg/Name"
  /// @param definition  text of the .msg file, with the types it uses after lines of "===" and
  ///                    "MSG: pkg/Name", as connection headers have it
  /// @throws std::invalid_argument "TYPE: ..." with the line, where it is none
  MessageLayout(const std::string& type, const std::string& definition);

  const std::string& type() const { return types_.front().name; }

  /// Finds a path as "esc_status[].rpm" (of every entry), "motor_rpm[2]" (of the third),
  /// "header.stamp". An array without brackets stands for all of its entries.
  /// @throws std::invalid_argument naming type, path and what there is instead
  FieldPath Find(const std::string& path) const;

  /// True if Find() would find it.
  bool Has(const std::string& path) const;

  /// Numbers at `path` in a serialized message, in its order. Times are in seconds.
  /// @throws std::invalid_argument naming type, field and byte where the message does not fit its
  ///   definition (too short, too long, an entry that is not there), or where `path` ends in text
  std::vector<double> Numbers(const FieldPath& path, const std::uint8_t* data, size_t size) const;

  /// Times and durations at `path`, to the nanosecond.
  std::vector<Stamp> Stamps(const FieldPath& path, const std::uint8_t* data, size_t size) const;

  /// Texts at `path`.
  std::vector<std::string> Texts(const FieldPath& path, const std::uint8_t* data,
                                 size_t size) const;

  /// Whether a field is an array, and whether its definition says of what length.
  enum class Array { kNone, kFixed, kVariable };

  /// One field of a message.
  struct Field {
    std::string name;
    FieldKind kind = FieldKind::kFloat64;
    std::string message;  ///< type of a message within, as written
    size_t type = 0;      ///< its place among the types
    Array array = Array::kNone;
    std::uint64_t length = 1;  ///< of a fixed array
  };

  /// A type of messages: that of the layout, or one within it.
  struct Type {
    std::string name;
    std::vector<Field> fields;
    std::uint64_t least_bytes = 0;  ///< of a serialized message with every array empty
    bool is_fixed = true;           ///< every message has this size
  };

 private:
  void Parse(const std::string& definition);
  void Link();
  void Measure(size_t type, std::vector<int>* state, int depth);
  std::vector<std::string> NamesIn(size_t type) const;
  [[noreturn]] void Fail(const std::string& what) const;

  std::vector<Type> types_;  // the message's own first
};

}  // namespace odmc

#include "odmc/io/message_layout.h"

#include <algorithm>
#include <cctype>
#include <cstring>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>

#include "odmc/text/format.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr size_t kMostDefinition = 1 << 20;       // bytes; the longest real ones have some 20,000
constexpr int kMostDepth = 32;                    // messages within messages
constexpr std::uint64_t kMostBytes = 1ULL << 40;  // more than any message: sums stop there
constexpr std::uint64_t kMostLength = std::numeric_limits<std::uint32_t>::max();

struct Builtin {
  const char* name;
  FieldKind kind;
  std::uint64_t bytes;  ///< at least
};

constexpr Builtin kBuiltins[] = {
    {"bool", FieldKind::kBool, 1},         {"int8", FieldKind::kInt8, 1},
    {"byte", FieldKind::kInt8, 1},         {"uint8", FieldKind::kUint8, 1},
    {"char", FieldKind::kUint8, 1},        {"int16", FieldKind::kInt16, 2},
    {"uint16", FieldKind::kUint16, 2},     {"int32", FieldKind::kInt32, 4},
    {"uint32", FieldKind::kUint32, 4},     {"int64", FieldKind::kInt64, 8},
    {"uint64", FieldKind::kUint64, 8},     {"float32", FieldKind::kFloat32, 4},
    {"float64", FieldKind::kFloat64, 8},   {"time", FieldKind::kTime, 8},
    {"duration", FieldKind::kDuration, 8}, {"string", FieldKind::kString, 4},
};

std::uint64_t LeastBytes(FieldKind kind) {
  for (const Builtin& b : kBuiltins) {
    if (b.kind == kind) return b.bytes;
  }
  return 0;
}

std::uint64_t Times(std::uint64_t a, std::uint64_t b) {
  return b != 0 && a > kMostBytes / b ? kMostBytes : std::min(a * b, kMostBytes);
}

bool IsName(const std::string& text, bool slash) {
  if (text.empty() || std::isalpha(static_cast<unsigned char>(text[0])) == 0) return false;
  return std::all_of(text.begin(), text.end(), [slash](unsigned char c) {
    return std::isalnum(c) != 0 || c == '_' || (slash && c == '/');
  });
}

std::string Trimmed(const std::string& text) {
  const char* const kSpace = " \t\r";
  const size_t begin = text.find_first_not_of(kSpace);
  if (begin == std::string::npos) return "";
  return text.substr(begin, text.find_last_not_of(kSpace) - begin + 1);
}

/// A number of digits alone, up to kMostLength.
bool ParseLength(const std::string& text, std::uint64_t* value) {
  if (text.empty() || text.size() > 10) return false;
  *value = 0;
  for (const char c : text) {
    if (std::isdigit(static_cast<unsigned char>(c)) == 0) return false;
    *value = 10 * *value + static_cast<std::uint64_t>(c - '0');
  }
  return *value <= kMostLength;
}

/// "name", "name[]" or "name[5]".
struct Bracketed {
  std::string name;
  bool has_brackets = false, has_number = false;
  std::uint64_t number = 0;
};

bool ParseBracketed(const std::string& text, Bracketed* result) {
  *result = Bracketed();
  const size_t open = text.find('[');
  result->name = text.substr(0, open);
  if (open == std::string::npos) return true;
  if (text.back() != ']') return false;
  const std::string inside = text.substr(open + 1, text.size() - open - 2);
  result->has_brackets = true;
  result->has_number = !inside.empty();
  return inside.empty() || ParseLength(inside, &result->number);
}

/// One field of a definition's line.
/// @returns false if the line is none
bool ParseField(const std::string& line, MessageLayout::Field* field) {
  const size_t space = line.find_first_of(" \t");
  if (space == std::string::npos) return false;
  Bracketed type;
  if (!ParseBracketed(line.substr(0, space), &type) || !IsName(type.name, true)) return false;
  field->name = Trimmed(line.substr(space));
  if (!IsName(field->name, false)) return false;
  if (type.has_brackets) {
    field->array = type.has_number ? MessageLayout::Array::kFixed : MessageLayout::Array::kVariable;
    if (type.has_number) field->length = type.number;
  }
  field->kind = FieldKind::kMessage;
  field->message = type.name;
  for (const Builtin& b : kBuiltins) {
    if (type.name == b.name) field->kind = b.kind;
  }
  return true;
}

/// A line of "type NAME=value"; the value of a string may hold anything, a '#' too.
bool IsConstant(const std::string& line) {
  const size_t equals = line.find('='), hash = line.find('#');
  if (equals == std::string::npos || (hash != std::string::npos && hash < equals)) return false;
  const std::string left = Trimmed(line.substr(0, equals));
  const size_t space = left.find_first_of(" \t");
  return space != std::string::npos && IsName(left.substr(0, space), false) &&
         IsName(Trimmed(left.substr(space)), false);
}

bool IsSeparator(const std::string& line) {
  return line.size() >= 3 && line.find_first_not_of('=') == std::string::npos;
}

// ---- Serialized messages -----------------------------------------------------------------------

std::uint64_t LittleEndian(const std::uint8_t* data, size_t bytes) {
  std::uint64_t value = 0;
  for (size_t i = 0; i < bytes; ++i) value |= static_cast<std::uint64_t>(data[i]) << (8 * i);
  return value;
}

template <typename To, typename Bits>
To BitsAs(std::uint64_t bits) {
  const Bits narrow = static_cast<Bits>(bits);
  To value;
  static_assert(sizeof narrow == sizeof value);
  std::memcpy(&value, &narrow, sizeof value);
  return value;
}

Stamp StampOf(FieldKind kind, const std::uint8_t* data) {
  constexpr Stamp kSecond = 1000000000;
  const std::uint64_t s = LittleEndian(data, 4), ns = LittleEndian(data + 4, 4);
  if (kind == FieldKind::kTime) return static_cast<Stamp>(s) * kSecond + static_cast<Stamp>(ns);
  return static_cast<Stamp>(BitsAs<std::int32_t, std::uint32_t>(s)) * kSecond +
         static_cast<Stamp>(BitsAs<std::int32_t, std::uint32_t>(ns));
}

double NumberOf(FieldKind kind, const std::uint8_t* data) {
  const std::uint64_t bits = LittleEndian(data, LeastBytes(kind));
  switch (kind) {
    case FieldKind::kBool:
      return bits != 0 ? 1.0 : 0.0;
    case FieldKind::kInt8:
      return BitsAs<std::int8_t, std::uint8_t>(bits);
    case FieldKind::kInt16:
      return BitsAs<std::int16_t, std::uint16_t>(bits);
    case FieldKind::kInt32:
      return BitsAs<std::int32_t, std::uint32_t>(bits);
    case FieldKind::kInt64:
      return static_cast<double>(BitsAs<std::int64_t, std::uint64_t>(bits));
    case FieldKind::kFloat32:
      return BitsAs<float, std::uint32_t>(bits);
    case FieldKind::kFloat64:
      return BitsAs<double, std::uint64_t>(bits);
    case FieldKind::kTime:
    case FieldKind::kDuration:
      return ToSeconds(StampOf(kind, data));
    default:
      return static_cast<double>(bits);
  }
}

/// Goes through a serialized message and shows what lies at the end of a path.
template <typename Sink>
class Walk {
 public:
  using Type = MessageLayout::Type;
  using Field = MessageLayout::Field;

  Walk(const std::vector<Type>& types, const FieldPath& path, const std::uint8_t* data, size_t size,
       Sink sink)
      : types_(types), path_(path), data_(data), size_(size), sink_(sink) {}

  void Run() {
    Message(types_.front(), 0);
    if (at_ != size_) {
      Fail("has " + std::to_string(size_ - at_) + " bytes after its last field");
    }
  }

 private:
  static constexpr size_t kAside = std::numeric_limits<size_t>::max();  // not on the path

  /// @param step of the path that is in this message, kAside if none
  void Message(const Type& type, size_t step) {
    for (size_t i = 0; i < type.fields.size(); ++i) {
      const bool wanted = step != kAside && path_.steps[step].field == i;
      trail_.push_back({&type.fields[i].name, kAside});
      Entries(type.fields[i], wanted ? step : kAside);
      trail_.pop_back();
    }
  }

  void Entries(const Field& field, size_t step) {
    std::uint64_t count = field.length;
    if (field.array == MessageLayout::Array::kVariable) count = LittleEndian(Take(4), 4);
    const bool is_message = field.kind == FieldKind::kMessage;
    const std::uint64_t least =
        is_message ? types_[field.type].least_bytes : LeastBytes(field.kind);
    Need(Times(count, least));
    const bool is_fixed =
        is_message ? types_[field.type].is_fixed : field.kind != FieldKind::kString;
    if (step == kAside && is_fixed) {
      at_ += static_cast<size_t>(count * least);
      return;
    }
    const FieldPath::Step* wanted = step == kAside ? nullptr : &path_.steps[step];
    if (wanted != nullptr && !wanted->all && wanted->entry >= count) {
      Fail("has " + std::to_string(count) + " entries in " + Where() + ", not " +
           std::to_string(wanted->entry + 1));
    }
    for (std::uint64_t i = 0; i < count; ++i) {
      if (field.array != MessageLayout::Array::kNone) trail_.back().entry = i;
      Entry(field, wanted != nullptr && (wanted->all || wanted->entry == i) ? step : kAside);
    }
  }

  void Entry(const Field& field, size_t step) {
    if (field.kind == FieldKind::kMessage) {
      Message(types_[field.type], step == kAside ? kAside : step + 1);
      return;
    }
    const std::uint8_t* begin = Take(static_cast<size_t>(LeastBytes(field.kind)));
    size_t length = 0;
    if (field.kind == FieldKind::kString) {
      length = static_cast<size_t>(LittleEndian(begin, 4));
      begin = Take(length);
    }
    if (step != kAside) sink_(field.kind, begin, length);
  }

  const std::uint8_t* Take(size_t bytes) {
    Need(bytes);
    const std::uint8_t* begin = data_ + at_;
    at_ += bytes;
    return begin;
  }

  void Need(std::uint64_t bytes) const {
    if (bytes <= size_ - at_) return;
    Fail("ends at byte " + std::to_string(size_) + ", but " + Where() + " at byte " +
         std::to_string(at_) + " takes " + std::to_string(bytes) + " more");
  }

  std::string Where() const {
    std::string text;
    for (const Place& place : trail_) {
      text += (text.empty() ? "" : ".") + *place.name;
      if (place.entry != kAside) text += "[" + std::to_string(place.entry) + "]";
    }
    return text;
  }

  [[noreturn]] void Fail(const std::string& what) const {
    RefuseFile(types_.front().name, "a message " + what);
  }

  struct Place {
    const std::string* name;
    std::uint64_t entry;
  };

  const std::vector<Type>& types_;
  const FieldPath& path_;
  const std::uint8_t* data_;
  size_t size_, at_ = 0;
  Sink sink_;
  std::vector<Place> trail_;
};

template <typename Sink>
void WalkMessage(const std::vector<MessageLayout::Type>& types, const FieldPath& path,
                 const std::uint8_t* data, size_t size, Sink sink) {
  Walk<Sink>(types, path, data, size, sink).Run();
}

}  // namespace

MessageLayout::MessageLayout(const std::string& type, const std::string& definition) {
  types_.push_back({Printable(type, 200), {}, 0, true});
  if (!IsName(type, true)) Fail("is no name of a type of messages");
  if (definition.size() > kMostDefinition) Fail("its definition is longer than any");
  Parse(definition);
  Link();
  std::vector<int> state(types_.size(), 0);
  Measure(0, &state, 0);
}

void MessageLayout::Fail(const std::string& what) const { RefuseFile(type(), what); }

// ---- Definitions -------------------------------------------------------------------------------

void MessageLayout::Parse(const std::string& definition) {
  std::istringstream lines(definition);
  std::string line;
  for (int number = 1; std::getline(lines, line); ++number) {
    line = Trimmed(line);
    if (IsSeparator(line)) {
      if (!std::getline(lines, line)) return;
      ++number;
      line = Trimmed(line);
      const std::string name = Trimmed(line.substr(std::min<size_t>(4, line.size())));
      if (line.rfind("MSG:", 0) != 0 || !IsName(name, true)) {
        Fail("line " + std::to_string(number) + " of its definition names no type: '" +
             Printable(line, 80) + "'");
      }
      types_.push_back({name, {}, 0, true});
      continue;
    }
    if (IsConstant(line)) continue;
    line = Trimmed(line.substr(0, line.find('#')));
    if (line.empty()) continue;
    Field field;
    if (!ParseField(line, &field)) {
      Fail("line " + std::to_string(number) + " of its definition is no field: '" +
           Printable(line, 80) + "'");
    }
    types_.back().fields.push_back(std::move(field));
  }
}

void MessageLayout::Link() {
  std::map<std::string, size_t> places;
  for (size_t i = 0; i < types_.size(); ++i) places.emplace(types_[i].name, i);
  for (Type& owner : types_) {
    const std::string package = owner.name.substr(0, owner.name.find('/') + 1);
    for (Field& field : owner.fields) {
      if (field.kind != FieldKind::kMessage) continue;
      std::string name = field.message;
      if (name == "Header") name = "std_msgs/Header";
      if (name.find('/') == std::string::npos) name = package + name;
      const auto found = places.find(name);
      if (found == places.end()) {
        Fail("its definition uses " + name + " for " + field.name + " and does not say what it is");
      }
      field.type = found->second;
    }
  }
}

/// Sizes of a type and of those in it.
/// @param state 0: not seen, 1: being measured, 2: measured
void MessageLayout::Measure(size_t index, std::vector<int>* state, int depth) {
  Type& type = types_[index];
  if ((*state)[index] == 2) return;
  if ((*state)[index] == 1) Fail("its definition has " + type.name + " within itself");
  if (depth > kMostDepth) Fail("its definition has too many messages within messages");
  (*state)[index] = 1;
  for (const Field& field : type.fields) {
    std::uint64_t least = LeastBytes(field.kind);
    bool is_fixed = field.kind != FieldKind::kString;
    if (field.kind == FieldKind::kMessage) {
      Measure(field.type, state, depth + 1);
      least = types_[field.type].least_bytes;
      is_fixed = types_[field.type].is_fixed;
    }
    const bool is_variable = field.array == Array::kVariable;
    least = is_variable ? 4 : Times(field.length, least);
    type.is_fixed = type.is_fixed && is_fixed && !is_variable;
    type.least_bytes = std::min(type.least_bytes + least, kMostBytes);
  }
  (*state)[index] = 2;
}

// ---- Paths -------------------------------------------------------------------------------------

std::vector<std::string> MessageLayout::NamesIn(size_t type) const {
  std::vector<std::string> names;
  for (const Field& field : types_[type].fields) {
    names.push_back(field.name + (field.array == Array::kNone ? "" : "[]"));
    if (names.size() == 30) break;
  }
  return names;
}

FieldPath MessageLayout::Find(const std::string& text) const {
  FieldPath path;
  path.text = text;
  size_t type = 0;
  std::istringstream steps(text);
  std::string step;
  bool is_done = false;
  const auto refuse = [&](const std::string& what) {
    Fail("field '" + Printable(text, 100) + "': " + what);
  };
  while (std::getline(steps, step, '.')) {
    if (is_done) refuse("nothing lies within '" + path.text + "'");
    Bracketed wanted;
    if (!ParseBracketed(step, &wanted)) refuse("'" + Printable(step, 100) + "' is no field");
    const std::vector<Field>& fields = types_[type].fields;
    const auto found = std::find_if(fields.begin(), fields.end(),
                                    [&](const Field& f) { return f.name == wanted.name; });
    if (found == fields.end()) {
      refuse("there is no '" + Printable(wanted.name, 100) + "' in " + types_[type].name +
             ", which has " + (fields.empty() ? "no fields" : Listed(NamesIn(type))));
    }
    const bool is_array = found->array != Array::kNone;
    if (found->length == 0) refuse("'" + wanted.name + "' never has an entry");
    if (wanted.has_brackets && !is_array) refuse("'" + wanted.name + "' is no array");
    const bool all = is_array && !wanted.has_number;
    if (wanted.has_number && found->array == Array::kFixed && wanted.number >= found->length) {
      refuse("'" + wanted.name + "' has " + std::to_string(found->length) + " entries");
    }
    path.steps.push_back(
        {static_cast<size_t>(found - fields.begin()), all, static_cast<size_t>(wanted.number)});
    path.kind = found->kind;
    path.text = wanted.name;
    is_done = found->kind != FieldKind::kMessage;
    type = found->type;
  }
  if (path.steps.empty()) refuse("is empty");
  if (!is_done) refuse("is a " + types_[type].name + "; choose of " + Listed(NamesIn(type)));
  path.text = text;
  return path;
}

bool MessageLayout::Has(const std::string& path) const {
  try {
    Find(path);
    return true;
  } catch (const std::invalid_argument&) {
    return false;
  }
}

// ---- Values ------------------------------------------------------------------------------------

std::vector<double> MessageLayout::Numbers(const FieldPath& path, const std::uint8_t* data,
                                           size_t size) const {
  if (path.kind == FieldKind::kString) Fail("field '" + path.text + "' is text, not a number");
  std::vector<double> values;
  WalkMessage(types_, path, data, size,
              [&values](FieldKind kind, const std::uint8_t* begin, size_t) {
                values.push_back(NumberOf(kind, begin));
              });
  return values;
}

std::vector<Stamp> MessageLayout::Stamps(const FieldPath& path, const std::uint8_t* data,
                                         size_t size) const {
  if (path.kind != FieldKind::kTime && path.kind != FieldKind::kDuration) {
    Fail("field '" + path.text + "' is no time");
  }
  std::vector<Stamp> values;
  WalkMessage(types_, path, data, size,
              [&values](FieldKind kind, const std::uint8_t* begin, size_t) {
                values.push_back(StampOf(kind, begin));
              });
  return values;
}

std::vector<std::string> MessageLayout::Texts(const FieldPath& path, const std::uint8_t* data,
                                              size_t size) const {
  if (path.kind != FieldKind::kString) Fail("field '" + path.text + "' is no text");
  std::vector<std::string> values;
  WalkMessage(types_, path, data, size,
              [&values](FieldKind, const std::uint8_t* begin, size_t length) {
                values.emplace_back(reinterpret_cast<const char*>(begin), length);
              });
  return values;
}

}  // namespace odmc

#include "ulog_file.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <optional>

#include "binary_file.h"
#include "odmc/io/autopilot_logs.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr std::string_view kMagic("ULog\x01\x12\x35", 7);
constexpr size_t kFileHeader = 16;    // magic, version, start
constexpr size_t kMessageHeader = 3;  // size, type
constexpr std::string_view kTypes = "BFIMPQARDLCSO";
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

/// One field of a message's definition.
struct Field {
  std::string type, name;
  int count = 1;
  bool is_array = false;
};

size_t SizeOf(const std::string& type) {
  static const std::map<std::string, size_t> sizes = {
      {"int8_t", 1},  {"uint8_t", 1},  {"bool", 1},     {"char", 1},
      {"int16_t", 2}, {"uint16_t", 2}, {"int32_t", 4},  {"uint32_t", 4},
      {"float", 4},   {"int64_t", 8},  {"uint64_t", 8}, {"double", 8}};
  const auto found = sizes.find(type);
  return found == sizes.end() ? 0 : found->second;
}

double ValueOf(const std::string& type, std::string_view bytes) {
  ByteReader in(bytes);
  if (type == "int8_t") return in.Number<std::int8_t>();
  if (type == "uint8_t" || type == "bool" || type == "char") return in.Number<std::uint8_t>();
  if (type == "int16_t") return in.Number<std::int16_t>();
  if (type == "uint16_t") return in.Number<std::uint16_t>();
  if (type == "int32_t") return in.Number<std::int32_t>();
  if (type == "uint32_t") return in.Number<std::uint32_t>();
  if (type == "float") return static_cast<double>(in.Number<float>());
  if (type == "int64_t") return static_cast<double>(in.Number<std::int64_t>());
  if (type == "uint64_t") return static_cast<double>(in.Number<std::uint64_t>());
  return in.Number<double>();
}

/// "TYPE[N] NAME" of a definition. @returns nothing where it is none
std::optional<Field> ParseField(std::string_view text) {
  const size_t space = text.find(' ');
  if (space == std::string_view::npos || space == 0 || space + 1 == text.size()) return {};
  Field field;
  field.type = std::string(text.substr(0, space));
  field.name = std::string(text.substr(space + 1));
  const size_t bracket = field.type.find('[');
  if (bracket == std::string::npos) return field;
  field.is_array = true;
  field.count = std::atoi(field.type.c_str() + bracket + 1);
  field.type.resize(bracket);
  if (field.count < 1 || field.count > 65535) return {};
  return field;
}

/// Where a plain value lies in a message.
struct Place {
  std::string type;
  size_t offset = 0;
};

/// Definitions of all messages.
class Formats {
 public:
  /// Takes the text "NAME:TYPE FIELD;TYPE FIELD;".
  void Add(std::string_view text);
  bool Has(const std::string& name) const { return formats_.count(name) > 0; }

  /// Bytes of a message, nested ones included; 0 where a definition is missing or endless.
  size_t SizeOfMessage(const std::string& name, int depth = 0) const;

  /// A field by its path, "esc[0].esc_rpm". @returns nothing where there is none
  std::optional<Place> Locate(const std::string& format, std::string_view path,
                              int depth = 0) const;

 private:
  size_t SizeOfElement(const Field& field, int depth) const {
    const size_t size = SizeOf(field.type);
    return size > 0 ? size : SizeOfMessage(field.type, depth + 1);
  }

  static constexpr int kDeepest = 8;
  std::map<std::string, std::vector<Field>> formats_;
};

void Formats::Add(std::string_view text) {
  const size_t colon = text.find(':');
  if (colon == std::string_view::npos) return;
  std::vector<Field> fields;
  std::string_view rest = text.substr(colon + 1);
  while (!rest.empty()) {
    const size_t end = std::min(rest.find(';'), rest.size());
    const std::optional<Field> field = ParseField(rest.substr(0, end));
    if (!field && end > 0) return;  // damaged: the topic is then unknown
    if (field) fields.push_back(*field);
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  formats_[std::string(text.substr(0, colon))] = std::move(fields);
}

size_t Formats::SizeOfMessage(const std::string& name, int depth) const {
  const auto found = formats_.find(name);
  if (found == formats_.end() || depth > kDeepest) return 0;
  size_t size = 0;
  for (const Field& field : found->second) {
    const size_t element = SizeOfElement(field, depth);
    size += element * static_cast<size_t>(field.count);
    if (element == 0 || size > (size_t{1} << 16)) return 0;
  }
  return size;
}

std::optional<Place> Formats::Locate(const std::string& format, std::string_view path,
                                     int depth) const {
  const auto found = formats_.find(format);
  if (found == formats_.end() || depth > kDeepest) return {};
  const size_t end = std::min(path.find_first_of(".["), path.size());
  int index = 0;
  size_t rest = end;
  if (end < path.size() && path[end] == '[') {
    index = std::atoi(std::string(path.substr(end + 1)).c_str());
    rest = std::min(path.find(']', end), path.size() - 1) + 1;
  }
  size_t offset = 0;
  for (const Field& field : found->second) {
    const size_t element = SizeOfElement(field, depth);
    if (element == 0) return {};
    if (field.name != path.substr(0, end)) {
      offset += element * static_cast<size_t>(field.count);
      continue;
    }
    if (index >= field.count) return {};
    offset += element * static_cast<size_t>(index);
    if (rest >= path.size()) {
      if (SizeOf(field.type) == 0) return {};
      return Place{field.type, offset};
    }
    const std::optional<Place> inner = Locate(field.type, path.substr(rest + 1), depth + 1);
    if (!inner) return {};
    return Place{inner->type, offset + inner->offset};
  }
  return {};
}

class Decoder {
 public:
  Decoder(const std::string& file, std::string_view bytes, const WantedFields& wanted)
      : file_(file), bytes_(bytes), wanted_(wanted) {}
  ULogContent Run();

 private:
  /// How the data messages of one id become rows.
  struct Subscription {
    MessageColumns* table = nullptr;
    Place stamp;
    std::vector<std::pair<std::vector<double>*, Place>> columns;
  };

  void ReadPart(size_t begin, size_t end);
  void ReadMessage(char type, std::string_view body);
  void ReadFlags(std::string_view body);
  void ReadParameter(std::string_view body);
  void Subscribe(std::string_view body);
  void ReadData(std::string_view body);
  /// True if a message may start there, and the `more` after it.
  bool IsPlausible(size_t at, size_t end, int more) const;

  std::string file_;
  std::string_view bytes_;
  const WantedFields& wanted_;
  Formats formats_;
  std::map<int, Subscription> subscriptions_;
  std::vector<size_t> parts_;  // where data was appended
  ULogContent content_;
};

bool Decoder::IsPlausible(size_t at, size_t end, int more) const {
  if (at == end) return true;
  if (at + kMessageHeader > end) return false;
  const size_t size = ByteReader(bytes_, at).Number<std::uint16_t>();
  if (size == 0 || kTypes.find(bytes_[at + 2]) == std::string_view::npos) return false;
  const size_t next = at + kMessageHeader + size;
  return next <= end && (more == 0 || IsPlausible(next, end, more - 1));
}

void Decoder::ReadPart(size_t begin, size_t end) {
  constexpr int kMessagesThatTell = 3;
  for (size_t at = begin; at < end;) {
    if (IsPlausible(at, end, 0)) {
      const size_t size = ByteReader(bytes_, at).Number<std::uint16_t>();
      ReadMessage(bytes_[at + 2], bytes_.substr(at + kMessageHeader, size));
      at += kMessageHeader + size;
      continue;
    }
    size_t next = at + 1;
    while (next < end && !IsPlausible(next, end, kMessagesThatTell)) ++next;
    if (next == end) {
      content_.damage.is_cut_off = true;
      if (end - at > size_t{1} << 16) content_.damage.Note(at, next);
      return;
    }
    content_.damage.Note(at, next);
    at = next;
  }
}

void Decoder::ReadFlags(std::string_view body) {
  ByteReader in(body);
  in.Take(8);  // compatible flags
  const std::string_view incompatible = in.Take(8);
  const bool has_appended = !incompatible.empty() && (incompatible[0] & 1) != 0;
  for (size_t i = 0; i < incompatible.size(); ++i) {
    if ((incompatible[i] & (i == 0 ? ~1 : ~0)) != 0) {
      RefuseFile(file_, "is a ULog of a later version than is read (incompatible flag in byte " +
                            std::to_string(i) + ")");
    }
  }
  for (int i = 0; has_appended && i < 3; ++i) {
    const auto offset = in.Number<std::uint64_t>();
    if (offset > kFileHeader && offset < bytes_.size())
      parts_.push_back(static_cast<size_t>(offset));
  }
}

void Decoder::ReadParameter(std::string_view body) {
  ByteReader in(body);
  const std::string_view key = in.Take(in.Byte());
  const std::optional<Field> field = ParseField(key);
  if (!field || (field->type != "int32_t" && field->type != "float")) return;
  const std::string_view raw = in.Take(4);
  if (!in.ended()) content_.parameters[field->name] = ValueOf(field->type, raw);
}

void Decoder::Subscribe(std::string_view body) {
  ByteReader in(body);
  const int instance = in.Byte();
  const int id = in.Number<std::uint16_t>();
  if (in.ended()) return;
  const std::string name(in.Take(in.left()));
  content_.topic_names.insert(name);
  const auto wanted = wanted_.find(name);
  const std::optional<Place> stamp = formats_.Locate(name, "timestamp");
  if (wanted == wanted_.end() || !stamp || subscriptions_.count(id) > 0) return;
  Subscription subscription;
  subscription.table = &content_.topics[{name, instance}];
  subscription.stamp = *stamp;
  for (const std::string& field : wanted->second) {
    const std::optional<Place> place = formats_.Locate(name, field);
    if (place) subscription.columns.push_back({&subscription.table->values[field], *place});
  }
  if (subscription.table->size() == 0) subscriptions_[id] = std::move(subscription);
}

void Decoder::ReadData(std::string_view body) {
  const int id = ByteReader(body).Number<std::uint16_t>();
  const auto found = subscriptions_.find(id);
  if (found == subscriptions_.end() || body.size() < 2) return;
  const std::string_view data = body.substr(2);
  const Subscription& subscription = found->second;
  if (data.size() < subscription.stamp.offset + 8) return;
  const auto stamp_us = ByteReader(data, subscription.stamp.offset).Number<std::uint64_t>();
  constexpr std::uint64_t kLatest_us = std::uint64_t{1} << 53;
  if (stamp_us > kLatest_us) return;
  subscription.table->stamps.push_back(1000 * static_cast<Stamp>(stamp_us));
  for (const auto& [column, place] : subscription.columns) {
    const size_t size = SizeOf(place.type);
    column->push_back(place.offset + size <= data.size()
                          ? ValueOf(place.type, data.substr(place.offset, size))
                          : kNone);
  }
}

void Decoder::ReadMessage(char type, std::string_view body) {
  switch (type) {
    case 'B':
      return ReadFlags(body);
    case 'F':
      return formats_.Add(body);
    case 'P':
      return ReadParameter(body);
    case 'A':
      return Subscribe(body);
    case 'D':
      return ReadData(body);
    case 'O':
      content_.lost_s += 1e-3 * ByteReader(body).Number<std::uint16_t>();
      return;
    default:
      return;
  }
}

ULogContent Decoder::Run() {
  if (!IsULog(bytes_)) RefuseFile(file_, "is no ULog: it does not start as one");
  if (bytes_.size() < kFileHeader) RefuseFile(file_, "byte 7: the ULog is cut off in its header");
  size_t begin = kFileHeader;
  if (begin < bytes_.size() && IsPlausible(begin, bytes_.size(), 0) && bytes_[begin + 2] == 'B') {
    const size_t size = ByteReader(bytes_, begin).Number<std::uint16_t>();
    ReadFlags(bytes_.substr(begin + kMessageHeader, size));
    begin += kMessageHeader + size;
  }
  std::sort(parts_.begin(), parts_.end());
  parts_.push_back(bytes_.size());
  for (const size_t end : std::vector<size_t>(parts_)) {
    if (end <= begin) continue;
    ReadPart(begin, end);
    begin = end;
  }
  return std::move(content_);
}

}  // namespace

const MessageColumns* ULogContent::Find(const std::string& topic, int instance) const {
  const auto found = topics.find({topic, instance});
  return found == topics.end() || found->second.size() == 0 ? nullptr : &found->second;
}

bool IsULog(std::string_view head) { return head.substr(0, kMagic.size()) == kMagic; }

ULogContent DecodeULog(const std::string& file, std::string_view bytes,
                       const WantedFields& wanted) {
  return Decoder(file, bytes, wanted).Run();
}

}  // namespace odmc

#include "dataflash_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "binary_file.h"
#include "odmc/io/autopilot_logs.h"

namespace odmc {
namespace {

constexpr std::string_view kMark("\xa3\x95", 2);
constexpr size_t kHeader = 3;  // mark, type
constexpr std::uint8_t kFormatType = 128;
constexpr size_t kFormatLength = 89;

/// Bytes of a field by its letter; 0 where there is no such letter.
size_t SizeOf(char letter) {
  switch (letter) {
    case 'b':
    case 'B':
    case 'M':
      return 1;
    case 'h':
    case 'H':
    case 'c':
    case 'C':
    case 'g':
      return 2;
    case 'i':
    case 'I':
    case 'e':
    case 'E':
    case 'L':
    case 'f':
    case 'n':
      return 4;
    case 'q':
    case 'Q':
    case 'd':
      return 8;
    case 'N':
      return 16;
    case 'a':
    case 'Z':
      return 64;
    default:
      return 0;
  }
}

bool IsText(char letter) {
  return letter == 'n' || letter == 'N' || letter == 'Z' || letter == 'a';
}

/// Factor that the letter itself says; 1 where the multiplier of FMTU says it.
double LetterScale(char letter) {
  if (letter == 'L') return 1e-7;
  return letter == 'c' || letter == 'C' || letter == 'e' || letter == 'E' ? 0.01 : 1.0;
}

double HalfFloat(std::uint16_t bits) {
  const int exponent = bits >> 10 & 31, fraction = bits & 1023;
  const double magnitude = exponent == 0    ? std::ldexp(fraction, -24)
                           : exponent == 31 ? std::numeric_limits<double>::quiet_NaN()
                                            : std::ldexp(1024 + fraction, exponent - 25);
  return (bits & 0x8000) != 0 ? -magnitude : magnitude;
}

double ValueOf(char letter, std::string_view bytes) {
  ByteReader in(bytes);
  switch (letter) {
    case 'b':
      return in.Number<std::int8_t>();
    case 'B':
    case 'M':
      return in.Number<std::uint8_t>();
    case 'h':
    case 'c':
      return in.Number<std::int16_t>();
    case 'H':
    case 'C':
      return in.Number<std::uint16_t>();
    case 'g':
      return HalfFloat(in.Number<std::uint16_t>());
    case 'i':
    case 'e':
    case 'L':
      return in.Number<std::int32_t>();
    case 'I':
    case 'E':
      return in.Number<std::uint32_t>();
    case 'f':
      return static_cast<double>(in.Number<float>());
    case 'q':
      return static_cast<double>(in.Number<std::int64_t>());
    case 'Q':
      return static_cast<double>(in.Number<std::uint64_t>());
    default:
      return in.Number<double>();
  }
}

std::string UntilZero(std::string_view bytes) {
  return std::string(bytes.substr(0, bytes.find('\0')));
}

struct Column {
  std::string name;
  char letter = 0;
  size_t offset = 0;  // in the body
  double scale = 1.0;
};

/// One kind of message, as FMT and FMTU define it.
struct Format {
  std::string name;
  size_t length = 0;  // with the header
  std::vector<Column> columns;
  std::optional<size_t> stamp, instance;  // columns
};

class Decoder {
 public:
  Decoder(std::string_view bytes, const std::set<std::string>& wanted)
      : bytes_(bytes), wanted_(wanted) {
    formats_[kFormatType].length = kFormatLength;
  }
  DataflashContent Run();

 private:
  /// Length of the message there; 0 where there is none.
  size_t LengthAt(size_t at) const;
  void ReadMessage(std::uint8_t type, std::string_view body);
  void Define(std::string_view body);
  void ReadMultiplier(std::string_view body);
  void ReadUnits(std::string_view body);
  void ReadParameter(const Format& format, std::string_view body);
  void Keep(const Format& format, std::string_view body);

  std::string_view bytes_;
  const std::set<std::string>& wanted_;
  std::array<Format, 256> formats_;
  std::map<char, double> multipliers_;
  DataflashContent content_;
};

size_t Decoder::LengthAt(size_t at) const {
  if (bytes_.substr(at, 2) != kMark || at + kHeader > bytes_.size()) return 0;
  const size_t length = formats_[static_cast<std::uint8_t>(bytes_[at + 2])].length;
  if (length == 0 || at + length > bytes_.size()) return 0;
  const std::string_view next = bytes_.substr(at + length, 2);
  return next.empty() || next == kMark || next == kMark.substr(0, next.size()) ? length : 0;
}

void Decoder::Define(std::string_view body) {
  ByteReader in(body);
  const std::uint8_t type = in.Byte();
  Format format;
  format.length = in.Byte();
  format.name = UntilZero(in.Take(4));
  const std::string letters = UntilZero(in.Take(16));
  std::string labels = UntilZero(in.Take(64));
  size_t offset = 0;
  for (const char letter : letters) {
    const size_t end = std::min(labels.find(','), labels.size());
    Column column{labels.substr(0, end), letter, offset, LetterScale(letter)};
    labels.erase(0, std::min(end + 1, labels.size()));
    offset += SizeOf(letter);
    if (SizeOf(letter) == 0) return;  // damaged
    if (column.name == "TimeUS") format.stamp = format.columns.size();
    const bool is_number = column.name == "I" || column.name == "C" || column.name == "Inst" ||
                           column.name == "Instance";
    if (is_number && letter == 'B') format.instance = format.columns.size();
    format.columns.push_back(std::move(column));
  }
  if (type == kFormatType || format.length != offset + kHeader) return;
  content_.names.insert(format.name);
  formats_[type] = std::move(format);
}

void Decoder::ReadMultiplier(std::string_view body) {
  ByteReader in(body);
  in.Take(8);
  const char id = static_cast<char>(in.Byte());
  const double factor = in.Number<double>();
  if (!in.ended() && std::isfinite(factor) && factor > 0.0 && id != '?') multipliers_[id] = factor;
}

/// Units (a '#' marks the instance) and multipliers of another message's fields.
void Decoder::ReadUnits(std::string_view body) {
  ByteReader in(body);
  in.Take(8);
  Format& format = formats_[in.Byte()];
  const std::string units = UntilZero(in.Take(16)), factors = UntilZero(in.Take(16));
  for (size_t i = 0; i < format.columns.size(); ++i) {
    Column& column = format.columns[i];
    if (i < units.size() && units[i] == '#' && column.letter == 'B') format.instance = i;
    if (i >= factors.size() || LetterScale(column.letter) != 1.0) continue;
    const auto factor = multipliers_.find(factors[i]);
    if (factor != multipliers_.end()) column.scale = factor->second;
  }
}

void Decoder::ReadParameter(const Format& format, std::string_view body) {
  std::string name;
  for (const Column& column : format.columns) {
    const std::string_view raw = body.substr(column.offset, SizeOf(column.letter));
    if (column.name == "Name" && IsText(column.letter)) name = UntilZero(raw);
    if (column.name == "Value" && !IsText(column.letter) && !name.empty()) {
      content_.parameters[name] = ValueOf(column.letter, raw);
    }
  }
}

void Decoder::Keep(const Format& format, std::string_view body) {
  if (!format.stamp) return;
  const auto raw = [&](const Column& c) {
    return ValueOf(c.letter, body.substr(c.offset, SizeOf(c.letter)));
  };
  constexpr double kLatest_us = 9e15;
  const double stamp_us = raw(format.columns[*format.stamp]);
  if (!(stamp_us >= 0.0 && stamp_us < kLatest_us)) return;
  const int instance =
      format.instance ? static_cast<int>(raw(format.columns[*format.instance])) : 0;
  MessageColumns& table = content_.messages[{format.name, instance}];
  table.stamps.push_back(1000 * static_cast<Stamp>(stamp_us));
  for (const Column& column : format.columns) {
    if (IsText(column.letter)) continue;
    std::vector<double>& values = table.values[column.name];
    values.resize(table.stamps.size() - 1, std::numeric_limits<double>::quiet_NaN());
    values.push_back(column.scale * raw(column));
  }
}

void Decoder::ReadMessage(std::uint8_t type, std::string_view body) {
  if (type == kFormatType) return Define(body);
  const Format& format = formats_[type];
  if (format.name == "MULT") return ReadMultiplier(body);
  if (format.name == "FMTU") return ReadUnits(body);
  if (format.name == "PARM") return ReadParameter(format, body);
  if (wanted_.count(format.name) > 0) Keep(format, body);
}

DataflashContent Decoder::Run() {
  for (size_t at = 0; at < bytes_.size();) {
    const size_t length = LengthAt(at);
    if (length > 0) {
      ReadMessage(static_cast<std::uint8_t>(bytes_[at + 2]),
                  bytes_.substr(at + kHeader, length - kHeader));
      at += length;
      continue;
    }
    size_t next = bytes_.find(kMark, at + 1);
    while (next != std::string_view::npos && LengthAt(next) == 0)
      next = bytes_.find(kMark, next + 1);
    if (next == std::string_view::npos) {
      content_.damage.is_cut_off = true;
      next = bytes_.size();
      if (next - at <= 256) break;  // the message it was cut off in
    }
    content_.damage.Note(at, next);
    at = next;
  }
  // A column that a second definition brought may be shorter or longer.
  for (auto& [name, table] : content_.messages) {
    for (auto& [field, values] : table.values) {
      values.resize(table.stamps.size(), std::numeric_limits<double>::quiet_NaN());
    }
  }
  return std::move(content_);
}

}  // namespace

const MessageColumns* DataflashContent::Find(const std::string& name, int instance) const {
  const auto found = messages.find({name, instance});
  return found == messages.end() || found->second.size() == 0 ? nullptr : &found->second;
}

const MessageColumns* DataflashContent::First(const std::string& name) const {
  const auto found = messages.lower_bound({name, 0});
  return found == messages.end() || found->first.first != name ? nullptr : &found->second;
}

bool IsDataflash(std::string_view head) {
  return head.size() > kFormatLength && head.substr(0, 2) == kMark &&
         static_cast<std::uint8_t>(head[2]) == kFormatType &&
         head.substr(kFormatLength, 2) == kMark;
}

DataflashContent DecodeDataflash(std::string_view bytes, const std::set<std::string>& wanted) {
  return Decoder(bytes, wanted).Run();
}

}  // namespace odmc

#include "blackbox_frames.h"

#include <algorithm>
#include <cstdlib>

#include "binary_file.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

// Numbers of the header's lines "encoding" and "predictor".
enum Encoding {
  kSignedVb = 0,
  kUnsignedVb = 1,
  kNegative14Bit = 3,
  kTag8_8Svb = 6,
  kTag2_3S32 = 7,
  kTag8_4S16 = 8,
  kNothing = 9,
  kTag2_3SVariable = 10,
};
enum Predictor {
  kZero = 0,
  kPrevious = 1,
  kStraightLine = 2,
  kAverageOfTwo = 3,
  kMinThrottle = 4,
  kMotor0 = 5,
  kIncrement = 6,
  kHome = 7,
  k1500 = 8,
  kBatteryReference = 9,
  kLastMainTime = 10,
  kMinMotor = 11,
};

constexpr int kKnownEncodings[] = {0, 1, 3, 6, 7, 8, 9, 10};
constexpr int kMostPredictor = kMinMotor;

std::vector<std::string> SplitAtCommas(const std::string& text) {
  std::vector<std::string> parts;
  size_t begin = 0;
  while (begin <= text.size() && !text.empty()) {
    const size_t end = std::min(text.find(',', begin), text.size());
    parts.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return parts;
}

}  // namespace

// ---- Header ------------------------------------------------------------------------------------

void BlackboxHeader::ReadLines(std::string_view log) {
  constexpr size_t kLongest = 1 << 16;
  while (log.substr(bytes_, 2) == "H ") {
    const size_t end = log.substr(0, std::min(log.size(), bytes_ + kLongest)).find('\n', bytes_);
    if (end == std::string_view::npos) {
      RefuseFile(file_,
                 "byte " + std::to_string(bytes_) + ": the blackbox header is cut off or damaged");
    }
    const std::string_view line = log.substr(bytes_ + 2, end - bytes_ - 2);
    const size_t colon = line.find(':');
    if (colon != std::string_view::npos) {
      lines_[std::string(line.substr(0, colon))] = std::string(line.substr(colon + 1));
    }
    bytes_ = end + 1;
  }
}

std::vector<int> BlackboxHeader::Codes(const std::string& name, size_t count) const {
  const std::vector<std::string> parts = SplitAtCommas(Text(name));
  if (parts.size() != count) {
    RefuseFile(file_, "blackbox header: line '" + name + "' has " + std::to_string(parts.size()) +
                          " entries for " + std::to_string(count) + " fields");
  }
  std::vector<int> codes;
  for (const std::string& part : parts) codes.push_back(std::atoi(part.c_str()));
  for (const int code : codes) {
    const bool is_encoding = name.find("encoding") != std::string::npos;
    const bool is_known =
        is_encoding ? std::count(std::begin(kKnownEncodings), std::end(kKnownEncodings), code) > 0
                    : code >= 0 && code <= kMostPredictor;
    if (!is_known) {
      RefuseFile(file_, "blackbox header: line '" + name + "' has the unknown code " +
                            std::to_string(code));
    }
  }
  return codes;
}

BlackboxHeader::BlackboxHeader(const std::string& file, std::string_view log) : file_(file) {
  constexpr size_t kMostFields = 1000;
  ReadLines(log);
  if (Text("Product").empty())
    RefuseFile(file_, "is no blackbox log: it does not start with 'H Product:'");
  if (Text("Data version") != "2") {
    RefuseFile(file_, "blackbox data version " + Printable(Text("Data version")) +
                          " is not read, only 2 is");
  }
  fields_ = SplitAtCommas(Text("Field I name"));
  if (fields_.empty() || fields_.size() > kMostFields) {
    RefuseFile(file_, "blackbox header: no usable line 'Field I name'");
  }
  for (const int code : Codes("Field I signed", fields_.size())) signed_.push_back(code != 0);
  intra_ = {Codes("Field I predictor", fields_.size()), Codes("Field I encoding", fields_.size())};
  inter_ = {Codes("Field P predictor", fields_.size()), Codes("Field P encoding", fields_.size())};
  for (const char type : {'S', 'G', 'H'}) {
    const std::string start = std::string("Field ") + type;
    const size_t count = SplitAtCommas(Text(start + " name")).size();
    if (count > 0) others_[type] = Codes(start + " encoding", count);
  }
  for (const char* name : {"loopIteration", "time"}) {
    if (!FieldNamed(name))
      RefuseFile(file_, std::string("blackbox header: there is no field ") + name);
  }
}

const std::vector<int>& BlackboxHeader::OthersEncodings(char type) const {
  static const std::vector<int> none;
  const auto found = others_.find(type);
  return found == others_.end() ? none : found->second;
}

std::optional<size_t> BlackboxHeader::FieldNamed(const std::string& name) const {
  const auto found = std::find(fields_.begin(), fields_.end(), name);
  if (found == fields_.end()) return std::nullopt;
  return static_cast<size_t>(found - fields_.begin());
}

std::string BlackboxHeader::Text(const std::string& name) const {
  const auto found = lines_.find(name);
  return found == lines_.end() ? "" : found->second;
}

std::optional<std::int64_t> BlackboxHeader::Number(const std::string& name, size_t i) const {
  const std::vector<std::string> parts = SplitAtCommas(Text(name));
  if (i >= parts.size()) return std::nullopt;
  const int base = parts[i].rfind("0x", 0) == 0 ? 16 : 10;
  char* end = nullptr;
  const std::int64_t value = std::strtoll(parts[i].c_str(), &end, base);
  if (end == parts[i].c_str()) return std::nullopt;
  return value;
}

// ---- Fields ------------------------------------------------------------------------------------

namespace {

/// Values are coded modulo 2^32; the header says which are signed.
using Word = std::uint32_t;

/// The lowest `bits` of a value, as two's complement.
Word SignExtended(Word value, int bits) {
  const Word sign = Word{1} << (bits - 1);
  value &= (sign << 1) - 1;
  return (value ^ sign) - sign;
}

/// Seven bits a byte, the lowest first.
Word ReadUnsigned(ByteReader* in) {
  Word value = 0;
  for (int shift = 0; shift < 35; shift += 7) {
    const Word byte = in->Byte();
    value |= (byte & 0x7f) << shift;
    if (byte < 0x80) return value;
  }
  return 0;  // no such number: the frame is damaged, and does not end where one begins
}

/// Signs alternate: 0, -1, 1, -2, ...
Word ReadSigned(ByteReader* in) {
  const Word value = ReadUnsigned(in);
  return (value >> 1) ^ (Word{0} - (value & 1));
}

/// A byte whose bits say which of up to 8 values are not zero.
void ReadTag8_8(ByteReader* in, size_t count, Word* values) {
  if (count == 1) {
    values[0] = ReadSigned(in);
    return;
  }
  const Word tag = in->Byte();
  for (size_t i = 0; i < count; ++i) values[i] = (tag >> i & 1) != 0 ? ReadSigned(in) : 0;
}

/// Three values of 1 to 4 bytes each, lengths in the lowest bits of `tag`.
void ReadThreeOfBytes(ByteReader* in, Word tag, Word* values) {
  for (int i = 0; i < 3; ++i, tag >>= 2) {
    const int bytes = static_cast<int>(tag & 3) + 1;
    Word value = 0;
    for (int b = 0; b < bytes; ++b) value |= static_cast<Word>(in->Byte()) << 8 * b;
    values[i] = bytes == 4 ? value : SignExtended(value, 8 * bytes);
  }
}

/// Three values of 2 bits behind a lead of two.
void ReadThreeOfTwoBits(Word lead, Word* values) {
  for (int i = 0; i < 3; ++i) values[i] = SignExtended(lead >> (4 - 2 * i), 2);
}

/// Three values of 2, 4 or 6 bits, or of whole bytes.
void ReadTag2_3(ByteReader* in, Word* values) {
  const Word lead = in->Byte();
  switch (lead >> 6) {
    case 0:
      ReadThreeOfTwoBits(lead, values);
      return;
    case 1: {
      const Word next = in->Byte();
      values[0] = SignExtended(lead, 4);
      values[1] = SignExtended(next >> 4, 4);
      values[2] = SignExtended(next, 4);
      return;
    }
    case 2:
      values[0] = SignExtended(lead, 6);
      values[1] = SignExtended(in->Byte(), 6);
      values[2] = SignExtended(in->Byte(), 6);
      return;
    default:
      ReadThreeOfBytes(in, lead, values);
  }
}

/// The same with 2, 5-5-4 or 8-7-7 bits.
void ReadTag2_3Variable(ByteReader* in, Word* values) {
  const Word lead = in->Byte();
  switch (lead >> 6) {
    case 0:
      ReadThreeOfTwoBits(lead, values);
      return;
    case 1: {
      const Word bits = lead << 8 | in->Byte();
      values[0] = SignExtended(bits >> 9, 5);
      values[1] = SignExtended(bits >> 4, 5);
      values[2] = SignExtended(bits, 4);
      return;
    }
    case 2: {
      const Word second = in->Byte();
      const Word bits = lead << 16 | second << 8 | in->Byte();
      values[0] = SignExtended(bits >> 14, 8);
      values[1] = SignExtended(bits >> 7, 7);
      values[2] = SignExtended(bits, 7);
      return;
    }
    default:
      ReadThreeOfBytes(in, lead, values);
  }
}

/// Takes half bytes, the upper one first.
class NibbleReader {
 public:
  explicit NibbleReader(ByteReader* in) : in_(in) {}
  Word Take(int nibbles) {
    Word value = 0;
    for (; nibbles > 0; --nibbles) value = value << 4 | Next();
    return value;
  }

 private:
  Word Next() {
    has_lower_ = !has_lower_;
    if (!has_lower_) return byte_ & 0xf;
    byte_ = in_->Byte();
    return byte_ >> 4;
  }
  ByteReader* in_;
  Word byte_ = 0;
  bool has_lower_ = false;
};

/// Four values of 0, 4, 8 or 16 bits, lengths in the first byte.
void ReadTag8_4(ByteReader* in, Word* values) {
  constexpr int kNibbles[] = {0, 1, 2, 4};
  Word tag = in->Byte();
  NibbleReader nibbles(in);
  for (int i = 0; i < 4; ++i, tag >>= 2) {
    const int count = kNibbles[tag & 3];
    values[i] = count == 0 ? 0 : SignExtended(nibbles.Take(count), 4 * count);
  }
}

/// Reads one value or a group of them.
/// @returns how many fields it filled
size_t ReadGroup(ByteReader* in, const std::vector<int>& encodings, size_t field, Word* values) {
  switch (encodings[field]) {
    case kSignedVb:
      values[0] = ReadSigned(in);
      return 1;
    case kUnsignedVb:
      values[0] = ReadUnsigned(in);
      return 1;
    case kNegative14Bit:
      values[0] = Word{0} - SignExtended(ReadUnsigned(in), 14);
      return 1;
    case kTag8_8Svb: {
      size_t count = 1;
      while (count < 8 && field + count < encodings.size() &&
             encodings[field + count] == kTag8_8Svb) {
        ++count;
      }
      ReadTag8_8(in, count, values);
      return count;
    }
    case kTag2_3S32:
      ReadTag2_3(in, values);
      return 3;
    case kTag2_3SVariable:
      ReadTag2_3Variable(in, values);
      return 3;
    case kTag8_4S16:
      ReadTag8_4(in, values);
      return 4;
    default:
      values[0] = 0;
      return 1;
  }
}

// ---- Frames ------------------------------------------------------------------------------------

enum Event {
  kSyncBeep = 0,
  kInflightAdjustment = 13,
  kLoggingResume = 14,
  kDisarm = 15,
  kFlightMode = 30,
  kImuFailure = 40,
  kLogEnd = 255,
};

bool IsFrameType(char c) {
  return c == 'I' || c == 'P' || c == 'S' || c == 'G' || c == 'H' || c == 'E';
}

class Decoder {
 public:
  Decoder(const BlackboxHeader& header, std::string_view log,
          const std::vector<std::string>& wanted);
  BlackboxFrames Run();

 private:
  enum class Outcome { kGood, kDamaged, kEnd };

  Outcome ReadFrame();
  bool ReadIntra();
  bool ReadInter();
  Outcome ReadEvent();
  void SkipFields(const std::vector<int>& encodings);
  void ReadFields(const std::vector<int>& encodings);
  Word Predicted(int predictor, size_t field) const;
  void ApplyPredictions(const std::vector<int>& predictors);
  Word SkippedLoops() const;
  bool ShouldHaveFrame(Word iteration) const;
  /// True if the frame just read follows the last one in time.
  bool StepsForward() const;
  void Keep();
  void NoteDamage(size_t at);

  const BlackboxHeader& header_;
  std::string_view log_;
  ByteReader in_;
  const size_t iteration_, time_;  // fields
  std::optional<size_t> motor0_, home_;
  Word interval_i_ = 32, interval_p_num_ = 1, interval_p_denominator_ = 1;
  Word min_throttle_ = 0, min_motor_ = 0, battery_reference_ = 0;
  std::vector<size_t> kept_fields_;
  std::vector<std::vector<double>*> kept_;
  std::vector<Word> frame_, last_, last_but_one_;  // frame_ has room for a group beyond its fields
  bool has_history_ = false;                       // a good frame to predict from
  bool has_time_ = false;
  std::int64_t clock_us_ = 0;  // of the last frame, does not wrap
  BlackboxFrames frames_;
};

Decoder::Decoder(const BlackboxHeader& header, std::string_view log,
                 const std::vector<std::string>& wanted)
    : header_(header),
      log_(log),
      in_(log, header.bytes()),
      iteration_(*header.FieldNamed("loopIteration")),
      time_(*header.FieldNamed("time")),
      motor0_(header.FieldNamed("motor[0]")) {
  const auto number = [&](const char* name, size_t i, Word otherwise) {
    return static_cast<Word>(header.Number(name, i).value_or(otherwise));
  };
  interval_i_ = std::max<Word>(1, number("I interval", 0, 32));
  const std::string p_interval = header.Text("P interval");  // "1/4", or "4" for the same
  const size_t slash = p_interval.find('/');
  if (slash == std::string::npos) {
    interval_p_denominator_ = number("P interval", 0, 1);
  } else {
    interval_p_num_ = number("P interval", 0, 1);
    interval_p_denominator_ = static_cast<Word>(std::atoi(p_interval.c_str() + slash + 1));
  }
  interval_p_denominator_ = std::max<Word>(1, interval_p_denominator_);
  min_throttle_ = number("minthrottle", 0, 0);
  min_motor_ = number("motorOutput", 0, min_throttle_);
  battery_reference_ = number("vbatref", 0, 0);
  const size_t size = header.fields().size();
  frame_.assign(size + 8, 0);
  last_.assign(size, 0);
  last_but_one_.assign(size, 0);
  for (const std::string& name : wanted) {
    const auto field = header.FieldNamed(name);
    if (!field) continue;
    kept_fields_.push_back(*field);
    kept_.push_back(&frames_.values[name]);
  }
}

void Decoder::ReadFields(const std::vector<int>& encodings) {
  for (size_t field = 0; field < encodings.size();) {
    field += ReadGroup(&in_, encodings, field, &frame_[field]);
  }
}

void Decoder::SkipFields(const std::vector<int>& encodings) {
  Word values[8];
  for (size_t field = 0; field < encodings.size();) {
    field += ReadGroup(&in_, encodings, field, values);
  }
}

bool Decoder::ShouldHaveFrame(Word iteration) const {
  return (iteration % interval_i_ + interval_p_num_ - 1) % interval_p_denominator_ <
         interval_p_num_;
}

/// Loops after the last frame that the log leaves out by its rate.
Word Decoder::SkippedLoops() const {
  Word skipped = 0;
  while (skipped < interval_i_ && !ShouldHaveFrame(last_[iteration_] + 1 + skipped)) ++skipped;
  return skipped;
}

Word Decoder::Predicted(int predictor, size_t field) const {
  const auto as_signed = [](Word word) {
    return static_cast<std::int64_t>(static_cast<std::int32_t>(word));
  };
  switch (predictor) {
    case kPrevious:
      return last_[field];
    case kStraightLine:
      return 2 * last_[field] - last_but_one_[field];
    case kAverageOfTwo:  // the firmware's division rounds towards zero
      return header_.is_signed(field)
                 ? static_cast<Word>((as_signed(last_[field]) + as_signed(last_but_one_[field])) /
                                     2)
                 : static_cast<Word>(
                       (std::uint64_t{last_[field]} + std::uint64_t{last_but_one_[field]}) / 2);
    case kMinThrottle:
      return min_throttle_;
    case kMotor0:
      return motor0_ ? frame_[*motor0_] : 0;
    case kIncrement:
      return last_[field] + 1 + SkippedLoops();
    case k1500:
      return 1500;
    case kBatteryReference:
      return battery_reference_;
    case kMinMotor:
      return min_motor_;
    default:
      return 0;
  }
}

void Decoder::ApplyPredictions(const std::vector<int>& predictors) {
  for (size_t field = 0; field < predictors.size(); ++field) {
    frame_[field] += Predicted(predictors[field], field);
  }
}

bool Decoder::StepsForward() const {
  constexpr Word kMostLoops = 5000;
  constexpr Word kMostStep_us = 10000000, kMostGap_us = 600000000;  // while decoding; after damage
  if (!has_time_) return true;
  const Word loops = frame_[iteration_] - last_[iteration_];
  const Word step = frame_[time_] - last_[time_];
  if (step == 0 || loops == 0) return false;
  return has_history_ ? loops < kMostLoops && step < kMostStep_us : step < kMostGap_us;
}

void Decoder::Keep() {
  if (has_time_) {
    clock_us_ += static_cast<std::int64_t>(frame_[time_] - last_[time_]);
  } else {
    clock_us_ = frame_[time_];
  }
  has_time_ = has_history_ = true;
  frames_.stamps.push_back(1000 * clock_us_);
  for (size_t i = 0; i < kept_.size(); ++i) {
    const Word word = frame_[kept_fields_[i]];
    kept_[i]->push_back(header_.is_signed(kept_fields_[i])
                            ? static_cast<double>(static_cast<std::int32_t>(word))
                            : static_cast<double>(word));
  }
}

bool Decoder::ReadIntra() {
  ReadFields(header_.intra().encodings);
  ApplyPredictions(header_.intra().predictors);
  return true;
}

bool Decoder::ReadInter() {
  ReadFields(header_.inter().encodings);
  if (has_history_) ApplyPredictions(header_.inter().predictors);
  return true;
}

Decoder::Outcome Decoder::ReadEvent() {
  constexpr std::string_view kEndText("End of log\0", 11);
  switch (in_.Byte()) {
    case kSyncBeep:
    case kDisarm:
    case kImuFailure:
      ReadUnsigned(&in_);
      return Outcome::kGood;
    case kFlightMode:
      ReadUnsigned(&in_);
      ReadUnsigned(&in_);
      return Outcome::kGood;
    case kInflightAdjustment:
      if (in_.Byte() < 128) {
        ReadSigned(&in_);
      } else {
        in_.Take(4);
      }
      return Outcome::kGood;
    case kLoggingResume:  // after a pause: the next full frame may be any time later
      ReadUnsigned(&in_);
      ReadUnsigned(&in_);
      has_history_ = false;
      return Outcome::kGood;
    case kLogEnd:
      return in_.Take(kEndText.size()) == kEndText ? Outcome::kEnd : Outcome::kDamaged;
    default:
      return Outcome::kDamaged;
  }
}

Decoder::Outcome Decoder::ReadFrame() {
  const char type = static_cast<char>(in_.Byte());
  const bool had_history = has_history_;
  switch (type) {
    case 'I':
      ReadIntra();
      break;
    case 'P':
      ReadInter();
      break;
    case 'E': {
      const Outcome outcome = ReadEvent();
      if (outcome != Outcome::kGood) return outcome;
      break;
    }
    default:
      if (!IsFrameType(type) || header_.OthersEncodings(type).empty()) return Outcome::kDamaged;
      SkipFields(header_.OthersEncodings(type));
  }
  const bool is_followed = in_.left() == 0 || IsFrameType(log_[in_.position()]);
  if (in_.ended() || !is_followed) return Outcome::kDamaged;
  if (type != 'I' && type != 'P') return Outcome::kGood;
  if (type == 'P' && !had_history) return Outcome::kGood;  // nothing to decode it with
  if (!StepsForward()) return Outcome::kDamaged;
  Keep();
  last_but_one_ = last_;
  std::copy(frame_.begin(), frame_.begin() + static_cast<std::ptrdiff_t>(last_.size()),
            last_.begin());
  if (type == 'I') last_but_one_ = last_;
  return Outcome::kGood;
}

void Decoder::NoteDamage(size_t at) {
  if (has_history_ || frames_.damage.places == 0) {
    if (frames_.damage.places++ == 0) frames_.damage.first = at;
  }
  has_history_ = false;
}

BlackboxFrames Decoder::Run() {
  while (in_.left() > 0) {
    const size_t start = in_.position();
    const Outcome outcome = ReadFrame();
    if (outcome == Outcome::kEnd) return std::move(frames_);
    if (outcome == Outcome::kGood) continue;
    if (in_.ended() && has_history_ && IsFrameType(log_[start])) {
      frames_.damage.is_cut_off = true;
      return std::move(frames_);
    }
    NoteDamage(start);
    in_.MoveTo(start + 1);
    while (in_.left() > 0 && log_[in_.position()] != 'I') in_.Byte();
    frames_.damage.skipped += in_.position() - start;
  }
  frames_.damage.is_cut_off = true;
  return std::move(frames_);
}

}  // namespace

BlackboxFrames DecodeBlackbox(const BlackboxHeader& header, std::string_view log,
                              const std::vector<std::string>& wanted) {
  return Decoder(header, log, wanted).Run();
}

}  // namespace odmc

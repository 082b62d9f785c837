#include "odmc/io/foreign_messages.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "odmc/math/units.h"
#include "odmc/model/motor.h"

namespace odmc {
namespace {

constexpr double kLeastPulse_us = 500.0;  // an output without pulses reads 0

constexpr double kLeastDate_s = 1e9;  // of 2001: no clock runs so long from its start
constexpr double kSameClock_s = 1.0;  // between a date and the message that brought it

enum Note { kArrival, kZeroStamp, kMd5, kUnit, kPadded };

const char* NameOf(ForeignUse use) {
  switch (use) {
    case ForeignUse::kRotorSpeeds:
      return "rotor speeds";
    case ForeignUse::kCommands:
      return "commands";
    default:
      return "the voltage";
  }
}

/// The option that names the unit.
const char* UnitOption(ForeignUse use) {
  return use == ForeignUse::kCommands ? "command_unit (fraction, us, raw16)"
                                      : "rotor_speed_unit (rad_s, rpm, erpm)";
}

const char* FieldOption(ForeignUse use) {
  switch (use) {
    case ForeignUse::kRotorSpeeds:
      return "rotor_topic_field";
    case ForeignUse::kCommands:
      return "command_topic_field";
    default:
      return "battery_topic_field";
  }
}

}  // namespace

const std::vector<KnownMessage>& KnownMessages() {
  using Use = ForeignUse;
  static const std::vector<KnownMessage> known = {
      {Use::kRotorSpeeds, "mav_msgs/Actuators", "25741daf38ed25442e3a66a855ee8d9c",
       "angular_velocities[]", "rad_s"},
      {Use::kRotorSpeeds, "mavros_msgs/ESCStatus", "145d49eaf5cfecbdfd50ae4a22fe82d4",
       "esc_status[].rpm", "rpm", "", true},
      {Use::kRotorSpeeds, "mavros_msgs/ESCTelemetry", "7b1fb252ca6aa175fe8dd23d029b3362",
       "esc_telemetry[].rpm", "rpm", "", true},
      {Use::kRotorSpeeds, "blackbird/MotorRPM", "b5f09223542b26e832f8faf8e5bf6d22", "rpm[]", "rpm",
       "sample_stamp[]"},
      {Use::kRotorSpeeds, "agiros_msgs/QuadState", "", "motors[]", "rad_s", "", false, true},
      {Use::kRotorSpeeds, "quadrotor_msgs/LowLevelFeedback", "e3cfad3ba98dfdc505bcf1fe91833d87",
       "motor_speeds[]", "rpm"},
      {Use::kRotorSpeeds, "kr_mav_msgs/MotorRPM", "aa0b8f1e09aa084c2f05fdb94e7b972e", "rpm[]",
       "rpm", "", true},
      {Use::kRotorSpeeds, "geom_inertia_estimator/MotorRPM", "f0958d1c7e6546f4ee55c7ba1414c22a",
       "rpm[]", "rpm"},
      {Use::kRotorSpeeds, "std_msgs/Float64MultiArray", "4b7d974086d4060e7db4613a7e6c3ba4",
       "data[]", "", "", false, true},
      {Use::kRotorSpeeds, "std_msgs/Float32MultiArray", "6a40e0ffa6a17a503ac3f8616991b1f6",
       "data[]", "", "", false, true},
      {Use::kCommands, "mavros_msgs/RCOut", "52cacf104bab5ae3b103cfe176590713", "channels[]", "us",
       "", true},
      {Use::kCommands, "blackbird/MotorPWM", "ebc116a4663ad5100b836133847de99d", "pwm[]", "us"},
      {Use::kCommands, "mav_msgs/Actuators", "25741daf38ed25442e3a66a855ee8d9c", "normalized[]",
       "fraction", "", false, true},
      {Use::kCommands, "std_msgs/Float64MultiArray", "4b7d974086d4060e7db4613a7e6c3ba4", "data[]",
       "", "", false, true},
      {Use::kCommands, "std_msgs/Float32MultiArray", "6a40e0ffa6a17a503ac3f8616991b1f6", "data[]",
       "", "", false, true},
      {Use::kVoltage, "quadrotor_msgs/LowLevelFeedback", "e3cfad3ba98dfdc505bcf1fe91833d87",
       "battery_voltage", "V"},
      {Use::kVoltage, "mav_msgs/Status", "", "battery_voltage", "V"},
      {Use::kVoltage, "mavros_msgs/BatteryStatus", "8ba4ae7c602c5ae6a7e8f3ffb652dc5f", "voltage",
       "V"},
      {Use::kVoltage, "std_msgs/Float32", "73fcbf46b49191e672908e50842a83d4", "data", "V", "",
       false, true},
      {Use::kVoltage, "std_msgs/Float64", "fdb28210bfa9d7c91146260178d9a584", "data", "V", "",
       false, true},
  };
  return known;
}

const KnownMessage* FindKnown(ForeignUse use, const std::string& type) {
  for (const KnownMessage& known : KnownMessages()) {
    if (known.use == use && type == known.type) return &known;
  }
  return nullptr;
}

double RotorSpeedScale(const std::string& unit, int pole_pairs) {
  if (unit == "rad_s" || unit == "auto") return 1.0;
  if (unit == "rpm") return kRpm;
  if (unit != "erpm") {
    throw std::invalid_argument("rotor_speed_unit must be rad_s, rpm or erpm, not '" + unit + "'");
  }
  if (pole_pairs < 1) {
    throw std::invalid_argument("pole_pairs must be at least 1, not " + std::to_string(pole_pairs));
  }
  return kRpm / pole_pairs;
}

double StampScale(const std::string& unit) {
  if (unit == "auto") return 0.0;
  if (unit == "s") return 1.0;
  if (unit == "ms") return 1e-3;
  if (unit == "us") return 1e-6;
  if (unit == "ns") return 1e-9;
  throw std::invalid_argument("rotor_stamp_unit must be auto, s, ms, us or ns, not '" + unit + "'");
}

std::vector<int> ParseOrder(const std::string& text) {
  std::string plain;
  for (const char c : text) {
    if (c != '[' && c != ']' && c != ' ') plain += c;
  }
  std::vector<int> order;
  std::istringstream items(plain);
  for (std::string item; std::getline(items, item, ',');) {
    const bool is_number = !item.empty() && item.size() <= 3 &&
                           item.find_first_not_of("0123456789") == std::string::npos;
    const int entry = is_number ? std::atoi(item.c_str()) : 0;
    if (entry < 1 || std::count(order.begin(), order.end(), entry) > 0) {
      throw std::invalid_argument("'" + text +
                                  "' is no order of rotors: the numbers of different entries, "
                                  "from 1, as 2,4,1,3");
    }
    order.push_back(entry);
  }
  return order;
}

std::optional<std::vector<double>> EntriesInOrder(const std::vector<double>& entries,
                                                  const std::vector<int>& order) {
  if (order.empty()) return entries;
  std::vector<double> ordered;
  for (const int entry : order) {
    if (static_cast<size_t>(entry) > entries.size()) return std::nullopt;
    ordered.push_back(entries[static_cast<size_t>(entry) - 1]);
  }
  return ordered;
}

// ---- What a stream means -----------------------------------------------------------------------

ForeignStream::ForeignStream(ForeignUse use, const MessageDescription& message,
                             const FieldOptions& options, int count)
    : use_(use), layout_(message.type, message.definition), order_(options.order), count_(count) {
  ChooseField(options, message);
  if (use == ForeignUse::kRotorSpeeds) scale_ = RotorSpeedScale(unit_, options.pole_pairs);
  if (use == ForeignUse::kCommands && !CommandUnitNamed(unit_)) {
    throw std::invalid_argument("command_unit must be fraction, us or raw16, not '" + unit_ + "'");
  }
  if (count_ > 0 && !order_.empty() && static_cast<int>(order_.size()) != count_) {
    throw std::invalid_argument("an order of " + std::to_string(order_.size()) +
                                " rotors was given, the vehicle has " + std::to_string(count_));
  }
}

void ForeignStream::ChooseField(const FieldOptions& options, const MessageDescription& message) {
  const KnownMessage* known = FindKnown(use_, message.type);
  const bool is_the_known_field =
      known != nullptr && (options.field.empty() || options.field == known->field);
  const bool takes_known = options.field.empty() && known != nullptr;
  const std::string field = takes_known ? known->field : options.field;
  if (field.empty()) {
    throw std::invalid_argument(message.type + " is not known: say which of its fields holds " +
                                NameOf(use_) + " (" + FieldOption(use_) + ", as esc_status[].rpm)");
  }
  field_ = layout_.Find(field);
  if (field_.kind == FieldKind::kString) layout_.Numbers(field_, nullptr, 0);  // says what it is
  const std::string known_unit = is_the_known_field ? known->unit : "";
  unit_ = options.unit == "auto" ? known_unit : options.unit;
  if (use_ == ForeignUse::kVoltage) unit_ = "V";
  if (unit_.empty()) {
    throw std::invalid_argument(message.type + " does not say in which unit " + field +
                                " is: give " + UnitOption(use_));
  }
  if (!known_unit.empty() && unit_ != known_unit) {
    NoteOnce(kUnit, message.type + " has " + field + " in " + known_unit + ", taken as " + unit_ +
                        " as the options say");
  }
  if (known != nullptr && *known->md5 != '\0' && !message.md5.empty() && message.md5 != "*" &&
      message.md5 != known->md5) {
    NoteOnce(kMd5, message.type + " is another version than the one that is known (md5 " +
                       message.md5 + ", not " + known->md5 + "); " + field + " was taken as " +
                       unit_);
  }
  is_padded_ = is_the_known_field && known->is_padded;
  if (layout_.Has("header.stamp")) {
    stamp_ = layout_.Find("header.stamp");
    if (stamp_->kind != FieldKind::kTime) stamp_.reset();
  }
  SettleStamp(options, is_the_known_field ? known : nullptr);
}

/// @param known  what is known of the field of the numbers; null: nothing
void ForeignStream::SettleStamp(const FieldOptions& options, const KnownMessage* known) {
  const bool has_known =
      known != nullptr && *known->entry_stamps != '\0' && layout_.Has(known->entry_stamps);
  if (options.stamp_field.empty()) {
    if (has_known) entry_stamps_ = layout_.Find(known->entry_stamps);
    return;
  }
  entry_stamps_ = layout_.Find(options.stamp_field);
  const FieldKind kind = entry_stamps_->kind;
  if (kind == FieldKind::kString) layout_.Numbers(*entry_stamps_, nullptr, 0);  // says what it is
  const bool is_time = kind == FieldKind::kTime || kind == FieldKind::kDuration;
  if (is_time) return;
  stamp_scale_ = StampScale(options.stamp_unit);
  if (stamp_scale_ == 0.0) {
    throw std::invalid_argument(layout_.type() + " does not say in which unit " +
                                options.stamp_field + " is: give rotor_stamp_unit (s, ms, us, ns)");
  }
}

std::string ForeignStream::Describe() const {
  const std::string stamp = entry_stamps_ ? entry_stamps_->text
                            : stamp_      ? stamp_->text
                                          : "time of arrival";
  return field_.text + " in " + unit_ + ", " + stamp;
}

std::string ForeignStream::StampSource() const {
  const std::string message = is_arrival_ ? "time of arrival" : "header.stamp";
  if (!entry_stamps_) return message;
  return entry_stamps_->text +
         (has_own_clock_.value_or(false) ? ", a clock of its own laid on " + message : "");
}

void ForeignStream::NoteOnce(int kind, const std::string& sentence) {
  if (std::count(noted_.begin(), noted_.end(), kind) > 0) return;
  noted_.push_back(kind);
  notes_.push_back(sentence);
}

std::vector<std::string> ForeignStream::TakeNotes() { return std::exchange(notes_, {}); }

// ---- Messages ----------------------------------------------------------------------------------

std::optional<ForeignReading> ForeignStream::Read(const std::uint8_t* data, size_t size,
                                                  Stamp arrival) {
  const std::vector<double> entries = layout_.Numbers(field_, data, size);
  if (entries.empty()) return std::nullopt;
  std::vector<double> values = Choose(entries);
  for (double& value : values) value = ToUnit(value);
  if (!entry_stamps_) return ForeignReading{StampOf(data, size, arrival), std::move(values)};
  const std::vector<Stamp> stamps = EntryStamps(data, size, entries.size(), values.size());
  if (stamps.empty()) return ForeignReading{StampOf(data, size, arrival), std::move(values)};
  const Stamp newest = *std::max_element(stamps.begin(), stamps.end());
  if (newest == 0) return std::nullopt;
  const Stamp offset = OffsetOf(newest, data, size, arrival);
  std::optional<ForeignReading> reading = aligner_.Add(values, stamps);
  if (reading) reading->stamp += offset;
  return reading;
}

/// Of the values that were chosen; empty where the message has none.
std::vector<Stamp> ForeignStream::EntryStamps(const std::uint8_t* data, size_t size, size_t entries,
                                              size_t values) const {
  std::vector<Stamp> all;
  if (stamp_scale_ == 0.0) {
    all = layout_.Stamps(*entry_stamps_, data, size);
  } else {
    for (const double number : layout_.Numbers(*entry_stamps_, data, size)) {
      const double stamp_ns = number * stamp_scale_ * 1e9;
      // Differences of stamps have to fit, too. Else, or where it is no number: none.
      const bool fits = std::abs(stamp_ns) < 4e18;
      all.push_back(fits ? static_cast<Stamp>(std::llround(stamp_ns)) : 0);
    }
  }
  const bool is_of_all = std::none_of(entry_stamps_->steps.begin(), entry_stamps_->steps.end(),
                                      [](const FieldPath::Step& step) { return step.all; });
  if (is_of_all && all.size() == 1) return std::vector<Stamp>(values, all.front());
  std::vector<Stamp> stamps;
  for (size_t i = 0; i < values && !all.empty(); ++i) {
    const size_t entry = order_.empty() ? i : static_cast<size_t>(order_[i]) - 1;
    if (entry >= all.size()) {
      throw std::invalid_argument(layout_.type() + ": " + entry_stamps_->text + " has " +
                                  std::to_string(all.size()) + " stamps for " +
                                  std::to_string(entries) + " entries of " + field_.text);
    }
    stamps.push_back(all[entry]);
  }
  return stamps;
}

/// From the entries' clock to that of the messages. Times of ROS are on it already.
Stamp ForeignStream::OffsetOf(Stamp newest, const std::uint8_t* data, size_t size, Stamp arrival) {
  if (entry_stamps_->kind == FieldKind::kTime) return 0;
  const Stamp message = StampOf(data, size, arrival);
  if (!has_own_clock_) {
    const bool is_date =
        ToSeconds(newest) > kLeastDate_s && std::abs(ToSeconds(message - newest)) < kSameClock_s;
    has_own_clock_ = !is_date;
  }
  return *has_own_clock_ ? offset_.Follow(newest, message) : 0;
}

/// The entries that are rotors, in their order.
std::vector<double> ForeignStream::Choose(std::vector<double> entries) {
  const std::string has =
      layout_.type() + ": " + field_.text + " has " + std::to_string(entries.size()) + " entries, ";
  if (!order_.empty()) {
    std::optional<std::vector<double>> ordered = EntriesInOrder(entries, order_);
    if (ordered) return *std::move(ordered);
    const int last = *std::max_element(order_.begin(), order_.end());
    throw std::invalid_argument(has + "the order asks for entry " + std::to_string(last));
  }
  const size_t count = use_ == ForeignUse::kVoltage ? 1 : static_cast<size_t>(count_);
  if (count == 0 && !is_padded_) return entries;
  if (entries.size() == count) return entries;
  const bool has_spare = entries.size() > count;
  if (has_spare && is_padded_ && count > 0) {
    NoteOnce(kPadded, has + "took the first " + std::to_string(count) +
                          " as the rotors in their order (an order of your own says otherwise)");
    entries.resize(count);
    return entries;
  }
  throw std::invalid_argument(
      has + (count == 0 ? "say which of them are rotors by an order, as 1,2,3,4"
             : use_ == ForeignUse::kVoltage
                 ? "choose one, as " + field_.text.substr(0, field_.text.find('[')) + "[0]"
                 : "the vehicle has " + std::to_string(count) + " rotors" +
                       (has_spare ? "; an order, as 1,2,3,4, says which they are" : "")));
}

double ForeignStream::ToUnit(double value) const {
  if (use_ != ForeignUse::kCommands) return scale_ * value;
  const CommandUnit unit = *CommandUnitNamed(unit_);
  if (unit == CommandUnit::kMicroseconds && value < kLeastPulse_us) return 0.0;
  return ThrottleOf(value, unit);
}

Stamp ForeignStream::StampOf(const std::uint8_t* data, size_t size, Stamp arrival) {
  if (stamp_) {
    const Stamp stamp = layout_.Stamps(*stamp_, data, size).front();
    is_arrival_ = stamp == 0;
    if (stamp != 0) return stamp;
    NoteOnce(kZeroStamp, layout_.type() +
                             ": headers without a stamp: took the time of arrival, which is late "
                             "by what the link takes");
    return arrival;
  }
  is_arrival_ = true;
  NoteOnce(kArrival, layout_.type() +
                         " has no stamp: took the time of arrival, which is late by what the link "
                         "takes");
  return arrival;
}

}  // namespace odmc

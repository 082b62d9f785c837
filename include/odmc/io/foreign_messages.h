#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/io/entry_stamps.h"
#include "odmc/io/message_layout.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Rotor speeds, commands and battery voltage in messages of other packages, read by their
/// definitions.

/// What the numbers of a message are read as.
enum class ForeignUse { kRotorSpeeds, kCommands, kVoltage };

/// What is known of a type by its name.
struct KnownMessage {
  ForeignUse use;
  const char* type;
  const char* md5;    ///< of the definition this was written from; empty: not known
  const char* field;  ///< path of the numbers
  const char* unit;   ///< rad_s, rpm; fraction, us, raw16; V; empty: the user has to say
  const char* entry_stamps = "";  ///< path of a stamp per entry; empty: one for the message
  /// There may be more entries than rotors (outputs of an autopilot); those are nobody's.
  bool is_padded = false;
  /// Taken only where the user names the topic: the type does not say what it holds.
  bool by_name_only = false;
};

const std::vector<KnownMessage>& KnownMessages();
/// Nothing if the type is not known for this use.
const KnownMessage* FindKnown(ForeignUse use, const std::string& type);

/// How the user wants the numbers of a stream read.
struct FieldOptions {
  std::string field;          ///< path as "esc_status[].rpm"; empty: that of the known type
  std::string unit = "auto";  ///< as in KnownMessage, and erpm; auto: that of the known type
  int pole_pairs = 7;         ///< for erpm
  /// Which entry, from 1, is rotor 1, 2, ...; empty: as they come.
  std::vector<int> order = {};
  /// Path of the stamp of each entry, or of all of them; empty: that of the known type, else
  /// header.stamp.
  std::string stamp_field = {};
  std::string stamp_unit = "auto";  ///< of a stamp that is a number: s, ms, us, ns
};

/// Factor that takes a stamp in `unit` to seconds; 0 for auto.
/// @throws std::invalid_argument for other units than auto, s, ms, us, ns
double StampScale(const std::string& unit);

/// Factor that takes a speed in `unit` (rad_s, rpm, erpm; auto counts as rad_s) to rad/s.
/// @throws std::invalid_argument for other units or pole pairs below 1
double RotorSpeedScale(const std::string& unit, int pole_pairs);

/// "2,4,1,3", in brackets or not, as [2, 4, 1, 3].
/// @throws std::invalid_argument unless these are the numbers of different entries, from 1
std::vector<int> ParseOrder(const std::string& text);

/// Entries of a message in the order of the vehicle's rotors.
/// @returns nothing if the message has too few
std::optional<std::vector<double>> EntriesInOrder(const std::vector<double>& entries,
                                                  const std::vector<int>& order);

/// Type of a message, as connections and bags describe it.
struct MessageDescription {
  std::string type, md5, definition;
};

/// Reads one topic of a foreign type. Stamps are header.stamp; where there is none, or it is zero,
/// the time of arrival. Where every entry has a stamp of its own, speeds are brought to one time
/// (EntryAligner). A stamp that is a number and no date (seconds since 1970, within a second of the
/// message) is of a clock of its own, laid on that of the messages (OwnClock). Thread-compatible.
class ForeignStream {
 public:
  /// @param count  of numbers wanted: rotors of the vehicle; 0: as many as there are
  /// @throws std::invalid_argument where the definition is none, has no such field, or neither the
  ///   type nor the options tell field and unit
  ForeignStream(ForeignUse use, const MessageDescription& message, const FieldOptions& options,
                int count);

  /// @param arrival  when the message came or was recorded
  /// @returns nothing for a message to be passed over: without entries yet, or with nothing new of
  ///   one of them
  /// @throws std::invalid_argument naming type and field where the bytes do not fit the definition,
  ///   or the number of entries does not fit the vehicle
  std::optional<ForeignReading> Read(const std::uint8_t* data, size_t size, Stamp arrival);

  /// Sentences for the user about what was read so far, each once.
  std::vector<std::string> TakeNotes();

  /// "esc_status[].rpm in rpm, header.stamp"
  std::string Describe() const;

  /// What the newest reading's stamp is: "header.stamp", "time of arrival", "esc_status[].timestamp
  /// [us], a clock of its own".
  std::string StampSource() const;

 private:
  void SettleStamp(const FieldOptions& options, const KnownMessage* known);
  std::vector<Stamp> EntryStamps(const std::uint8_t* data, size_t size, size_t entries,
                                 size_t values) const;
  Stamp OffsetOf(Stamp newest, const std::uint8_t* data, size_t size, Stamp arrival);
  void ChooseField(const FieldOptions& options, const MessageDescription& message);
  std::vector<double> Choose(std::vector<double> entries);
  double ToUnit(double value) const;
  Stamp StampOf(const std::uint8_t* data, size_t size, Stamp arrival);
  void NoteOnce(int kind, const std::string& sentence);

  ForeignUse use_;
  MessageLayout layout_;
  std::vector<int> order_;
  int count_;
  FieldPath field_;
  std::optional<FieldPath> stamp_, entry_stamps_;
  std::string unit_;
  double scale_ = 1.0;
  bool is_padded_ = false;
  double stamp_scale_ = 0.0;  // of entry_stamps_ to seconds; 0: times
  EntryAligner aligner_;
  OwnClock offset_;
  std::optional<bool> has_own_clock_;  // known from the first message on
  bool is_arrival_ = false;            // the message's own stamp, as of the newest reading
  std::vector<int> noted_;
  std::vector<std::string> notes_;
};

}  // namespace odmc

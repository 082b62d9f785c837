#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "decoding_damage.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// The text header of one blackbox log.
class BlackboxHeader {
 public:
  /// Reads the lines "H NAME:VALUE" at the start of `log`.
  /// @throws std::invalid_argument "FILE: ..." where there is no header, it is cut off, or the
  /// frames
  ///   it defines cannot be decoded
  BlackboxHeader(const std::string& file, std::string_view log);

  /// How one frame type codes its fields, by number as the header has them.
  struct Coding {
    std::vector<int> predictors, encodings;
  };

  const std::vector<std::string>& fields() const { return fields_; }  ///< of main frames
  bool is_signed(size_t field) const { return signed_[field]; }
  const Coding& intra() const { return intra_; }
  const Coding& inter() const { return inter_; }
  /// Encodings of the frames S, G and H; empty where the log has none.
  const std::vector<int>& OthersEncodings(char type) const;

  std::optional<size_t> FieldNamed(const std::string& name) const;
  /// The text of a line; empty where there is none.
  std::string Text(const std::string& name) const;
  /// Item `i` of a line of whole numbers, decimal or 0x...
  std::optional<std::int64_t> Number(const std::string& name, size_t i = 0) const;

  size_t bytes() const { return bytes_; }  ///< length of the header

 private:
  void ReadLines(std::string_view log);
  std::vector<int> Codes(const std::string& name, size_t count) const;

  std::string file_;
  std::map<std::string, std::string> lines_;
  std::vector<std::string> fields_;
  std::vector<bool> signed_;
  Coding intra_, inter_;
  std::map<char, std::vector<int>> others_;
  size_t bytes_ = 0;
};

/// Some fields of all main frames of a log, and how decoding went.
struct BlackboxFrames {
  std::vector<Stamp> stamps;                          ///< since the flight controller's start [ns]
  std::map<std::string, std::vector<double>> values;  ///< by field, one per stamp
  DecodingDamage damage;                              ///< bytes count from the log's first
};

/// Decodes the frames after the header. A damaged place costs the frames up to the next full one.
/// @param wanted fields to keep; those the log has not are left out
BlackboxFrames DecodeBlackbox(const BlackboxHeader& header, std::string_view log,
                              const std::vector<std::string>& wanted);

}  // namespace odmc

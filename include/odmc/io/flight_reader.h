#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "odmc/io/flight_csv.h"
#include "odmc/io/flight_read_options.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// One format of recorded flights.
struct FlightReader {
  std::string name;                  ///< for sentences, "a PX4 log (.ulg)"
  std::vector<std::string> endings;  ///< of files, in lower case, ".ulg"
  /// True if a file's first bytes (kHeadBytes at most) are of this format.
  std::function<bool(std::string_view head)> recognises;
  /// Endings that other programs' files share (".bin"): content must agree where folders are
  /// searched.
  bool shares_ending = false;
  /// @throws std::invalid_argument naming file and place
  std::function<FlightLog(const std::string& file, const FlightReadOptions& options)> read;
  /// A flight is a folder of several files: true if this one is. Null for formats of one file.
  std::function<bool(const std::string& folder)> is_folder = nullptr;
};

/// The formats a flight may have: found by the file's content, by its ending where the content is
/// none's, so that the reader of that ending says what is wrong.
class FlightReaders {
 public:
  static constexpr size_t kHeadBytes = 4096;  ///< that recognise a format

  /// The formats the core reads: CSV, NeuroBEM's CSV, Blackbird's folders, blackbox (.bfl, .bbl),
  /// PX4 (.ulg), ArduPilot (.bin).
  static FlightReaders Core();

  /// Adds a format; those added first are asked first.
  void Add(FlightReader reader) { readers_.push_back(std::move(reader)); }

  /// Null where no format fits.
  const FlightReader* Find(const std::string& file) const;

  /// True if a folder is itself a flight, not one that holds flights.
  bool IsFlightFolder(const std::string& folder) const;

  /// True if a folder's file is a flight: of a known ending (and content, where the ending is
  /// shared), and no companion of one (NAME_mocap.csv, NAME_rotor.csv;
  /// NAME_truth.csv of `simulate`).
  bool IsFlight(const std::string& file) const;

  /// True if a name has the ending of a format, whatever is behind it.
  bool HasEnding(const std::string& file) const;

  /// "a CSV file (.csv), a rosbag (.bag) or ..."
  std::string Names() const;

  /// @throws std::invalid_argument where no format fits, and what the format's reader throws
  FlightLog Read(const std::string& file, const FlightReadOptions& options) const;

 private:
  const FlightReader* OfEnding(const std::string& file) const;

  std::vector<FlightReader> readers_;
};

}  // namespace odmc

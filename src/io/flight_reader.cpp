#include "odmc/io/flight_reader.h"

#include <algorithm>
#include <cctype>
#include <filesystem>

#include "binary_file.h"
#include "csv_text.h"
#include "odmc/io/autopilot_logs.h"
#include "odmc/io/data_sets.h"
#include "odmc/io/flight_csv.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

std::string LowerEnding(const std::string& file) {
  std::string ending = std::filesystem::path(file).extension().string();
  for (char& c : ending) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return ending;
}

bool EndsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

bool IsCompanion(const std::string& file) {
  const std::string stem = std::filesystem::path(file).stem().string();
  return LowerEnding(file) == ".csv" &&
         (EndsWith(stem, "_mocap") || EndsWith(stem, "_rotor") || EndsWith(stem, "_truth"));
}

bool HasEnding(const FlightReader& reader, const std::string& ending) {
  return std::find(reader.endings.begin(), reader.endings.end(), ending) != reader.endings.end();
}

/// A header line with a column t and those of a position.
bool IsFlightCsv(std::string_view head) {
  head = WithoutMark(head);
  std::string_view line = head.substr(0, head.find('\n'));
  int found = 0;
  while (!line.empty()) {
    const std::string_view cell = Unquoted(NextCell(&line));
    if (cell == "t" || cell == "px" || cell == "qw") ++found;
  }
  return found == 3;
}

FlightReader CsvReader() {
  return {"a CSV file (.csv)",
          {".csv"},
          IsFlightCsv,
          false,
          [](const std::string& file, const FlightReadOptions& options) {
            return ReadFlightCsv(file, options);
          }};
}

}  // namespace

FlightReaders FlightReaders::Core() {
  FlightReaders readers;
  readers.Add(CsvReader());
  readers.Add({"a NeuroBEM flight (.csv)", {".csv"}, IsNeurobem, false, ReadNeurobem});
  readers.Add({"a Blackbird flight (folder)",
               {},
               [](std::string_view) { return false; },
               false,
               ReadBlackbird,
               IsBlackbirdFolder});
  readers.Add({"a blackbox log (.bfl, .bbl)", {".bfl", ".bbl"}, IsBlackbox, false, ReadBlackbox});
  readers.Add({"a PX4 log (.ulg)", {".ulg"}, IsULog, false, ReadULog});
  readers.Add({"an ArduPilot log (.bin)", {".bin"}, IsDataflash, true, ReadDataflash});
  return readers;
}

const FlightReader* FlightReaders::OfEnding(const std::string& file) const {
  const std::string ending = LowerEnding(file);
  for (const FlightReader& reader : readers_) {
    if (odmc::HasEnding(reader, ending)) return &reader;
  }
  return nullptr;
}

bool FlightReaders::HasEnding(const std::string& file) const { return OfEnding(file) != nullptr; }

bool FlightReaders::IsFlightFolder(const std::string& folder) const {
  std::error_code ignored;
  if (!std::filesystem::is_directory(folder, ignored)) return false;
  return std::any_of(readers_.begin(), readers_.end(), [&](const FlightReader& reader) {
    return reader.is_folder != nullptr && reader.is_folder(folder);
  });
}

const FlightReader* FlightReaders::Find(const std::string& file) const {
  std::error_code ignored;
  if (std::filesystem::is_directory(file, ignored)) {
    for (const FlightReader& reader : readers_) {
      if (reader.is_folder != nullptr && reader.is_folder(file)) return &reader;
    }
    return nullptr;
  }
  const std::string head = ReadHead(file, kHeadBytes);
  for (const FlightReader& reader : readers_) {
    if (!head.empty() && reader.recognises(head)) return &reader;
  }
  return OfEnding(file);
}

bool FlightReaders::IsFlight(const std::string& file) const {
  const FlightReader* reader = OfEnding(file);
  if (reader == nullptr || IsCompanion(file)) return false;
  return !reader->shares_ending || reader->recognises(ReadHead(file, kHeadBytes));
}

std::string FlightReaders::Names() const {
  std::string text;
  for (const FlightReader& reader : readers_) {
    const bool is_last = &reader == &readers_.back();
    text += (text.empty() ? "" : is_last ? " or " : ", ") + reader.name;
  }
  return text;
}

FlightLog FlightReaders::Read(const std::string& file, const FlightReadOptions& options) const {
  const FlightReader* reader = Find(file);
  if (reader == nullptr) {
    std::error_code ignored;
    const bool is_there = std::filesystem::exists(file, ignored);
    RefuseFile(file, std::string(is_there ? "" : "cannot be opened; ") + "a flight is " + Names());
  }
  return reader->read(file, options);
}

}  // namespace odmc

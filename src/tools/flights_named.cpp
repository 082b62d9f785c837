#include "flights_named.h"

#include <glob.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <set>
#include <stdexcept>
#include <utility>

#include "odmc/ros/flight_bag.h"

namespace odmc::tools {

namespace fs = std::filesystem;

namespace {

/// Numbers in names by their size.
bool NaturallyBefore(const std::string& a, const std::string& b) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      const auto skip = [&](const std::string& text, size_t at) {
        while (at < text.size() && text[at] == '0') ++at;
        return at;
      };
      const size_t i0 = skip(a, i), j0 = skip(b, j);
      for (i = i0; i < a.size() && is_digit(a[i]);) ++i;
      for (j = j0; j < b.size() && is_digit(b[j]);) ++j;
      if (i - i0 != j - j0) return i - i0 < j - j0;
      const int order = a.compare(i0, i - i0, b, j0, j - j0);
      if (order != 0) return order < 0;
    } else {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
    }
  }
  return a.size() - i < b.size() - j;
}

void AddFlights(const std::string& name, std::set<std::string>* seen,
                std::vector<std::string>* files) {
  const FlightReaders readers = AllFlightReaders({});
  std::vector<std::string> found;
  if (fs::is_directory(name) && !readers.IsFlightFolder(name)) {
    for (fs::recursive_directory_iterator it(name), end; it != end; ++it) {
      const bool is_flight =
          it->is_directory() ? readers.IsFlightFolder(it->path()) : readers.IsFlight(it->path());
      if (is_flight) found.push_back(it->path());
      if (is_flight && it->is_directory()) it.disable_recursion_pending();
    }
  } else if (fs::exists(name)) {
    found.push_back(name);
  } else if (name.find_first_of("*?[") != std::string::npos) {
    glob_t matches;
    if (glob(name.c_str(), 0, nullptr, &matches) == 0) {
      for (size_t i = 0; i < matches.gl_pathc; ++i) {
        if (readers.IsFlight(matches.gl_pathv[i])) found.push_back(matches.gl_pathv[i]);
      }
    }
    globfree(&matches);
  }
  const bool is_named_as_one =
      readers.HasEnding(name) || fs::path(name).extension().string() == ".json";
  if (found.empty() && is_named_as_one && !fs::is_directory(name)) {
    found.push_back(name);  // the reader says what is wrong with it
  }
  if (found.empty()) {
    throw std::invalid_argument(name + (fs::is_directory(name)
                                            ? ": holds no flight (" + readers.Names() + ")"
                                            : ": no such file, folder or pattern of flights"));
  }
  std::sort(found.begin(), found.end(), NaturallyBefore);
  for (std::string& file : found) {
    if (seen->insert(file).second) files->push_back(std::move(file));
  }
}

}  // namespace

std::vector<std::string> FlightsNamed(const std::vector<std::string>& names) {
  std::vector<std::string> files;
  std::set<std::string> seen;
  for (const std::string& name : names) {
    if (name.size() < 2 || name[0] != '@') {
      AddFlights(name, &seen, &files);
      continue;
    }
    std::ifstream list(name.substr(1));
    if (!list) throw std::invalid_argument(name.substr(1) + ": cannot be read");
    for (std::string line; std::getline(list, line);) {
      if (!line.empty()) AddFlights(line, &seen, &files);
    }
  }
  return files;
}

}  // namespace odmc::tools

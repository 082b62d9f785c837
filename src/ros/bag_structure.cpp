#include "bag_structure.h"

#include <cstring>
#include <fstream>
#include <map>
#include <set>
#include <stdexcept>
#include <string_view>

namespace odmc {
namespace {

constexpr char kMagic[] = "#ROSBAG V2.0\n";
constexpr std::uint32_t kLongestHeader = 1 << 20;  // fields of a record; definitions are data
// Nobody writes chunks of a gigabyte: a recorder closes one after 768 KB and its last message.
constexpr std::uint64_t kLargestChunk = 1 << 30;
// LZ4 spends one byte on at most 255; a little for what frames them.
constexpr std::uint64_t kLz4Ratio = 255, kLz4Frame = 1024;

enum Op : int { kIndex = 4, kFileHeader = 3, kChunk = 5, kChunkInfo = 6, kConnection = 7 };

/// Fields of one record's header, and where its data lie.
struct Record {
  std::uint64_t at = 0;
  std::map<std::string, std::string> fields;
  std::uint64_t data_at = 0;
  std::uint32_t data_bytes = 0;
};

/// The records of one file, read with all bounds checked.
class BagRecords {
 public:
  explicit BagRecords(const std::string& file) : file_(file), in_(file, std::ios::binary) {
    in_.seekg(0, std::ios::end);
    size_ = static_cast<std::uint64_t>(in_.tellg());
  }

  [[noreturn]] void Fail(std::uint64_t at, const std::string& what) const {
    throw std::invalid_argument(file_ + ": is damaged or truncated: " + what + " at byte " +
                                std::to_string(at));
  }

  std::string Bytes(std::uint64_t at, std::uint64_t count) {
    if (at > size_ || count > size_ - at) Fail(at, "the file ends within a record");
    std::string bytes(count, '\0');
    in_.seekg(static_cast<std::streamoff>(at));
    in_.read(bytes.data(), static_cast<std::streamsize>(count));
    if (!in_) Fail(at, "the file cannot be read");
    return bytes;
  }

  /// The record at `at`, which must be of kind `op`.
  Record At(std::uint64_t at, Op op) {
    Record record;
    record.at = at;
    const std::uint32_t length = Number32(Bytes(at, 4), 0);
    if (length > kLongestHeader) Fail(at, "a record's header of " + std::to_string(length) + " B");
    ReadFields(Bytes(at + 4, length), &record);
    record.data_bytes = Number32(Bytes(at + 4 + length, 4), 0);
    record.data_at = at + 8 + length;
    if (record.data_bytes > size_ - record.data_at) Fail(at, "a record reaches beyond the file");
    if (Value<std::uint8_t>(record, "op") != op) Fail(at, "another record than expected");
    return record;
  }

  template <typename Number>
  Number Value(const Record& record, const std::string& field) const {
    const auto found = record.fields.find(field);
    if (found == record.fields.end() || found->second.size() != sizeof(Number)) {
      Fail(record.at, "no field '" + field + "' in the record");
    }
    Number value;
    std::memcpy(&value, found->second.data(), sizeof value);
    return value;
  }

  static std::uint32_t Number32(const std::string& bytes, size_t at) {
    std::uint32_t value;
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return value;
  }

 private:
  void ReadFields(std::string_view header, Record* record) const {
    while (!header.empty()) {
      if (header.size() < 4) Fail(record->at, "a field that is cut off");
      std::uint32_t length;
      std::memcpy(&length, header.data(), sizeof length);
      header.remove_prefix(4);
      const size_t equals = header.substr(0, length).find('=');
      if (length > header.size() || equals == std::string_view::npos) {
        Fail(record->at, "a field that is none");
      }
      record->fields[std::string(header.substr(0, equals))] =
          header.substr(equals + 1, length - equals - 1);
      header.remove_prefix(length);
    }
  }

  std::string file_;
  std::ifstream in_;
  std::uint64_t size_ = 0;
};

/// Size of a chunk once it is unpacked, as far as its packed size allows that.
std::uint64_t UncompressedBytes(const BagRecords& bag, const Record& chunk) {
  const auto bytes = bag.Value<std::uint32_t>(chunk, "size");
  const auto compression = chunk.fields.find("compression");
  const std::string how = compression == chunk.fields.end() ? "" : compression->second;
  const bool is_sound = how == "none"  ? bytes == chunk.data_bytes
                        : how == "lz4" ? bytes <= kLz4Ratio * chunk.data_bytes + kLz4Frame
                                       : how == "bz2";
  if (!is_sound || bytes > kLargestChunk) bag.Fail(chunk.at, "a chunk's header is wrong");
  return bytes;
}

/// One index of a chunk: where the messages of one connection begin.
void CheckIndex(BagRecords* bag, const Record& index, std::uint64_t chunk_bytes,
                const std::map<std::uint32_t, std::uint32_t>& counts) {
  constexpr std::uint32_t kEntryBytes = 12;  // time and offset
  const auto promised = counts.find(bag->Value<std::uint32_t>(index, "conn"));
  const auto count = bag->Value<std::uint32_t>(index, "count");
  if (promised == counts.end() || promised->second != count ||
      index.data_bytes != std::uint64_t{kEntryBytes} * count) {
    bag->Fail(index.at, "a chunk's index disagrees with the list of chunks");
  }
  const std::string entries = bag->Bytes(index.data_at, index.data_bytes);
  for (size_t at = 0; at < entries.size(); at += kEntryBytes) {
    const std::uint32_t seconds = BagRecords::Number32(entries, at);
    const std::uint32_t nanoseconds = BagRecords::Number32(entries, at + 4);
    // The library leaves out messages with another time.
    if (nanoseconds >= 1000000000 || (seconds == 0 && nanoseconds == 0)) {
      bag->Fail(index.at, "an index with a time that is none");
    }
    if (BagRecords::Number32(entries, at + 8) >= chunk_bytes) {
      bag->Fail(index.at, "an index points beyond its chunk");
    }
  }
}

/// Messages of each connection in one chunk, as the list of chunks at the end has them.
std::map<std::uint32_t, std::uint32_t> MessageCounts(BagRecords* bag, const Record& info,
                                                     const std::set<std::uint32_t>& connections) {
  const auto count = bag->Value<std::uint32_t>(info, "count");
  if (info.data_bytes != std::uint64_t{8} * count) bag->Fail(info.at, "a list of another length");
  const std::string pairs = bag->Bytes(info.data_at, info.data_bytes);
  std::map<std::uint32_t, std::uint32_t> counts;
  for (size_t at = 0; at < pairs.size(); at += 8) {
    const std::uint32_t connection = BagRecords::Number32(pairs, at);
    if (connections.count(connection) == 0) bag->Fail(info.at, "an unknown connection");
    counts[connection] = BagRecords::Number32(pairs, at + 4);
  }
  return counts;
}

/// One chunk with its indices. @returns its size once it is unpacked
std::uint64_t CheckChunk(BagRecords* bag, const Record& info,
                         const std::set<std::uint32_t>& connections) {
  const auto counts = MessageCounts(bag, info, connections);
  const Record chunk = bag->At(bag->Value<std::uint64_t>(info, "chunk_pos"), kChunk);
  const std::uint64_t bytes = UncompressedBytes(*bag, chunk);
  std::uint64_t at = chunk.data_at + chunk.data_bytes;
  std::set<std::uint32_t> indexed;
  for (size_t i = 0; i < counts.size(); ++i) {
    const Record index = bag->At(at, kIndex);
    CheckIndex(bag, index, bytes, counts);
    if (!indexed.insert(bag->Value<std::uint32_t>(index, "conn")).second) {
      bag->Fail(index.at, "a second index of one connection");
    }
    at = index.data_at + index.data_bytes;
  }
  return bytes;
}

}  // namespace

BagStructure CheckBagStructure(const std::string& file) {
  constexpr size_t kMagicBytes = sizeof kMagic - 1;
  BagStructure structure;
  BagRecords bag(file);
  if (bag.Bytes(0, kMagicBytes) != kMagic) return structure;
  const Record header = bag.At(kMagicBytes, kFileHeader);
  std::uint64_t at = bag.Value<std::uint64_t>(header, "index_pos");
  if (at == 0) return structure;
  std::set<std::uint32_t> connections;
  for (auto left = bag.Value<std::uint32_t>(header, "conn_count"); left > 0; --left) {
    const Record connection = bag.At(at, kConnection);
    connections.insert(bag.Value<std::uint32_t>(connection, "conn"));
    at = connection.data_at + connection.data_bytes;
  }
  for (auto left = bag.Value<std::uint32_t>(header, "chunk_count"); left > 0; --left) {
    const Record info = bag.At(at, kChunkInfo);
    structure.uncompressed_bytes += CheckChunk(&bag, info, connections);
    at = info.data_at + info.data_bytes;
  }
  return structure;
}

}  // namespace odmc

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>

#include "odmc/io/bench_csv.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;
using testing_support::ErrorOf;

const char kHeader[] = "t,px,py,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3,rotor4";

std::string RowAt(const std::string& t) { return "\n" + t + ",1,2,3,1,0,0,0,1000,1001,1002,1003"; }

std::string Rows(int count) {
  std::string text;
  for (int i = 0; i < count; ++i) text += RowAt(std::to_string(0.01 * i));
  return text;
}

/// "a,a,...": `count` columns with a comma between them.
std::string Columns(int count, const std::string& cell) {
  std::string text = cell;
  for (int i = 1; i < count; ++i) text += "," + cell;
  return text;
}

class HostileTexts : public ::testing::Test {
 protected:
  std::string Write(const std::string& text) const { return folder_.Write("f.csv", text); }
  FlightLog Read(const std::string& text) const {
    return ReadFlightCsv(Write(text), 4, PoseSource::kEkf);
  }

  testing_support::TemporaryFolder folder_;
};

TEST_F(HostileTexts, ColumnsAndLinesHaveALimit) {
  ODMC_EXPECT_ERROR(Read("t," + Columns(1000, "") + "\n"), "line 1: 1001 columns; at most 1000");
  ODMC_EXPECT_ERROR(Read("t," + Columns(1000000, "column")), "line 1 has more than 1 MB");
  ODMC_EXPECT_ERROR(Read(kHeader + Rows(3) + "\n" + std::string(5000000, '1')),
                    "line 5 has more than 1 MB");
  ODMC_EXPECT_ERROR(ReadBenchCsv(Write("t," + Columns(1000, "")), {}), "1001 columns");
}

// A block of the reader ends somewhere in a line.
TEST_F(HostileTexts, LongFilesAreReadWhole) {
  const int rows = 40000;  // 2 MB
  const FlightLog log = Read(kHeader + Rows(rows));
  EXPECT_EQ(log.odometry.size(), static_cast<size_t>(rows));
  EXPECT_EQ(log.odometry.back().stamp, (rows - 1) * Stamp{10000000});
  EXPECT_EQ(log.dropped, 0);
}

TEST_F(HostileTexts, WhatIsNoTextIsRefused) {
  ODMC_EXPECT_ERROR(Read(kHeader + Rows(3) + std::string(1, '\0') + Rows(3)), "zero bytes");
  std::string utf16 = "\xff\xfe";
  for (const char c : kHeader + Rows(3)) utf16 += {c, '\0'};
  ODMC_EXPECT_ERROR(Read(utf16), "f.csv: holds zero bytes and is no text; a text in UTF-16");
  ODMC_EXPECT_ERROR(LoadVehicle(folder_.Write("v.yaml", std::string("a: \0", 4))), "zero bytes");
}

TEST_F(HostileTexts, OnlyRegularFilesAreOpened) {
  const std::string pipe = folder_.File("f.csv");
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  for (const std::string& file : {pipe, std::string("/dev/zero")}) {
    ODMC_EXPECT_ERROR(ReadFlightCsv(file, 4, PoseSource::kEkf), file + ": is no regular file");
    ODMC_EXPECT_ERROR(LoadVehicle(file), file + ": is no regular file");
    ODMC_EXPECT_ERROR(LoadParameters(file), file + ": is no regular file");
    ODMC_EXPECT_ERROR(ReadBenchCsv(file, {}), file + ": is no regular file");
  }
  ODMC_EXPECT_ERROR(ReadFlightCsv("/tmp", 4, PoseSource::kEkf), "/tmp: is a folder");
  folder_.Write("g.csv", kHeader + Rows(3));
  ASSERT_EQ(mkfifo(folder_.File("g_rotor.csv").c_str(), 0600), 0);
  ODMC_EXPECT_ERROR(ReadFlightCsv(folder_.File("g.csv"), 4, PoseSource::kEkf),
                    "g_rotor.csv: is no regular file");
}

TEST_F(HostileTexts, SettingsHaveALimit) {
  const std::string file = folder_.Write("v.yaml", "# " + std::string(3 << 20, 'x'));
  ODMC_EXPECT_ERROR(LoadVehicle(file), "v.yaml: is too long; a file of settings has at most 2 MB");
}

TEST_F(HostileTexts, NestingAndAliasesEndInASentence) {
  std::string bomb = "a: &a [x, x, x, x, x, x, x, x]\n";
  for (char c = 'b'; c < 'm'; ++c) {
    const std::string before(1, static_cast<char>(c - 1));
    bomb += std::string(1, c) + ": &" + c + " [" + Columns(8, "*" + before) + "]\n";
  }
  ODMC_EXPECT_ERROR(ParseVehicle(bomb, "v.yaml"), "v.yaml: a: unknown key 'a'");
  ODMC_EXPECT_ERROR(ParseVehicle("effects: " + std::string(100000, '['), "v.yaml"), "not YAML");
  std::string deep = "name:\n";
  for (int i = 0; i < 100000; ++i) deep += "- ";
  ODMC_EXPECT_ERROR(ParseVehicle(deep, "v.yaml"), "not YAML");
}

// Nothing of it reaches a terminal as it is, whether it is an error or a warning.
TEST_F(HostileTexts, EscapeSequencesAreShown) {
  const FlightLog log = Read(std::string(kHeader) + ",\x1b[2Jevil" + RowAt("0") + ",1");
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_TRUE(Contains(log.warnings[0], "unknown columns ignored: \\x1b[2Jevil"));
  for (const std::string& error :
       {ErrorOf([&] { Read("\x1b[2Jevil,px\n1,2\n"); }),
        ErrorOf([&] { Read(kHeader + RowAt("\x1b[2Jevil")); }),
        ErrorOf([] { ParseVehicle("\"\\e[2Jevil\": 1\n", "v.yaml"); }),
        ErrorOf([] { ParseVehicle("mass_kg: \"\\e[2Jevil\"\n", "v.yaml"); })}) {
    EXPECT_TRUE(Contains(error, "\\x1b[2Jevil")) << error;
    EXPECT_EQ(error.find('\x1b'), std::string::npos);
  }
}

TEST_F(HostileTexts, LongListsOfNamesAreCut) {
  std::string header = "px";
  for (int i = 0; i < 500; ++i) header += ",column" + std::to_string(i);
  const std::string error = ErrorOf([&] { Read(header + "\n"); });
  EXPECT_TRUE(Contains(error, "column t is missing")) << error;
  EXPECT_TRUE(Contains(error, "and 461 more")) << error;
}

TEST_F(HostileTexts, OneStampThatLeapsIsLeftOut) {
  for (const std::string wrong : {"1e9", "1000000000", "5"}) {
    const FlightLog log = Read(kHeader + RowAt("0") + RowAt("0.01") + RowAt(wrong) + RowAt("0.02") +
                               RowAt("0.03") + RowAt("0.04"));
    EXPECT_EQ(log.odometry.size(), 5u);
    EXPECT_EQ(log.odometry.back().stamp, 40000000);
    ASSERT_EQ(log.warnings.size(), 1u);
    EXPECT_TRUE(Contains(log.warnings[0],
                         "dropped 1 rows whose t leaps ahead of all after it "
                         "(first: line 4"))
        << log.warnings[0];
  }
  EXPECT_EQ(Read(kHeader + RowAt("1e9") + Rows(5)).odometry.size(), 5u);
}

TEST_F(HostileTexts, ALateRowIsStillTheOneThatIsDropped) {
  const FlightLog log = Read(kHeader + RowAt("0") + RowAt("0.02") + RowAt("0.01") + RowAt("0.03"));
  EXPECT_EQ(log.odometry.size(), 3u);
  EXPECT_EQ(log.odometry[1].stamp, 20000000);
}

TEST_F(HostileTexts, StampsThatAreNoTimesAreNamed) {
  std::string rows = RowAt("0");
  for (int i = 1; i < 5; ++i) rows += RowAt(std::to_string(i) + "e300");
  ODMC_EXPECT_ERROR(Read(kHeader + rows), "column t is no time in 4 of 5 rows (first: line 3)");
}

}  // namespace
}  // namespace odmc

#include <gtest/gtest.h>

#include "odmc/io/flight_reader.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

constexpr char kCsv[] =
    "t,px,py,pz,qw,qx,qy,qz,rotor1,rotor2,rotor3,rotor4\n"
    "0.0,0,0,1,1,0,0,0,500,500,500,500\n0.01,0,0,1,1,0,0,0,500,500,500,500\n";
constexpr char kBlackbox[] = "H Product:Blackbox flight data recorder by Nicholas Sherlock\n";

class FlightReaderRegistry : public ::testing::Test {
 protected:
  std::string Found(const std::string& name, const std::string& text) const {
    const FlightReader* reader = readers_.Find(folder_.Write(name, text));
    return reader == nullptr ? "" : reader->name;
  }
  testing_support::TemporaryFolder folder_;
  FlightReaders readers_ = FlightReaders::Core();
};

TEST_F(FlightReaderRegistry, ContentTellsTheFormatWhateverTheName) {
  EXPECT_EQ(Found("flight.txt", kCsv), "a CSV file (.csv)");
  EXPECT_EQ(Found("flight.csv", kBlackbox), "a blackbox log (.bfl, .bbl)");
  EXPECT_EQ(Found("flight", kBlackbox), "a blackbox log (.bfl, .bbl)");
  EXPECT_EQ(readers_.Read(folder_.Write("flight.dat", kCsv), {}).odometry.size(), 2u);
}

TEST_F(FlightReaderRegistry, EndingTellsWhereContentIsNothing) {
  EXPECT_EQ(Found("LOG1.BFL", "something"), "a blackbox log (.bfl, .bbl)");
  ODMC_EXPECT_ERROR(readers_.Read(folder_.File("LOG1.BFL"), {}), "is no blackbox log");
  EXPECT_EQ(Found("x.csv", ""), "a CSV file (.csv)");
  EXPECT_EQ(Found("notes.txt", "nothing of ours"), "");
  ODMC_EXPECT_ERROR(readers_.Read(folder_.File("notes.txt"), {}),
                    "notes.txt: a flight is a CSV file (.csv)");
}

TEST_F(FlightReaderRegistry, CompanionsAreNoFlights) {
  EXPECT_TRUE(readers_.IsFlight(folder_.Write("a.csv", kCsv)));
  EXPECT_FALSE(readers_.IsFlight(folder_.Write("a_mocap.csv", kCsv)));
  EXPECT_FALSE(readers_.IsFlight(folder_.Write("a_rotor.csv", kCsv)));
  EXPECT_FALSE(readers_.IsFlight(folder_.Write("a_truth.csv", kCsv)));
  EXPECT_FALSE(readers_.IsFlight(folder_.Write("a.yaml", "x: 1")));
}

}  // namespace
}  // namespace odmc

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

TEST_F(FlightReaderRegistry, DataSetsAreToldByTheirColumnsAndFiles) {
  constexpr char kHeader[] = "t,ang vel x,quat x,quat w,vel x,pos x,mot 1\n";
  EXPECT_EQ(Found("neurobem.csv", kHeader), "a NeuroBEM flight (.csv)");
  EXPECT_EQ(Found("one_lost.csv", "t,ang vel x,quat x,vel x,mot 1\n"), "a NeuroBEM flight (.csv)");
  EXPECT_FALSE(readers_.IsFlightFolder(folder_.File("")));
  EXPECT_EQ(readers_.Find(folder_.File("")), nullptr);
  folder_.Write("blackbird_slash_rotor_rpm.csv", "rosbagTimestamp,header\n");
  EXPECT_TRUE(readers_.IsFlightFolder(folder_.File("")));
  ASSERT_NE(readers_.Find(folder_.File("")), nullptr);
  EXPECT_EQ(readers_.Find(folder_.File(""))->name, "a Blackbird flight (folder)");
  ODMC_EXPECT_ERROR(readers_.Read(folder_.File(""), {}), "groundTruthPoses.csv");
}

TEST_F(FlightReaderRegistry, PartOfACsvFile) {
  const std::string poses =
      folder_.Write("poses.csv", "t,px,py,pz,qw,qx,qy,qz,other\n0,0,0,1,1,0,0,0,7\n");
  FlightReadOptions options;
  ODMC_EXPECT_ERROR(readers_.Read(poses, options), "rotor1");
  options.part = FlightPart::kPoses;
  EXPECT_EQ(readers_.Read(poses, options).odometry.size(), 1u);
  EXPECT_TRUE(readers_.Read(poses, options).warnings.empty());
  const std::string onboard =
      folder_.Write("onboard.csv", "t,gx,gy,gz,rotor1,rotor2,rotor3,rotor4\n0,0,0,1,5,5,5,5\n");
  ODMC_EXPECT_ERROR(readers_.Read(onboard, options), "px, py, pz");
  options.part = FlightPart::kOnboard;
  const FlightLog log = readers_.Read(onboard, options);
  EXPECT_TRUE(log.odometry.empty());
  EXPECT_EQ(log.imu.size(), 1u);
  EXPECT_EQ(log.rotors.size(), 1u);
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

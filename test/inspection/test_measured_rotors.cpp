#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <numeric>

#include "odmc/inspection/rotor_assignment.h"
#include "odmc/inspection/rotor_inspection.h"
#include "odmc/inspection/rotor_scale.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sensing/plausible.h"
#include "support/recorded_data.h"
#include "support/rotor_frames.h"

namespace odmc {
namespace test {
namespace {

struct Recording {
  const char* file;
  const char* vehicle;  ///< of this package, or a file beside the data
};

constexpr Recording kRecordings[] = {
    {"neurobem/test1_first18s.csv", "neurobem"},
    {"neurobem_fast/racetrack_2.csv", "neurobem_fast/vehicle.yaml"},
    {"polyu_quad13/flight_2024-02-21_first70.csv", "polyu_quad13"},
    {"imrc_cf21_brushless/eckart00.csv", "imrc_cf21_brushless"},
    {"imrc_cf21_brushless/eckart35.csv", "imrc_cf21_brushless"},
    {"imrc_cf21_brushed/jana04.csv", "imrc_cf21_brushed"},
    {"imrc_cf21_payload/eckart13.csv", "imrc_cf21_payload"},
    {"indiflight/LOG00267.csv", "indiflight/vehicle.yaml"},
    {"indiflight/full/LOG00230.csv", "indiflight/vehicle.yaml"},
    {"nanodrone/random1_run4.csv", "nanodrone/vehicle.yaml"},
};

Vehicle VehicleOf(const Recording& recording) {
  const std::string name = recording.vehicle;
  return LoadVehicle(name.find('/') == std::string::npos
                         ? std::string(ODMC_SOURCE_DIR) + "/config/vehicles/" + name + ".yaml"
                         : RecordedFile(name));
}

FlightLog LogOf(const std::string& file, double late_s) {
  FlightLog log = ReadFlightCsv(file, 4, PoseSource::kEkf);
  MendFlight(&log);
  for (RotorSample& sample : log.rotors) sample.stamp += FromSeconds(late_s);
  return log;
}

/// What became of one spoiled file after another.
struct Count {
  int named = 0, unsure = 0, missed = 0, wrong = 0;

  void Add(bool doubts, bool names, bool right) {
    if (!doubts) {
      ++missed;
    } else if (!names) {
      ++unsure;
    } else {
      ++(right ? named : wrong);
    }
  }
};

/// All 23 wrong orders: missed ones are "cannot tell".
Count TryOrders(const RotorResponse& response, const Vehicle& truth) {
  Count count;
  std::vector<int> order = {0, 1, 2, 3};
  while (std::next_permutation(order.begin(), order.end())) {
    const Vehicle spoiled = Reordered(truth, order);
    const RotorAssignment found = TestRotorAssignment(response, spoiled);
    bool right = true;
    for (size_t j = 0; j < 4; ++j) {
      const auto place = static_cast<size_t>(found.order[j]);
      right = right && spoiled.rotors[place].p_BP == truth.rotors[j].p_BP;
    }
    count.Add(found.places.Doubts(), found.places.Names(), right);
  }
  return count;
}

/// All 15 wrong patterns of spins.
Count TrySpins(const RotorResponse& response, const Vehicle& truth) {
  Count count;
  for (unsigned pattern = 0; pattern < 16; ++pattern) {
    const Vehicle spoiled = Respun(truth, pattern);
    bool same = true, right = true;
    for (size_t j = 0; j < 4; ++j) same = same && spoiled.rotors[j].spin == truth.rotors[j].spin;
    if (same) continue;
    const RotorAssignment found = TestRotorAssignment(response, spoiled);
    for (size_t j = 0; j < 4; ++j) right = right && found.spin[j] == truth.rotors[j].spin;
    count.Add(found.spins.Doubts(), found.spins.Names(), right);
  }
  return count;
}

// The table: of 23 wrong orders and 15 wrong patterns of spins, how many are refuted and the right
// one named, refuted without a name, not refuted ("cannot tell"), or named wrongly.
TEST(MeasuredRotors, OrdersAndSpinsAreNamedOrCannotBeTold) {
  if (RecordedFile(kRecordings[0].file).empty()) GTEST_SKIP() << "no recorded flights";
  int orders = 0, named = 0;
  std::printf("%-46s %6s  orders named unsure missed wrong  spins named unsure missed wrong\n",
              "recording", "late");
  for (const Recording& recording : kRecordings) {
    for (const double late_s : {0.0, -0.1, 0.06}) {
      const Vehicle truth = VehicleOf(recording);
      const FlightLog log = LogOf(RecordedFile(recording.file), late_s);
      const RotorResponse response = MeasureRotorResponse(CutRotorBlocks(log, truth), truth);
      const Count order = TryOrders(response, truth), spin = TrySpins(response, truth);
      std::printf("%-46s %3.0f ms %13d %6d %6d %5d %12d %6d %6d %5d\n", recording.file,
                  1e3 * late_s, order.named, order.unsure, order.missed, order.wrong, spin.named,
                  spin.unsure, spin.missed, spin.wrong);
      EXPECT_EQ(order.wrong + spin.wrong, 0) << recording.file;
      EXPECT_FALSE(TestRotorAssignment(response, truth).places.Doubts()) << recording.file;
      EXPECT_FALSE(TestRotorAssignment(response, truth).spins.Doubts()) << recording.file;
      orders += 23;
      named += order.named;
    }
  }
  EXPECT_GE(named, 0.95 * orders);
}

TEST(MeasuredRotors, SoundRecordingsGetNoFinding) {
  if (RecordedFile(kRecordings[0].file).empty()) GTEST_SKIP() << "no recorded flights";
  for (const Recording& recording : kRecordings) {
    const std::vector<Finding> findings =
        InspectRotors(LogOf(RecordedFile(recording.file), 0.0), VehicleOf(recording)).findings;
    EXPECT_TRUE(findings.empty()) << recording.file << ": " << Sentence(findings[0]);
  }
}

// A reading 20 % off is found on nine of ten, and never blamed on another rotor.
TEST(MeasuredRotors, OneRotorThatReadsWrongIsNamed) {
  if (RecordedFile(kRecordings[0].file).empty()) GTEST_SKIP() << "no recorded flights";
  int all = 0, named = 0, wrong = 0;
  for (const Recording& recording : kRecordings) {
    const Vehicle vehicle = VehicleOf(recording);
    const RotorBlocks blocks = CutRotorBlocks(LogOf(RecordedFile(recording.file), 0.0), vehicle);
    for (int rotor = 0; rotor < 4; ++rotor) {
      for (const double factor : {0.8, 1.2}) {
        RotorBlocks spoiled = blocks;
        for (RotorBlock& block : spoiled.blocks) {
          block.squared.col(rotor) *= factor * factor;
          block.spin_up.col(rotor) *= factor;
          block.mean_squared[rotor] *= factor * factor;
        }
        const RotorScale found = FindRotorScale(MeasureRotorResponse(spoiled, vehicle), vehicle);
        ++all;
        const bool finding = !ScaleFindings(found, vehicle).empty();
        if (finding && found.rotor == rotor) ++named;
        if (finding && found.rotor != rotor && found.or_rotor != rotor) ++wrong;
      }
    }
  }
  EXPECT_GE(named, 0.9 * all);
  EXPECT_LE(wrong, 0.02 * all);
}

TEST(MeasuredRotors, KnownBadSensorsAreNamed) {
  const std::string half = RecordedFile("imrc_cf21_payload_badsensor/eckart52.csv");
  const std::string dead = RecordedFile("imrc_cf21_brushed_badsensor/jana23.csv");
  if (half.empty() || dead.empty()) GTEST_SKIP() << "no recorded flights";
  const Vehicle payload = VehicleOf({"", "imrc_cf21_payload_badsensor"});
  const std::vector<Finding> halved = InspectRotors(LogOf(half, 0.0), payload).findings;
  ASSERT_EQ(halved.size(), 1u);
  EXPECT_EQ(halved[0].what.rfind("rotor3 reads", 0), 0u) << halved[0].what;
  const Vehicle brushed = VehicleOf({"", "imrc_cf21_brushed_badsensor"});
  const std::vector<Finding> gone = InspectRotors(LogOf(dead, 0.0), brushed).findings;
  ASSERT_EQ(gone.size(), 1u);
  EXPECT_EQ(gone[0].what.rfind("rotor1 reads almost zero", 0), 0u) << gone[0].what;
}

}  // namespace
}  // namespace test
}  // namespace odmc

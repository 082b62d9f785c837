#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "odmc/inspection/vehicle_fit.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/flight_reader.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/frame_layout.h"
#include "odmc/sensing/plausible.h"
#include "support/recorded_data.h"

namespace odmc {
namespace test {
namespace {

struct Recording {
  const char* file;
  const char* vehicle;  ///< of this package, or a file beside the data
  bool tells_spins;     ///< with the flight alone
};

constexpr Recording kRecordings[] = {
    {"neurobem/test1_first18s.csv", "neurobem", true},
    {"neurobem_fast/figure8_1.csv", "neurobem_fast/vehicle.yaml", true},
    {"neurobem_fast/racetrack_2.csv", "neurobem_fast/vehicle.yaml", true},
    {"indiflight/LOG00267.csv", "indiflight/vehicle.yaml", true},
    {"indiflight/raw/LOG00267.BFL", "indiflight/vehicle.yaml", true},
    {"imrc_cf21_brushless/eckart00.csv", "imrc_cf21_brushless", true},
    {"imrc_cf21_brushed/jana04.csv", "imrc_cf21_brushed", true},
    {"nanodrone/random1_run4.csv", "nanodrone/vehicle.yaml", true},
    {"polyu_quad13/flight_2024-02-21_first70.csv", "polyu_quad13", false},
};

Vehicle VehicleOf(const Recording& recording) {
  const std::string name = recording.vehicle;
  return LoadVehicle(name.find('/') == std::string::npos
                         ? std::string(ODMC_SOURCE_DIR) + "/config/vehicles/" + name + ".yaml"
                         : RecordedFile(name));
}

/// What is known before a flight: mass and frame.
Vehicle Nominal(double mass_kg) {
  Vehicle vehicle;
  vehicle.mass_kg = mass_kg;
  const double half_m = 0.09 * std::cbrt(mass_kg);
  vehicle.rotors = RotorsAt(FrameLayout("quad_x", Autopilot::kPx4), half_m, half_m, 0.7 * half_m);
  const double about_x = 0.44 * mass_kg * half_m * half_m;
  vehicle.inertia_kg_m2 = {about_x, about_x, 1.7 * about_x};
  return vehicle;
}

// With nothing but the mass: orders are told, and they and the spins are right; those of the one
// flight that hardly yaws are called a guess.
TEST(MeasuredVehicleFit, FindsTheRotorsOfRecordedFlights) {
  if (RecordedFile(kRecordings[0].file).empty()) GTEST_SKIP() << "no recorded flights";
  for (const Recording& recording : kRecordings) {
    const Vehicle truth = VehicleOf(recording), nominal = Nominal(truth.mass_kg);
    FlightReadOptions options;
    FlightLog log = FlightReaders::Core().Read(RecordedFile(recording.file), options);
    MendFlight(&log);
    const VehicleFit fit = FitVehicle(log, nominal);
    ASSERT_TRUE(fit.rotors_tested) << recording.file;
    EXPECT_TRUE(fit.order_choice.is_told) << recording.file;
    for (size_t j = 0; j < 4; ++j) {
      const Eigen::Vector3d& is = nominal.rotors[static_cast<size_t>(fit.order[j])].p_BP;
      EXPECT_GT(is.x() * truth.rotors[j].p_BP.x(), 0.0) << recording.file << j;
      EXPECT_GT(is.y() * truth.rotors[j].p_BP.y(), 0.0) << recording.file << j;
      EXPECT_EQ(fit.spin[j], truth.rotors[j].spin) << recording.file << j;
    }
    EXPECT_TRUE(fit.spins_are_usual) << recording.file;
    EXPECT_EQ(fit.spin_choice.is_told, recording.tells_spins) << recording.file;
    std::printf("%-46s order %6.1f nats, spins %6.2f nats%s\n", recording.file,
                fit.order_choice.lead_nats, fit.spin_choice.lead_nats,
                fit.spin_choice.is_told ? "" : " (not told)");
  }
}

TEST(MeasuredVehicleFit, OnlyPolyusPoseLeans) {
  if (RecordedFile(kRecordings[0].file).empty()) GTEST_SKIP() << "no recorded flights";
  for (const Recording& recording : kRecordings) {
    const Vehicle nominal = Nominal(VehicleOf(recording).mass_kg);
    FlightLog log = FlightReaders::Core().Read(RecordedFile(recording.file), FlightReadOptions());
    MendFlight(&log);
    const VehicleFit fit = FitVehicle(log, nominal);
    const bool leans = std::string(recording.file).find("polyu") != std::string::npos;
    EXPECT_EQ(fit.leans, leans) << recording.file;
    if (leans) {  // the README's axis
      EXPECT_LT((fit.balance->thrust_axis_S - Eigen::Vector3d(0.161, 0.042, 0.986)).norm(), 0.01);
    }
  }
}

// k_f as the data sets' own READMEs and files have it.
TEST(MeasuredVehicleFit, ThrustIsWhatIsPublished) {
  struct Published {
    const char* file;
    double mass_kg, k_f;
  };
  for (const Published& set :
       {Published{"imrc_cf21_brushless/eckart00.csv", 0.037, 3.70e-8},
        Published{"indiflight/LOG00267.csv", 0.428, 2.66e-7},
        Published{"polyu_quad13/flight_2024-02-21_first70.csv", 0.949, 1.248e-6}}) {
    const std::string file = RecordedFile(set.file);
    if (file.empty()) GTEST_SKIP() << "no recorded flights";
    FlightLog log = ReadFlightCsv(file, 4, PoseSource::kEkf);
    MendFlight(&log);
    const VehicleFit fit = FitVehicle(log, Nominal(set.mass_kg));
    ASSERT_TRUE(fit.balance.has_value()) << set.file;
    EXPECT_NEAR(set.mass_kg * fit.balance->k_f_over_mass / set.k_f, 1.0, 0.03) << set.file;
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc

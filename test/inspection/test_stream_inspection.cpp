#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <random>

#include "odmc/inspection/stream_inspection.h"
#include "odmc/io/flight_csv.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/sensing/plausible.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/recorded_data.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using Spoil = std::function<void(FlightLog*)>;

Vehicle TestVehicle() {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.odometry = {};
  vehicle.imu = SensorMount{};
  return vehicle;
}

/// A simulated flight with an IMU.
FlightLog Fly(const std::string& trajectory, int seed, double rate_noise_rad_s = 0.002) {
  const Vehicle vehicle = TestVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.seed = seed;
  options.duration_s = 20.0;
  options.log_rate_hz = 250.0;
  SimulationNoise noise;
  noise.imu = true;
  noise.gyro_noise_density = 3e-4;
  noise.accelerometer_noise_density = 3e-3;
  noise.rate_rad_s = rate_noise_rad_s;
  noise.position_m = 0.002;
  noise.attitude_rad = 0.001;
  noise.rotor_speed_rad_s = 1.0;
  return Simulate(model, model.InitialValues(), options, noise).log;
}

const FlightLog& Octo() {
  static const FlightLog kLog = Fly("octo", 1);
  return kLog;
}

std::string Checks(const StreamInspection& inspection) {
  std::string text;
  for (const Finding& finding : inspection.findings) {
    text += finding.check + ": " + finding.what + "\n";
  }
  return text;
}

const TimeOffset* Find(const StreamInspection& inspection, const std::string& stream) {
  for (const TimeOffset& offset : inspection.offsets) {
    if (offset.stream == stream) return &offset;
  }
  return nullptr;
}

StreamInspection Spoiled(const Spoil& spoil) {
  FlightLog log = Octo();
  spoil(&log);
  return InspectStreams(log, TestVehicle());
}

/// Expects one finding of this check whose sentence has this text.
void ExpectNamed(const StreamInspection& inspection, const std::string& check,
                 const std::string& text) {
  for (const Finding& finding : inspection.findings) {
    if (finding.check == check && Sentence(finding).find(text) != std::string::npos) return;
  }
  ADD_FAILURE() << "no finding '" << check << "' with '" << text << "' among:\n"
                << Checks(inspection);
}

void ForPoses(FlightLog* log, const std::function<void(OdometrySample*)>& change) {
  for (OdometrySample& sample : log->odometry) change(&sample);
}

TEST(StreamInspection, SaysNothingAboutSoundFlights) {
  for (const char* trajectory : {"octo", "lemniscate", "vertical", "yaw", "hover", "aggressive"}) {
    const StreamInspection inspection = InspectStreams(Fly(trajectory, 2, 0.01), TestVehicle());
    EXPECT_TRUE(inspection.findings.empty()) << trajectory << ":\n" << Checks(inspection);
    EXPECT_TRUE(inspection.refusal.empty());
  }
}

TEST(StreamInspection, FindsShiftsOfRotorSpeedsOfEitherSign) {
  const StreamInspection sound = InspectStreams(Octo(), TestVehicle());
  ASSERT_NE(Find(sound, "rotor_speeds"), nullptr) << Checks(sound);
  const StreamLag own = Find(sound, "rotor_speeds")->lag;
  for (const double late_s : {-0.06, -0.033, 0.02, 0.06}) {
    const StreamInspection found = Spoiled([late_s](FlightLog* log) { ShiftRotors(-late_s, log); });
    const TimeOffset* offset = Find(found, "rotor_speeds");
    ASSERT_NE(offset, nullptr);
    EXPECT_NEAR(offset->lag.lag_s - own.lag_s, late_s,
                std::max(0.002, 3.0 * std::hypot(own.scatter_s, offset->lag.scatter_s)));
    EXPECT_NEAR(offset->lag.lag_s, late_s, 3.0 * offset->lag.sigma_s());
    EXPECT_EQ(offset->compensated_s, offset->lag.lag_s);
    ExpectNamed(found, "rotor_speeds_offset", late_s > 0.0 ? "late" : "early");
  }
}

TEST(StreamInspection, SigmaOfRotorOffsetsHolds) {
  int held = 0, all = 0;
  for (int seed = 10; seed < 22; ++seed) {
    FlightLog log = Fly(seed % 2 == 0 ? "octo" : "aggressive", seed, 0.005);
    const double late_s = 0.005 * (seed - 16);
    ShiftRotors(-late_s, &log);
    const TimeOffset* offset = nullptr;
    const StreamInspection found = InspectStreams(log, TestVehicle());
    offset = Find(found, "rotor_speeds");
    if (offset == nullptr || !offset->lag.determined()) continue;
    ++all;
    if (std::abs(offset->lag.lag_s - late_s) <= 3.0 * offset->lag.sigma_s()) ++held;
  }
  EXPECT_GE(all, 10);
  EXPECT_EQ(held, all);
}

/// A flight of the generic vehicle as `simulate --log-rate 100` makes it.
FlightLog FlyGeneric(const Vehicle& vehicle, const std::string& trajectory, int seed) {
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.seed = seed;
  options.duration_s = 20.0;
  options.log_rate_hz = 100.0;
  return Simulate(model, DefaultTruth(model), options, SimulationNoise()).log;
}

// On calm flights the lag of the controller's answers explains about as much as the stamps do: 6 of
// 1,000 flights with right stamps, 5 of them circles, lost 34 to 44 ms.
TEST(StreamInspection, AnswersOfTheControllerAreNoOffset) {
  const Vehicle vehicle =
      LoadVehicle(std::string(ODMC_SOURCE_DIR) + "/config/vehicles/generic.yaml");
  for (const int seed : {1507, 1675, 1883}) {
    const StreamInspection found = InspectStreams(FlyGeneric(vehicle, "circle", seed), vehicle);
    const TimeOffset* offset = Find(found, "rotor_speeds");
    ASSERT_NE(offset, nullptr);
    EXPECT_LT(offset->lag.lag_s, -0.03) << "no longer an example";
    EXPECT_EQ(offset->compensated_s, 0.0) << "seed " << seed;
    EXPECT_TRUE(found.findings.empty()) << Checks(found);
  }
  FlightLog early = FlyGeneric(vehicle, "lemniscate", 1742);
  ShiftRotors(0.034, &early);
  EXPECT_NE(Find(InspectStreams(early, vehicle), "rotor_speeds")->compensated_s, 0.0);
}

TEST(StreamInspection, FindsShiftsOfVelocityRatesAndImu) {
  const StreamInspection velocity = Spoiled([](FlightLog* log) { ShiftVelocity(-0.05, log); });
  ASSERT_NE(Find(velocity, "velocity"), nullptr) << Checks(velocity);
  EXPECT_NEAR(Find(velocity, "velocity")->lag.lag_s, 0.05, 0.002);
  EXPECT_NE(Find(velocity, "velocity")->compensated_s, 0.0);
  EXPECT_EQ(Find(velocity, "rotor_speeds")->compensated_s, 0.0) << Checks(velocity);

  const StreamInspection rates = Spoiled([](FlightLog* log) { ShiftRates(0.04, log); });
  EXPECT_NEAR(Find(rates, "body_rates")->lag.lag_s, -0.04, 0.002);
  EXPECT_NE(Find(rates, "body_rates")->compensated_s, 0.0);
  // Rotor speeds are measured against the rates, whose own offset must not count as theirs.
  EXPECT_EQ(Find(rates, "rotor_speeds")->compensated_s, 0.0) << Checks(rates);

  const StreamInspection imu = Spoiled([](FlightLog* log) { ShiftImu(-0.03, log); });
  EXPECT_NEAR(Find(imu, "gyro")->lag.lag_s, 0.03, 0.002);
  EXPECT_NE(Find(imu, "gyro")->compensated_s, 0.0);
}

/// What a filter of first order makes of the odometry's velocity and rates.
void Filter(double lag_s, FlightLog* log) {
  Vector3d v = *log->odometry.front().v_WS, w = *log->odometry.front().w_WS_S;
  Stamp before = log->odometry.front().stamp;
  for (OdometrySample& sample : log->odometry) {
    const double share = 1.0 - std::exp(-ToSeconds(sample.stamp - before) / lag_s);
    before = sample.stamp;
    v += share * (*sample.v_WS - v);
    w += share * (*sample.w_WS_S - w);
    sample.v_WS = v;
    sample.w_WS_S = w;
  }
}

// A filter's lag is nobody's mistake, but left in it is put on the rotor speeds, which are then
// early.
TEST(StreamInspection, LagOfAFilterIsTakenOffWithoutAWord) {
  for (const int seed : {1, 2, 3}) {
    FlightLog log = Fly("octo", seed);
    Filter(0.008, &log);
    const StreamInspection found = InspectStreams(log, TestVehicle());
    EXPECT_TRUE(found.findings.empty()) << Checks(found);
    // In discrete time the filter is late by half a step less.
    EXPECT_NEAR(Find(found, "velocity")->compensated_s, 0.007, 0.0015);
    EXPECT_NEAR(Find(found, "body_rates")->compensated_s, 0.007, 0.0015);
    EXPECT_EQ(Find(found, "gyro")->compensated_s, 0.0);
    EXPECT_EQ(Find(found, "rotor_speeds")->compensated_s, 0.0);
  }
}

// Rates cannot be early by a filter: the attitude is late, and rotor speeds go with the rates.
TEST(StreamInspection, RotorSpeedsGoWithTheRatesWhereTheAttitudeIsLate) {
  const StreamInspection found = Spoiled([](FlightLog* log) {
    ShiftRates(0.0045, log);
    ShiftImu(0.0045, log);
    ShiftRotors(0.0045, log);
  });
  EXPECT_TRUE(found.findings.empty()) << Checks(found);
  EXPECT_NEAR(Find(found, "body_rates")->compensated_s, -0.0045, 0.0005);
  EXPECT_NEAR(Find(found, "gyro")->compensated_s, -0.0045, 0.0005);
  EXPECT_NEAR(Find(found, "rotor_speeds")->compensated_s, -0.0045, 0.0005);
}

TEST(ShiftStream, KeepsWhatIsFast) {
  FlightLog log;
  constexpr double kRate_Hz = 100.0, kTone_Hz = 20.0, kLate_s = 0.005;
  for (int i = 0; i < 200; ++i) {
    OdometrySample sample;
    sample.stamp = FromSeconds(1.0 + i / kRate_Hz);
    sample.w_WS_S = Vector3d::Constant(std::sin(2.0 * M_PI * kTone_Hz * i / kRate_Hz));
    log.odometry.push_back(sample);
  }
  ShiftRates(kLate_s, &log);
  double worst = 0.0;
  for (const OdometrySample& sample : log.odometry) {
    const double t = ToSeconds(sample.stamp) - 1.0 + kLate_s;
    if (t < 0.02 || t > 1.96) continue;  // lines at both ends
    worst = std::max(worst, std::abs(sample.w_WS_S->x() - std::sin(2.0 * M_PI * kTone_Hz * t)));
  }
  EXPECT_LT(worst, 0.06);  // half way along a line: 0.19
}

TEST(StreamInspection, TakesTheOffsetOff) {
  FlightLog log = Octo();
  ShiftRotors(-0.04, &log);
  ShiftVelocity(-0.05, &log);
  MendStreams(InspectStreams(log, TestVehicle()), &log);
  const StreamInspection mended = InspectStreams(log, TestVehicle());
  EXPECT_TRUE(mended.findings.empty()) << Checks(mended);
  const StreamLag& left = Find(mended, "rotor_speeds")->lag;
  EXPECT_NEAR(left.lag_s, 0.0, 3.0 * left.scatter_s);
  EXPECT_NEAR(Find(mended, "velocity")->lag.lag_s, 0.0, 0.002);
}

TEST(StreamInspection, NamesWhatIsWrongWithTheVelocity) {
  const auto check = [](const Spoil& spoil, const std::string& text) {
    const StreamInspection found = Spoiled(spoil);
    ExpectNamed(found, "velocity", text);
    EXPECT_TRUE(found.drop_velocity);
    EXPECT_TRUE(found.refusal.empty());
  };
  check([](FlightLog* log) { ForPoses(log, [](auto* s) { s->v_WS->x() = 0.0; }); }, "axis x");
  check(
      [](FlightLog* log) {
        ForPoses(log, [](auto* s) { *s->v_WS = s->q_WS.conjugate() * *s->v_WS; });
      },
      "written in the body frame");
  check([](FlightLog* log) { ForPoses(log, [](auto* s) { *s->v_WS *= 3.6; }); }, "in km/h");
  check([](FlightLog* log) { ForPoses(log, [](auto* s) { *s->v_WS *= 2.2; }); }, "times too large");
  check(
      [](FlightLog* log) {
        ForPoses(log, [](auto* s) { *s->v_WS = Vector3d(1, -1, -1).cwiseProduct(*s->v_WS); });
      },
      "with axes x, -y, -z");
  check(
      [](FlightLog* log) {
        ForPoses(log,
                 [](auto* s) { *s->v_WS += s->q_WS * s->w_WS_S->cross(Vector3d(0.5, 0.2, -0.4)); });
      },
      "of a point");
}

TEST(StreamInspection, NamesWhatIsWrongWithTheRates) {
  const auto check = [](const Spoil& spoil, const std::string& text) {
    const StreamInspection found = Spoiled(spoil);
    ExpectNamed(found, "body_rates", text);
    EXPECT_TRUE(found.drop_rates);
    EXPECT_TRUE(found.refusal.empty());
  };
  check([](FlightLog* log) { ForPoses(log, [](auto* s) { *s->w_WS_S *= 57.3; }); }, "in degrees");
  check([](FlightLog* log) { ForPoses(log, [](auto* s) { *s->w_WS_S = -*s->w_WS_S; }); },
        "with axes -x, -y, -z");
  check([](FlightLog* log) { ForPoses(log, [](auto* s) { *s->w_WS_S = s->q_WS * *s->w_WS_S; }); },
        "written in the world frame");
  const StreamInspection gyro = Spoiled([](FlightLog* log) {
    for (ImuSample& s : log->imu) *s.gyro_I *= 57.3;
  });
  ExpectNamed(gyro, "gyro", "in degrees");
}

TEST(StreamInspection, RefusesAnAttitudeThatPointsTheThrustElsewhere) {
  const auto check = [](const std::function<void(OdometrySample*)>& change,
                        const std::string& text) {
    const StreamInspection found = Spoiled([&](FlightLog* log) { ForPoses(log, change); });
    ExpectNamed(found, "attitude", text);
    EXPECT_NE(found.refusal.find(text), std::string::npos) << found.refusal;
    EXPECT_EQ(TrustOf(found.findings), Trust::kBad);
  };
  check([](OdometrySample* s) { s->q_WS = s->q_WS.conjugate(); }, "conjugated");
  check(
      [](OdometrySample* s) {
        // The file held x, y, z, w and was read as w, x, y, z.
        const Quaterniond q = s->q_WS;
        s->q_WS = Quaterniond(q.x(), q.y(), q.z(), q.w());
      },
      "x, y, z, w");
  check(
      [](OdometrySample* s) {
        const Matrix3d down = Vector3d(1.0, -1.0, -1.0).asDiagonal();
        s->p_WS = down * s->p_WS;
        s->q_WS = Quaterniond(Matrix3d(down * s->q_WS.toRotationMatrix() * down));
        *s->v_WS = down * *s->v_WS;
        *s->w_WS_S = down * *s->w_WS_S;
      },
      "NED, FRD");
}

TEST(StreamInspection, NamesWhatIsWrongWithTheAccelerometer) {
  const auto check = [](const std::function<Vector3d(const Vector3d&, const Quaterniond&)>& change,
                        const std::string& text) {
    const StreamInspection found = Spoiled([&](FlightLog* log) {
      for (size_t i = 0; i < log->imu.size(); ++i) {
        const Quaterniond q = log->odometry[std::min(i, log->odometry.size() - 1)].q_WS;
        Vector3d& f = *log->imu[i].specific_force_I;
        f = change(f, q);
      }
    });
    ExpectNamed(found, "accelerometer", text);
    EXPECT_TRUE(found.drop_accelerometer);
  };
  ASSERT_EQ(Octo().imu.size(), Octo().odometry.size());
  check([](const Vector3d& f, const Quaterniond&) { return Vector3d(f / 9.81); }, "in g");
  check([](const Vector3d& f, const Quaterniond& q) { return Vector3d(q * f); },
        "in the world frame");
  check([](const Vector3d& f,
           const Quaterniond& q) { return Vector3d(f - q.conjugate() * Vector3d(0.0, 0.0, 9.81)); },
        "without gravity");
}

TEST(StreamInspection, NamesALeanAndWhereItIs) {
  const Quaterniond lean(Eigen::AngleAxisd(0.14, Vector3d::UnitY()));
  const StreamInspection body = Spoiled([&](FlightLog* log) {
    log->imu.clear();
    ForPoses(log, [&](auto* s) {
      s->q_WS = s->q_WS * lean;
      *s->w_WS_S = lean.conjugate() * *s->w_WS_S;
    });
  });
  ExpectNamed(body, "body_lean", "8.1 degrees (-8.1 towards x");
  const StreamInspection world = Spoiled([&](FlightLog* log) {
    ForPoses(log, [&](auto* s) {
      s->p_WS = lean * s->p_WS;
      s->q_WS = lean * s->q_WS;
      *s->v_WS = lean * *s->v_WS;
    });
  });
  ExpectNamed(world, "gravity_lean", "degrees");
}

TEST(StreamInspection, NamesAMassAndInertiaThatCannotBe) {
  Vehicle vehicle = TestVehicle();
  vehicle.mass_kg *= 2.0;
  vehicle.parameters["thrust.k_f"].sigma = 0.2 * *vehicle.parameters["thrust.k_f"].value;
  ExpectNamed(InspectStreams(Octo(), vehicle), "weight", "0.5 times the weight");
  vehicle = TestVehicle();
  vehicle.inertia_kg_m2 *= 1000.0;
  const StreamInspection absurd = InspectStreams(Octo(), vehicle);
  ExpectNamed(absurd, "vehicle_units", "inertia (inertia_kg_m2) is in g m^2");
  EXPECT_FALSE(absurd.refusal.empty());
  vehicle = TestVehicle();
  vehicle.inertia_kg_m2.z() *= 10.0;
  ExpectNamed(InspectStreams(Octo(), vehicle), "inertia_bounds", "cannot belong");
  vehicle = TestVehicle();
  vehicle.inertia_kg_m2 *= 5.0;
  ExpectNamed(InspectStreams(Fly("aggressive", 7, 0.0005), vehicle), "inertia", "times the file's");
}

TEST(StreamInspection, RefusesRotorSpeedsOfAnotherUnit) {
  const StreamInspection found = Spoiled([](FlightLog* log) {
    for (RotorSample& s : log->rotors) s.speed *= 30.0 / M_PI;
  });
  ExpectNamed(found, "rotor_unit", "in rpm");
  EXPECT_FALSE(found.refusal.empty());
}

TEST(StreamInspection, RefusesAPositionInMillimetres) {
  const StreamInspection found =
      Spoiled([](FlightLog* log) { ForPoses(log, [](auto* s) { s->p_WS *= 1e3; }); });
  ExpectNamed(found, "position", "in mm");
  EXPECT_FALSE(found.refusal.empty());
}

TEST(StreamInspection, TellsATurnedWorldFromOneUpsideDown) {
  const Quaterniond half(Eigen::AngleAxisd(M_PI, Vector3d::UnitZ()));
  const StreamInspection turned =
      Spoiled([&](FlightLog* log) { ForPoses(log, [&](auto* s) { s->q_WS = half * s->q_WS; }); });
  ExpectNamed(turned, "attitude", "turned by 180 degrees about z");
}

TEST(StreamInspection, RatesTellTheOrderOfAQuaternionInHover) {
  FlightLog log = Fly("yaw", 8);
  ForPoses(&log, [](auto* s) {
    s->q_WS = Quaterniond(s->q_WS.x(), s->q_WS.y(), s->q_WS.z(), s->q_WS.w());
  });
  const StreamInspection found = InspectStreams(log, TestVehicle());
  ExpectNamed(found, "attitude", "x, y, z, w");
}

// ---- Recordings --------------------------------------------------------------------------------

struct Recording {
  std::string flight, vehicle;
};

TEST(MeasuredStreams, ShiftsAreFoundWithinTwoMilliseconds) {
  const std::string vehicles = std::string(ODMC_SOURCE_DIR) + "/config/vehicles/";
  const std::string indiflight = test::RecordedFile("indiflight/vehicle.yaml");
  if (indiflight.empty()) GTEST_SKIP() << "no recorded data";
  for (const Recording& r : std::vector<Recording>{
           {"neurobem/test1_first18s.csv", vehicles + "neurobem.yaml"},
           {"imrc_cf21_brushless/eckart22.csv", vehicles + "imrc_cf21_brushless.yaml"},
           {"indiflight/LOG00267.csv", indiflight}}) {
    const Vehicle vehicle = LoadVehicle(r.vehicle);
    FlightLog log =
        ReadFlightCsv(test::RecordedFile(r.flight), vehicle.num_rotors(), PoseSource::kEkf);
    MendFlight(&log);
    const StreamInspection own = InspectStreams(log, vehicle);
    EXPECT_TRUE(own.findings.empty()) << r.flight << ":\n" << Checks(own);
    for (const double late_s : {-0.06, -0.02, 0.02, 0.06}) {
      FlightLog late = log;
      ShiftRotors(-late_s, &late);
      const StreamInspection found = InspectStreams(late, vehicle);
      EXPECT_NEAR(Find(found, "rotor_speeds")->lag.lag_s - Find(own, "rotor_speeds")->lag.lag_s,
                  late_s, 0.002)
          << r.flight;
      EXPECT_NE(Find(found, "rotor_speeds")->compensated_s, 0.0) << r.flight << " " << late_s;
      FlightLog slow = log;
      ShiftVelocity(-2.0 * late_s, &slow);
      const StreamInspection velocity = InspectStreams(slow, vehicle);
      EXPECT_NEAR(Find(velocity, "velocity")->lag.lag_s - Find(own, "velocity")->lag.lag_s,
                  2.0 * late_s, std::max(0.002, 3.0 * Find(velocity, "velocity")->lag.scatter_s))
          << r.flight;
    }
  }
}

}  // namespace
}  // namespace odmc

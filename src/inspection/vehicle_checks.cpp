#include "odmc/inspection/vehicle_checks.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>

#include "motion_windows.h"
#include "odmc/math/statistics.h"
#include "odmc/model/vehicle_units.h"
#include "odmc/text/format.h"
#include "rotor_unit_check.h"

namespace odmc {
namespace {

using Eigen::Matrix3Xd;
using Eigen::Matrix4d;
using Eigen::Vector3d;
using Eigen::Vector4d;

// All mass at the rotors' outer edge is the most inertia a vehicle can have, a hundredth of it at
// the hubs (motors weigh a fifth and more) the least. Ten times beyond, no guess was meant.
constexpr double kLeastAtHubs = 0.01, kBeyondGuessing = 10.0;
// A file that gives k_f with a sigma says how far it may be off; 25 % always (a battery, other
// propellers, ground effect).
constexpr double kSigmas = 3.0, kLeastFactor = 1.25;
// The torque regression is off by up to 2 where the controller fights disturbances.
constexpr double kInertiaFactor = 3.0, kLeastShare = 0.5, kLeastLikeness = 0.8;
// Priors of gravity and mounts are a few degrees wide.
constexpr double kLean_rad = 0.07, kLeanSigmas = 5.0;
// A steady wind pushes as gravity that leans by less does (9 degrees: a storm to most); only an
// accelerometer tells them apart.
constexpr double kLeanNotWind_rad = 0.2;
// A sensor some centimetres from the centre feels w² r: 0.3 m/s² at this rate and 3 cm.
constexpr double kCalm_rad_s = 3.0;
constexpr double kLeastGravity = 9.7, kMostGravity = 9.9;  // 9.764 (Huascaran) to 9.834 (Arctic)
constexpr int kLeastWindows = 10 * kWindowsPerBlock;

/// Specific force of the body in B, and the velocity in B.
struct MotionInBody {
  Matrix3Xd force, velocity;
};

MotionInBody MotionOf(const MotionWindows& w, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  MotionInBody motion{Matrix3Xd(3, w.size()), Matrix3Xd(3, w.size())};
  for (int i = 0; i < w.size(); ++i) {
    const Eigen::Matrix3d R_BW = R_BS * w.q_WS[i].conjugate().toRotationMatrix();
    const Vector3d up_W = vehicle.gravity_m_s2 * Vector3d::UnitZ();
    motion.force.col(i) = R_BW * (Vector3d(w.acceleration_W.col(i)) + up_W);
    motion.velocity.col(i) = R_BW * Vector3d(w.displacement_m_s.col(i));
  }
  return motion;
}

/// k_f that carries the mass; empty where rotor speeds are missing.
std::optional<double> CarryingThrust(const MotionWindows& w, const MotionInBody& motion,
                                     const Vehicle& vehicle) {
  std::vector<double> ratios;
  for (int i = 0; i < w.rotors.cols(); ++i) {
    const double squares = w.rotors.col(i).sum();
    if (squares > 0.0) ratios.push_back(vehicle.mass_kg * motion.force(2, i) / squares);
  }
  if (ratios.size() < kLeastWindows) return std::nullopt;
  return Median(ratios);
}

void CheckWeight(double k_f, const Vehicle& vehicle, StreamInspection* inspection) {
  const auto setting = vehicle.parameters.find("thrust.k_f");
  if (setting == vehicle.parameters.end() || !setting->second.value) return;
  const double file = *setting->second.value;
  const double relative = setting->second.sigma ? *setting->second.sigma / file : 1.0;
  const double off = std::log(k_f / file);
  if (!(k_f > 0.0) || std::abs(off) < std::max(kSigmas * relative, std::log(kLeastFactor))) return;
  inspection->findings.push_back({"weight", Trust::kDoubtful,
                                  "in flight thrust is " + Rounded(file / k_f, 2) +
                                      " times the weight by the file's k_f and mass",
                                  "check mass_kg (" + Rounded(vehicle.mass_kg * file / k_f, 2) +
                                      " would fit) or thrust.k_f (" + Rounded(k_f, 2) +
                                      " would fit), and the unit of the rotor speeds"});
}

// ---- Lean --------------------------------------------------------------------------------------

/// Specific force across the thrust explained by a lean and by drag along each axis.
struct Lean {
  Eigen::Vector2d angle = Eigen::Vector2d::Zero();  ///< [rad]
  double sigma = 0.0, left = 0.0;                   ///< of the larger angle; sum of squares
};

/// @param across 3×n: what a lean of one radian along x and y makes, as two 3×n
Lean FitLean(const MotionInBody& motion, const Matrix3Xd& along_x, const Matrix3Xd& along_y) {
  const auto n = motion.force.cols();
  Matrix4d normal = 1e-9 * Matrix4d::Identity();
  Vector4d right = Vector4d::Zero();
  const auto rows = [&](Eigen::Index i) {
    Eigen::Matrix<double, 2, 4> x = Eigen::Matrix<double, 2, 4>::Zero();
    x.col(0) = along_x.col(i).head<2>();
    x.col(1) = along_y.col(i).head<2>();
    x(0, 2) = motion.velocity(0, i);
    x(1, 3) = motion.velocity(1, i);
    return x;
  };
  for (Eigen::Index i = 0; i < n; ++i) {
    normal += rows(i).transpose() * rows(i);
    right += rows(i).transpose() * motion.force.col(i).head<2>();
  }
  const Vector4d fit = normal.ldlt().solve(right);
  Matrix4d scatter = Matrix4d::Zero();
  Lean lean;
  for (Eigen::Index b = 0; b + kWindowsPerBlock <= n; b += kWindowsPerBlock) {
    Vector4d score = Vector4d::Zero();
    for (Eigen::Index i = b; i < b + kWindowsPerBlock; ++i) {
      const Eigen::Vector2d left = motion.force.col(i).head<2>() - rows(i) * fit;
      score += rows(i).transpose() * left;
      lean.left += left.squaredNorm();
    }
    scatter += score * score.transpose();
  }
  const Matrix4d inverse = normal.ldlt().solve(Matrix4d::Identity());
  const Matrix4d covariance = inverse * scatter * inverse;
  lean.angle = fit.head<2>();
  lean.sigma = std::sqrt(std::max(covariance(0, 0), covariance(1, 1)));
  return lean;
}

std::string Degrees(const Eigen::Vector2d& angle) {
  const Eigen::Vector2d degrees = angle * 180.0 / M_PI;
  return Rounded(degrees.norm(), 2) + " degrees (" + Rounded(degrees.x(), 2) + " towards x, " +
         Rounded(degrees.y(), 2) + " towards y)";
}

/// What the accelerometer feels beyond what the pose says, as gravity that leans; the sensor's own
/// bias and lean stay in the body. @returns true if it could tell
bool CheckFeltGravity(const MotionWindows& w, const MotionInBody& motion, const Matrix3Xd& world_x,
                      const Matrix3Xd& world_y, const Vehicle& vehicle,
                      StreamInspection* inspection) {
  if (w.accelerometer.cols() == 0) return false;
  const Eigen::Matrix3d R_BI =
      vehicle.imu ? vehicle.imu->q_BS.toRotationMatrix() : Eigen::Matrix3d::Identity();
  MotionInBody felt = motion;
  felt.force = R_BI * w.accelerometer - motion.force;
  felt.velocity.setOnes();
  const Lean lean = FitLean(felt, world_x, world_y);
  if (lean.sigma > kLean_rad / kLeanSigmas) return false;
  if (lean.angle.norm() < std::max(kLean_rad, kLeanSigmas * lean.sigma)) return true;
  inspection->findings.push_back({"gravity_lean", Trust::kDoubtful,
                                  "the world's z leans by " + Degrees(lean.angle) +
                                      " against the gravity that the "
                                      "accelerometer feels",
                                  "level the motion capture or the filter's world frame"});
  return true;
}

void CheckLean(const MotionWindows& w, const MotionInBody& motion, const Vehicle& vehicle,
               StreamInspection* inspection) {
  Matrix3Xd body_x = Matrix3Xd::Zero(3, w.size()), body_y = body_x, world_x = body_x,
            world_y = body_x;
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  for (int i = 0; i < w.size(); ++i) {
    body_x(0, i) = body_y(1, i) = motion.force(2, i);
    const Eigen::Matrix3d R_BW = R_BS * w.q_WS[i].conjugate().toRotationMatrix();
    world_x.col(i) = vehicle.gravity_m_s2 * R_BW.col(0);
    world_y.col(i) = vehicle.gravity_m_s2 * R_BW.col(1);
  }
  if (CheckFeltGravity(w, motion, world_x, world_y, vehicle, inspection) &&
      !inspection->findings.empty() && inspection->findings.back().check == "gravity_lean") {
    return;
  }
  const Lean body = FitLean(motion, body_x, body_y), world = FitLean(motion, world_x, world_y);
  const bool is_body = body.left <= world.left;
  const Lean& lean = is_body ? body : world;
  const double angle = lean.angle.norm();
  const double least = is_body ? kLean_rad : kLeanNotWind_rad;
  if (angle < std::max(least, kLeanSigmas * lean.sigma)) return;
  const std::string degrees = Degrees(lean.angle);
  inspection->findings.push_back(
      {is_body ? "body_lean" : "gravity_lean", Trust::kDoubtful,
       is_body ? "the pose's frame leans by " + degrees + " against the thrust axis"
               : "the world's z leans by " + degrees + " against gravity",
       is_body ? "give the mount in odometry.q_BS_xyzw, or let it be estimated (effect "
                 "odometry_extrinsics)"
               : "level the motion capture or the filter's world frame"});
}

}  // namespace

void CheckVehicleUnits(const Vehicle& vehicle, StreamInspection* inspection) {
  const UnitError slip = FindUnitError(vehicle);
  if (!slip.Refutes()) return;
  const std::string what = slip.Sentence();
  const size_t mend = what.find("; ");
  inspection->findings.push_back(
      {"vehicle_units", Trust::kBad, what.substr(0, mend), what.substr(mend + 2)});
  if (inspection->refusal.empty()) inspection->refusal = what;
}

void CheckInertiaBounds(const Vehicle& vehicle, StreamInspection* inspection) {
  double hub = 0.0, edge = 0.0;
  for (const Rotor& rotor : vehicle.rotors) {
    hub = std::max(hub, rotor.p_BP.norm());
    edge = std::max(edge, rotor.p_BP.norm() + rotor.radius_m);
  }
  const double most = vehicle.mass_kg * edge * edge;
  const double least = kLeastAtHubs * vehicle.mass_kg * hub * hub;
  const double largest = vehicle.inertia_kg_m2.maxCoeff();
  const double smallest = vehicle.inertia_kg_m2.minCoeff();
  if (largest <= most && smallest >= least) return;
  const double wrong = largest > most ? largest : smallest;
  const std::string what = "inertia_kg_m2 " + Rounded(wrong, 2) + " cannot belong to " +
                           Rounded(vehicle.mass_kg, 2) + " kg within " + Rounded(edge, 2) +
                           " m: that has between " + Rounded(least, 2) + " and " + Rounded(most, 2);
  const bool absurd = largest > kBeyondGuessing * most || kBeyondGuessing * smallest < least;
  const std::string mend = "check inertia_kg_m2, mass_kg and the rotors' positions";
  inspection->findings.push_back(
      {"inertia_bounds", absurd ? Trust::kBad : Trust::kDoubtful, what, mend});
  if (absurd && inspection->refusal.empty()) inspection->refusal = what + "; " + mend;
}

void CheckGravity(const Vehicle& vehicle, StreamInspection* inspection) {
  const double g = vehicle.gravity_m_s2;
  if (g > kLeastGravity && g < kMostGravity) return;
  inspection->findings.push_back({"gravity", Trust::kDoubtful,
                                  "gravity_m_s2 of the vehicle file is " + Rounded(g, 2) +
                                      ": nowhere on Earth is it outside 9.76 to 9.84",
                                  "write 9.81; thrust and drag scale with it"});
}

void CheckThrust(const MotionSignals& signals, const Vehicle& vehicle,
                 const std::vector<bool>& flight, StreamInspection* inspection) {
  const MotionWindows all = WindowsOf(signals, flight);
  if (const auto unit = CheckRotorUnit(all, vehicle)) {
    inspection->findings.push_back(*unit);
    inspection->refusal = Sentence(*unit);
    return;
  }
  const MotionWindows w = CalmOnes(all, kCalm_rad_s);
  if (w.size() < kLeastWindows) return;
  const MotionInBody motion = MotionOf(w, vehicle);
  if (const auto k_f = CarryingThrust(w, motion, vehicle)) CheckWeight(*k_f, vehicle, inspection);
  CheckLean(w, motion, vehicle, inspection);
}

void CheckInertia(const MotionSignals& signals, const Vehicle& vehicle,
                  const std::vector<bool>& flight, const TimeOffset& torque,
                  StreamInspection* inspection) {
  const Eigen::MatrixXd& gain = torque.lag.band_gain;
  if (!torque.lag.determined() || torque.lag.band_share < kLeastShare) return;
  if (gain.rows() != vehicle.num_rotors() || gain.cols() != 2) return;
  const MotionWindows w = WindowsOf(signals, flight);
  const auto k_f = CarryingThrust(w, MotionOf(w, vehicle), vehicle);
  if (!k_f || !(*k_f > 0.0)) return;
  for (int axis = 0; axis < 2; ++axis) {
    Eigen::VectorXd arm(vehicle.num_rotors());
    for (int j = 0; j < vehicle.num_rotors(); ++j) {
      const Vector3d& p = vehicle.rotors[j].p_BP;
      arm[j] = axis == 0 ? p.y() : -p.x();
    }
    const double along = gain.col(axis).dot(arm);
    // Another order or other spins of the rotors are somebody else's to name.
    if (along < kLeastLikeness * gain.col(axis).norm() * arm.norm()) continue;
    const double inertia = *k_f * arm.squaredNorm() / along;
    const double ratio = inertia / vehicle.inertia_kg_m2[axis];
    if (ratio < kInertiaFactor && ratio > 1.0 / kInertiaFactor) continue;
    inspection->findings.push_back(
        {"inertia", Trust::kDoubtful,
         std::string("inertia about ") + "xy"[axis] + " is " + Rounded(ratio, 2) +
             " times the file's by the rotors' torque between 3 and 20 Hz",
         "check inertia_kg_m2 (about " + Rounded(inertia, 2) +
             " would fit) and the rotors' positions"});
  }
}

}  // namespace odmc

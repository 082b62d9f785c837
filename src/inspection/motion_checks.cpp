#include "odmc/inspection/motion_checks.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "motion_windows.h"
#include "odmc/inspection/stream_readings.h"
#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"
#include "odmc/math/units.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix3Xd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kLeastMotion = 0.1;  // m/s or rad/s RMS: what shows less says nothing
constexpr double kLeastScale = 0.85;  // observers are off by up to 10 %
// One velocity in ten is scaled (an observer's, a wrong unit of flow), by some 10 %.
constexpr double kScalesAre = 0.1, kScaleSize = 0.1;
constexpr double kNoScale = 0.005;     // changes nothing worth a replay
constexpr double kNothingAlike = 0.5;  // of a signal's mean square, by whichever reading

/// Axes as a reader names them: "x, -y, -z".
std::string AxesText(const Matrix3d& axes) {
  std::vector<std::string> names;
  for (int i = 0; i < 3; ++i) {
    int j = 0;
    axes.row(i).cwiseAbs().maxCoeff(&j);
    names.push_back(std::string(axes(i, j) < 0.0 ? "-" : "") + "xyz"[j]);
  }
  return Listed(names);
}

/// All 48 ways to confuse axes and signs: the right one, then y right and z down, all signs, turns
/// about z, then the others.
std::vector<Matrix3d> AxisMistakes() {
  const int orders[6][3] = {{0, 1, 2}, {1, 0, 2}, {0, 2, 1}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
  std::vector<Matrix3d> all = {Matrix3d::Identity(), Vector3d(1.0, -1.0, -1.0).asDiagonal(),
                               -Matrix3d::Identity(), Vector3d(-1.0, -1.0, 1.0).asDiagonal()};
  for (const auto& order : orders) {
    for (int signs = 0; signs < 8; ++signs) {
      Matrix3d axes = Matrix3d::Zero();
      for (int i = 0; i < 3; ++i) axes(i, order[i]) = (signs >> i) & 1 ? -1.0 : 1.0;
      all.push_back(axes);
    }
  }
  return all;
}

/// Every column through its own rotation; `inverse` takes W to S.
Matrix3Xd Turned(const std::vector<Quaterniond>& q, const Matrix3Xd& x, bool inverse) {
  Matrix3Xd turned(3, x.cols());
  for (Eigen::Index i = 0; i < x.cols(); ++i) {
    const Quaterniond& q_i = q[static_cast<size_t>(i)];
    turned.col(i) = (inverse ? q_i.conjugate() : q_i) * Vector3d(x.col(i));
  }
  return turned;
}

double MedianSquare(const Matrix3Xd& x) {
  std::vector<double> squares;
  for (Eigen::Index i = 0; i + kWindowsPerBlock <= x.cols(); i += kWindowsPerBlock) {
    squares.push_back(x.middleCols(i, kWindowsPerBlock).squaredNorm() / kWindowsPerBlock);
  }
  return Median(squares);
}

/// The factor that makes `x` most like `y`.
double ScaleOf(const Matrix3Xd& x, const Matrix3Xd& y) {
  const double square = x.squaredNorm();
  return square > 0.0 ? x.cwiseProduct(y).sum() / square : 0.0;
}

/// Another unit: what it must be multiplied with.
struct UnitMistake {
  std::string name;
  double factor;
};

/// "; or the pose's body frame is turned by 180 degrees about z": what looks the same.
std::string TurnText(const Matrix3d& axes) {
  if (axes(2, 2) != 1.0 || axes.determinant() < 0.0) return "";
  const bool half = axes(0, 0) == -1.0;
  return std::string(", or the pose's body frame is turned by ") + (half ? "180" : "90") +
         " degrees about z";
}

/// Readings of a stream `x` that should be `y`: turned by every rotation, of other units, confused
/// axes.
std::vector<StreamReading> Readings(const Matrix3Xd& x, const Matrix3Xd& y,
                                    const std::vector<Quaterniond>& q, bool world_is_right,
                                    const std::vector<UnitMistake>& units) {
  std::vector<StreamReading> all = {{"as it is", x - y}};
  all.push_back({world_is_right ? "written in the body frame" : "written in the world frame",
                 Turned(q, x, !world_is_right) - y});
  for (const UnitMistake& unit : units) all.push_back({unit.name, unit.factor * x - y});
  for (const Matrix3d& axes : AxisMistakes()) {
    if (axes.isIdentity()) continue;
    all.push_back({"with axes " + AxesText(axes) + TurnText(axes), axes * x - y});
  }
  const double scale = ScaleOf(x, y);
  if (scale > kLeastScale && scale < 1.0 / kLeastScale) return all;
  for (const UnitMistake& unit : units) {
    if (std::abs(scale / unit.factor - 1.0) < 0.1) return all;  // is among them
  }
  all.push_back({Rounded(1.0 / scale, 2) + " times too large", scale * x - y, true});
  return all;
}

Finding Dropped(const std::string& check, const std::string& what, const std::string& mend) {
  return {check, Trust::kDoubtful, what + "; it is not used", mend};
}

// ---- Velocity -----------------------------------------------------------------------------------

/// Axes whose numbers never change while the position moves along them.
std::string StuckAxes(const Matrix3Xd& x, const Matrix3Xd& y) {
  std::vector<std::string> stuck;
  for (int i = 0; i < 3; ++i) {
    const double moves = std::sqrt(y.row(i).squaredNorm() / static_cast<double>(y.cols()));
    const double spread = x.row(i).maxCoeff() - x.row(i).minCoeff();
    if (moves <= kLeastMotion || spread > 1e-6) continue;
    stuck.emplace_back(1, "xyz"[i]);
  }
  return Listed(stuck);
}

/// Adds the reading "of another point": v + R (w x r) with the r that fits.
void AddOtherPoint(const MotionWindows& w, std::vector<StreamReading>* readings) {
  const Matrix3Xd& rates = w.rates.cols() > 0 ? w.rates : w.gyro;
  if (rates.cols() == 0) return;
  Matrix3d normal = 1e-9 * Matrix3d::Identity();
  Vector3d right = Vector3d::Zero();
  const Matrix3Xd error = w.velocity - w.displacement_m_s;
  const auto lever = [&](Eigen::Index i) {
    return Matrix3d(w.q_WS[static_cast<size_t>(i)].toRotationMatrix() * Hat(rates.col(i)));
  };
  for (Eigen::Index i = 0; i < error.cols(); ++i) {
    normal += lever(i).transpose() * lever(i);
    right += lever(i).transpose() * error.col(i);
  }
  const Vector3d r = normal.ldlt().solve(right);
  Matrix3Xd left = error;
  for (Eigen::Index i = 0; i < error.cols(); ++i) left.col(i) -= lever(i) * r;
  readings->push_back({"of a point " + Rounded(r.norm(), 2) + " m away (" + Rounded(r.x(), 2) +
                           ", " + Rounded(r.y(), 2) + ", " + Rounded(r.z(), 2) +
                           " in the sensor's frame)",
                       left, true});
}

/// The velocity over what the position's derivative is, with its sigma: by either regression, as
/// noise in the one or the other makes them differ, and by the scatter of blocks.
RareError VelocityScale(const MotionWindows& w) {
  const Matrix3Xd &x = w.velocity, &y = w.displacement_m_s;
  const double xy = x.cwiseProduct(y).sum();
  if (!(xy > 0.0)) return {};
  const double least = xy / y.squaredNorm(), most = x.squaredNorm() / xy;
  const double scale = std::sqrt(least * most);
  double scatter = 0.0;
  for (Eigen::Index i = 0; i + kWindowsPerBlock <= x.cols(); i += kWindowsPerBlock) {
    const auto x_block = x.middleCols(i, kWindowsPerBlock);
    const auto y_block = y.middleCols(i, kWindowsPerBlock);
    const double slope = (x_block - scale * y_block).cwiseProduct(y_block).sum();
    scatter += slope * slope;
  }
  const double sigma = std::hypot(std::sqrt(scatter) / y.squaredNorm(), 0.5 * (most - least));
  return RareErrorPosterior(scale - 1.0, std::max(sigma, 1e-3), kScalesAre, kScaleSize);
}

const std::vector<UnitMistake> kVelocityUnits = {
    {"in km/h", 1.0 / 3.6}, {"in cm/s", 0.01}, {"in mm/s", 0.001}, {"in ft/s", 0.3048}};

void CheckVelocity(const MotionWindows& w, MotionSignals* s, StreamInspection* inspection) {
  if (w.velocity.cols() == 0) return;
  if (MedianSquare(w.displacement_m_s) < kLeastMotion * kLeastMotion) return;
  const std::string cause = "the velocity is not the derivative of the position: ";
  const auto drop = [&](const std::string& what, const std::string& mend) {
    inspection->findings.push_back(Dropped("velocity", cause + what, mend));
    inspection->drop_velocity = true;
    s->velocity.reset();
  };
  const std::string stuck = StuckAxes(w.velocity, w.displacement_m_s);
  if (!stuck.empty()) {
    return drop("its axis " + stuck + " does not change while the position does",
                "record the whole velocity, or none");
  }
  std::vector<StreamReading> readings =
      Readings(w.velocity, w.displacement_m_s, w.q_WS, true, kVelocityUnits);
  AddOtherPoint(w, &readings);
  const BestReading verdict = CompareReadings(readings, kWindowsPerBlock);
  if (verdict.mistaken()) {
    return drop("it fits " + readings[verdict.best].name + " (" +
                    Rounded(verdict.best_error_rms, 2) + " m/s RMS left instead of " +
                    Rounded(verdict.error_rms, 2) + ")",
                "columns vx, vy, vz are the velocity of the pose's own point in the world frame, "
                "in m/s");
  }
  const double unlike = verdict.error_rms * verdict.error_rms / MedianSquare(w.displacement_m_s);
  const double unlike_best =
      verdict.best_error_rms * verdict.best_error_rms / MedianSquare(w.displacement_m_s);
  const double whole = (w.velocity - w.displacement_m_s).squaredNorm();
  if (unlike > 1.0 && unlike_best > kNothingAlike && whole > w.displacement_m_s.squaredNorm()) {
    drop("they differ by " + Rounded(verdict.error_rms, 2) + " m/s RMS, and by " +
             Rounded(verdict.best_error_rms, 2) + " in any other frame",
         "record the velocity of the same source as the pose, or none");
    return;
  }
  const RareError scale = VelocityScale(w);
  const double factor = 1.0 + std::copysign(scale.rms(), scale.mean);
  if (std::abs(factor - 1.0) > kNoScale) {
    inspection->doubts.push_back({"velocity", 0.0, factor});
  }
}

// ---- Rates --------------------------------------------------------------------------------------

const std::vector<UnitMistake> kRateUnits = {{"in degrees", kDegree}};

/// What the attitude's own turn says the rates are.
Matrix3Xd Turns(const MotionWindows& w) {
  Matrix3Xd turns(3, w.size());
  for (int i = 0; i < w.size(); ++i) {
    turns.col(i) = Log(w.q0[i].conjugate() * w.q1[i]) / kWindow_s;
  }
  return turns;
}

/// @returns what is wrong with rates `x`, in words; empty if nothing
std::string WrongRates(const MotionWindows& w, const Matrix3Xd& x, const Matrix3d& R_SX) {
  if (x.cols() == 0) return "";
  Matrix3Xd turns = Turns(w);
  if (MedianSquare(turns) < kLeastMotion * kLeastMotion) return "";
  const Matrix3Xd in_S = R_SX * x;
  const std::vector<StreamReading> readings = Readings(in_S, turns, w.q_WS, false, kRateUnits);
  const BestReading verdict = CompareReadings(readings, kWindowsPerBlock);
  if (!verdict.mistaken()) return "";
  return "fits " + readings[verdict.best].name + " (" + Rounded(verdict.best_error_rms, 2) +
         " rad/s RMS left instead of " + Rounded(verdict.error_rms, 2) + ")";
}

void CheckRates(const MotionWindows& w, const Vehicle& vehicle, MotionSignals* s,
                StreamInspection* inspection) {
  const std::string rates = WrongRates(w, w.rates, Matrix3d::Identity());
  if (!rates.empty()) {
    inspection->findings.push_back(
        Dropped("body_rates", "the attitude is not the integral of the body rates, which " + rates,
                "columns wx, wy, wz are in the body frame (x forward, y left, z up), in rad/s"));
    inspection->drop_rates = true;
    s->rates.reset();
  }
  const Matrix3d R_SI =
      vehicle.imu ? (vehicle.odometry.q_BS.conjugate() * vehicle.imu->q_BS).toRotationMatrix()
                  : Matrix3d::Identity();
  const std::string gyro = WrongRates(w, w.gyro, R_SI);
  if (gyro.empty()) return;
  inspection->findings.push_back(
      Dropped("gyro", "the attitude is not the integral of the gyro, which " + gyro,
              "gyro rates are in the frame that the vehicle file's imu states, in rad/s"));
  inspection->drop_gyro = true;
  s->gyro.reset();
}

// ---- Attitude -----------------------------------------------------------------------------------

/// A mistake in reading a pose: of the quaternion, of the axes of world and body, of the position's
/// unit.
struct PoseMistake {
  std::string name, mend;
  Quaterniond (*read)(const Quaterniond& q);
  bool world_down, body_down;
  double position = 1.0;  ///< what it must be multiplied with
};

Quaterniond AsIs(const Quaterniond& q) { return q; }
Quaterniond Conjugate(const Quaterniond& q) { return q.conjugate(); }
// The file holds x, y, z, w and was read as w, x, y, z; and the other way round.
Quaterniond LastIsW(const Quaterniond& q) { return {q.z(), q.w(), q.x(), q.y()}; }
Quaterniond FirstIsW(const Quaterniond& q) { return {q.x(), q.y(), q.z(), q.w()}; }
Quaterniond AboutZ(double angle, const Quaterniond& q) {
  return Quaterniond(Eigen::AngleAxisd(angle, Vector3d::UnitZ())) * q;
}
Quaterniond HalfTurn(const Quaterniond& q) { return AboutZ(M_PI, q); }
Quaterniond BodyHalfTurn(const Quaterniond& q) { return q * AboutZ(M_PI, Quaterniond::Identity()); }
Quaterniond QuarterLeft(const Quaterniond& q) { return AboutZ(0.5 * M_PI, q); }
Quaterniond QuarterRight(const Quaterniond& q) { return AboutZ(-0.5 * M_PI, q); }

constexpr size_t kQuaternionMistakes = 3;  // after the first: those of the quaternion itself

/// The likeliest first.
const std::vector<PoseMistake>& PoseMistakes() {
  static const char kOrder[] = "give the quaternion as qw, qx, qy, qz";
  static const char kFrames[] =
      "turn the pose into a world with z up and a body with x forward, "
      "y left, z up";
  static const char kWorlds[] = "give position and attitude in one world frame";
  static const char kMetres[] = "give the position in m (columns px, py, pz)";
  static const std::vector<PoseMistake> kAll = {
      {"as it is", "", AsIs, false, false},
      {"as a conjugated quaternion (world to body)",
       "conjugate it: it must take body vectors into "
       "the world",
       Conjugate, false, false},
      {"as a quaternion in the order x, y, z, w", kOrder, LastIsW, false, false},
      {"as a quaternion whose first number was taken for the last", kOrder, FirstIsW, false, false},
      {"in a world with z down and a body with z down (NED, FRD)", kFrames, AsIs, true, true},
      {"in a world with z down (NED)", kFrames, AsIs, true, false},
      {"with a body whose z points down (FRD)", kFrames, AsIs, false, true},
      {"a body frame of the attitude that is turned by 180 degrees about z",
       "turn the attitude, or odometry.q_BS_xyzw", BodyHalfTurn, false, false},
      {"a position in mm", kMetres, AsIs, false, false, 1e-3},
      {"a position in cm", kMetres, AsIs, false, false, 1e-2},
      {"a world of the attitude that is turned by 180 degrees about z against the position's",
       kWorlds, HalfTurn, false, false},
      {"a world of the attitude that is turned by 90 degrees about z against the position's",
       kWorlds, QuarterLeft, false, false},
      {"a world of the attitude that is turned by -90 degrees about z against the position's",
       kWorlds, QuarterRight, false, false}};
  return kAll;
}

/// Specific force across the thrust axis, and what is missing of it along the axis; in B.
Matrix3Xd AcrossThrust(const MotionWindows& w, const Vehicle& vehicle, const PoseMistake& mistake) {
  const Matrix3d down = Vector3d(1.0, -1.0, -1.0).asDiagonal();
  const Matrix3d world = mistake.world_down ? down : Matrix3d::Identity();
  const Matrix3d body = mistake.body_down ? down : Matrix3d::Identity();
  const Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  Matrix3Xd across(3, w.size());
  for (int i = 0; i < w.size(); ++i) {
    const Matrix3d R_WS = world * mistake.read(w.q_WS[i]).toRotationMatrix() * body;
    const Vector3d a_W = mistake.position * w.acceleration_W.col(i);
    const Vector3d force_W = world * a_W + vehicle.gravity_m_s2 * Vector3d::UnitZ();
    Vector3d force_B = R_BS * R_WS.transpose() * force_W;
    force_B.z() = force_B.z() - force_W.norm();
    across.col(i) = force_B;
  }
  return across;
}

// Multirotors accelerate by some 3 m/s² (RMS), ten times more or less: in a smaller unit than
// metres by as many times more. What is nearer to that than to what smaller numbers would be is no
// metre.
constexpr double kUsualAcceleration_m_s2 = 3.0;

/// True if the position's numbers may be in the unit of this mistake: a hovering vehicle's that are
/// mostly noise fit anything smaller.
bool IsPossible(const MotionWindows& w, const PoseMistake& mistake) {
  if (mistake.position == 1.0) return true;
  const double least_m_s2 = kUsualAcceleration_m_s2 / std::sqrt(mistake.position);
  return MedianSquare(w.acceleration_W) > least_m_s2 * least_m_s2;
}

/// Body rates beside the turn of the attitude that a mistake leaves; empty without rates.
Matrix3Xd OffTurn(const MotionWindows& w, const PoseMistake& mistake) {
  const Matrix3Xd& rates = w.rates.cols() > 0 ? w.rates : w.gyro;
  Matrix3Xd off(3, rates.cols());
  for (Eigen::Index i = 0; i < rates.cols(); ++i) {
    const auto k = static_cast<size_t>(i);
    off.col(i) =
        rates.col(i) - Log(mistake.read(w.q0[k]).conjugate() * mistake.read(w.q1[k])) / kWindow_s;
  }
  return off;
}

/// Specific force beside what the sum of the squared rotor speeds says, in a first row; empty
/// without rotor speeds. Only the world's z and the position's unit change it.
Matrix3Xd OffThrust(const MotionWindows& w, const Vehicle& vehicle, const PoseMistake& mistake) {
  const double up = mistake.world_down ? -1.0 : 1.0;
  std::vector<double> force, ratios;
  for (Eigen::Index i = 0; i < w.rotors.cols(); ++i) {
    const Vector3d a_W = mistake.position * w.acceleration_W.col(i);
    force.push_back((up * a_W + vehicle.gravity_m_s2 * Vector3d::UnitZ()).norm());
    ratios.push_back(force.back() / std::max(w.rotors.col(i).sum(), 1e-30));
  }
  const double per_square = Median(ratios);
  Matrix3Xd off = Matrix3Xd::Zero(3, w.rotors.cols());
  for (Eigen::Index i = 0; i < w.rotors.cols(); ++i) {
    off(0, i) = force[static_cast<size_t>(i)] - per_square * w.rotors.col(i).sum();
  }
  return off;
}

/// True if the truth is nearer to the second of two mistakes, neither of which is likelier
/// beforehand.
bool IsNearer(const Matrix3Xd& first, const Matrix3Xd& second) {
  constexpr double kSigmas = 3.0;
  std::vector<StreamReading> two(2);
  two[0].error = first;
  two[1].error = second;
  const BestReading verdict = CompareReadings(two, kWindowsPerBlock);
  return verdict.best != 0 && verdict.towards - kSigmas * verdict.towards_sigma > 0.5;
}

/// Readings that send the thrust nearly the same way are told apart by the turn that rates show
/// (recorded in the frame of the pose, as it is), and by the size of the thrust.
constexpr double kNearlyAsGood = 4.0;

size_t BestPose(const MotionWindows& w, const Vehicle& vehicle,
                const std::vector<StreamReading>& readings, size_t best) {
  const double least = MedianSquare(readings[best].error);
  const auto fits_better = [&](size_t i) {
    const PoseMistake &now = PoseMistakes()[best], &other = PoseMistakes()[i];
    return IsNearer(OffTurn(w, now), OffTurn(w, other)) ||
           IsNearer(OffThrust(w, vehicle, now), OffThrust(w, vehicle, other));
  };
  for (size_t i = 1; i < readings.size(); ++i) {
    if (i == best || MedianSquare(readings[i].error) > kNearlyAsGood * least) continue;
    if (fits_better(i)) best = i;
  }
  return best;
}

/// Where the thrust does not tell (a calm flight): the reading of the quaternion whose turn the
/// rates show, if the thrust, too, fits it rather than the quaternion as it is; otherwise 0.
size_t PoseByTurn(const MotionWindows& w, const std::vector<StreamReading>& readings) {
  const Matrix3Xd as_is = OffTurn(w, PoseMistakes()[0]);
  if (as_is.cols() == 0) return 0;
  const Matrix3Xd& rates = w.rates.cols() > 0 ? w.rates : w.gyro;
  if (MedianSquare(rates) < kLeastMotion * kLeastMotion) return 0;
  size_t best = 0;
  double least = MedianSquare(as_is);
  for (size_t i = 1; i <= kQuaternionMistakes; ++i) {
    const Matrix3Xd turn = OffTurn(w, PoseMistakes()[i]);
    if (!(MedianSquare(turn) < least)) continue;
    if (!CompareReadings({{"", as_is}, {"", turn}}, kWindowsPerBlock).mistaken()) continue;
    const BestReading thrust = CompareReadings({readings[0], readings[i]}, kWindowsPerBlock);
    if (thrust.best == 0 || thrust.towards - thrust.towards_sigma < 0.5) continue;
    best = i;
    least = MedianSquare(turn);
  }
  return best;
}

void CheckAttitude(const MotionWindows& w, const Vehicle& vehicle, StreamInspection* inspection) {
  std::vector<StreamReading> readings;
  for (const PoseMistake& mistake : PoseMistakes()) {
    const bool is_possible = IsPossible(w, mistake);
    readings.push_back(
        {mistake.name, AcrossThrust(w, vehicle, is_possible ? mistake : PoseMistakes().front())});
  }
  const BestReading verdict = CompareReadings(readings, kWindowsPerBlock);
  const size_t best = verdict.mistaken()
                          ? BestPose(w, vehicle, readings, static_cast<size_t>(verdict.best))
                          : PoseByTurn(w, readings);
  if (best == 0) return;
  const PoseMistake& mistake = PoseMistakes()[best];
  const bool is_position = mistake.position != 1.0;
  const std::string what =
      is_position ? "the position does not move as attitude and thrust say"
                  : "the attitude does not point the thrust where the vehicle accelerates";
  const auto rms = [&](size_t i) { return Rounded(std::sqrt(MedianSquare(readings[i].error)), 2); };
  inspection->refusal = what + ": it fits " + mistake.name +
                        " (specific force across the thrust axis " + rms(best) +
                        " m/s^2 RMS instead of " + rms(0);
  const Matrix3Xd as_is = OffTurn(w, PoseMistakes()[0]);
  if (as_is.cols() > 0) {
    inspection->refusal += "; turn beside the rates " +
                           Rounded(std::sqrt(MedianSquare(OffTurn(w, mistake))), 2) +
                           " rad/s RMS instead of " + Rounded(std::sqrt(MedianSquare(as_is)), 2);
  }
  inspection->refusal += ")";
  inspection->findings.push_back(
      {is_position ? "position" : "attitude", Trust::kBad, inspection->refusal, mistake.mend});
  inspection->refusal += "; " + mistake.mend;
}

// ---- Accelerometer ------------------------------------------------------------------------------

void CheckAccelerometer(const MotionWindows& w, const Vehicle& vehicle, MotionSignals* s,
                        StreamInspection* inspection) {
  if (w.accelerometer.cols() == 0) return;
  const double g = vehicle.gravity_m_s2;
  const Matrix3d R_IS =
      vehicle.imu ? (vehicle.imu->q_BS.conjugate() * vehicle.odometry.q_BS).toRotationMatrix()
                  : Matrix3d::Identity();
  const Matrix3Xd up_W = (g * Vector3d::UnitZ()).replicate(1, w.size());
  const Matrix3Xd up_I = R_IS * Turned(w.q_WS, up_W, true);
  const Matrix3Xd force_I = R_IS * Turned(w.q_WS, w.acceleration_W + up_W, true);
  const Matrix3Xd& x = w.accelerometer;
  const Matrix3Xd turned = R_IS * Turned(w.q_WS, x, true);
  std::vector<StreamReading> readings = {
      {"as it is", x - force_I},
      {"in g", g * x - force_I},
      {"in the world frame", turned - force_I},
      {"in the world frame, in g", g * turned - force_I},
      {"without gravity", x + up_I - force_I},
      {"without gravity, in the world frame", turned + up_I - force_I},
      {"without gravity, in g", g * x + up_I - force_I}};
  for (const Matrix3d& axes : AxisMistakes()) {
    if (!axes.isIdentity()) readings.push_back({"with axes " + AxesText(axes), axes * x - force_I});
  }
  const BestReading verdict = CompareReadings(readings, kWindowsPerBlock);
  if (!verdict.mistaken()) return;
  inspection->findings.push_back(
      Dropped("accelerometer",
              "the accelerometer is not the specific force that the pose shows: it fits " +
                  readings[verdict.best].name + " (" + Rounded(verdict.best_error_rms, 2) +
                  " m/s^2 RMS left instead of " + Rounded(verdict.error_rms, 2) + ")",
              "columns ax, ay, az are specific force in the sensor's frame, +9.8 on z at hover, "
              "in m/s^2"));
  inspection->drop_accelerometer = true;
  s->accelerometer.reset();
}

}  // namespace

void CheckMotion(const Vehicle& vehicle, const std::vector<bool>& flight, MotionSignals* signals,
                 StreamInspection* inspection) {
  const MotionWindows windows = WindowsOf(*signals, flight);
  CheckAttitude(windows, vehicle, inspection);
  if (!inspection->refusal.empty()) return;
  CheckVelocity(windows, signals, inspection);
  CheckRates(windows, vehicle, signals, inspection);
  CheckAccelerometer(windows, vehicle, signals, inspection);
}

}  // namespace odmc

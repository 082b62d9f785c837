#include "odmc/model/frame_layout.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "odmc/math/units.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kCw = 1.0, kCcw = -1.0;
constexpr double kAbove = 0.1;  // of coaxial rotors, over the arm, as PX4's geometry has it
constexpr double kUpper = kAbove, kLower = -kAbove;

/// A motor as the autopilots write it.
struct DrawnMotor {
  double angle_deg;  // clockwise from the front
  double spin;
  double z = 0.0;
};

using DrawnMotors = std::vector<DrawnMotor>;

struct Frame {
  std::string name;
  DrawnMotors px4, ardupilot, betaflight;
};

/// PX4 and ArduPilot alike.
Frame Shared(const std::string& name, const DrawnMotors& both, const DrawnMotors& betaflight) {
  return {name, both, both, betaflight};
}

using Frames = std::vector<Frame>;

Frames Quads() {
  return {Shared("quad_x", {{45, kCcw}, {-135, kCcw}, {-45, kCw}, {135, kCw}},
                 {{135, kCw}, {45, kCcw}, {-135, kCcw}, {-45, kCw}}),
          Shared("quad_plus", {{90, kCcw}, {-90, kCcw}, {0, kCw}, {180, kCw}},
                 {{180, kCw}, {90, kCcw}, {-90, kCcw}, {0, kCw}})};
}

Frames Hexas() {
  return {
      Shared("hexa_x", {{90, kCw}, {-90, kCcw}, {-30, kCw}, {150, kCcw}, {30, kCcw}, {-150, kCw}},
             {{150, kCcw}, {30, kCcw}, {-150, kCw}, {-30, kCw}, {90, kCw}, {-90, kCcw}}),
      Shared("hexa_plus", {{0, kCw}, {180, kCcw}, {-120, kCw}, {60, kCcw}, {-60, kCcw}, {120, kCw}},
             {{120, kCcw}, {60, kCw}, {-120, kCcw}, {-60, kCw}, {0, kCcw}, {180, kCw}})};
}

Frames Octos() {
  return {Shared("octo_x",
                 {{22.5, kCw},
                  {-157.5, kCw},
                  {67.5, kCcw},
                  {157.5, kCcw},
                  {-22.5, kCcw},
                  {-112.5, kCcw},
                  {-67.5, kCw},
                  {112.5, kCw}},
                 {{-67.5, kCcw},
                  {22.5, kCcw},
                  {112.5, kCcw},
                  {-157.5, kCcw},
                  {-22.5, kCw},
                  {67.5, kCw},
                  {157.5, kCw},
                  {-112.5, kCw}}),
          Shared("octo_plus",
                 {{0, kCw},
                  {180, kCw},
                  {45, kCcw},
                  {135, kCcw},
                  {-45, kCcw},
                  {-135, kCcw},
                  {-90, kCw},
                  {90, kCw}},
                 {{-45, kCcw},
                  {45, kCcw},
                  {135, kCcw},
                  {-135, kCcw},
                  {0, kCw},
                  {90, kCw},
                  {180, kCw},
                  {-90, kCw}})};
}

/// One rotor above the other.
Frames Coaxial() {
  return {Frame{"y6",
                {{60, kCw, kUpper},
                 {60, kCcw, kLower},
                 {180, kCw, kUpper},
                 {180, kCcw, kLower},
                 {-60, kCw, kUpper},
                 {-60, kCcw, kLower}},
                {{60, kCcw, kLower},
                 {-60, kCw, kUpper},
                 {-60, kCcw, kLower},
                 {180, kCw, kLower},
                 {60, kCw, kUpper},
                 {180, kCcw, kUpper}},
                {{180, kCcw, kUpper},
                 {60, kCw, kUpper},
                 {-60, kCw, kUpper},
                 {180, kCw, kLower},
                 {60, kCcw, kLower},
                 {-60, kCcw, kLower}}}};
}

const Frames& AllFrames() {
  static const Frames kAll = [] {
    Frames all;
    for (const Frames& some : {Quads(), Hexas(), Octos(), Coaxial()}) {
      all.insert(all.end(), some.begin(), some.end());
    }
    return all;
  }();
  return kAll;
}

const DrawnMotors& MotorsOf(const Frame& frame, Autopilot autopilot) {
  if (autopilot == Autopilot::kPx4) return frame.px4;
  return autopilot == Autopilot::kArduPilot ? frame.ardupilot : frame.betaflight;
}

/// Without what sin(pi) leaves; never -0.
double ToNineDecimals(double value) { return std::round(1e9 * value) / 1e9 + 0.0; }

/// "front right", of octos with the side that is nearer: "right front".
std::string PlaceName(const DrawnMotor& motor, bool is_octo_x) {
  const double angle = std::abs(motor.angle_deg);
  const std::string side = motor.angle_deg > 0.0 ? "right" : "left";
  const std::string end = angle < 90.0 ? "front" : "rear";
  std::string name;
  if (angle == 0.0 || angle == 180.0) {
    name = end;
  } else if (angle == 90.0) {
    name = side;
  } else if (is_octo_x && angle > 45.0 && angle < 135.0) {
    name = side + " " + end;
  } else {
    name = end + " " + side;
  }
  if (motor.z != 0.0) name += motor.z > 0.0 ? ", upper" : ", lower";
  return name;
}

}  // namespace

const char* Name(Autopilot autopilot) {
  if (autopilot == Autopilot::kPx4) return "px4";
  return autopilot == Autopilot::kArduPilot ? "ardupilot" : "betaflight";
}

const std::vector<std::string>& FrameNames() {
  static const std::vector<std::string> kNames = [] {
    std::vector<std::string> names;
    for (const Frame& frame : AllFrames()) names.push_back(frame.name);
    return names;
  }();
  return kNames;
}

std::vector<std::string> FramesOf(int num_rotors) {
  std::vector<std::string> names;
  for (const Frame& frame : AllFrames()) {
    if (static_cast<int>(frame.px4.size()) == num_rotors) names.push_back(frame.name);
  }
  return names;
}

std::vector<FramePlace> FrameLayout(const std::string& frame, Autopilot autopilot) {
  std::vector<std::string> known;
  for (const Frame& candidate : AllFrames()) {
    known.push_back(candidate.name);
    if (candidate.name != frame) continue;
    std::vector<FramePlace> places;
    for (const DrawnMotor& motor : MotorsOf(candidate, autopilot)) {
      const double angle = motor.angle_deg * kDegree;
      const Eigen::Vector3d direction(ToNineDecimals(std::cos(angle)),
                                      ToNineDecimals(-std::sin(angle)), motor.z);
      places.push_back({PlaceName(motor, frame == "octo_x"), direction, motor.spin});
    }
    return places;
  }
  throw std::invalid_argument("there is no frame '" + frame + "'; there are " + Listed(known));
}

std::vector<Rotor> RotorsAt(const std::vector<FramePlace>& places, double half_x_m, double half_y_m,
                            double radius_m) {
  Eigen::Vector3d most = Eigen::Vector3d::Zero();
  for (const FramePlace& place : places) most = most.cwiseMax(place.direction.cwiseAbs());
  const Eigen::Vector3d scale(half_x_m / most.x(), half_y_m / most.y(),
                              0.5 * (half_x_m / most.x() + half_y_m / most.y()));
  std::vector<Rotor> rotors;
  for (const FramePlace& place : places) {
    rotors.push_back({place.direction.cwiseProduct(scale), place.spin, radius_m});
  }
  return rotors;
}

bool IsCoaxial(const Rotor& a, const Rotor& b) {
  constexpr double kBeside = 0.05;  // of the arm
  return (a.p_BP - b.p_BP).head<2>().norm() < kBeside * a.p_BP.head<2>().norm();
}

std::vector<unsigned> UsualSpins(const std::vector<Rotor>& rotors) {
  unsigned own = 0, all = 0;
  std::vector<unsigned> pairs;  // bits of both rotors
  for (size_t j = 0; j < rotors.size(); ++j) {
    all |= 1U << j;
    if (rotors[j].spin > 0.0) own |= 1U << j;
    for (size_t i = 0; i < j; ++i) {
      const bool opposite = rotors[i].spin != rotors[j].spin;
      if (opposite && IsCoaxial(rotors[i], rotors[j])) pairs.push_back(1U << i | 1U << j);
    }
  }
  std::vector<unsigned> patterns;
  for (unsigned swaps = 0; swaps < 1U << pairs.size(); ++swaps) {
    unsigned pattern = own;
    for (size_t k = 0; k < pairs.size(); ++k) {
      if ((swaps >> k & 1U) != 0U) pattern ^= pairs[k];
    }
    for (const unsigned one : {pattern, pattern ^ all}) {
      if (std::count(patterns.begin(), patterns.end(), one) == 0) patterns.push_back(one);
    }
  }
  return patterns;
}

}  // namespace odmc

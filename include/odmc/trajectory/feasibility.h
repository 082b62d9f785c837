#pragma once

#include <functional>
#include <string>
#include <vector>

#include "odmc/trajectory/flat_reference.h"

namespace odmc {

/// What a flight may ask of a vehicle. Thrust is that of a vehicle without drag.
struct FlightLimits {
  double max_speed_m_s = 5.0;           ///< > 0
  double max_thrust_over_weight = 2.0;  ///< > 1, the thrust of hover
  double min_thrust_over_weight = 0.2;  ///< > 0 and < 1
  double max_body_rate_rad_s = 6.0;     ///< norm of w_WB_B, > 0
  double max_yaw_rate_rad_s = 2.0;      ///< of the reference's yaw, > 0

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("max_speed_m_s", &max_speed_m_s);
    v->Field("max_thrust_over_weight", &max_thrust_over_weight);
    v->Field("min_thrust_over_weight", &min_thrust_over_weight);
    v->Field("max_body_rate_rad_s", &max_body_rate_rad_s);
    v->Field("max_yaw_rate_rad_s", &max_yaw_rate_rad_s);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// What a flight asks of a vehicle without drag.
struct Feasibility {
  double max_speed_m_s = 0.0;
  double max_acceleration_m_s2 = 0.0;
  double min_thrust_over_weight = 0.0;
  double max_thrust_over_weight = 0.0;
  double max_tilt_rad = 0.0;            ///< of body z from W z
  double max_body_rate_rad_s = 0.0;     ///< norm of w_WB_B
  double max_yaw_rate_rad_s = 0.0;      ///< of the reference's yaw
  std::vector<std::string> violations;  ///< a sentence for each limit that does not hold

  bool ok() const { return violations.empty(); }
};

/// Samples a reference every 5 ms or finer (beyond 1000 s: 200 000 times) from `start_s` to
/// `end_s`, both included, and compares what it asks by FlatAttitudeOf() with `limits`. Where the
/// vehicle stands, nothing is asked.
/// @param at reference at a time [s]
/// @param gravity [m/s²], > 0
/// @throws std::invalid_argument if the span ends before it starts or is not finite
Feasibility CheckFeasibility(const std::function<FlatReference(double)>& at, double start_s,
                             double end_s, const FlightLimits& limits, double gravity);

}  // namespace odmc

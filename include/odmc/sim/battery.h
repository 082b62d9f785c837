#pragma once

namespace odmc {

/// A battery whose open-circuit voltage falls linearly with the charge taken, and by itself with
/// time, behind a resistance.
class Battery {
 public:
  /// Full, without load.  @param capacity_As charge from full to empty
  /// @param slope_V_s of the voltage with time, < 0 where it falls; it never falls below 0
  Battery(double full_V, double empty_V, double capacity_As, double resistance_ohm,
          double slope_V_s);

  /// Gives `power_W` for `dt` [s] until `time_s` since it was full; what it can't give it gives at
  /// half its open-circuit voltage, the most any resistance lets through.
  void Draw(double power_W, double time_s, double dt);

  double voltage_V() const { return voltage_; }  ///< at the terminals

 private:
  double full_, empty_, capacity_, resistance_, slope_;
  double used_As_ = 0.0;
  double voltage_, current_ = 0.0;
};

}  // namespace odmc

#pragma once

namespace odmc {

/// A battery whose open-circuit voltage falls linearly with the charge taken, behind a resistance.
class Battery {
 public:
  /// Full, without load.  @param capacity_As charge from full to empty
  Battery(double full_V, double empty_V, double capacity_As, double resistance_ohm);

  /// Gives `power_W` for `dt` [s]; what it can't give it gives at half its open-circuit voltage,
  /// the most any resistance lets through.
  void Draw(double power_W, double dt);

  double voltage_V() const { return voltage_; }  ///< at the terminals
  double current_A() const { return current_; }

 private:
  double full_, empty_, capacity_, resistance_;
  double used_As_ = 0.0;
  double voltage_, current_ = 0.0;
};

}  // namespace odmc

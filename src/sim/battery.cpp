#include "odmc/sim/battery.h"

#include <algorithm>
#include <cmath>

namespace odmc {

Battery::Battery(double full_V, double empty_V, double capacity_As, double resistance_ohm,
                 double slope_V_s)
    : full_(full_V),
      empty_(empty_V),
      capacity_(capacity_As),
      resistance_(resistance_ohm),
      slope_(slope_V_s),
      voltage_(full_V) {}

// V = U - R I and I = P / V: the larger root of V² - U V + R P = 0.
void Battery::Draw(double power_W, double time_s, double dt) {
  used_As_ = std::min(used_As_ + current_ * dt, capacity_);
  const double left = full_ + slope_ * time_s - (full_ - empty_) * used_As_ / capacity_;
  const double open = std::max(0.0, left);
  const double root = std::sqrt(std::max(0.0, open * open - 4.0 * resistance_ * power_W));
  voltage_ = 0.5 * (open + root);
  if (resistance_ > 0.0) {
    current_ = (open - voltage_) / resistance_;
  } else {
    current_ = voltage_ > 0.0 ? power_W / voltage_ : 0.0;
  }
}

}  // namespace odmc

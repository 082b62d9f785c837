#include "odmc/sim/battery.h"

#include <algorithm>
#include <cmath>

namespace odmc {

Battery::Battery(double full_V, double empty_V, double capacity_As, double resistance_ohm)
    : full_(full_V),
      empty_(empty_V),
      capacity_(capacity_As),
      resistance_(resistance_ohm),
      voltage_(full_V) {}

// V = U - R I and I = P / V: the larger root of V² - U V + R P = 0.
void Battery::Draw(double power_W, double dt) {
  used_As_ = std::min(used_As_ + current_ * dt, capacity_);
  const double open = full_ - (full_ - empty_) * used_As_ / capacity_;
  const double root = std::sqrt(std::max(0.0, open * open - 4.0 * resistance_ * power_W));
  voltage_ = 0.5 * (open + root);
  current_ = resistance_ > 0.0 ? (open - voltage_) / resistance_ : power_W / voltage_;
}

}  // namespace odmc

#include "odmc/math/descent.h"

#include <utility>

namespace odmc {

CostAt Descend(CostAt start, const DescentOptions& options,
               const std::function<Eigen::VectorXd(const CostAt&)>& step_from,
               const std::function<double(const Eigen::VectorXd&)>& cost) {
  CostAt lowest = std::move(start);
  for (int i = 0; i < options.most_steps; ++i) {
    const CostAt before = lowest;
    const Eigen::VectorXd step = step_from(before);
    bool falls = false;
    for (double share = 1.0; share > options.shortest && !falls; share *= options.shorter) {
      CostAt next{before.x + share * step, 0.0};
      if (options.least.size() > 0) next.x = next.x.cwiseMax(options.least);
      if (options.most.size() > 0) next.x = next.x.cwiseMin(options.most);
      next.cost = cost(next.x);
      falls = next.cost < before.cost;
      if (falls) lowest = std::move(next);
    }
    if (!falls || before.cost - lowest.cost < options.least_gain) break;
  }
  return lowest;
}

}  // namespace odmc

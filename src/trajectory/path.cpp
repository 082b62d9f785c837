#include "path.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <utility>

#include "odmc/trajectory/minimum_snap.h"
#include "odmc/trajectory/waypoints_yaml.h"

namespace odmc {
namespace {

constexpr double kHeight_m = 2.5;  // of the middle of every named path
constexpr double kQuarter = 1.5707963267948966;

// One sinusoid A sin(w t + phase): amplitude [m] or [rad], frequency [rad/s], phase [rad].
struct Sinusoid {
  double amplitude, frequency, phase;
};

using Axes = std::array<std::vector<Sinusoid>, 4>;  // x, y, z, yaw

// A sin(y) with y = w phi(t) + phase, by the chain rule.
Derivatives Along(const Sinusoid& sine, const Derivatives& phi) {
  const double y = sine.frequency * phi[0] + sine.phase;
  const double y1 = sine.frequency * phi[1], y2 = sine.frequency * phi[2];
  const double y3 = sine.frequency * phi[3], y4 = sine.frequency * phi[4];
  const double S = sine.amplitude * std::sin(y), C = sine.amplitude * std::cos(y);
  const double y1_2 = y1 * y1;
  return {S, C * y1, C * y2 - S * y1_2, C * (y3 - y1_2 * y1) - 3.0 * S * y1 * y2,
          C * (y4 - 6.0 * y1_2 * y2) + S * (y1_2 * y1_2 - 4.0 * y1 * y3 - 3.0 * y2 * y2)};
}

Derivatives Along(const std::vector<Sinusoid>& axis, const Derivatives& phi) {
  Derivatives sum = {};
  for (const Sinusoid& sine : axis) {
    const Derivatives one = Along(sine, phi);
    for (size_t k = 0; k < sum.size(); ++k) sum[k] += one[k];
  }
  return sum;
}

// A reference whose derivatives are by phi becomes one by t, by the chain rule.
FlatReference ByTime(const FlatReference& r, const Derivatives& phi) {
  const double f1 = phi[1], f2 = phi[2], f3 = phi[3], f4 = phi[4];
  FlatReference by_t = r;
  by_t.v_WB = f1 * r.v_WB;
  by_t.a_WB = f1 * f1 * r.a_WB + f2 * r.v_WB;
  by_t.j_WB = f1 * f1 * f1 * r.j_WB + 3.0 * f1 * f2 * r.a_WB + f3 * r.v_WB;
  by_t.s_WB = f1 * f1 * f1 * f1 * r.s_WB + 6.0 * f1 * f1 * f2 * r.j_WB +
              (4.0 * f1 * f3 + 3.0 * f2 * f2) * r.a_WB + f4 * r.v_WB;
  by_t.d_yaw = f1 * r.d_yaw;
  by_t.dd_yaw = f1 * f1 * r.dd_yaw + f2 * r.d_yaw;
  return by_t;
}

// Sums of sinusoids on x, y, z and yaw.
class SinusoidPath final : public Path {
 public:
  explicit SinusoidPath(Axes axes) : axes_(std::move(axes)) {}

  FlatReference At(const Derivatives& phi) const override {
    std::array<Derivatives, 4> along;
    for (size_t i = 0; i < along.size(); ++i) along[i] = Along(axes_[i], phi);
    along[2][0] += kHeight_m;
    const auto order = [&along](size_t k) {
      return Eigen::Vector3d(along[0][k], along[1][k], along[2][k]);
    };
    FlatReference reference = {order(0), order(1), order(2), order(3), order(4)};
    reference.yaw = along[3][0];
    reference.d_yaw = along[3][1];
    reference.dd_yaw = along[3][2];
    return reference;
  }

  // Frequencies without a common period come close to their top speed within two minutes.
  double span_s() const override { return 120.0; }

 private:
  Axes axes_;
};

// Lemniscate of Gerono, x = A sin(w t), y = B sin(2 w t), seen along: yaw is that of the tangent,
// which never vanishes. 4.0 m/s, 23 deg, yaw rates to 2.2 rad/s.
class LemniscatePath final : public Path {
 public:
  FlatReference At(const Derivatives& phi) const override {
    const Derivatives own = {phi[0], 1.0, 0.0, 0.0, 0.0};
    const Derivatives x = Along({kLength, kFrequency, 0.0}, own);
    const Derivatives y = Along({kWidth, 2.0 * kFrequency, 0.0}, own);
    FlatReference r;
    r.p_WB = {x[0], y[0], kHeight_m};
    r.v_WB = {x[1], y[1], 0.0};
    r.a_WB = {x[2], y[2], 0.0};
    r.j_WB = {x[3], y[3], 0.0};
    r.s_WB = {x[4], y[4], 0.0};
    LookAlong(&r);
    return ByTime(r, phi);
  }

  double span_s() const override { return 4.0 * kQuarter / kFrequency; }

 private:
  static constexpr double kLength = 4.0, kWidth = 2.0, kFrequency = 0.7;

  // The tangent swings less than half a turn to either side of -y, so measured from there its
  // angle never jumps.
  static void LookAlong(FlatReference* r) {
    const double speed_2 = r->v_WB.squaredNorm();
    r->yaw = std::atan2(r->v_WB.x(), -r->v_WB.y()) - kQuarter;
    r->d_yaw = r->v_WB.cross(r->a_WB).z() / speed_2;
    r->dd_yaw = (r->v_WB.cross(r->j_WB).z() - 2.0 * r->d_yaw * r->v_WB.dot(r->a_WB)) / speed_2;
  }
};

// A polynomial path flown once, or forth and back for ever. Turning back at its end, where it
// rests, keeps snap continuous: even derivatives are the same in both directions.
class PolynomialPath final : public Path {
 public:
  enum class Repeat { kOnce, kForthAndBack };

  PolynomialPath(MinimumSnap polynomials, Repeat repeat)
      : polynomials_(std::move(polynomials)), repeat_(repeat) {}

  FlatReference At(const Derivatives& phi) const override {
    const double duration_s = polynomials_.duration_s();
    if (repeat_ == Repeat::kOnce) return ByTime(polynomials_.At(phi[0]), phi);
    const double time_s = std::fmod(phi[0], 2.0 * duration_s);
    if (time_s <= duration_s) return ByTime(polynomials_.At(time_s), phi);
    return ByTime(polynomials_.At(2.0 * duration_s - time_s), Scaled(-1.0, phi));
  }

  double span_s() const override { return polynomials_.duration_s(); }
  bool needs_ramp() const override { return repeat_ != Repeat::kOnce; }

 private:
  MinimumSnap polynomials_;
  Repeat repeat_;
};

// Every three seconds one of x, y, z (by 1 m) and yaw (by 45 deg) steps out, then each steps back.
class StepPath final : public Path {
 public:
  FlatReference At(const Derivatives& phi) const override {
    const int phase = static_cast<int>(std::fmod(phi[0] / kHold_s, 8.0));
    const auto is_out = [phase](int axis) { return phase > axis && phase <= axis + 4 ? 1.0 : 0.0; };
    FlatReference reference;
    reference.p_WB = Eigen::Vector3d(is_out(0), is_out(1), is_out(2) + kHeight_m);
    reference.yaw = is_out(3) * 0.5 * kQuarter;
    return reference;
  }

  double span_s() const override { return 8.0 * kHold_s; }
  bool needs_ramp() const override { return false; }

 private:
  static constexpr double kHold_s = 3.0;
};

// Figure of eight with vertical and yaw motion: 6.1 m/s, 44 deg.              model.md section 8
Axes Octo() {
  return {{{{4.6, 1.165, 0.0}}, {{1.25, 2.33, 0.0}}, {{0.6, 0.99, 0.0}}, {{1.2, 0.7, 0.0}}}};
}

// Fast and rich in frequencies: 8.4 m/s, 69 deg, rates of 2.5 rad/s and more.  model.md section 8
Axes Aggressive() {
  return {{{{3.19, 2.287, 0.0}, {0.62, 1.606, 0.0}},
           {{2.43, 2.287, 1.62}, {0.225, 3.365, 0.0}},
           {{0.35, 1.9, 0.0}, {0.1, 4.1, 0.0}},
           {{1.0, 1.1, 0.0}, {0.25, 2.7, 0.0}}}};
}

// A horizontal V, forth and back: 3.5 m/s, with its sharp turn at the tip.
std::shared_ptr<const Path> VShape() {
  FlightLimits limits;
  limits.max_speed_m_s = 3.5;
  const std::vector<Waypoint> waypoints = {
      {{-3.0, 2.5, kHeight_m}, {}}, {{0.0, -2.5, kHeight_m}, {}}, {{3.0, 2.5, kHeight_m}, {}}};
  return std::make_shared<PolynomialPath>(MinimumSnap(waypoints, limits),
                                          PolynomialPath::Repeat::kForthAndBack);
}

std::shared_ptr<const Path> Sinusoids(const Axes& axes) {
  return std::make_shared<SinusoidPath>(axes);
}

using Catalogue = std::vector<std::pair<std::string, std::function<std::shared_ptr<const Path>()>>>;

const Catalogue& Paths() {
  static const Catalogue paths = {
      {"hover", [] { return Sinusoids({}); }},
      {"octo", [] { return Sinusoids(Octo()); }},
      {"circle",
       [] {
         return Sinusoids({{{{2.0, 2.0, kQuarter}}, {{2.0, 2.0, 0.0}}, {}, {}}});
       }},
      {"vertical",
       [] {
         return Sinusoids({{{}, {}, {{1.5, 1.6, 0.0}}, {}}});
       }},
      {"yaw",
       [] {
         return Sinusoids({{{}, {}, {}, {{1.745, 1.2, 0.0}}}});
       }},
      {"aggressive", [] { return Sinusoids(Aggressive()); }},
      {"vshape", VShape},
      {"lemniscate", [] { return std::make_shared<LemniscatePath>(); }},
      {"steps", [] { return std::make_shared<StepPath>(); }},
  };
  return paths;
}

}  // namespace

double Path::TopSpeed() const {
  constexpr double kStep_s = 0.002;
  double top = 0.0;
  for (double time_s = 0.0; time_s <= span_s(); time_s += kStep_s) {
    top = std::max(top, At({time_s, 1.0, 0.0, 0.0, 0.0}).v_WB.norm());
  }
  return top;
}

const std::vector<std::string>& PathNames() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list;
    for (const auto& path : Paths()) list.push_back(path.first);
    return list;
  }();
  return names;
}

std::shared_ptr<const Path> MakePath(const std::string& name) {
  for (const auto& [known, make] : Paths()) {
    if (known == name) return make();
  }
  throw std::out_of_range("no path '" + name + "'");
}

std::shared_ptr<const Path> MakeWaypointPath(const std::string& file) {
  const WaypointFile plan = LoadWaypoints(file);
  return std::make_shared<PolynomialPath>(MinimumSnap(plan.waypoints, plan.limits),
                                          PolynomialPath::Repeat::kOnce);
}

}  // namespace odmc

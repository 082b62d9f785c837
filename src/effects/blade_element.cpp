#include <vector>

#include "odmc/effects/blade_inflow.h"
#include "odmc/effects/effects.h"
#include "rotor_air.h"
#include "rotor_wake.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// What moves a rotor's wrench: the hub's air velocity, own parameters, the borrowed k_f.
enum Variable : int { kAir = 0, kOwn = 3, kThrust = 9, kNumVariables = 10 };
using Number = Dual<kNumVariables>;

/// Blades in numbers. docs/effects.md, "Blade elements and momentum", Eq. (F9) to (F14).
struct Blades {
  Number lift, twist, profile_drag, flapping, lag, wake;
  Number pitch, pitch_at_half;  ///< that give the static thrust k_f [rad]
  Number hover_inflow;          ///< induced velocity of hover over tip speed
};

/// What a rotor does at its hub beyond its static thrust and torque, in the axes of the body,
/// without the sign of its spin. Pitch and roll are about the axes across and along the in-plane
/// air velocity u_h: pitch (u_h × e3), roll u_h.
struct HubWrench {
  Number thrust;    ///< along e3 [N]
  Number in_plane;  ///< along -u_h [N s/m]
  Number pitch;     ///< [N s]
  Number roll;      ///< [N s], for a rotor that turns clockwise seen from above
  Number torque;    ///< reaction [N m], likewise
};

/// Rotor forces and moments by blade-element theory with the induced velocity of momentum theory:
/// all that changes with the air the rotor meets. In still air it is nothing: `thrust` and
/// `rotor_torque` hold the static values, and k_f ties the blades' pitch.   docs/effects.md
class BladeElement final : public Effect {
 public:
  explicit BladeElement(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"blade_element", "Blade elements and momentum",
             "at hub j: (T(u_j) - k_f Omega_j^2) e3 - (H + f T a_1) u_h/|u_h|, moments of the "
             "advancing blade and of the skewed wake, s_j (Q(u_j) - Q(0)) e3; T = 2 rho A v W",
             "model.md 12.1, 12.3, 12.4 and 12.5 from one rotor model; Glauert 1926; Leishman "
             "2006, ch. 2 and 3; Johnson 1980; docs/effects.md, Eq. (F9) to (F14)",
             "advance ratio below 0.4, attached flow; quasi-steady; in place of rotor_drag, drag "
             "along x and y, axial_inflow, hvt, hub_moment and vortex_ring"},
            Specs(), {"thrust.k_f"}) {}

  /// No candidate: it replaces other effects.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override { return {}; }
  std::vector<std::string> shown_by() const override { return {}; }

  /// What ties the pitch.
  std::vector<DerivedFigure> DerivedFigures(const Eigen::VectorXd& own) const override {
    if (vehicle().rotors.empty()) return {};
    const auto it = vehicle().parameters.find("thrust.k_f");
    const double speed = HoverSpeed(vehicle());
    const double k_f =
        it != vehicle().parameters.end() && it->second.value
            ? *it->second.value
            : vehicle().mass_kg * vehicle().gravity_m_s2 / (vehicle().num_rotors() * speed * speed);
    Eigen::VectorXd values(own.size() + 1);
    values << own, k_f;
    return {{"pitch", "rad", BladesOf(values, vehicle().rotors.front().radius_m).pitch.v}};
  }

 private:
  static std::vector<ParameterSpec> Specs() {
    const auto positive = PhysicalSign::kPositive, negative = PhysicalSign::kNegative;
    const auto linear = ParameterTransform::kLinear;
    return {
        // Two to three blades of 0.03 to 0.06 each; 4 to 5.7 per radian at their Reynolds numbers.
        {"lift", "1", "lift slope times solidity", 0.7, 0.3, 0.7, ParameterTransform::kLog,
         positive},
        // A screw of constant geometric pitch, 0.8 to 0.9 of the diameter.
        {"twist", "rad", "pitch at the tip less that at the root, linear", -0.4, 0.2, 0.2, linear,
         negative},
        // Solidity 0.1 to 0.2 times 0.02 to 0.04 at Reynolds numbers of 50,000.
        {"profile_drag", "1", "drag coefficient of the blades at no lift times solidity", 0.005,
         0.004, 0.004, linear, positive},
        // S the stiffness of the blade root over the aerodynamic damping of flapping.
        {"flapping", "1", "share of a freely flapping rotor's tilt, 1/(1 + S^2)", 0.1, 0.1, 0.1,
         linear, positive},
        {"lag", "1", "share of the moment that flapping turns by a quarter turn, S/(1 + S^2)", 0.2,
         0.2, 0.2, linear, positive},
        {"wake", "1", "gradient of the inflow of a skewed wake over that of Pitt and Peters", 1.0,
         0.5, 0.5, linear, positive}};
  }

  static Blades BladesOf(const ParameterValues& values, double radius) {
    const auto own = [&](int i) { return Number::Variable(values[i], kOwn + i); };
    Blades b;
    b.lift = own(0), b.twist = own(1), b.profile_drag = own(2);
    b.flapping = own(3), b.lag = own(4), b.wake = own(5);
    // C_T = σa/2 (θ/3 - λ/2) and λ = sqrt(C_T/2) in hover.
    const double area = M_PI * radius * radius;
    const Number coefficient =
        Number::Variable(values[6], kThrust) / (kAirDensity * area * radius * radius);
    b.hover_inflow = sqrt(0.5 * coefficient);
    b.pitch = 3.0 * (2.0 * coefficient / b.lift + 0.5 * b.hover_inflow);
    b.pitch_at_half = b.pitch - 0.25 * b.twist;
    return b;
  }

  static HubWrench WrenchOf(const Blades& b, const Number& k_f, const Vector3d& air, double tip,
                            double radius) {
    constexpr double kSlowestTip = 5.0;  // [m/s]: what is over the tip speed stays finite
    constexpr double kInflow = 0.5;      // [m/s]: smooth |w|
    constexpr double kPittPeters = 15.0 * M_PI / 32.0;
    const Number x = Number::Variable(air.x(), kAir), y = Number::Variable(air.y(), kAir + 1);
    const BladeFlow<Number> flow{
        x * x + y * y, Number::Variable(air.z(), kAir + 2), tip, b.lift, b.pitch, b.pitch_at_half};
    const Number v = InducedVelocityWithSlope(flow);
    const Number w = flow.axial + v, w0 = tip * b.hover_inflow;
    const double disc = kAirDensity * M_PI * radius * radius;
    const double turning = std::max(tip, kSlowestTip);
    const Number half_lift = 0.5 * b.lift;
    // Gradient of the inflow along u_h, per unit of u_h: K v tan(χ/2) / |u_h|.
    const Number size = sqrt(w * w + kInflow * kInflow);
    const Number gradient =
        kPittPeters * b.wake * v / (sqrt(flow.in_plane_squared + w * w + kInflow * kInflow) + size);
    const Number thrust = disc * BladeThrust(flow, v);
    const Number tilt = (8.0 / 3.0 * b.pitch - 2.0 / turning * w) / turning;  // per unit of u_h
    const Number advancing = disc * radius * half_lift * (tip / 3.0 * b.pitch - 0.25 * w);
    const Number skewed = disc * radius * 0.125 * tip * half_lift * gradient;
    HubWrench hub;
    hub.thrust = thrust - k_f * (tip * tip / (radius * radius));
    hub.in_plane = 0.25 * disc * (b.lift * w * b.pitch_at_half + tip * b.profile_drag) +
                   b.flapping * thrust * tilt;
    hub.pitch = b.lag * advancing + (1.0 - b.flapping) * skewed;
    hub.roll = (1.0 - b.flapping) * advancing - b.lag * skewed;
    hub.torque = disc * radius *
                 (half_lift * (tip / 3.0 * b.pitch * (w - w0) - 0.5 * (w * w - w0 * w0) -
                               0.125 * flow.in_plane_squared * gradient * gradient) +
                  0.125 * b.profile_drag * flow.in_plane_squared);
    return hub;
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Number k_f = Number::Variable(values[6], kThrust);
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Vector3d u = HubAirVelocity(state, rotor);
      const Blades blades = BladesOf(values, rotor.radius_m);
      const double tip = std::max(0.0, state.rotors.speed[j]) * rotor.radius_m;
      const HubWrench hub = WrenchOf(blades, k_f, u, tip, rotor.radius_m);
      AddHub(rotor, hub, u, wrench, J);
    }
  }

  static void AddHub(const Rotor& rotor, const HubWrench& hub, const Vector3d& u, Wrench* wrench,
                     WrenchJacobians* J) {
    const Vector3d e3 = Vector3d::UnitZ(), along(u.x(), u.y(), 0.0), across(u.y(), -u.x(), 0.0);
    const double s = rotor.spin;
    const Vector3d force = hub.thrust.v * e3 - hub.in_plane.v * along;
    wrench->AddCouple(hub.pitch.v * across + s * hub.roll.v * along + s * hub.torque.v * e3);
    if (J == nullptr) {
      wrench->AddForceAt(rotor.p_BP, force);
      return;
    }
    // 3×10 each.
    Eigen::Matrix<double, 3, kNumVariables> d_force =
        e3 * hub.thrust.d.transpose() - along * hub.in_plane.d.transpose();
    Eigen::Matrix<double, 3, kNumVariables> d_couple = across * hub.pitch.d.transpose() +
                                                       s * along * hub.roll.d.transpose() +
                                                       s * e3 * hub.torque.d.transpose();
    d_force.topLeftCorner<2, 2>().diagonal().array() -= hub.in_plane.v;
    d_couple.topLeftCorner<2, 2>().diagonal().array() += s * hub.roll.v;
    d_couple(0, 1) += hub.pitch.v;
    d_couple(1, 0) -= hub.pitch.v;
    const Matrix3d d_couple_air = d_couple.leftCols<3>();
    AddHubForce(rotor, force, d_force.leftCols<3>(), wrench, J);
    J->AddCouple(kColumnAirVelocity, d_couple_air);
    J->AddCouple(kColumnAngularRate, TimesHat(d_couple_air, -rotor.p_BP));
    for (int i = 0; i < kNumVariables - kOwn; ++i) {
      J->AddForceAtParameter(rotor.p_BP, i, d_force.col(kOwn + i));
      J->AddCoupleParameter(i, d_couple.col(kOwn + i));
    }
  }
};

}  // namespace

std::unique_ptr<Effect> MakeBladeElement(const Vehicle& vehicle) {
  return std::make_unique<BladeElement>(vehicle);
}

}  // namespace odmc

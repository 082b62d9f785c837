#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Moves the point torques are taken about: p_BBcm. Adds no force.
///                                    model.md section 2, Eq. (M3); paper Eq. (7) to (10)
class CentreOfGravity final : public Effect {
 public:
  explicit CentreOfGravity(const Vehicle& vehicle)
      : Effect(vehicle,
               {"centre_of_gravity", "Centre of gravity", "tau = sum (r_j - c) x f_j + couples",
                "model.md section 2; paper Eq. (7) to (10), sign corrected",
                "c_z is seen only with rates and lateral forces (model.md section 10)"},
               {Axis("x", vehicle), Axis("y", vehicle), Axis("z", vehicle)}) {}

  bool adds_wrench() const override { return false; }
  bool changes_between_flights() const override { return true; }
  BodyPropertyRows shaped_rows() const override { return {kRowCom, 3}; }

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {
        "pitches forward and back", "rolls to both sides", "quick changes of direction at speed"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  static ParameterSpec Axis(const std::string& name, const Vehicle& vehicle) {
    return {name,
            "m",
            "centre of gravity from the rotor centre, body " + name,
            0.0,
            0.2 * vehicle.ArmLength(),
            0.05 * vehicle.ArmLength()};
  }

  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    body->p_BBcm += values.head<3>();
    if (J != nullptr) J->block<3, 3>(kRowCom, 0).setIdentity();
  }
};

}  // namespace

std::unique_ptr<Effect> MakeCentreOfGravity(const Vehicle& vehicle) {
  return std::make_unique<CentreOfGravity>(vehicle);
}

}  // namespace odmc

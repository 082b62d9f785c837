#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Principal inertia about Bcm, in body axes; always positive.
///                                                     model.md section 2, Eq. (A); paper Eq. (1)
class Inertia final : public Effect {
 public:
  explicit Inertia(const Vehicle& vehicle)
      : Effect(vehicle,
               {"inertia", "Inertia", "I dw/dt = tau - w x I w, I = diag(x, y, z)",
                "model.md sections 2, 4.4 and 9; paper Eq. (1)",
                "needs angular acceleration: hover and straight flight do not show it"},
               {Axis(0, vehicle), Axis(1, vehicle), Axis(2, vehicle)}) {}

  bool adds_wrench() const override { return false; }
  BodyPropertyRows shaped_rows() const override { return {kRowInertia, 3}; }

  /// No candidate: it is the base of every model.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override { return {}; }

  std::string manoeuvre(size_t k) const override {
    static const std::vector<std::string> kShownBy = {"quick rolls", "quick pitches",
                                                      "quick turns of the heading"};
    return kShownBy[std::min(k, kShownBy.size() - 1)];
  }

 private:
  static ParameterSpec Axis(int axis, const Vehicle& vehicle) {
    const std::string letter(1, "xyz"[axis]);
    const double nominal = vehicle.inertia_kg_m2[axis];
    return {letter,
            "kg m^2",
            "inertia about the centre of gravity, body " + letter,
            nominal,
            0.4 * nominal,
            nominal,
            ParameterTransform::kLog,
            PhysicalSign::kPositive,
            false,
            {},
            {},
            false,
            true};
  }

  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    body->I_BBcm_B.diagonal() += values.head<3>() - vehicle().inertia_kg_m2;
    if (J != nullptr) J->block<3, 3>(kRowInertia, 0).setIdentity();
  }
};

}  // namespace

std::unique_ptr<Effect> MakeInertia(const Vehicle& vehicle) {
  return std::make_unique<Inertia>(vehicle);
}

}  // namespace odmc

#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Thrust lost to air that comes from above: f_j = -k_z Ω_j e3 (e3·u_j) at hub j.
///                                                                  model.md 12.3, Eq. (M30)
class AxialInflow final : public Effect {
 public:
  explicit AxialInflow(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"axial_inflow", "Thrust loss with axial inflow", "f_j = -k_z Omega_j u_jz e3 at hub j",
             "model.md 12.3; Leishman; Hoffmann et al. 2007; Huang et al. 2009",
             "climb and moderate descent; not in the vortex ring state"},
            {HubDampingSpec("k_z", "thrust loss per rotor speed and axial air speed", vehicle)}) {}

  std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const override {
    return {{"drag", "vertical oscillation with load changes, and roll rates"},
            {"rotor_delay", "slow climbs and descents"}};
  }
  std::vector<std::string> shown_by() const override { return {"aggressive", "octo", "vertical"}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddHubDamping(state, vehicle(), values[0], Eigen::Vector3d::UnitZ(), 0, wrench, J);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeAxialInflow(const Vehicle& vehicle) {
  return std::make_unique<AxialInflow>(vehicle);
}

}  // namespace odmc

#include "odmc/control/flat_inputs.h"

#include <cmath>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

constexpr double kStep_s = 0.004;  // of differences along the reference
constexpr int kRounds = 4;         // attitude and the air's force, each from the other

// Motion along a reference, to second order about its instant.
class Along {
 public:
  Along(const ControlModel& model, const FlatReference& reference, const FlatAttitude& attitude)
      : model_(model), reference_(reference), attitude_(attitude) {
    const double squared =
        model.properties().mass * attitude.specific_thrust / model.rotor_map().row(0).sum();
    speeds_.setConstant(model.model().vehicle().num_rotors(), std::sqrt(squared));
  }

  BodyWrench AirAt(double h, Eigen::Matrix3d* R_WB) const {
    const Eigen::Vector3d turn = h * attitude_.w_WB_B + 0.5 * h * h * attitude_.dw_WB_B;
    *R_WB = (attitude_.q_WB * Exp(turn)).toRotationMatrix();
    const Eigen::Vector3d p = reference_.p_WB + h * reference_.v_WB;
    const Eigen::Vector3d v = reference_.v_WB + h * (reference_.a_WB + 0.5 * h * reference_.j_WB);
    const Eigen::Vector3d w = attitude_.w_WB_B + h * attitude_.dw_WB_B;
    return model_.AirWrench(p, *R_WB, v, w, speeds_);
  }

  // Acceleration by the air, less that of Bo about Bcm, in W.
  Eigen::Vector3d AccelerationAt(double h) const {
    Eigen::Matrix3d R_WB;
    const BodyWrench air = AirAt(h, &R_WB);
    const Eigen::Vector3d w = attitude_.w_WB_B + h * attitude_.dw_WB_B;
    const Eigen::Vector3d& c = model_.properties().p_BBcm;
    const Eigen::Vector3d lever_B = attitude_.dw_WB_B.cross(c) + w.cross(w.cross(c));
    return R_WB * (air.f_B / model_.properties().mass - lever_B);
  }

 private:
  const ControlModel& model_;
  const FlatReference& reference_;
  const FlatAttitude& attitude_;
  RotorVector speeds_;
};

FlatReference Less(const FlatReference& reference, const Along& along) {
  const Eigen::Vector3d before = along.AccelerationAt(-kStep_s), at = along.AccelerationAt(0.0),
                        after = along.AccelerationAt(kStep_s);
  FlatReference left = reference;
  left.a_WB -= at;
  left.j_WB -= (after - before) / (2.0 * kStep_s);
  left.s_WB -= (after - 2.0 * at + before) / (kStep_s * kStep_s);
  return left;
}

}  // namespace

FlatReference ReferenceWithoutAir(const ControlModel& model, const FlatReference& reference) {
  return Less(reference,
              Along(model, reference, FlatAttitudeOf(reference, model.properties().g_W)));
}

FlatInputs FlatInputsOf(const ControlModel& model, const Allocation& allocation,
                        const FlatReference& reference) {
  const BodyProperties& properties = model.properties();
  FlatInputs inputs;
  inputs.attitude = FlatAttitudeOf(reference, properties.g_W);
  for (int round = 0; round < kRounds; ++round) {
    const FlatReference left = Less(reference, Along(model, reference, inputs.attitude));
    inputs.attitude = FlatAttitudeOf(left, properties.g_W);
  }
  const FlatAttitude& attitude = inputs.attitude;
  inputs.thrust_N = properties.mass * attitude.specific_thrust;
  Eigen::Matrix3d R_WB;
  const BodyWrench air = Along(model, reference, attitude).AirAt(0.0, &R_WB);
  const Eigen::Matrix3d& I = properties.I_BBcm_B;
  inputs.tau_Bcm_B =
      I * attitude.dw_WB_B + attitude.w_WB_B.cross(I * attitude.w_WB_B) - air.tau_Bcm_B;
  Eigen::Vector4d wrench;
  wrench << inputs.thrust_N, inputs.tau_Bcm_B;
  inputs.rotor_speed = allocation.SquaredSpeeds(wrench).cwiseSqrt();
  return inputs;
}

}  // namespace odmc

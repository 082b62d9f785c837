#include "odmc/effects/effects.h"

namespace odmc {

void RegisterAllEffects(EffectRegistry* registry) {
  registry->Add("thrust", MakeThrust);
  registry->Add("rotor_torque", MakeRotorTorque);
  registry->Add("drag", MakeDrag);
  registry->Add("viscous_torque", MakeViscousTorque);
  registry->Add("hvt", MakeHvt);
  registry->Add("centre_of_gravity", MakeCentreOfGravity);
  registry->Add("inertia", MakeInertia);
  registry->Add("gravity", MakeGravity);
  registry->Add("odometry_extrinsics", MakeOdometryExtrinsics);
  registry->Add("imu_extrinsics", MakeImuExtrinsics);
}

}  // namespace odmc

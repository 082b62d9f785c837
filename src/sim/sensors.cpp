#include "odmc/sim/sensors.h"

#include <algorithm>

#include "odmc/math/so3.h"

namespace odmc {

OdometrySample OdometryOf(Stamp stamp, const RigidBodyState& state,
                          const BodyProperties& properties) {
  const Eigen::Quaterniond q_BS(properties.R_BS);
  OdometrySample sample;
  sample.stamp = stamp;
  sample.p_WS = state.p_WB + state.q_WB * properties.p_BS;
  sample.q_WS = (state.q_WB * q_BS).normalized();
  sample.v_WS = state.v_WB + state.q_WB * state.w_WB_B.cross(properties.p_BS);
  sample.w_WS_S = properties.R_BS.transpose() * state.w_WB_B;
  return sample;
}

ImuSample ImuOf(const TruthSample& truth, const BodyProperties& properties) {
  const Eigen::Vector3d p_BcmI_B = properties.p_BI - properties.p_BBcm;
  const Eigen::Vector3d& w = truth.w_WB_B;
  const Eigen::Vector3d specific_force_B =
      truth.f_B / properties.mass + truth.dw_WB_B.cross(p_BcmI_B) + w.cross(w.cross(p_BcmI_B));
  ImuSample sample;
  sample.stamp = truth.stamp;
  sample.gyro_I = properties.R_BI.transpose() * w;
  sample.specific_force_I = properties.R_BI.transpose() * specific_force_B;
  return sample;
}

void AddNoise(const OdometryErrors& noise, Gaussian* random, OdometrySample* sample) {
  sample->p_WS += noise.position_m * random->Next3();
  sample->q_WS = (sample->q_WS * Exp(noise.attitude_rad * random->Next3())).normalized();
  *sample->v_WS += noise.velocity_m_s * random->Next3();
  *sample->w_WS_S += noise.rate_rad_s * random->Next3();
}

void AddNoise(const ImuErrors& noise, Gaussian* random, ImuSample* sample) {
  *sample->gyro_I += noise.gyro_bias + noise.gyro_rad_s * random->Next3();
  *sample->specific_force_I +=
      noise.accelerometer_bias + noise.accelerometer_m_s2 * random->Next3();
}

void AddNoise(double sigma, Gaussian* random, RotorVector* speed) {
  for (double& value : *speed) {
    const double error = sigma * random->Next();
    if (value > 0.0) value = std::max(0.0, value + error);
  }
}

}  // namespace odmc

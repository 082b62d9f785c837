#include "odmc/ros/estimate_messages.h"

#include <cmath>

#include "odmc/ros/conversions.h"

namespace odmc {

bool IsFinite(const Snapshot& s) {
  return s.values.allFinite() && s.sigma.allFinite() && s.covariance.allFinite() &&
         s.state.p_WS.allFinite() && s.state.q_WS.coeffs().allFinite() &&
         s.state.v_WS.allFinite() && s.state.w_WS_S.allFinite() && s.body.p_BS.allFinite() &&
         s.body.R_BS.allFinite() && s.body.p_BI.allFinite() && s.body.R_BI.allFinite() &&
         s.residual_force_B.allFinite() && s.residual_torque_B.allFinite() &&
         std::isfinite(s.residual_force_rms_N) && std::isfinite(s.residual_torque_rms_Nm) &&
         std::isfinite(s.battery_voltage_V);
}

DynamicParameters ToMessage(const DynamicModel& model, const Snapshot& snapshot,
                            const std::string& body_frame) {
  DynamicParameters m;
  m.header = MakeHeader(snapshot.stamp, body_frame);
  m.vehicle = model.vehicle().name;
  const ParameterSet set = Estimator::ToParameterSet(model, snapshot);
  m.effects = set.effects;
  for (const ParameterEstimate& p : set.parameters) m.parameters.push_back(ToMessage(p));
  // Symmetric, so the order of storage does not matter.
  m.covariance.assign(snapshot.covariance.data(),
                      snapshot.covariance.data() + snapshot.covariance.size());
  m.unobservable = snapshot.unobservable;
  m.airborne = snapshot.airborne;
  m.residual_force_N = snapshot.residual_force_rms_N;
  m.residual_torque_Nm = snapshot.residual_torque_rms_Nm;
  m.battery_voltage_V = snapshot.battery_voltage_V;
  m.states_in_window = static_cast<std::uint32_t>(snapshot.timing.states);
  m.update_ms = snapshot.timing.wall_ms;
  return m;
}

UnexplainedResidual ToMessage(const ResidualAnalysis& look, const std::string& body_frame,
                              const std::vector<std::string>& added) {
  UnexplainedResidual m;
  m.header = MakeHeader(look.stamp, body_frame);
  m.flight_s = look.flight_s;
  m.effects = look.model->effect_names();
  for (int i = 0; i < 3; ++i) {
    m.force_rmse_N[i] = look.force_rmse_N[i];
    m.torque_rmse_Nm[i] = look.torque_rmse_Nm[i];
  }
  m.structured_share = look.structured_share;
  m.channel = look.channel;
  m.whiteness_p = look.whiteness_p;
  m.structured = look.structured;
  m.in_a_row = static_cast<std::uint32_t>(look.in_a_row);
  m.added = added;
  if (!look.candidate) return m;
  m.candidate = look.candidate->name;
  m.score = look.candidate->score;
  m.explained_share = look.explained_share;
  for (const ParameterEstimate& p : look.candidate->parameters) {
    m.parameters.push_back(ToMessage(p));
  }
  m.beside = look.beside;
  m.alternatives = look.alternatives;
  return m;
}

nav_msgs::Odometry BodyOdometry(const Snapshot& snapshot, const std::string& world_frame,
                                const std::string& body_frame) {
  const BodyProperties& body = snapshot.body;
  const Eigen::Quaterniond q_SB(body.R_BS.transpose());
  const Eigen::Quaterniond q_WB = (snapshot.state.q_WS * q_SB).normalized();
  const Eigen::Vector3d p_WB = snapshot.state.p_WS - q_WB * body.p_BS;
  const Eigen::Vector3d w_WB_B = body.R_BS * snapshot.state.w_WS_S;
  // Bo moves with So, less what the turning adds over the lever arm p_BS.
  const Eigen::Vector3d v_WS_B = q_WB.conjugate() * snapshot.state.v_WS;
  const Eigen::Vector3d v_WB_B = v_WS_B - w_WB_B.cross(body.p_BS);

  nav_msgs::Odometry m;
  m.header = MakeHeader(snapshot.stamp, world_frame);
  m.child_frame_id = body_frame;
  m.pose.pose.position = ToPoint(p_WB);
  m.pose.pose.orientation = ToQuaternion(q_WB);
  m.twist.twist.linear = ToVector3(v_WB_B);
  m.twist.twist.angular = ToVector3(w_WB_B);
  return m;
}

geometry_msgs::WrenchStamped ResidualWrench(const Snapshot& snapshot,
                                            const std::string& body_frame) {
  geometry_msgs::WrenchStamped m;
  m.header = MakeHeader(snapshot.stamp, body_frame);
  m.wrench.force = ToVector3(snapshot.residual_force_B);
  m.wrench.torque = ToVector3(snapshot.residual_torque_B);
  return m;
}

}  // namespace odmc

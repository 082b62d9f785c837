#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

enum class Sensor { kOdometry, kImu };

/// Pose of a sensor's own frame S in the body: p_BS and R_BS = Exp((rx, ry, rz)). The prior is the
/// vehicle file's pose.                                       model.md sections 1 and 6.4, paper
/// (20)
class Extrinsics final : public Effect {
 public:
  Extrinsics(const Vehicle& vehicle, Sensor sensor)
      : Effect(vehicle, Description(sensor), Parameters(vehicle, sensor)), sensor_(sensor) {}

  bool adds_wrench() const override { return false; }
  BodyPropertyRows shaped_rows() const override {
    return {sensor_ == Sensor::kOdometry ? kRowOdometryPosition : kRowImuPosition, 6};
  }

  /// The odometry's: a point that moves otherwise than the body's origin does so by the motion
  /// alone.
  bool is_kinematic() const override { return sensor_ == Sensor::kOdometry; }

  /// Where it sits, unless that was measured. Never how it is turned: that is the frame in which
  /// all others are seen, and a torque that no effect explains would turn it.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override {
    if (MountOf(vehicle(), sensor_).p_BS_sigma_m) return {};
    EffectTrial trial;
    trial.freed = {"px", "py", "pz"};
    return {trial};
  }
  std::vector<DerivedFigure> DerivedFigures(const Eigen::VectorXd& own) const override {
    return {{"distance", "m", own.head<3>().norm()}};
  }
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  static EffectDescription Description(Sensor sensor) {
    const std::string who = sensor == Sensor::kOdometry ? "odometry" : "imu";
    return {who + "_extrinsics", "Pose of the " + who + " sensor in the body",
            "p_BS = (px, py, pz), R_BS = Exp((rx, ry, rz))",
            "model.md sections 1, 6.1 and 6.4; paper Eq. (20)",
            "pz is one with c_z, roll and pitch with gravity at constant heading (model.md 10)"};
  }

  static SensorMount MountOf(const Vehicle& vehicle, Sensor sensor) {
    return sensor == Sensor::kOdometry ? vehicle.odometry : vehicle.imu.value_or(SensorMount());
  }

  static std::vector<ParameterSpec> Parameters(const Vehicle& vehicle, Sensor sensor) {
    constexpr double kNaturalTurn_rad = 0.1;
    const SensorMount mount = MountOf(vehicle, sensor);
    const Eigen::Vector3d rotation = Log(mount.q_BS.normalized());
    const double length = 0.3 * vehicle.ArmLength();
    const double length_sigma = mount.p_BS_sigma_m.value_or(length);
    const double turn_sigma = mount.q_BS_sigma_rad.value_or(kNaturalTurn_rad);
    std::vector<ParameterSpec> specs;
    specs.reserve(6);
    for (int i = 0; i < 3; ++i) {
      specs.push_back({std::string("p") + "xyz"[i], "m",
                       std::string("sensor position, body ") + "xyz"[i], mount.p_BS[i],
                       length_sigma, length});
    }
    for (int i = 0; i < 3; ++i) {
      specs.push_back({std::string("r") + "xyz"[i], "rad",
                       std::string("sensor rotation vector, body ") + "xyz"[i], rotation[i],
                       turn_sigma, kNaturalTurn_rad});
    }
    for (ParameterSpec& spec : specs) spec.frozen_by_default = !mount.estimate;
    return specs;
  }

  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    const Eigen::Vector3d rotation = values.segment<3>(3);
    Eigen::Matrix3d J_r;
    const Eigen::Matrix3d R_BS = Exp(rotation, &J_r).toRotationMatrix();
    const bool odometry = sensor_ == Sensor::kOdometry;
    (odometry ? body->p_BS : body->p_BI) = values.head<3>();
    (odometry ? body->R_BS : body->R_BI) = R_BS;
    if (J == nullptr) return;
    const int position_row = odometry ? kRowOdometryPosition : kRowImuPosition;
    const int rotation_row = odometry ? kRowOdometryRotation : kRowImuRotation;
    J->block<3, 3>(position_row, 0).setIdentity();
    J->block<3, 3>(rotation_row, 3) = J_r;
  }

  Sensor sensor_;
};

}  // namespace

std::unique_ptr<Effect> MakeOdometryExtrinsics(const Vehicle& vehicle) {
  return std::make_unique<Extrinsics>(vehicle, Sensor::kOdometry);
}

std::unique_ptr<Effect> MakeImuExtrinsics(const Vehicle& vehicle) {
  return std::make_unique<Extrinsics>(vehicle, Sensor::kImu);
}

}  // namespace odmc

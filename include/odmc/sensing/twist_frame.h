#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Frame an odometry's linear twist is written in. The same message type carries either, depending
/// on the source, and a wrong choice turns the velocity with the heading.
enum class TwistFrame {
  kUndecided,  ///< too little motion so far, or both frames fit alike
  kBody,       ///< along the odometry's own frame S, as nav_msgs/Odometry defines it
  kWorld,      ///< along W, as VINS-Fusion, MaRS and others send it
  kNeither,    ///< the twist is not the derivative of the position in either
};

/// The frame that a setting states: body | world, or kUndecided for auto, which leaves it to the
/// motion. Nothing for any other text.
std::optional<TwistFrame> TwistFrameStated(const std::string& setting);

/// A linear twist in W.
/// @param frame  in which it is written; what is not decided counts as the body's
Eigen::Vector3d TwistInWorld(TwistFrame frame, const Eigen::Quaterniond& q_WS,
                             const Eigen::Vector3d& twist_linear);

/// What a TwistFrameDetector found so far.
struct TwistFrameDecision {
  TwistFrame frame = TwistFrame::kUndecided;
  double body_residual_m_s = 0.0;   ///< RMS of d(position)/dt - R v over the motion seen
  double world_residual_m_s = 0.0;  ///< RMS of d(position)/dt - v
  double speed_m_s = 0.0;           ///< RMS of the speed, to compare with
  double moving_s = 0.0;            ///< how much motion was seen [s]

  /// One sentence with both residuals.
  std::string Describe() const;
};

/// Decides by comparing the displacement over short stretches of motion with the integral of the
/// twist taken in either frame. Keeps its verdict once it has one. Thread-compatible.
class TwistFrameDetector {
 public:
  /// @param p_WS         position [m]
  /// @param q_WS         unit
  /// @param twist_linear as received [m/s]
  void AddSample(Stamp stamp, const Eigen::Vector3d& p_WS, const Eigen::Quaterniond& q_WS,
                 const Eigen::Vector3d& twist_linear);

  const TwistFrameDecision& decision() const { return decision_; }
  bool decided() const { return decision_.frame != TwistFrame::kUndecided; }
  /// No motion so far speaks against either frame, as on the way up to hover. Of a slow or short
  /// climb no stretch may have been fast enough to say anything: that counts, too.
  bool contradicts_none() const;

 private:
  struct Sample {
    Stamp stamp;
    Eigen::Vector3d p, v_if_body, v_if_world;
  };

  void StartStretch(const Sample& sample);
  void CloseStretch();
  void Decide();

  std::optional<Sample> last_;
  Sample first_{};  // of the stretch
  Eigen::Vector3d body_path_ = Eigen::Vector3d::Zero(), world_path_ = Eigen::Vector3d::Zero();
  double body_sum_ = 0.0, world_sum_ = 0.0, speed_sum_ = 0.0;  // squared speeds times time
  TwistFrameDecision decision_;
};

/// Frame to use: the verdict, and where there is none the frame that the message declares. By
/// definition of nav_msgs/Odometry twist is in child_frame_id, so a child_frame_id that names the
/// pose's own frame declares the world, any other the body.
TwistFrame ResolveTwistFrame(TwistFrame verdict, const std::string& frame_id,
                             const std::string& child_frame_id);

}  // namespace odmc

#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/flight_motion.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Force and torque at one sample, in the body axes of the vehicle file.
struct PredictionSample {
  double t_s = 0.0;
  double speed_m_s = 0.0;
  double height_m = 0.0, climb_m_s = 0.0;  ///< of Bo in W
  Eigen::Vector3d v_AB_B, w_WB_B;          ///< relative to the air, angular velocity [m/s, rad/s]
  Eigen::Vector3d measured_force, predicted_force;  ///< [N]
  /// predicted_force, but with the angular acceleration that the model predicts in the place of the
  /// measured one wherever a point off the centre of mass swings [N].
  Eigen::Vector3d predicted_swing_force;
  Eigen::Vector3d measured_torque, predicted_torque;                              ///< [N m]
  Eigen::Vector3d measured_angular_acceleration, predicted_angular_acceleration;  ///< [rad/s²]
  Eigen::Vector3d predicted_specific_force;  ///< of an accelerometer at the model's IMU mount, in
                                             ///< its axes [m/s²]                model.md Eq. (C)
  std::optional<Eigen::Vector3d> measured_specific_force;  ///< by the accelerometer, if any [m/s²]
  Eigen::Vector3d rotor_torque;       ///< share of the rotors' thrust and reaction in the torque
  std::vector<EffectWrench> effects;  ///< one entry per effect that adds a wrench
};

/// Figures of one axis each; empty where they cannot be had.
struct PredictionFigures {
  using Axes = std::optional<Eigen::Vector3d>;
  Axes force_rmse_N, zero_force_rmse_N, force_explained;
  /// The force's error where the recorded point swings about the centre of mass as the model has
  /// it, not as it was measured: nothing of the answer is given away.
  Axes predicted_swing_force_rmse_N;
  /// Mass times what is missed of the accelerometer's reading, in its axes, the mean (its bias)
  /// taken off; of the samples that have one, where those are more than half.
  Axes accelerometer_force_rmse_N;
  Axes torque_rmse_Nm, zero_torque_rmse_Nm, torque_explained;
  Axes rotor_torque_gain;                 ///< factor on the rotor torque that would fit best
  Axes angular_acceleration_rmse_rad_s2;  ///< with the estimated inertia
  Axes inertia_over_nominal;
  long samples = 0;          ///< that count
  long left_out_gaps = 0;    ///< within one filter window of a gap
  long left_out_ground = 0;  ///< on the ground

  /// True if the measured angular acceleration tells a part of the force that is to be predicted:
  /// with the predicted one the error is another by 1 % or more.
  bool GivesAway() const;
};

/// Force and torque that `values` predict on a flight, against those its motion shows.
///
/// Measured force = m R^T (dv/dt + g e3), measured torque = I0 dw/dt + w × I0 w, with R, v, w of
/// the body origin taken from the recording and the vehicle file only and I0 the vehicle file's
/// inertia. All derivatives and the model's inputs go through one Savitzky-Golay filter (order 3,
/// odd count nearest 0.1 s). Missing velocity: derivatives of position; missing rates: of the
/// quaternion. Every estimated quantity enters the predicted side: gravity direction, extrinsics
/// and centre of gravity turn and shift the prediction to the point and axes the measurement is in.
struct Prediction {
  std::vector<PredictionSample> samples;
  PredictionFigures figures;
};

/// Takes the samples of a prediction one by one, in their order.
using PredictionSink = std::function<void(const PredictionSample&)>;

/// Puts the values that varied in flight at their size at one flight time [s].
using ValueVariation = std::function<void(double t_s, ModelValues* values)>;

/// @param file_vehicle the vehicle file as it is (nominal inertia and mounts)
/// @param ground_spans stamps that do not count
/// @param vary for models with parameters that vary; empty: all values hold throughout
Prediction Predict(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
                   const ModelValues& values, const StampSpans& ground_spans,
                   const ValueVariation& vary = {});

/// The same, sample by sample: holds no more of the flight than a filter's window.
/// @param use takes each sample, with its effects
/// @returns figures of all of them
PredictionFigures PredictEach(const FlightLog& log, const Vehicle& file_vehicle,
                              const DynamicModel& model, const ModelValues& values,
                              const StampSpans& ground_spans, const ValueVariation& vary,
                              const PredictionSink& use);

/// Step of a difference by a parameter: a thousandth of its value or, where that may be zero, of
/// its natural size.
double DifferenceStep(const ModelParameter& parameter, double value);

/// Measured and predicted at one sample.
/// @param with_effects also the wrench of every effect, and what the rotors alone do
/// @param body the model's properties at `values`, where they are known; null: they are worked out
PredictionSample PredictSample(const FilteredMotion& motion, const Eigen::Vector3d& load_pull_W,
                               const Vehicle& file_vehicle, const DynamicModel& model,
                               const ModelValues& values, bool with_effects,
                               const BodyProperties* body = nullptr);

/// Sums that give the figures of a prediction; those left out are not counted.
class PredictionSummary {
 public:
  void Add(const PredictionSample& sample);
  PredictionFigures Figures(bool with_torque, const Vehicle& vehicle, const DynamicModel& model,
                            const ModelValues& values) const;

 private:
  /// Sums over samples, axis by axis.
  struct AxisSums {
    Eigen::Vector3d error2 = Eigen::Vector3d::Zero(), value = Eigen::Vector3d::Zero(),
                    value2 = Eigen::Vector3d::Zero();
    void Add(const Eigen::Vector3d& measured, const Eigen::Vector3d& predicted);
    Eigen::Vector3d Rmse(double n) const;
    Eigen::Vector3d Zero(double n) const;
    Eigen::Vector3d Explained(double n) const;
  };

  long samples_ = 0, felt_ = 0;  // with an accelerometer
  AxisSums force_, swing_force_, torque_, acceleration_;
  Eigen::Vector3d felt_error_ = Eigen::Vector3d::Zero(), felt_error2_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d rotor_other_ = Eigen::Vector3d::Zero(), rotor_rotor_ = Eigen::Vector3d::Zero();
};

/// Figures of some samples of a prediction; those left out are not counted.
PredictionFigures SummarisePrediction(const std::vector<PredictionSample>& samples,
                                      bool with_torque, const Vehicle& vehicle,
                                      const DynamicModel& model, const ModelValues& values);

}  // namespace odmc

#pragma once

#include <ros/node_handle.h>

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/attribution/residual_watch.h"
#include "odmc/estimator/acceptance.h"
#include "odmc/estimator/options.h"
#include "odmc/model/parameter_set.h"
#include "odmc/model/vehicle.h"
#include "odmc/ros/sample_intake.h"
#include "odmc/ros/streams.h"

namespace odmc {

/// Private parameters of estimator_node, besides those of EstimatorOptions.
struct EstimatorNodeOptions : StreamOptions {
  std::string vehicle_file;     ///< vehicle YAML; empty: the URDF in robot_description
  std::string config;           ///< YAML of EstimatorOptions; empty: defaults
  std::string parameters_file;  ///< start values and priors from an earlier calibration
  double rotor_radius_m = 0.0;  ///< for a URDF whose propellers have no simple shape [m]
  std::string body_frame = "base_link";
  std::string twist_frame = "auto";         ///< auto | body | world
  std::string rotor_speed_from = "sensor";  ///< sensor | commands, by the actuator
  std::string actuator;  ///< file of calibrate_actuator; empty: that of the vehicle file
  std::string on_time_reset = "restart";  ///< restart | stop, where the clock steps back
  double publish_rate_hz = 20.0;          ///< of `parameters`, at most [Hz], > 0
  bool live_image = false;                ///< draw also while nobody listens
  double display_rate_hz = 10.0;          ///< of `~displays` and `~path`, at most [Hz], > 0
  double path_length_s = 60.0;            ///< flight time that `~path` looks back [s], > 0
  bool plot_topics = false;               ///< a topic per parameter below `~plot`
  /// never | auto | always: publish the body's pose as a transform; auto: where nobody else does.
  std::string body_tf = "never";
  std::string output_dir;  ///< parameters.yaml goes there at the end; empty: none
  int queue_size = 20000;  ///< samples waiting for the estimator, at most
  /// Effects the node may add to the model in flight once residual_watch_confirmations looks in a
  /// row found them; empty: none.
  std::vector<std::string> add_effects;
  ResidualWatchOptions residual_watch;
  AcceptanceOptions acceptance;

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("vehicle_file", &vehicle_file);
    v->Field("config", &config);
    v->Field("parameters_file", &parameters_file);
    v->Field("rotor_radius_m", &rotor_radius_m);
    v->Field("body_frame", &body_frame);
    v->Field("twist_frame", &twist_frame);
    StreamOptions::Visit(v);
    v->Field("rotor_speed_from", &rotor_speed_from);
    v->Field("actuator", &actuator);
    v->Field("on_time_reset", &on_time_reset);
    v->Field("publish_rate_hz", &publish_rate_hz);
    v->Field("live_image", &live_image);
    v->Field("display_rate_hz", &display_rate_hz);
    v->Field("path_length_s", &path_length_s);
    v->Field("plot_topics", &plot_topics);
    v->Field("body_tf", &body_tf);
    v->Field("output_dir", &output_dir);
    v->Field("queue_size", &queue_size);
    v->Field("add_effects", &add_effects);
    residual_watch.Visit(v);
    acceptance.Visit(v);
  }

  bool IsValid(std::string* error) const;
};

/// Everything the node reads before it starts.
struct EstimatorNodeSetup {
  EstimatorNodeOptions options;
  EstimatorOptions estimator;
  Vehicle vehicle;
  /// Priors of the vehicle file, with a thrust coefficient that an earlier flight knows.
  std::map<std::string, ParameterSetting> file_parameters;
  std::optional<ParameterSet> history;  ///< of a fleet's flights before, with their scatter
  bool odometry_mount_known = false;    ///< the vehicle file says where the odometry's sensor sits
  std::vector<std::string> warnings;    ///< for the user
};

/// Reads private parameters, configuration and vehicle.
/// @throws std::invalid_argument with a sentence for the user
EstimatorNodeSetup ReadEstimatorNodeSetup(const ros::NodeHandle& public_node,
                                          const ros::NodeHandle& private_node);

/// Where the node takes rotor speeds from.
RotorIntake RotorIntakeOf(const EstimatorNodeSetup& setup);

}  // namespace odmc

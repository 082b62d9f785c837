#pragma once

#include <Eigen/Core>
#include <deque>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "odmc/estimator/estimator.h"

namespace odmc {

/// The past of an estimate, thinned so that its size stays bounded however long the flight.
/// Thread-compatible.
class LiveHistory {
 public:
  struct Entry {
    double t_s;
    ModelValues values;
    Eigen::VectorXd sigma;
  };
  /// What the model did not explain, of the last seconds.
  struct Residual {
    double t_s;
    Eigen::Vector3d force_B, torque_B;  ///< [N], [N m]
  };

  void Add(const Snapshot& snapshot);
  void Clear();
  const std::vector<Entry>& entries() const { return entries_; }
  const std::deque<Residual>& residuals() const { return residuals_; }

 private:
  static constexpr size_t kMost = 600;

  std::vector<Entry> entries_;
  double spacing_s_ = 0.05;
  std::deque<Residual> residuals_;
};

/// The words around the curves.
struct LiveImageTexts {
  std::string title;    ///< vehicle
  std::string status;   ///< "airborne", "on the ground", ...
  bool good = false;    ///< colours the status
  std::string details;  ///< one line: timing, residuals
  std::vector<std::string> warnings;
};

/// Draws parameters with 3-sigma bands over time, one panel per kind, and the residual force and
/// torque, 1280×800 bgr8.
cv::Mat DrawLiveImage(const DynamicModel& model, const LiveHistory& history,
                      const std::vector<bool>& observable, const LiveImageTexts& texts);

}  // namespace odmc

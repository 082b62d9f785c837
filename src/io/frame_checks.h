#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace odmc {

/// \file
/// Which of several readings of a format a recording agrees with.

/// Where the four numbers named w, x, y, z may really be, and which way they may turn.
struct QuaternionReading {
  const char* name;
  std::array<int, 4> order;
  bool is_conjugated;

  Eigen::Quaterniond Of(const Eigen::Vector4d& named_wxyz) const;
};
/// The documented one first.
const std::vector<QuaternionReading>& QuaternionReadings();
const QuaternionReading& ReadingNamed(const std::string& name);

/// Numbers of one quantity, one column a sample, at strictly increasing times.
struct TimedVectors {
  std::vector<double> t_s;
  Eigen::Matrix3Xd values;
};
/// The same of attitudes.
struct TimedTurns {
  std::vector<double> t_s;
  std::vector<Eigen::Quaterniond> q;
};

/// Spans of about 0.05 s between samples `stride` apart.
struct CheckSpans {
  size_t stride = 1;
  std::vector<double> from_s, to_s;
};
CheckSpans SpansOf(const std::vector<double>& t_s);

/// Mean of a signal (linear between its samples, held outside) over each span, 3×n.
Eigen::Matrix3Xd MeansOver(const TimedVectors& signal, const CheckSpans& spans);
/// Change of a signal over each span of its own samples, per second, 3×n.
Eigen::Matrix3Xd SlopesOver(const TimedVectors& signal, const CheckSpans& spans);
/// Mean body rate over each span of the turns' own samples [rad/s], 3×n.
Eigen::Matrix3Xd RatesOver(const TimedTurns& turns, const CheckSpans& spans);

/// Root mean square residuals of competing readings.
class ReadingResiduals {
 public:
  /// @param signal  what they explain, 3×n
  ReadingResiduals(std::string unit, const Eigen::Matrix3Xd& signal);

  void Add(const std::string& reading, const Eigen::Matrix3Xd& residual);

  /// The readings that fit about as well as the best; the documented one first if it does.
  /// @throws std::invalid_argument with all residuals where none is below
  ///   relative * signal + absolute
  std::vector<std::string> Fitting(const std::string& documented, double relative, double absolute,
                                   const std::string& what) const;

 private:
  std::string unit_;
  double signal_rms_ = 0.0;
  bool is_empty_ = false;
  std::vector<std::pair<std::string, double>> rms_;
};

/// What `judge` makes of the first reading that it does not refuse (by std::invalid_argument).
/// @throws the first refusal
std::string FirstAccepted(const std::vector<std::string>& readings,
                          const std::function<void(const std::string& reading)>& judge);

/// World z up and body z along the thrust: rotors push against gravity on average. The specific
/// force is from second differences of the position over 0.1 s.
/// @throws std::invalid_argument where it is not up along the body's z
void CheckThrustIsUp(const TimedVectors& position, const std::vector<Eigen::Quaterniond>& q_WB);

}  // namespace odmc

#include "odmc/analysis/recorded_point.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <complex>
#include <unsupported/Eigen/FFT>

#include "odmc/analysis/prediction.h"
#include "odmc/math/line.h"
#include "odmc/math/statistics.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kLongestSegment_s = 4.0, kShortestSegment_s = 1.0;
constexpr int kFewestSegments = 8;      // one after the other
constexpr int kSegmentsPerLength = 4;   // they overlap
constexpr size_t kMostSegments = 256;   // of a longer flight, further apart
constexpr double kHighest_Hz = 10.0;    // the filter of the motion takes what is above
constexpr double kHighestShare = 0.2;   // of the odometry's rate
constexpr double kLooked_Hz = 50.0;     // more samples a second say no more of that
constexpr Index kLowestBin = 2;         // the window spreads a line over the bins below
constexpr Index kSmoothedBins = 4;      // on either side
constexpr double kHalfOctave = 1.4142;  // the highest frequency looked at is lowered by
constexpr Index kFewestBins = 8;
constexpr int kRounds = 4;  // of weights and fit

/// What acts on the force at one time: the residual, and its derivatives by the parameters.
using Rows = Eigen::Matrix<double, 3, Eigen::Dynamic>;

/// Parameters of the model that are fitted: the point's three first.
struct Unknowns {
  std::vector<int> index;
  VectorXd prior_mean, prior_sigma;  ///< of the change of their values
};

Vector3d ForceError(const FilteredMotion& motion, const Vector3d& pull_W, const Vehicle& vehicle,
                    const DynamicModel& model, const ModelValues& values) {
  const PredictionSample s = PredictSample(motion, pull_W, vehicle, model, values, false);
  return s.measured_force - s.predicted_force;
}

/// Estimated parameters that may change the force. The centre of gravity is none of them: the point
/// is seen from there.
Unknowns UnknownsOf(const DynamicModel& model, const ModelValues& values) {
  Unknowns unknowns;
  const auto add = [&](int k) { unknowns.index.push_back(k); };
  for (const char* const name : {"px", "py", "pz"}) {
    add(model.IndexOf(std::string("odometry_extrinsics.") + name));
  }
  for (int k = 0; k < model.num_parameters(); ++k) {
    const bool is_point = std::count(unknowns.index.begin(), unknowns.index.end(), k) > 0;
    const ModelParameter& p = model.parameters()[k];
    const bool is_body = p.effect == "inertia" || p.effect == "centre_of_gravity";
    if (p.estimated && !is_point && !is_body) add(k);
  }
  const auto n = static_cast<Index>(unknowns.index.size());
  unknowns.prior_mean.resize(n);
  unknowns.prior_sigma.resize(n);
  for (Index i = 0; i < n; ++i) {
    const int k = unknowns.index[static_cast<size_t>(i)];
    const ParameterSpec& spec = model.parameters()[k].spec;
    unknowns.prior_mean[i] = spec.prior_value - values[k];
    unknowns.prior_sigma[i] = spec.prior_sigma;
  }
  return unknowns;
}

/// Evenly sampled stretches of the flight without gaps.
std::vector<std::vector<Rows>> RunsOf(const FlightMotion& flight, const Vehicle& vehicle,
                                      const DynamicModel& model, const ModelValues& values,
                                      const Unknowns& unknowns, int stride) {
  const std::vector<Vector3d> pulls = LoadPulls(flight, model, values);
  std::vector<std::vector<Rows>> runs;
  int since = 0;
  for (size_t i = 0; i < flight.samples.size(); ++i) {
    const FilteredMotion& motion = flight.samples[i];
    if (!motion.follows || runs.empty()) {
      runs.emplace_back();
      since = 0;
    }
    if (since++ % stride != 0) continue;
    Rows rows(3, static_cast<Index>(unknowns.index.size()) + 1);
    rows.col(0) = ForceError(motion, pulls[i], vehicle, model, values);
    for (size_t j = 0; j < unknowns.index.size(); ++j) {
      const int k = unknowns.index[j];
      ModelValues changed = values;
      const double step = DifferenceStep(model.parameters()[k], values[k]);
      changed[k] += step;
      rows.col(static_cast<Index>(j) + 1) =
          (rows.col(0) - ForceError(motion, pulls[i], vehicle, model, changed)) / step;
    }
    runs.back().push_back(std::move(rows));
  }
  return runs;
}

/// Sums over one segment at one frequency and axis.
struct Bin {
  MatrixXd XX;
  VectorXd Xy;
  double yy = 0.0;
};

/// A regression in the frequency domain.
class SpectralFit {
 public:
  SpectralFit(const Unknowns& unknowns, Index length, Index bins)
      : unknowns_(unknowns), length_(length), bins_(bins) {
    for (Index i = 0; i < length; ++i) {
      window_.push_back(0.5 - 0.5 * std::cos(2.0 * M_PI * (static_cast<double>(i) + 0.5) /
                                             static_cast<double>(length)));
    }
  }

  void AddSegment(const Rows* rows) {
    std::vector<Bin>& segment = segments_.emplace_back();
    const Index columns = rows->cols();
    for (Index axis = 0; axis < 3; ++axis) {
      Eigen::MatrixXcd spectra(bins_, columns);
      for (Index c = 0; c < columns; ++c) spectra.col(c) = SpectrumOf(rows, axis, c);
      for (Index f = 0; f < bins_; ++f) {
        const Eigen::RowVectorXcd x = spectra.row(f).tail(columns - 1);
        const std::complex<double> y = spectra(f, 0);
        segment.push_back({(x.adjoint() * x).real(), (x.adjoint() * y).real(), std::norm(y)});
      }
    }
  }
  size_t num_segments() const { return segments_.size(); }

  /// Weights each frequency and axis by what the fit leaves there, and fits again.
  /// @param bins lowest ones that count
  void Fit(Index bins) {
    Eigen::ArrayXXd counts = Eigen::ArrayXXd::Zero(bins_, 3);
    counts.topRows(bins) = 1.0;
    weight_ = counts;
    for (int round = 0; round < kRounds; ++round) {
      x_ = SolveWith(weight_);
      Eigen::ArrayXXd left = Eigen::ArrayXXd::Zero(bins_, 3);
      for (const std::vector<Bin>& segment : segments_) {
        for (Index axis = 0; axis < 3; ++axis) {
          for (Index f = 0; f < bins_; ++f) {
            const Bin& bin = segment[static_cast<size_t>(axis * bins_ + f)];
            left(f, axis) += std::max(0.0, bin.yy - 2.0 * x_.dot(bin.Xy) + x_.dot(bin.XX * x_));
          }
        }
      }
      left /= static_cast<double>(segments_.size());
      const double least = 1e-12 * std::max(left.maxCoeff(), 1e-300);
      for (Index axis = 0; axis < 3; ++axis) {
        for (Index f = 0; f < bins; ++f) {
          const Index from = std::max<Index>(0, f - kSmoothedBins);
          const Index to = std::min(bins - 1, f + kSmoothedBins);
          const auto around = left.col(axis).segment(from, to - from + 1).max(least);
          weight_(f, axis) = std::exp(-around.log().mean());
        }
      }
    }
    x_ = SolveWith(weight_);
  }

  Vector3d Point() const { return x_.head<3>(); }
  /// By what the segments say, one after the other (Newey and West, Econometrica 1987).
  Matrix3d Covariance() const { return CovarianceOf(x_, weight_); }

  /// Chi-squared, of three degrees of freedom, of the difference between what the frequencies below
  /// and above the one say that halves what they know of the point.
  double HalvesChiSquared() const {
    VectorXd known = VectorXd::Zero(bins_);
    for (const std::vector<Bin>& segment : segments_) {
      for (Index axis = 0; axis < 3; ++axis) {
        for (Index f = 0; f < bins_; ++f) {
          known[f] += weight_(f, axis) *
                      segment[static_cast<size_t>(axis * bins_ + f)].XX.diagonal().head<3>().sum();
        }
      }
    }
    Index half = 0;
    for (double sum = 0.0; half < bins_ && sum < 0.5 * known.sum(); ++half) sum += known[half];
    if (half < 1 || half >= bins_) return 0.0;
    Eigen::ArrayXXd low = weight_, high = weight_;
    low.bottomRows(bins_ - half) = 0.0;
    high.topRows(half) = 0.0;
    const VectorXd x_low = SolveWith(low), x_high = SolveWith(high);
    const Matrix3d C = CovarianceOf(x_low, low) + CovarianceOf(x_high, high);
    const Vector3d d = x_low.head<3>() - x_high.head<3>();
    return d.dot(C.ldlt().solve(d));
  }

 private:
  Eigen::VectorXcd SpectrumOf(const Rows* rows, Index axis, Index column) {
    std::vector<double> values(static_cast<size_t>(length_));
    for (Index i = 0; i < length_; ++i) values[static_cast<size_t>(i)] = rows[i](axis, column);
    const StraightLine line = LineThrough(values.data(), values.size());
    for (size_t i = 0; i < values.size(); ++i) {
      values[i] = window_[i] * (values[i] - line.At(static_cast<double>(i)));
    }
    std::vector<std::complex<double>> spectrum;
    fft_.fwd(spectrum, values);
    return Eigen::Map<Eigen::VectorXcd>(spectrum.data() + kLowestBin, bins_);
  }

  /// Normal matrix and right-hand side of one segment.
  std::pair<MatrixXd, VectorXd> SumOf(const std::vector<Bin>& segment,
                                      const Eigen::ArrayXXd& weight) const {
    const Index n = unknowns_.prior_mean.size();
    std::pair<MatrixXd, VectorXd> sum(MatrixXd::Zero(n, n), VectorXd::Zero(n));
    for (Index axis = 0; axis < 3; ++axis) {
      for (Index f = 0; f < bins_; ++f) {
        const Bin& bin = segment[static_cast<size_t>(axis * bins_ + f)];
        sum.first += weight(f, axis) * bin.XX;
        sum.second += weight(f, axis) * bin.Xy;
      }
    }
    return sum;
  }

  /// The normal matrix of all, with the priors, in units of these.
  MatrixXd Normal(const Eigen::ArrayXXd& weight, VectorXd* rhs) const {
    const Index n = unknowns_.prior_mean.size();
    MatrixXd H = MatrixXd::Zero(n, n);
    VectorXd g = VectorXd::Zero(n);
    for (const std::vector<Bin>& segment : segments_) {
      const auto [XX, Xy] = SumOf(segment, weight);
      H += XX;
      g += Xy;
    }
    const auto S = unknowns_.prior_sigma.asDiagonal();
    // Segments that overlap count a sample more than once, the prior as often.
    const double times = kSegmentsPerLength;
    H = (S * H * S).eval();
    H.diagonal().array() += times;
    *rhs = S * g + times * unknowns_.prior_mean.cwiseQuotient(unknowns_.prior_sigma);
    return H;
  }

  VectorXd SolveWith(const Eigen::ArrayXXd& weight) const {
    VectorXd rhs;
    const MatrixXd H = Normal(weight, &rhs);
    return unknowns_.prior_sigma.cwiseProduct(H.ldlt().solve(rhs));
  }

  Matrix3d CovarianceOf(const VectorXd& x, const Eigen::ArrayXXd& weight) const {
    const Index n = x.size();
    VectorXd rhs;
    const MatrixXd H = Normal(weight, &rhs);
    std::vector<VectorXd> scores;
    for (const std::vector<Bin>& segment : segments_) {
      const auto [XX, Xy] = SumOf(segment, weight);
      scores.push_back(unknowns_.prior_sigma.cwiseProduct(Xy - XX * x));
    }
    MatrixXd B = MatrixXd::Zero(n, n);
    for (size_t i = 0; i < scores.size(); ++i) {
      B += scores[i] * scores[i].transpose();
      for (size_t lag = 1; lag < kSegmentsPerLength && i + lag < scores.size(); ++lag) {
        const double share = 1.0 - static_cast<double>(lag) / kSegmentsPerLength;
        B += share *
             (scores[i] * scores[i + lag].transpose() + scores[i + lag] * scores[i].transpose());
      }
    }
    B.diagonal().array() += kSegmentsPerLength;  // the priors' share
    const MatrixXd inverse = H.ldlt().solve(MatrixXd::Identity(n, n));
    const MatrixXd C = inverse * B * inverse;
    // Few segments fit what they are judged by.
    const double independent = static_cast<double>(segments_.size()) / kSegmentsPerLength;
    const double scale = independent / std::max(1.0, independent - 3.0);
    const Vector3d S = unknowns_.prior_sigma.head<3>();
    return scale * (S.asDiagonal() * C.topLeftCorner<3, 3>() * S.asDiagonal());
  }

  const Unknowns& unknowns_;
  Index length_, bins_;
  std::vector<double> window_;
  std::vector<std::vector<Bin>> segments_;  // bins by axis, then frequency
  Eigen::ArrayXXd weight_;                  // bins × 3
  VectorXd x_;                              // change of the values
  Eigen::FFT<double> fft_;
};

bool IsEstimated(const DynamicModel& model, const std::string& name) {
  const int k = model.IndexOf(name);
  return k >= 0 && model.parameters()[k].estimated;
}

std::vector<std::string> PointNames() {
  return {"odometry_extrinsics.px", "odometry_extrinsics.py", "odometry_extrinsics.pz"};
}

bool EstimatesPoint(const DynamicModel& model) {
  const std::vector<std::string> names = PointNames();
  return std::all_of(names.begin(), names.end(),
                     [&](const std::string& name) { return IsEstimated(model, name); });
}

/// Which segments a flight is cut into.
struct Cut {
  double segment_s = 0.0;
  Index length = 0, bins = 0;  ///< samples of a segment, frequencies that are looked at
  size_t apart = 1;            ///< samples from one segment's start to the next one's
};

/// @param step_s between samples
Cut CutOf(double flight_s, double high_Hz, double step_s) {
  Cut cut;
  cut.segment_s = std::min(kLongestSegment_s, flight_s / kFewestSegments);
  cut.length = static_cast<Index>(cut.segment_s / step_s);
  cut.bins = static_cast<Index>(high_Hz * cut.segment_s) - kLowestBin + 1;
  cut.apart = std::max(static_cast<size_t>(cut.length) / kSegmentsPerLength,
                       static_cast<size_t>(flight_s / step_s) / kMostSegments + 1);
  return cut;
}

/// What all ranges say of the change of the point. Velocities are smoother than rates on some
/// recordings, and the point seems nearer at high frequencies; at low ones it follows the air.
/// Nobody knows the range: all count, by their variances, and the covariance holds how far they
/// differ.
/// @returns false if none says anything
bool JoinRanges(SpectralFit* fit, Index bins, Vector3d* change, Matrix3d* covariance) {
  double weights = 0.0;
  Vector3d sum = Vector3d::Zero();
  Matrix3d squares = Matrix3d::Zero(), noise = Matrix3d::Zero();
  for (double share = 1.0; share * static_cast<double>(bins) >= kFewestBins; share /= kHalfOctave) {
    fit->Fit(static_cast<Index>(share * static_cast<double>(bins)));
    const Vector3d p = fit->Point();
    const Matrix3d C = std::max(1.0, fit->HalvesChiSquared() / 3.0) * fit->Covariance();  // Birge
    if (!C.allFinite() || !p.allFinite()) continue;
    const double weight = 1.0 / C.trace();
    weights += weight;
    sum += weight * p;
    squares += weight * p * p.transpose();
    noise += weight * C;
  }
  if (!(weights > 0.0)) return false;
  *change = sum / weights;
  *covariance = noise / weights + squares / weights - *change * change->transpose();
  return true;
}

}  // namespace

RecordedPoint FindRecordedPoint(const FlightLog& log, const Vehicle& file_vehicle,
                                const DynamicModel& model, const ModelValues& values,
                                const StampSpans& ground_spans) {
  RecordedPoint point;
  for (const std::string& name : PointNames()) {
    if (IsEstimated(model, name)) continue;
    point.why = "the model does not estimate " + name;
    return point;
  }
  const FlightMotion flight = FilterFlight(log, file_vehicle.num_rotors(), ground_spans);
  if (flight.samples.empty()) {
    point.why = "no flight without gaps";
    return point;
  }
  const int stride = std::max(1, static_cast<int>(1.0 / (flight.step_s * kLooked_Hz)));
  const double step_s = stride * flight.step_s;
  const Unknowns unknowns = UnknownsOf(model, values);
  const auto runs = RunsOf(flight, file_vehicle, model, values, unknowns, stride);
  for (const auto& run : runs) point.flight_s += static_cast<double>(run.size()) * step_s;
  point.high_Hz = std::min(kHighest_Hz, kHighestShare / flight.step_s);
  const Cut cut = CutOf(point.flight_s, point.high_Hz, step_s);
  if (cut.segment_s < kShortestSegment_s || cut.bins < kFewestBins) {
    point.why = "too little flight: " + Rounded(point.flight_s) + " s";
    return point;
  }
  point.low_Hz = static_cast<double>(kLowestBin) / cut.segment_s;
  SpectralFit fit(unknowns, cut.length, cut.bins);
  for (const auto& run : runs) {
    for (size_t from = 0; from + static_cast<size_t>(cut.length) <= run.size(); from += cut.apart) {
      fit.AddSegment(run.data() + from);
    }
  }
  if (fit.num_segments() < static_cast<size_t>(kFewestSegments * kSegmentsPerLength / 2)) {
    point.why = "too little flight without gaps";
    return point;
  }
  Vector3d change;
  if (!JoinRanges(&fit, cut.bins, &change, &point.covariance)) {
    point.why = "the flight does not show it";
    return point;
  }
  point.p_m = change;
  for (Index i = 0; i < 3; ++i) (*point.p_m)[i] += values[unknowns.index[static_cast<size_t>(i)]];
  return point;
}

RecordedPoint FindPointOfKnownMount(const FlightLog& log, const Vehicle& file_vehicle,
                                    const DynamicModel& model, const ModelValues& values,
                                    const StampSpans& ground_spans) {
  constexpr double kLongestAsked_s = 60.0;  // memory does not grow with the flight
  if (EstimatesPoint(model) || log.odometry.empty()) {
    return FindRecordedPoint(log, file_vehicle, model, values, ground_spans);
  }
  Vehicle asked = model.vehicle();
  asked.effects = model.effect_names();
  if (std::count(asked.effects.begin(), asked.effects.end(), "odometry_extrinsics") == 0) {
    asked.effects.emplace_back("odometry_extrinsics");
  }
  for (const std::string& name : PointNames()) asked.parameters[name].estimated = true;
  const DynamicModel with(asked, asked.effects);
  ModelValues all = with.InitialValues();
  for (int k = 0; k < model.num_parameters(); ++k) {
    all[with.IndexOf(model.parameters()[k].full_name)] = values[k];
  }
  StampSpans left_out = ground_spans;
  const Stamp first = log.odometry.front().stamp;
  const Stamp from = log.odometry.back().stamp - FromSeconds(kLongestAsked_s);
  if (from > first) left_out.emplace_back(first, from);
  return FindRecordedPoint(log, file_vehicle, with, all, left_out);
}

std::optional<Finding> PointRemark(const RecordedPoint& point, const DynamicModel& model,
                                   const ModelValues& values, const VectorXd& sigma) {
  constexpr double kErrorRate = 1e-3, kMeasured_m = 0.005, kUsual = 0.3;  // of an arm: the prior
  if (!point.p_m || EstimatesPoint(model)) return std::nullopt;
  const Vector3d off = *point.p_m - model.Properties(values).p_BS;
  const double usual_m = kUsual * model.vehicle().ArmLength();
  // Not on the vehicle: something else that goes with the angular acceleration, as a load.
  if (ChiSquaredTail(off.squaredNorm() / (usual_m * usual_m), 3) < kErrorRate) return std::nullopt;
  Matrix3d C = point.covariance;
  for (Index axis = 0; axis < 3; ++axis) {
    const int k = model.IndexOf(std::string("centre_of_gravity.") + "xyz"[axis]);
    if (k >= 0) C(axis, axis) += sigma[k] * sigma[k];
  }
  const double chi_squared = off.dot(C.ldlt().solve(off));
  if (ChiSquaredTail(chi_squared, 3) > kErrorRate || off.norm() < kMeasured_m) return std::nullopt;
  const auto text = [](const Vector3d& cm) {
    return "(" + Rounded(cm.x(), 2) + ", " + Rounded(cm.y(), 2) + ", " + Rounded(cm.z(), 2) + ")";
  };
  Finding remark;
  remark.check = "recorded_point";
  remark.what = "the odometry records a point that is " + text(1e2 * off) + " +- " +
                text(1e2 * C.diagonal().cwiseSqrt()) +
                " cm off the place where the model takes it to be, by the force as it turns";
  remark.mend =
      "measure it (odometry: {frame: sensor, p_BS_m: [..]} of the vehicle file), or estimate it "
      "(odometry_extrinsics among the effects, with px, py, pz estimated)";
  return remark;
}

TakenPoint TakePoint(const RecordedPoint& point, const DynamicModel& model,
                     const ModelValues& values, const VectorXd& sigma) {
  constexpr double kShown = 0.5;  // of the prior's sigma
  TakenPoint taken;
  if (!point.p_m || !EstimatesPoint(model)) return taken;
  for (Index axis = 0; axis < 3; ++axis) {
    const char letter = "xyz"[axis];
    const int k = model.IndexOf(std::string("odometry_extrinsics.p") + letter);
    const int c = model.IndexOf(std::string("centre_of_gravity.") + letter);
    const double own = std::sqrt(point.covariance(axis, axis));
    if (own > kShown * model.parameters()[k].spec.prior_sigma) continue;
    taken.point[model.parameters()[k].full_name] = {(*point.p_m)[axis], own, true};
    if (c < 0 || !model.parameters()[c].estimated || sigma[c] < own) continue;
    taken.held[model.parameters()[c].full_name] = {values[c], sigma[c], true};
  }
  return taken;
}

}  // namespace odmc

#include "flight_torque.h"

#include <algorithm>
#include <cmath>

#include "odmc/estimator/noise_estimation.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr double kLongestSegment_s = 2.0, kShortestSegment_s = 0.5;
constexpr double kHighestShare = 0.2;  // of the slowest stream's rate
constexpr double kLongestGap_s = 0.03;
constexpr double kMostSteps = 3.5;  // that a hole may be long

/// Body rates of a flight, by the stream that has more of them.
struct Rates {
  std::vector<Stamp> stamps;
  std::vector<Vector3d> w_B;
};

Rates RatesOf(const FlightLog& log, const BodyProperties& body) {
  Rates odometry, gyro;
  for (const OdometrySample& s : log.odometry) {
    if (!s.w_WS_S) continue;
    odometry.stamps.push_back(s.stamp);
    odometry.w_B.push_back(body.R_BS * *s.w_WS_S);
  }
  for (const ImuSample& s : log.imu) {
    if (!s.gyro_I) continue;
    gyro.stamps.push_back(s.stamp);
    gyro.w_B.push_back(body.R_BI * *s.gyro_I);
  }
  return gyro.stamps.size() >= odometry.stamps.size() ? gyro : odometry;
}

template <typename T>
double MedianStep_s(const std::vector<T>& samples, Stamp (*stamp)(const T&)) {
  std::vector<double> steps;
  for (size_t i = 1; i < samples.size(); ++i) {
    steps.push_back(ToSeconds(stamp(samples[i]) - stamp(samples[i - 1])));
  }
  return Median(steps);
}

/// Rates of a flight, and the median steps of its streams.
struct Streams {
  Rates rates;
  double step_s, rotor_step_s, pose_step_s;

  /// Holes that are longer are not read across.
  double RateHole_s() const { return std::max(kMostSteps * step_s, kLongestGap_s); }
  double RotorHole_s() const { return std::max(kMostSteps * rotor_step_s, kLongestGap_s); }
  double PoseHole_s() const { return std::max(kMostSteps * pose_step_s, 5.0 * kLongestGap_s); }
};

Streams StreamsOf(const FlightLog& log, const BodyProperties& body) {
  Streams streams;
  streams.rates = RatesOf(log, body);
  streams.step_s =
      MedianStep_s<Stamp>(streams.rates.stamps, [](const Stamp& stamp) { return stamp; });
  streams.rotor_step_s =
      MedianStep_s<RotorSample>(log.rotors, [](const RotorSample& sample) { return sample.stamp; });
  streams.pose_step_s = MedianStep_s<OdometrySample>(
      log.odometry, [](const OdometrySample& sample) { return sample.stamp; });
  return streams;
}

template <typename Sample>
class StreamCursor {
 public:
  /// @param longest_s holes that are longer are not read across
  StreamCursor(const std::vector<Sample>& samples, double longest_s)
      : samples_(samples), longest_s_(longest_s) {}

  /// @returns false where there is a hole, or nothing around the stamp
  bool MoveTo(Stamp stamp) {
    while (next_ < samples_.size() && samples_[next_].stamp <= stamp) ++next_;
    if (next_ == 0) return false;
    if (samples_[next_ - 1].stamp == stamp) {
      share_ = 0.0;
      after_ = next_ - 1;
      return true;
    }
    if (next_ == samples_.size()) return false;
    const double span_s = ToSeconds(samples_[next_].stamp - before().stamp);
    if (span_s > longest_s_) return false;
    share_ = ToSeconds(stamp - before().stamp) / span_s;
    after_ = next_;
    return true;
  }
  const Sample& before() const { return samples_[next_ - 1]; }
  const Sample& after() const { return samples_[after_]; }
  double share() const { return share_; }

 private:
  const std::vector<Sample>& samples_;
  double longest_s_;
  size_t next_ = 0, after_ = 0;
  double share_ = 0.0;
};

/// The effects of a model that are thrust.
std::vector<std::string> ThrustEffects(const DynamicModel& model) {
  std::vector<std::string> names;
  for (const std::string& name : model.effect_names()) {
    if (name == "thrust" || name == "rotor_asymmetry") names.push_back(name);
  }
  return names;
}

/// Torque of the rotors' thrust at one instant.
class TorqueReader {
 public:
  TorqueReader(const FlightLog& log, const DynamicModel& model, const ModelValues& values,
               const Streams& streams)
      : model_(model.vehicle(), ThrustEffects(model)),
        values_(model_.InitialValues()),
        poses_(log.odometry, streams.PoseHole_s()),
        rotors_(log.rotors, streams.RotorHole_s()),
        body_(model.Properties(values)),
        first_(log.odometry.front().stamp) {
    for (int i = 0; i < model_.num_parameters(); ++i) {
      const int k = model.IndexOf(model_.parameters()[i].full_name);
      if (k >= 0) values_[i] = values[k];
    }
  }

  /// @returns nothing where a stream has a hole
  std::optional<TorqueSpectra::Sample> At(Stamp stamp, const Vector3d& w_B) {
    if (!rotors_.MoveTo(stamp) || !poses_.MoveTo(stamp)) return {};
    const double y = rotors_.share();
    const RotorVector speed = (1.0 - y) * rotors_.before().speed + y * rotors_.after().speed;
    FlightState state = StateAt(stamp, w_B);
    state.rotors = RotorState::Steady(speed);
    Vector3d f_B, tau_B;
    model_.EvaluateWrench(state, values_, body_.p_BBcm, &f_B, &tau_B);
    TorqueSpectra::Sample sample;
    sample.rate = w_B;
    sample.torque = tau_B - w_B.cross(body_.I_BBcm_B * w_B);
    const Vehicle& vehicle = model_.vehicle();
    for (int j = 0; j < vehicle.num_rotors(); ++j) {
      sample.drag += vehicle.rotors[j].spin * speed[j] * speed[j];
      sample.spin += vehicle.rotors[j].spin * speed[j];
    }
    speed_squares_ += speed.cwiseAbs2().mean();
    ++count_;
    return sample;
  }

  double MeanSquaredSpeed() const { return count_ > 0 ? speed_squares_ / count_ : 0.0; }

 private:
  /// Between the poses, without rotors.
  FlightState StateAt(Stamp stamp, const Vector3d& w_B) const {
    FlightState state;
    const double x = poses_.share();
    const OdometrySample &a = poses_.before(), &b = poses_.after();
    const Eigen::Quaterniond q = a.q_WS.slerp(x, b.q_WS);
    state.time_s = ToSeconds(stamp - first_);
    state.R_WB = q.toRotationMatrix() * body_.R_BS.transpose();
    state.w_WB_B = w_B;
    Vector3d v_WS = Vector3d::Zero();
    if (a.v_WS && b.v_WS) {
      v_WS = (1.0 - x) * *a.v_WS + x * *b.v_WS;
    } else if (b.stamp > a.stamp) {
      v_WS = (b.p_WS - a.p_WS) / ToSeconds(b.stamp - a.stamp);
    }
    state.p_WB = (1.0 - x) * a.p_WS + x * b.p_WS - state.R_WB * body_.p_BS;
    state.v_AB_B = state.R_WB.transpose() * (v_WS - body_.wind_W) - w_B.cross(body_.p_BS);
    return state;
  }

  DynamicModel model_;
  ModelValues values_;
  StreamCursor<OdometrySample> poses_;
  StreamCursor<RotorSample> rotors_;
  BodyProperties body_;
  Stamp first_;
  double speed_squares_ = 0.0;
  double count_ = 0.0;
};

TorqueSpectra::Noise NoiseOf(const FlightLog& log, const DynamicModel& model,
                             const ModelValues& values, double mean_squared_speed) {
  StreamNoise streams({0.0, 0.0, 0.0, 0.0});
  std::vector<double> levels;
  for (size_t i = 0; i < log.rotors.size(); ++i) {
    streams.Add(log.rotors[i]);
    if (i % 200 != 199) continue;
    streams.AdvanceTo(log.rotors[i].stamp);
    levels.push_back(streams.rotor_speed());
  }
  const double sigma = Median(levels), speed = std::sqrt(mean_squared_speed);
  const Vehicle& vehicle = model.vehicle();
  const int k_f = model.IndexOf("thrust.k_f");
  const double slope = k_f >= 0 ? 2.0 * values[k_f] * speed * sigma : 0.0;
  TorqueSpectra::Noise noise;
  double x2 = 0.0, y2 = 0.0;
  for (const Rotor& rotor : vehicle.rotors) {
    x2 += rotor.p_BP.x() * rotor.p_BP.x();
    y2 += rotor.p_BP.y() * rotor.p_BP.y();
  }
  const double count = std::sqrt(static_cast<double>(vehicle.num_rotors()));
  noise.torque_x = slope * std::sqrt(y2);
  noise.torque_y = slope * std::sqrt(x2);
  noise.drag = 2.0 * speed * sigma * count;
  noise.spin = sigma * count;
  return noise;
}

/// Adds a stretch without holes, at even steps from the rate `first` on.
/// @returns the rate at which it ends
size_t AddStretch(const Streams& streams, size_t first, const StampSpans& ground_spans,
                  TorqueReader* reader, TorqueSpectra* spectra) {
  const Rates& rates = streams.rates;
  spectra->Break();
  size_t i = first;
  for (long k = 0;; ++k) {
    const Stamp stamp = rates.stamps[first] + FromSeconds(static_cast<double>(k) * streams.step_s);
    while (i + 1 < rates.stamps.size() && rates.stamps[i + 1] <= stamp) ++i;
    if (i + 1 == rates.stamps.size()) return i;
    const double span_s = ToSeconds(rates.stamps[i + 1] - rates.stamps[i]);
    if (span_s > streams.RateHole_s() || IsInside(stamp, ground_spans)) return i;
    const double x = ToSeconds(stamp - rates.stamps[i]) / span_s;
    const Vector3d w_B = (1.0 - x) * rates.w_B[i] + x * rates.w_B[i + 1];
    const auto sample = reader->At(stamp, w_B);
    if (!sample) return i;
    spectra->Add(*sample);
  }
}

/// Why the recording cannot show torque; empty: it may.
std::string WhyNotReadable(const FlightLog& log) {
  if (log.rotor_rms_only) return "single rotor speeds are not known";
  if (log.odometry.size() < 2 || log.rotors.size() < 2) return "there is no flight";
  const bool modelled = std::any_of(log.rotors.begin(), log.rotors.end(),
                                    [](const RotorSample& s) { return s.model_sigma.size() > 0; });
  return modelled ? "rotor speeds come from a model" : "";
}

/// Why the streams cannot be summed up; empty: they can.
std::string WhyNotRegular(const Streams& streams) {
  if (streams.rates.stamps.size() < 2) return "there are no angular rates";
  const bool moves = streams.step_s > 0.0 && streams.rotor_step_s > 0.0;
  return moves ? "" : "stamps stand still";
}

}  // namespace

std::optional<FlightSpectra> SpectraOfFlight(const FlightLog& log, const DynamicModel& model,
                                             const ModelValues& values,
                                             const StampSpans& ground_spans, std::string* why) {
  *why = WhyNotReadable(log);
  if (!why->empty()) return {};
  const BodyProperties body = model.Properties(values);
  const Streams streams = StreamsOf(log, body);
  *why = WhyNotRegular(streams);
  if (!why->empty()) return {};
  const std::vector<Stamp>& stamps = streams.rates.stamps;
  const double flown_s = ToSeconds(stamps.back() - stamps.front());
  const double segment_s =
      std::clamp(flown_s / TorqueSpectra::kFewestSegments, kShortestSegment_s, kLongestSegment_s);
  const double highest_Hz = kHighestShare / std::max(streams.step_s, streams.rotor_step_s);
  TorqueSpectra spectra(1.0 / streams.step_s, segment_s, highest_Hz, body.I_BBcm_B(2, 2));
  TorqueReader reader(log, model, values, streams);
  for (size_t i = 0; i + 1 < stamps.size(); ++i) {
    i = AddStretch(streams, i, ground_spans, &reader, &spectra);
  }
  const TorqueSpectra::Noise noise = NoiseOf(log, model, values, reader.MeanSquaredSpeed());
  return FlightSpectra{std::move(spectra), noise};
}

}  // namespace odmc

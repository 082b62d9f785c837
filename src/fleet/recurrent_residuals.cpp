#include "odmc/fleet/recurrent_residuals.h"

#include <algorithm>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>
#include <numeric>

namespace odmc {

const std::array<const char*, kResidualChannels> kResidualChannelNames = {
    "force_x_N", "force_y_N", "force_z_N", "torque_x_Nm", "torque_y_Nm", "torque_z_Nm"};

const std::array<ResidualQuantity, kResidualQuantities> kResidualQuantityTable = {
    {{"air_speed_m_s", 0.125},
     {"climb_speed_m_s", 0.125},
     {"air_speed_x_m_s", 0.125},
     {"air_speed_y_m_s", 0.125},
     {"air_speed_z_m_s", 0.125},
     {"roll_rate_rad_s", 0.125},
     {"pitch_rate_rad_s", 0.125},
     {"yaw_rate_rad_s", 0.125},
     {"thrust_over_weight", 0.0625},
     {"height_m", 0.0625},
     {"flight_time_s", 1.0}}};

namespace {

constexpr size_t kMostBinsOfFlight = 32;
constexpr size_t kMostBinsOfFleet = 8;
constexpr double kShareOfTime = 0.95;  // that they hold
constexpr double kLongestStep_s = 0.1;

/// Along the rotors' axis.
double ThrustOf(const PredictionSample& sample) {
  for (const EffectWrench& e : sample.effects) {
    if (e.effect == "thrust") return e.f_B.z();
  }
  return 0.0;
}

std::array<double, kResidualQuantities> QuantitiesOf(const PredictionSample& s,
                                                     double flight_time_s, double weight_N) {
  return {s.v_AB_B.norm(),        s.climb_m_s,  s.v_AB_B.x(), s.v_AB_B.y(),
          s.v_AB_B.z(),           s.w_WB_B.x(), s.w_WB_B.y(), s.w_WB_B.z(),
          ThrustOf(s) / weight_N, s.height_m,   flight_time_s};
}

/// A bin's means, one per flight that has been in it long enough.
using BinMeans = std::map<long, std::vector<ResidualChannels>>;

BinMeans MeansOf(int quantity, int level, const std::vector<const FlightResiduals*>& flights) {
  BinMeans means;
  for (const FlightResiduals* flight : flights) {
    ResidualBins bins = flight->of(quantity);
    bins.CoarsenTo(level);
    for (const auto& [index, sum] : bins.bins()) {
      if (sum.seconds >= kLeastResidual_s) means[index].push_back(sum.Mean());
    }
  }
  for (auto it = means.begin(); it != means.end();) {
    it = it->second.size() < kLeastResidualFlights ? means.erase(it) : std::next(it);
  }
  return means;
}

/// That the flights' mean is no larger than `least` in truth, by chance alone.
double PValue(const RecurrentResidual& r, double least) {
  if (!(r.sigma > 0.0)) return 1.0;
  const boost::math::students_t t(r.flights - 1);
  const auto above = [&](double size) {
    return boost::math::cdf(boost::math::complement(t, size / r.sigma));
  };
  return above(std::abs(r.mean) - least) + above(std::abs(r.mean) + least);
}

RecurrentResidual Summarise(const std::vector<ResidualChannels>& means, int channel, double error) {
  RecurrentResidual r;
  r.channel = channel;
  r.flights = static_cast<int>(means.size());
  for (const ResidualChannels& of_flight : means) r.mean += of_flight[channel] / r.flights;
  double squares = 0.0;
  for (const ResidualChannels& of_flight : means) {
    squares += std::pow(of_flight[channel] - r.mean, 2);
    r.same_sign += of_flight[channel] * r.mean > 0.0;
  }
  r.scatter = std::sqrt(squares / (r.flights - 1));
  r.sigma = r.scatter / std::sqrt(r.flights);
  r.share_of_error = std::abs(r.mean) / error;
  r.p_value = PValue(r, kLeastResidualShare * error);
  return r;
}

/// Sorts by p-value and accounts for their number (Holm, Scandinavian Journal of Statistics 6,
/// 1979): holds however the bins depend on each other.
void AccountForNumber(std::vector<RecurrentResidual>* all) {
  std::stable_sort(all->begin(), all->end(),
                   [](const auto& a, const auto& b) { return a.p_value < b.p_value; });
  double largest = 0.0;
  for (size_t k = 0; k < all->size(); ++k) {
    const double adjusted = (*all)[k].p_value * static_cast<double>(all->size() - k);
    largest = std::max(largest, adjusted);
    (*all)[k].p_value = std::min(1.0, largest);
  }
}

/// True if few enough bins hold nearly all of the time.
bool IsCoarseEnough(const ResidualBins& all) {
  std::vector<double> seconds;
  double total = 0.0;
  for (const auto& [index, sum] : all.bins()) {
    seconds.push_back(sum.seconds);
    total += sum.seconds;
  }
  std::sort(seconds.rbegin(), seconds.rend());
  seconds.resize(std::min(seconds.size(), kMostBinsOfFleet));
  return std::accumulate(seconds.begin(), seconds.end(), 0.0) >= kShareOfTime * total;
}

/// Of the bins that all flights are compared in.
int LevelOf(int quantity, const std::vector<const FlightResiduals*>& flights) {
  ResidualBins all;
  for (const FlightResiduals* flight : flights) all.Add(flight->of(quantity));
  while (!IsCoarseEnough(all)) all.CoarsenTo(all.level() + 1);
  return all.level();
}

}  // namespace

void ResidualBins::Sum::Add(const Sum& other) {
  seconds += other.seconds;
  residual += other.residual;
}

void ResidualBins::Add(double in_steps, const Sum& sum) {
  bins_[static_cast<long>(std::floor(std::ldexp(in_steps, -level_)))].Add(sum);
  while (bins_.size() > kMostBinsOfFlight) CoarsenTo(level_ + 1);
}

void ResidualBins::Add(ResidualBins other) {
  CoarsenTo(other.level_);
  other.CoarsenTo(level_);
  for (const auto& [index, sum] : other.bins_) bins_[index].Add(sum);
}

void ResidualBins::CoarsenTo(int level) {
  for (; level_ < level; ++level_) {
    std::map<long, Sum> wider;
    for (const auto& [index, sum] : bins_) {
      wider[(index - (index & 1)) / 2].Add(sum);  // -1 goes to -1
    }
    bins_ = std::move(wider);
  }
}

void FlightResiduals::Add(const PredictionSample& sample, double weight_N) {
  const double dt = first_s_ ? std::min(sample.t_s - last_s_, kLongestStep_s) : 0.0;
  if (!first_s_) first_s_ = sample.t_s;
  last_s_ = sample.t_s;
  ResidualBins::Sum sum;
  sum.seconds = dt;
  sum.residual << sample.measured_force - sample.predicted_force,
      sample.measured_torque - sample.predicted_torque;
  if (!(dt > 0.0) || !sum.residual.allFinite()) return;
  sum.residual *= dt;
  const auto at = QuantitiesOf(sample, sample.t_s - *first_s_, weight_N);
  for (size_t k = 0; k < at.size(); ++k) {
    if (std::isfinite(at[k])) bins_[k].Add(at[k] / kResidualQuantityTable[k].step, sum);
  }
}

std::vector<RecurrentResidual> FindRecurrentResiduals(
    const std::vector<const FlightResiduals*>& flights, const ResidualChannels& error) {
  std::vector<RecurrentResidual> all;
  for (int quantity = 0; quantity < kResidualQuantities; ++quantity) {
    const int level = LevelOf(quantity, flights);
    const double width =
        std::ldexp(kResidualQuantityTable[static_cast<size_t>(quantity)].step, level);
    for (const auto& [index, of_flights] : MeansOf(quantity, level, flights)) {
      for (int channel = 0; channel < kResidualChannels; ++channel) {
        if (!(error[channel] > 0.0)) continue;
        RecurrentResidual r = Summarise(of_flights, channel, error[channel]);
        r.quantity = quantity;
        r.from = static_cast<double>(index) * width;
        r.to = r.from + width;
        all.push_back(r);
      }
    }
  }
  AccountForNumber(&all);
  return all;
}

}  // namespace odmc

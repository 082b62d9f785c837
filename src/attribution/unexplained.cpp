#include "odmc/attribution/unexplained.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include "odmc/attribution/attribution.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

/// Mean force that the model does not give over phases [from, to), over the weight.
double MissingForce(std::vector<PhaseSpan>::const_iterator from,
                    std::vector<PhaseSpan>::const_iterator to, bool flying_only) {
  double sum = 0.0, duration_s = 0.0;
  for (auto span = from; span != to; ++span) {
    if (flying_only && span->phase != FlightPhase::kFlying) continue;
    const double dt = ToSeconds(span->to - span->from);
    sum += dt * span->missing_force;
    duration_s += dt;
  }
  return duration_s > 0.0 ? sum / duration_s : 0.0;
}

}  // namespace

std::string WhereStructured(const std::vector<ChannelStructure>& structure,
                            const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                            const AttributionOptions& options) {
  if (structure.empty()) return "";
  const auto rank = [&](const ChannelStructure& channel) {
    return std::make_tuple(!IsStructured(channel, options), IsSensorNoise(channel, options),
                           channel.whiteness.p, -channel.whiteness.structured_share);
  };
  const auto worst = std::min_element(structure.begin(), structure.end(),
                                      [&](auto& a, auto& b) { return rank(a) < rank(b); });
  const auto c = static_cast<Eigen::Index>(worst - structure.begin());
  std::map<int, std::pair<double, int>> power;
  for (int i = 0; i < flight.size(); ++i) {
    power[flight.block(i)].first += residual(i, c) * residual(i, c);
    ++power[flight.block(i)].second;
  }
  int block = 0;
  double most = 0.0;
  for (const auto& [b, sum] : power) {
    if (sum.first / sum.second > most) {
      most = sum.first / sum.second;
      block = b;
    }
  }
  const auto quantity = std::max_element(worst->dependence.begin(), worst->dependence.end(),
                                         [](auto& a, auto& b) { return a.second < b.second; });
  std::string text =
      worst->name + ", strongest near " + Rounded(worst->whiteness.peak_Hz) + " Hz and in ";
  text += "block " + std::to_string(block) + " (RMS " + Rounded(std::sqrt(most)) + " " +
          worst->unit + ")";
  return text + "; of the quantities it lines up best with " + quantity->first + " (" +
         Rounded(100.0 * quantity->second) + " % of its variance)";
}

std::string PushInFlight(const ReplayResult& replay, Stamp zero) {
  constexpr double kFlight_s = 1.0;
  constexpr double kOverNoise = 3.0;         // a normal vector's norm is more once in 24,000 times
  if (replay.counters.jumps > 0) return "";  // the odometry's, as likely
  const auto& phases = replay.phases;
  const auto is_flight = [](const PhaseSpan& span) {
    return span.phase == FlightPhase::kFlying && ToSeconds(span.to - span.from) >= kFlight_s;
  };
  const double noise = MissingForce(phases.begin(), phases.end(), true);
  auto before = std::find_if(phases.begin(), phases.end(), is_flight);
  while (before != phases.end()) {
    const auto from = before + 1, after = std::find_if(from, phases.end(), is_flight);
    if (after == phases.end()) break;
    const bool touches = std::any_of(
        from, after, [](const PhaseSpan& span) { return span.phase == FlightPhase::kInContact; });
    const double missing = MissingForce(from, after, false);
    if (touches && missing > kOverNoise * noise) {
      return Format(
          "a force of %.2f of the weight acts from %.2f to %.2f s, which the estimator "
          "takes for contact: nothing was looked at there",
          missing, ToSeconds(from->from - zero), ToSeconds(after->from - zero));
    }
    before = after;
  }
  return "";
}

}  // namespace odmc

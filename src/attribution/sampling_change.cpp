#include "odmc/attribution/sampling_change.h"

#include <cmath>
#include <vector>

#include "odmc/inspection/stream_doubt.h"
#include "odmc/sensing/stream_pace.h"

namespace odmc {
namespace {

void Add(double factor, const RotorState& other, RotorState* sum) {
  sum->speed_squared += factor * other.speed_squared;
  sum->speed += factor * other.speed;
  sum->acceleration += factor * other.acceleration;
  sum->speed_squared_rate += factor * other.speed_squared_rate;
}

}  // namespace

std::optional<ThinnedFlight> WithEverySecondRotorSample(const FlightLog& log,
                                                        const ThinnedFlight& flight,
                                                        double start_s) {
  if (flight.size() == 0 || PaceOf(log.rotors).step_s() <= kSparseRotors_s) return std::nullopt;
  FlightLog half;  // what the motion takes of the log, but the IMU
  half.odometry = log.odometry;
  half.rotors = log.rotors;
  LeaveOutEverySecond("rotor_speeds", &half);
  const auto num_rotors = static_cast<int>(flight.sample(0).rotors.speed.size());
  const std::vector<FilteredMotion> halved = FilterFlight(half, num_rotors, {}).samples;
  if (halved.empty()) return std::nullopt;
  const std::vector<FilteredMotion>& whole = flight.motion().samples;
  const auto meant =
      flight.takes_means() ? std::lround(flight.step_s() / flight.motion().step_s) : 1L;
  const double same_s = 0.1 * flight.motion().step_s;  // both have the odometry's stamps
  std::vector<RotorState> rotors;
  rotors.reserve(static_cast<size_t>(flight.size()));
  auto other = halved.begin();
  for (int i = 0; i < flight.size(); ++i) {
    rotors.push_back(flight.sample(i).rotors);
    const size_t first = flight.index(i) - static_cast<size_t>(meant / 2);
    for (size_t k = first; k < first + static_cast<size_t>(meant); ++k) {
      const double t_s = whole[k].t_s - start_s;
      while (other != halved.end() && other->t_s < t_s - same_s) ++other;
      if (other == halved.end() || other->t_s > t_s + same_s) continue;  // beside a gap
      Add(1.0 / static_cast<double>(meant), other->rotors, &rotors.back());
      Add(-1.0 / static_cast<double>(meant), whole[k].rotors, &rotors.back());
    }
  }
  return flight.WithRotors(rotors);
}

ResidualModel::Wrenches ChangeBySampling(const ResidualModel& residual, const ThinnedFlight& halved,
                                         const DynamicModel& model, const ModelValues& values) {
  ResidualModel of_halved(&halved, &residual.file_vehicle(),
                          residual.num_channels() == kNumChannels);
  of_halved.BlendAs(residual);
  return of_halved.Residual(model, values) - residual.Residual(model, values);
}

}  // namespace odmc

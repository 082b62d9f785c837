#include "odmc/attribution/structure.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kHighest_Hz = 7.0;   // edge of the filter
constexpr int kCorrelationLags = 26;  // of 40 ms: one second
constexpr int kLeastBlocks = 6;       // of time, to tell a scatter
const char* const kChannelNames[] = {"force_x",  "force_y",  "force_z",
                                     "torque_x", "torque_y", "torque_z"};

/// Without the mean: an accelerometer has a bias.
Eigen::VectorXd Centred(const Eigen::VectorXd& x) { return x.array() - x.mean(); }

/// @param structured variance of the channel
std::optional<SharedStructure> Shared(const ThinnedFlight& flight, const Eigen::VectorXd& one,
                                      const Eigen::VectorXd& other, double structured,
                                      bool in_use_only) {
  if (!(structured > 0.0) || other.isZero(0.0)) return std::nullopt;
  const Eigen::VectorXd product = Centred(one).cwiseProduct(Centred(other)) / structured;
  std::map<int, std::pair<double, int>> blocks;
  for (int i = 0; i < flight.size(); ++i) {
    if (in_use_only && flight.held_out(i)) continue;
    auto& [sum, count] = blocks[flight.block(i)];
    sum += product[i];
    ++count;
  }
  const auto n = static_cast<double>(blocks.size());
  if (n < kLeastBlocks) return std::nullopt;
  double samples = 0.0, sum = 0.0, square = 0.0;
  for (const auto& entry : blocks) {
    samples += entry.second.second;
    sum += entry.second.first;
  }
  SharedStructure shared;
  shared.share = sum / samples;
  for (const auto& entry : blocks) {
    square += std::pow(entry.second.first - shared.share * entry.second.second, 2);
  }
  shared.sigma = std::sqrt(square * n / (n - 1.0)) / samples;
  return shared;
}

/// Of what slow streams leave out, where they do.
std::vector<std::vector<double>> RunsOf(const ResidualModel::Wrenches& by_sampling, int channel,
                                        const ThinnedFlight& flight, bool in_use_only) {
  if (by_sampling.rows() != flight.size()) return {};
  return flight.Runs(by_sampling.col(channel), in_use_only);
}

}  // namespace

const char* ChannelName(int channel) { return kChannelNames[channel]; }

std::vector<ChannelStructure> StructureByChannel(const ThinnedFlight& flight,
                                                 const ResidualModel::Wrenches& residual,
                                                 int num_channels, const ResidualContext& context,
                                                 const Vehicle& vehicle, bool in_use_only) {
  std::vector<ChannelStructure> all;
  const double rate_Hz = 1.0 / flight.step_s();
  for (int c = 0; c < num_channels; ++c) {
    ChannelStructure channel;
    channel.name = ChannelName(c);
    channel.unit = c < 3 ? "N" : "N m";
    const Eigen::VectorXd y = residual.col(c);
    channel.rmse = std::sqrt(y.squaredNorm() / std::max<Eigen::Index>(1, y.size()));
    const auto runs = flight.Runs(y, in_use_only);
    channel.whiteness = TestWhiteness(runs, rate_Hz, std::min(kHighest_Hz, 0.4 * rate_Hz),
                                      RunsOf(context.by_sampling, c, flight, in_use_only));
    channel.autocorrelation = Autocorrelation(runs, kCorrelationLags);
    const auto share = [&](auto quantity) {
      Eigen::MatrixXd A(y.size(), 3);
      for (int i = 0; i < flight.size(); ++i) {
        const double x = quantity(i);
        A.row(i) << 1.0, x, x * x;
      }
      Eigen::Vector3d size = A.cwiseAbs().colwise().maxCoeff().cwiseMax(1e-12);
      A = A * size.cwiseInverse().asDiagonal();
      const Eigen::Matrix3d H = A.transpose() * A + 1e-9 * Eigen::Matrix3d::Identity();
      const Eigen::VectorXd rest = y - A * H.ldlt().solve(A.transpose() * y);
      const double variance = (y.array() - y.mean()).matrix().squaredNorm();
      return variance > 0.0 ? std::max(0.0, 1.0 - rest.squaredNorm() / variance) : 0.0;
    };
    channel.dependence = {
        {"speed", share([&](int i) { return flight.sample(i).v_WS.norm(); })},
        {"forward_speed", share([&](int i) { return flight.v_B(i).x(); })},
        {"side_speed", share([&](int i) { return flight.v_B(i).y(); })},
        {"axial_speed", share([&](int i) { return flight.v_B(i).z(); })},
        {"roll_rate", share([&](int i) { return flight.w_B(i).x(); })},
        {"pitch_rate", share([&](int i) { return flight.w_B(i).y(); })},
        {"yaw_rate", share([&](int i) { return flight.w_B(i).z(); })},
        {"thrust", share([&](int i) { return flight.sample(i).rotors.speed_squared.sum(); })},
        {"height", share([&](int i) { return flight.sample(i).p_WS.z(); })},
        {"time", share([&](int i) { return flight.sample(i).t_s; })},
    };
    const double variance =
        Centred(y).squaredNorm() / static_cast<double>(std::max<Eigen::Index>(1, y.size()));
    const double slow_over_weight = std::sqrt(channel.whiteness.slow_share * variance) /
                                    (vehicle.mass_kg * vehicle.gravity_m_s2);
    if (c < 2) channel.lean_rad = slow_over_weight;
    if (c == 2) channel.thrust_wander = slow_over_weight;
    if (c < context.again.cols() && context.again.rows() == y.size()) {
      channel.shared = Shared(flight, y, context.again.col(c),
                              channel.whiteness.structured_share * variance, in_use_only);
    }
    all.push_back(std::move(channel));
  }
  return all;
}

double ExplainedStructure(const std::vector<ChannelStructure>& before,
                          const std::vector<ChannelStructure>& after, double whiteness_p,
                          double noise_p) {
  double best = 0.0;
  bool any = false;
  for (size_t c = 0; c < before.size(); ++c) {
    if (before[c].whiteness.p >= whiteness_p) continue;
    any = true;
    const double was = before[c].whiteness.structured_share * before[c].rmse * before[c].rmse;
    if (after[c].whiteness.p > noise_p) return 1.0;  // what remains is noise
    const double is = after[c].whiteness.structured_share * after[c].rmse * after[c].rmse;
    if (was > 0.0) best = std::max(best, 1.0 - is / was);
  }
  return any ? best : 1.0;
}

std::vector<ChannelStructure> LessStructured(std::vector<ChannelStructure> one,
                                             const std::vector<ChannelStructure>& other) {
  for (size_t c = 0; c < one.size(); ++c) {
    if (other[c].whiteness.p > one[c].whiteness.p) one[c] = other[c];
  }
  return one;
}

}  // namespace odmc

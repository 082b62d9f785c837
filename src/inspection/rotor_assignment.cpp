#include "odmc/inspection/rotor_assignment.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <string>

#include "odmc/math/units.h"
#include "odmc/model/frame_layout.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Matrix2d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::VectorXd;
using Order = std::vector<int>;

// Error rates. Under the file's own hypothesis the mean evidence of all others exceeds its own by a
// factor of 1/p with a probability of p at most (Markov's inequality). The mean: six rotors have
// 719 other orders, and together these are 700 times as likely where a flight says nothing. (Spins
// are compared with the sum, which is stricter with the file: 15 others, of which few fit at all.)
constexpr double kRefuted = 1e-4, kDoubtful = 1e-3, kNamed = 0.99;

// What a response may differ from the file's levers by, in sigmas. Measured on recordings with
// right files, columns scatter by 5 to 15 % in this band, mostly by what the controller answers;
// axes couple by products of inertia and leaning rotors.
constexpr double kGainScatter = 0.3;    // of the gain of an axis, beside the best common one
constexpr double kRotorScatter = 0.15;  // of each rotor's own coefficient
constexpr double kCoupling = 0.1;       // over the arm, of each coefficient
constexpr double kOffCentre = 0.1;      // over the arm, of the centre of gravity
constexpr double kReactionScatter = 0.5, kLean_rad = 0.05;
// What pushes roll or pitch often pushes yaw along, and the controller answers where it is quick:
// columns then seem to turn yaw by their levers of roll and pitch, as much as by their reaction.
constexpr double kAlong = 1.5;
// A rotor's inertia takes this long to be seen in its reaction torque: J w / (2 k_m w²). Four makes
// of motors and propellers of 2 to 5 inches lie between 30 and 80 ms.
constexpr double kSpinUp_s = 0.04, kSpinUpSigma_s = 0.04;
constexpr double kSteadyYaw = 0.1;        // imbalance of reaction torques in steady flight
constexpr double kMostSteadyNats = 10.0;  // that this imbalance may say: vehicles with tails differ
constexpr double kReactionPerRadius = 0.2;  // k_m/k_f over the propeller's radius

// Gains that are tried: a factor of nine either way, and their prior (70 %).
constexpr int kGains = 23;
constexpr double kLogGain = 0.2, kLogGainSigma = 0.7;
constexpr double kLeastErrorGain = 0.5;
constexpr int kExhaustive = 4;  // rotors; more are searched
// A lag less likely than this by roll and pitch can't make spins refuted or not.
constexpr double kSpinLagNats = 20.0;

double Gain(int i) { return std::exp(kLogGain * (i - kGains / 2)); }
double LogGainPrior(int i) {
  return -0.5 * std::pow(kLogGain * (i - kGains / 2) / kLogGainSigma, 2);
}

/// The gain that errors of the regression go with: they do not shrink with an effect that is hardly
/// seen (or answered by the controller).
double ErrorGain(double gain) { return std::max(gain, kLeastErrorGain); }

struct AssignmentEvidence {
  double log = 0.0;  // up to what all hypotheses share
  double chi = 0.0;  // squared misfit over the covariance of prior and data
};

/// Of coefficients ~ N(mean, covariance) seen through a regression.
AssignmentEvidence EvidenceOf(const BandRegression& seen, const VectorXd& mean,
                              const MatrixXd& covariance) {
  const Eigen::Index p = mean.size();
  const MatrixXd jitter = 1e-12 * covariance.trace() * MatrixXd::Identity(p, p);
  const MatrixXd root = Eigen::LLT<MatrixXd>(covariance + jitter).matrixL();
  const MatrixXd inner = MatrixXd::Identity(p, p) + root.transpose() * seen.information * root;
  const Eigen::LLT<MatrixXd> factor(inner);
  const VectorXd off = seen.information * (seen.value - mean), pulled = root.transpose() * off;
  AssignmentEvidence e;
  e.chi = off.dot(seen.value - mean) - pulled.dot(factor.solve(pulled));
  e.log = -0.5 * e.chi - MatrixXd(factor.matrixL()).diagonal().array().log().sum();
  return e;
}

/// Torques that the regression leaves out and that go with the rotors: kCoupling of what it
/// explains, shared among the directions. In one that hardly moves they are a large coefficient.
BandRegression WithCoupling(BandRegression seen) {
  const double said = seen.value.dot(seen.information * seen.value);
  seen.information /= 1.0 + kCoupling * kCoupling * said / static_cast<double>(seen.value.size());
  return seen;
}

/// Of one axis, where column j has the lever `lever[j]`.
AssignmentEvidence LeverEvidence(const BandRegression& seen, const VectorXd& lever, double arm,
                                 double gain) {
  const Eigen::Index n = lever.size();
  MatrixXd covariance = std::pow(kGainScatter * gain, 2) * lever * lever.transpose();
  covariance.array() += std::pow(kOffCentre * arm * gain, 2);
  covariance.diagonal().array() += (kRotorScatter * gain * lever).array().square() +
                                   std::pow(kCoupling * arm * ErrorGain(gain), 2);
  return EvidenceOf(seen, gain * lever.head(n), covariance);
}

/// Levers of roll and pitch at each of the file's places, and the arms that scale their errors.
struct Levers {
  VectorXd of[2];
  double arm[2];
  std::vector<std::pair<int, int>> coaxial;  ///< places above each other, the lower number first

  explicit Levers(const Vehicle& vehicle) {
    const int n = vehicle.num_rotors();
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < j; ++i) {
        if (IsCoaxial(vehicle.rotors[static_cast<size_t>(i)],
                      vehicle.rotors[static_cast<size_t>(j)])) {
          coaxial.emplace_back(i, j);
        }
      }
    }
    of[0].resize(n);
    of[1].resize(n);
    for (int j = 0; j < n; ++j) {
      of[0][j] = vehicle.rotors[static_cast<size_t>(j)].p_BP.y();
      of[1][j] = -vehicle.rotors[static_cast<size_t>(j)].p_BP.x();
    }
    for (int axis = 0; axis < 2; ++axis) arm[axis] = of[axis].cwiseAbs().mean();
  }

  /// Of the orders that coaxial places make equal, the one whose columns rise with the places.
  Order Canonical(Order order) const {
    for (const auto& [first, second] : coaxial) {
      const auto a = std::find(order.begin(), order.end(), first);
      const auto b = std::find(order.begin(), order.end(), second);
      if (b < a) std::iter_swap(a, b);
    }
    return order;
  }

  /// How many orders there are.
  double Orders() const {
    return std::tgamma(static_cast<double>(of[0].size()) + 1.0) /
           std::pow(2.0, static_cast<double>(coaxial.size()));
  }

  VectorXd At(int axis, const Order& order) const {
    VectorXd lever(of[axis].size());
    for (Eigen::Index j = 0; j < lever.size(); ++j)
      lever[j] = of[axis][order[static_cast<size_t>(j)]];
    return lever;
  }
};

/// Evidence of hypotheses, by gain.
template <typename Key>
using Table = std::map<Key, AssignmentEvidence>;

double LogSum(const std::vector<double>& logs) {
  const double most = *std::max_element(logs.begin(), logs.end());
  double sum = 0.0;
  for (const double log : logs) sum += std::exp(log - most);
  return most + std::log(sum);
}

template <typename Key>
double Total(const Table<Key>& table) {
  std::vector<double> logs;
  for (const auto& [key, evidence] : table) logs.push_back(evidence.log);
  return LogSum(logs);
}

/// The table at the gain that fits all hypotheses together best.
template <typename Key, typename Make>
Table<Key> AtBestGain(const Make& make, int* gain = nullptr) {
  Table<Key> best;
  double most = -std::numeric_limits<double>::infinity();
  for (int i = 0; i < kGains; ++i) {
    Table<Key> table = make(Gain(i));
    for (auto& [key, evidence] : table) evidence.log += LogGainPrior(i);
    const double total = Total(table);
    if (!(total > most)) continue;
    most = total;
    best = std::move(table);
    if (gain != nullptr) *gain = i;
  }
  return best;
}

template <typename Key>
const Key& BestOf(const Table<Key>& table) {
  return std::max_element(table.begin(), table.end(),
                          [](const auto& a, const auto& b) { return a.second.log < b.second.log; })
      ->first;
}

/// What all nats are divided by, so that the best fits. @param degrees of the misfit
template <typename Key>
double MisfitOf(const Table<Key>& table, double degrees) {
  return std::max(1.0, table.at(BestOf(table)).chi / degrees);
}

/// @param degrees of the misfit
/// @param others what the evidence of the other hypotheses together is divided by
template <typename Key>
AssignmentTest Judge(const Table<Key>& table, const Key& file, double degrees, double others) {
  const Key& best = BestOf(table);
  const double misfit = MisfitOf(table, degrees);
  std::vector<double> logs;
  double next = -std::numeric_limits<double>::infinity();
  for (const auto& [key, evidence] : table) {
    logs.push_back(evidence.log / misfit);
    if (key != best) next = std::max(next, logs.back());
  }
  const double all = LogSum(logs);
  AssignmentTest test;
  test.lead = table.size() > 1 ? table.at(best).log / misfit - next : 0.0;
  test.nats = (table.at(best).log - table.at(file).log) / misfit;
  test.best_share = std::exp(table.at(best).log / misfit - all);
  test.file_share = std::exp(table.at(file).log / misfit - all);
  if (test.file_share < 1.0) test.file_odds = others * test.file_share / (1.0 - test.file_share);
  return test;
}

/// Evidence over all lags, each as likely before the flight as its log says. All tables have the
/// same keys.
/// @param degrees of the misfit
template <typename Key>
Table<Key> OverLags(const std::vector<Table<Key>>& at_lags, double degrees) {
  const auto most_likely = [](const Table<Key>& a, const Table<Key>& b) {
    return a.at(BestOf(a)).log < b.at(BestOf(b)).log;
  };
  const Table<Key>& best = *std::max_element(at_lags.begin(), at_lags.end(), most_likely);
  const double misfit = MisfitOf(best, degrees);
  Table<Key> result = best;
  for (auto& [key, evidence] : result) {
    std::vector<double> logs;
    logs.reserve(at_lags.size());
    for (const Table<Key>& table : at_lags) logs.push_back(table.at(key).log / misfit);
    evidence.log = misfit * LogSum(logs);
  }
  return result;
}

Order FileOrder(int n) {
  Order order(static_cast<size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  return order;
}

Table<Order> AllOrders(const BandRegression& seen, const Levers& levers, int axis, double gain) {
  Table<Order> table;
  Order order = FileOrder(static_cast<int>(seen.value.size()));
  do {
    if (levers.Canonical(order) != order) continue;
    table[order] = LeverEvidence(seen, levers.At(axis, order), levers.arm[axis], gain);
  } while (std::next_permutation(order.begin(), order.end()));
  return table;
}

Table<Order> Sum(Table<Order> a, const Table<Order>& b) {
  for (auto& [key, evidence] : a) {
    evidence.log += b.at(key).log;
    evidence.chi += b.at(key).chi;
  }
  return a;
}

Table<Order> ExhaustiveOrders(const RotorLag& response, const Levers& levers) {
  const auto table = [&](const BandRegression& seen, int axis) {
    return AtBestGain<Order>([&](double gain) { return AllOrders(seen, levers, axis, gain); });
  };
  return Sum(table(response.roll, 0), table(response.pitch, 1));
}

/// Finds likely orders of many rotors without trying all of them.
class OrderSearch {
 public:
  OrderSearch(RotorLag response, const Levers& levers)
      : response_(std::move(response)), levers_(levers) {
    for (int axis = 0; axis < 2; ++axis) gain_[axis] = TypicalGain(axis);
  }

  /// Evidence of every order that was met on the way.
  const Table<Order>& Run() {
    const Order file = FileOrder(static_cast<int>(levers_.of[0].size()));
    for (const Order& start : {file, LinearAssignment()}) Descend(start);
    return met_;
  }

  AssignmentEvidence Of(const Order& any) {
    const Order order = levers_.Canonical(any);
    const auto known = met_.find(order);
    if (known != met_.end()) return known->second;
    AssignmentEvidence sum;
    for (int axis = 0; axis < 2; ++axis) {
      const AssignmentEvidence e =
          LeverEvidence(Seen(axis), levers_.At(axis, order), levers_.arm[axis], Gain(gain_[axis]));
      sum.log += e.log + LogGainPrior(gain_[axis]);
      sum.chi += e.chi;
    }
    return met_[order] = sum;
  }

 private:
  const BandRegression& Seen(int axis) const {
    return axis == 0 ? response_.roll : response_.pitch;
  }

  /// The gain under which levers in any order fit best.
  int TypicalGain(int axis) const {
    const VectorXd& lever = levers_.of[axis];
    const double size = lever.squaredNorm() / static_cast<double>(lever.size()) +
                        std::pow(kCoupling * levers_.arm[axis], 2);
    const MatrixXd any = size * MatrixXd::Identity(lever.size(), lever.size());
    int best = 0;
    double most = -std::numeric_limits<double>::infinity();
    for (int i = 0; i < kGains; ++i) {
      const double log =
          EvidenceOf(Seen(axis), VectorXd::Zero(lever.size()), Gain(i) * Gain(i) * any).log +
          LogGainPrior(i);
      if (log > most) best = i;
      most = std::max(most, log);
    }
    return best;
  }

  /// Swaps pairs as long as that helps.
  void Descend(Order order) {
    for (bool better = true; better;) {
      better = false;
      Order best = order;
      for (size_t a = 0; a < order.size(); ++a) {
        for (size_t b = a + 1; b < order.size(); ++b) {
          Order swapped = order;
          std::swap(swapped[a], swapped[b]);
          if (Of(swapped).log > Of(best).log) best = swapped;
        }
      }
      better = best != order;
      order = best;
    }
  }

  /// Every column at a place of its own with the least squared distance of their coefficients, by
  /// dynamic programming over the sets of places taken (8 rotors: 256).
  Order LinearAssignment() const {
    const int n = static_cast<int>(levers_.of[0].size());
    const MatrixXd distance = Distances();
    const size_t sets = size_t{1} << n;
    std::vector<double> least(sets, std::numeric_limits<double>::infinity());
    std::vector<int> last(sets, 0);
    least[0] = 0.0;
    for (size_t taken = 0; taken + 1 < sets; ++taken) {
      const int column = __builtin_popcountll(taken);
      for (int place = 0; place < n; ++place) {
        const size_t next = taken | (size_t{1} << place);
        const double cost = least[taken] + distance(column, place);
        if (next == taken || !(cost < least[next])) continue;
        least[next] = cost;
        last[next] = place;
      }
    }
    Order order(static_cast<size_t>(n));
    size_t taken = sets - 1;
    for (int column = n - 1; column >= 0; --column) {
      order[static_cast<size_t>(column)] = last[taken];
      taken &= ~(size_t{1} << last[taken]);
    }
    return order;
  }

  /// Of every column's coefficients (their mean beside a prior without an order) from every place.
  MatrixXd Distances() const {
    const Eigen::Index n = levers_.of[0].size();
    MatrixXd distance = MatrixXd::Zero(n, n);
    for (int axis = 0; axis < 2; ++axis) {
      const BandRegression& seen = Seen(axis);
      const VectorXd lever = Gain(gain_[axis]) * levers_.of[axis];
      const MatrixXd prior =
          MatrixXd::Identity(n, n) * (static_cast<double>(n) / lever.squaredNorm());
      const VectorXd mean = (seen.information + prior).ldlt().solve(seen.information * seen.value);
      for (Eigen::Index j = 0; j < n; ++j) {
        distance.row(j) += ((lever.array() - mean[j]) / levers_.arm[axis]).square().matrix();
      }
    }
    return distance;
  }

  RotorLag response_;
  const Levers& levers_;
  int gain_[2];
  Table<Order> met_;
};

/// Orders at each lag, the same ones.
std::vector<Table<Order>> OrdersAtLags(const RotorResponse& response, const Levers& levers) {
  std::vector<Table<Order>> tables;
  std::vector<OrderSearch> searches;
  Table<Order> met;
  for (const RotorLag& lag : response.lags) {
    RotorLag seen = lag;
    seen.roll = WithCoupling(lag.roll);
    seen.pitch = WithCoupling(lag.pitch);
    if (response.share.size() <= kExhaustive) {
      tables.push_back(ExhaustiveOrders(seen, levers));
      continue;
    }
    searches.emplace_back(std::move(seen), levers);
    const Table<Order>& likely = searches.back().Run();
    met.insert(likely.begin(), likely.end());
  }
  for (OrderSearch& search : searches) {
    Table<Order> table;
    for (const auto& [order, evidence] : met) table[order] = search.Of(order);
    tables.push_back(std::move(table));
  }
  for (size_t l = 0; l < tables.size(); ++l) {
    for (auto& [order, evidence] : tables[l]) evidence.log += response.lags[l].log_likelihood;
  }
  return tables;
}

/// Spins as bits: set where the reaction torque on the airframe is along +z.
using Spins = unsigned;

double SpinOf(Spins spins, Eigen::Index j) { return (spins >> j & 1U) != 0U ? 1.0 : -1.0; }

VectorXd SpinVector(Spins spins, Eigen::Index n) {
  VectorXd sign(n);
  for (Eigen::Index j = 0; j < n; ++j) sign[j] = SpinOf(spins, j);
  return sign;
}

Spins FileSpins(const Vehicle& vehicle) {
  Spins spins = 0;
  for (size_t j = 0; j < vehicle.rotors.size(); ++j) {
    if (vehicle.rotors[j].spin > 0.0) spins |= 1U << j;
  }
  return spins;
}

/// Reaction torque over thrust [m]: the file's where it is possible for its propellers.
double ReactionLever(const Vehicle& vehicle) {
  const double typical = kReactionPerRadius * vehicle.rotors.front().radius_m;
  const auto k_m = vehicle.parameters.find("rotor_torque.k_m");
  const auto k_f = vehicle.parameters.find("thrust.k_f");
  const auto& all = vehicle.parameters;
  if (k_m == all.end() || k_f == all.end() || !k_m->second.value || !k_f->second.value) {
    return typical;
  }
  const double stated = *k_m->second.value / *k_f->second.value;
  return stated > 0.25 * typical && stated < 4.0 * typical ? stated : typical;
}

/// Coefficients of yaw with these spins, and how far vehicles differ from them.
AssignmentEvidence SpinEvidence(const BandRegression& seen, const VectorXd& sign, double reaction,
                                const Levers& levers, double gain) {
  const Eigen::Index n = sign.size();
  const double arm = std::hypot(levers.arm[0], levers.arm[1]);
  MatrixXd along = MatrixXd::Zero(n, n);
  for (int axis = 0; axis < 2; ++axis) {
    const VectorXd lever = kAlong / levers.arm[axis] * levers.of[axis];
    along += std::pow(reaction * ErrorGain(gain), 2) * lever * lever.transpose();
  }
  const double scatter = ErrorGain(gain) * kRotorScatter * reaction;
  const double lean = ErrorGain(gain) * kLean_rad * arm;
  const MatrixXd together = sign * sign.transpose();
  MatrixXd covariance = MatrixXd::Zero(2 * n, 2 * n);
  covariance.topLeftCorner(n, n) =
      std::pow(gain * kReactionScatter * reaction, 2) * together + along;
  covariance.topLeftCorner(n, n).diagonal().array() += scatter * scatter + lean * lean;
  covariance.bottomRightCorner(n, n) =
      std::pow(gain * kSpinUpSigma_s * reaction, 2) * together + kSpinUp_s * kSpinUp_s * along;
  covariance.bottomRightCorner(n, n).diagonal().array() += std::pow(kSpinUp_s * scatter, 2);
  VectorXd mean(2 * n);
  mean << reaction * sign, kSpinUp_s * reaction * sign;
  return EvidenceOf(seen, gain * mean, covariance);
}

/// Reaction torques balance in steady flight.
double SteadyNats(const RotorResponse& response, const VectorXd& sign) {
  const double imbalance = sign.dot(response.share);
  const double variance = kSteadyYaw * kSteadyYaw + sign.dot(response.share_spread * sign);
  return std::max(-kMostSteadyNats, -0.5 * imbalance * imbalance / variance);
}

Table<Spins> SpinsAt(const BandRegression& yaw, const Vehicle& vehicle, const Levers& levers) {
  const Eigen::Index n = levers.of[0].size();
  const double reaction = ReactionLever(vehicle);
  return AtBestGain<Spins>([&](double gain) {
    Table<Spins> at;
    for (Spins spins = 0; spins < 1U << n; ++spins) {
      at[spins] = SpinEvidence(yaw, SpinVector(spins, n), reaction, levers, gain);
    }
    return at;
  });
}

/// @param lag_logs how likely each lag is by roll and pitch
Table<Spins> AllSpins(const RotorResponse& response, const std::vector<double>& lag_logs,
                      const Vehicle& vehicle, const Levers& levers) {
  const double most = *std::max_element(lag_logs.begin(), lag_logs.end());
  std::vector<Table<Spins>> tables;
  for (size_t l = 0; l < lag_logs.size(); ++l) {
    if (lag_logs[l] < most - kSpinLagNats) continue;
    const BandRegression& yaw = response.lags[l].yaw;
    Table<Spins> table = SpinsAt(yaw, vehicle, levers);
    for (auto& [spins, evidence] : table) {
      evidence.log += lag_logs[l] - most + yaw.LogRatio(response.lags.front().yaw);
    }
    tables.push_back(std::move(table));
  }
  const Eigen::Index n = response.share.size();
  Table<Spins> all = OverLags(tables, 2.0 * static_cast<double>(n));
  for (auto& [spins, evidence] : all) evidence.log += SteadyNats(response, SpinVector(spins, n));
  return all;
}

std::string OrderText(const Order& order) {
  std::vector<std::string> numbers;
  for (const int place : order) numbers.push_back(std::to_string(place + 1));
  return Listed(numbers);
}

/// True if turning (and mirroring) the file's places by `R` gives those of `order`.
bool IsTurned(const Vehicle& vehicle, const Order& order, const Matrix2d& R) {
  double off = 0.0, size = 0.0;
  for (size_t j = 0; j < order.size(); ++j) {
    const Vector2d here = vehicle.rotors[j].p_BP.head<2>();
    off += (vehicle.rotors[static_cast<size_t>(order[j])].p_BP.head<2>() - R * here).squaredNorm();
    size += here.squaredNorm();
  }
  constexpr double kAlike = 0.2;  // of the arms: an oblong frame still looks turned by 90 degrees
  return off < kAlike * kAlike * size;
}

/// What else than the order would look like it: "; or the body frame ...", or nothing.
std::string OtherCause(const Vehicle& vehicle, const Order& order) {
  for (const int turn : {90, 180, 270}) {
    const double angle = turn * kDegree;
    const Matrix2d R = Eigen::Rotation2Dd(angle).toRotationMatrix();
    if (IsTurned(vehicle, order, R)) {
      return ", or the body frame of attitude and rates is turned by " +
             std::to_string(turn == 270 ? 90 : turn) + " degrees about z";
    }
  }
  if (IsTurned(vehicle, order, Vector2d(1.0, -1.0).asDiagonal())) {
    return ", or left and right are exchanged";
  }
  return "";
}

std::string Figures(const AssignmentTest& test) {
  return " with " + Rounded(test.nats) +
         " nats more than the vehicle file's (which has a probability of " +
         Rounded(test.file_share) + ")";
}

/// Where more than one fits.
std::string Likeliest(const std::string& best, const AssignmentTest& test) {
  return ": the likeliest, " + best + " (probability " + Rounded(test.best_share) + "), fits" +
         Figures(test) + ", but the flight does not tell it from others";
}

/// The lines of `rotors` that fit.
std::string Lines(const RotorAssignment& assignment, const Vehicle& vehicle, bool with_spin) {
  std::vector<std::string> lines;
  for (size_t j = 0; j < assignment.order.size(); ++j) {
    const auto place = static_cast<size_t>(assignment.order[j]);
    const Eigen::Vector3d& p = vehicle.rotors[place].p_BP;
    const double spin = with_spin ? assignment.spin[j] : vehicle.rotors[place].spin;
    lines.push_back("{position_m: [" + Rounded(p.x()) + ", " + Rounded(p.y()) + ", " +
                    Rounded(p.z()) + "], spin: " + (spin > 0.0 ? "cw" : "ccw") + "}");
  }
  return "rotors would be " + Listed(lines);
}

Finding OrderFinding(const RotorAssignment& assignment, const Vehicle& vehicle) {
  Finding finding{"rotor_order", assignment.places.Refutes() ? Trust::kBad : Trust::kDoubtful, ""};
  if (!assignment.places.Names()) {
    finding.what = "the order of the rotors in the vehicle file does not fit the rotor speeds" +
                   Likeliest(OrderText(assignment.order), assignment.places);
    return finding;
  }
  finding.what = "rotor speeds fit the order " + OrderText(assignment.order) +
                 Figures(assignment.places) +
                 ": each column turns at the place of that rotor of the file";
  finding.mend =
      Lines(assignment, vehicle, assignment.spins.Names()) + OtherCause(vehicle, assignment.order);
  return finding;
}

/// Spins of the file's rotors in the order that fits: what they are once the order is mended.
bool SpinsFollowOrder(const RotorAssignment& assignment, const Vehicle& vehicle) {
  for (size_t j = 0; j < assignment.order.size(); ++j) {
    const auto place = static_cast<size_t>(assignment.order[j]);
    if (vehicle.rotors[place].spin != assignment.spin[j]) return false;
  }
  return true;
}

Finding SpinFinding(const RotorAssignment& assignment, const Vehicle& vehicle) {
  Finding finding{"rotor_spin", assignment.spins.Refutes() ? Trust::kBad : Trust::kDoubtful, ""};
  if (!assignment.spins.Names()) {
    finding.what = "the spins in the vehicle file do not fit the yaw motion" +
                   Likeliest(SpinText(assignment.spin), assignment.spins);
    return finding;
  }
  finding.what =
      "the yaw motion fits the spins " + SpinText(assignment.spin) + Figures(assignment.spins);
  finding.mend = Lines(assignment, vehicle, true);
  return finding;
}

}  // namespace

std::string SpinText(const std::vector<double>& spins) {
  std::vector<std::string> words;
  words.reserve(spins.size());
  for (const double s : spins) words.push_back(s > 0.0 ? "cw" : "ccw");
  return Listed(words);
}

bool AssignmentTest::Refutes() const { return file_odds < kRefuted; }
bool AssignmentTest::Doubts() const { return file_odds < kDoubtful; }
bool AssignmentTest::Names() const { return best_share > kNamed; }

RotorAssignment TestRotorAssignment(const RotorResponse& response, const Vehicle& vehicle) {
  RotorAssignment result;
  if (response.blocks == 0) return result;
  result.tested = true;
  const int n = vehicle.num_rotors();
  const Levers levers(vehicle);
  const std::vector<Table<Order>> orders_at = OrdersAtLags(response, levers);
  const Table<Order> orders = OverLags(orders_at, 2.0 * n);
  result.order = BestOf(orders);
  result.log_evidence = orders.at(result.order).log;
  result.misfit = MisfitOf(orders, 2.0 * n);
  result.places = Judge(orders, FileOrder(n), 2.0 * n, levers.Orders() - 1.0);
  std::vector<double> lag_logs;
  lag_logs.reserve(orders_at.size());
  for (const Table<Order>& table : orders_at) lag_logs.push_back(Total(table) / result.misfit);
  const Table<Spins> spins = AllSpins(response, lag_logs, vehicle, levers);
  const Spins best = BestOf(spins);
  for (int j = 0; j < n; ++j) result.spin.push_back(SpinOf(best, j));
  result.spins = Judge(spins, FileSpins(vehicle), 2.0 * n, 1.0);
  const double misfit = MisfitOf(spins, 2.0 * n);
  for (const auto& [pattern, evidence] : spins) {
    result.spin_nats.push_back((evidence.log - spins.at(best).log) / misfit);
  }
  return result;
}

std::vector<Finding> AssignmentFindings(const RotorAssignment& assignment, const Vehicle& vehicle) {
  std::vector<Finding> findings;
  if (!assignment.tested) return findings;
  if (assignment.places.Doubts()) findings.push_back(OrderFinding(assignment, vehicle));
  const bool mended = assignment.places.Doubts() && SpinsFollowOrder(assignment, vehicle);
  if (assignment.spins.Doubts() && !mended) findings.push_back(SpinFinding(assignment, vehicle));
  return findings;
}

}  // namespace odmc

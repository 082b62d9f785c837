#include "odmc/attribution/evidence.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <utility>

#include "odmc/analysis/parallel.h"
#include "odmc/attribution/structure.h"

namespace odmc {
namespace {

constexpr int kForceChannels = 3;

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using Wrenches = ResidualModel::Wrenches;

constexpr double kWide = 5.0;          // natural sizes of what is strangely large
constexpr double kWideFrom = 2.0;      // natural sizes from which that is looked at
constexpr double kBlock_s = 1.0;       // of Lead: a manoeuvre spans more than one
constexpr int kShiftsOfADraw = 10;     // surrogates of one draw of the noise
constexpr double kLeastShift_s = 2.0;  // of surrogates: beyond the noise's correlation

/// Normal distribution's cumulative.
double Phi(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

MatrixXd Picked(const MatrixXd& gram, const std::vector<int>& rows, const std::vector<int>& cols) {
  MatrixXd picked(static_cast<Index>(rows.size()), static_cast<Index>(cols.size()));
  for (size_t i = 0; i < rows.size(); ++i) {
    for (size_t k = 0; k < cols.size(); ++k) {
      picked(static_cast<Index>(i), static_cast<Index>(k)) = gram(rows[i], cols[k]);
    }
  }
  return picked;
}

/// Adds a matrix to some rows and columns of a larger one.
void Scatter(const MatrixXd& from, const std::vector<int>& to, MatrixXd* sum) {
  for (Index i = 0; i < from.rows(); ++i) {
    for (Index k = 0; k < from.cols(); ++k) {
      (*sum)(to[static_cast<size_t>(i)], to[static_cast<size_t>(k)]) += from(i, k);
    }
  }
}

/// The sum of a matrix's first columns times coefficients, most of which are zero.
VectorXd Combined(const MatrixXd& columns, const VectorXd& coefficients) {
  VectorXd sum = VectorXd::Zero(columns.rows());
  for (Index k = 0; k < coefficients.size(); ++k) {
    if (coefficients[k] != 0.0) sum += coefficients[k] * columns.col(k);
  }
  return sum;
}

/// What the others of an effect's parameters do is in proportion to its size s, and what a fit
/// linearized at s0 finds is their product with it: their step is worth s0/s where the size is s.
/// Settings stay in their bounds, and nothing goes beyond what was ever likely.
/// @param before where the fit was linearized
/// @param at what it found; changed
void Rescale(const EffectCandidate& candidate, const std::vector<ResidualCoefficient>& before,
             std::map<std::string, double>* at) {
  constexpr double kLikely = 3.0;  // prior sigmas
  const auto size = std::find_if(before.begin(), before.end(), [&](const ResidualCoefficient& c) {
    return c.name == candidate.size;
  });
  for (const ResidualCoefficient& c : before) {
    const auto value = at->find(c.name);
    if (value == at->end()) continue;
    if (size != before.end() && c.name != candidate.size && at->at(candidate.size) != 0.0) {
      const double ratio = size->linearized_at / at->at(candidate.size);
      const double reach =
          std::max(kLikely * c.prior_sigma, std::abs(value->second - c.prior_mean));
      value->second = std::clamp(c.linearized_at + ratio * (value->second - c.linearized_at),
                                 c.prior_mean - reach, c.prior_mean + reach);
    }
    const auto bounds = candidate.bounds.find(c.name);
    if (bounds == candidate.bounds.end()) continue;
    value->second = std::clamp(value->second, bounds->second.first, bounds->second.second);
  }
}

double LogDeterminant(const Eigen::LLT<MatrixXd>& llt) {
  return 2.0 * MatrixXd(llt.matrixL()).diagonal().array().log().sum();
}

/// What further columns gain at most beside known ones, by the sums of products of both and of what
/// they explain.
double MostGain(const MatrixXd& gram, const VectorXd& base_sigma, const VectorXd& sigma) {
  const Index n = base_sigma.size(), k = sigma.size();
  MatrixXd H = gram.topLeftCorner(n, n);
  H.diagonal() += base_sigma.cwiseAbs2().cwiseInverse();
  const Eigen::LLT<MatrixXd> llt(H);
  const MatrixXd BX = gram.block(0, n, n, k);
  MatrixXd S = gram.block(n, n, k, k) - BX.transpose() * llt.solve(BX);
  S.diagonal() += sigma.cwiseAbs2().cwiseInverse();
  const VectorXd g =
      gram.block(n, n + k, k, 1) - BX.transpose() * llt.solve(gram.block(0, n + k, n, 1));
  return 0.5 * g.dot(S.llt().solve(g));
}

/// A value as a coefficient moves it.
double Changed(const ResidualCoefficient& coefficient, double value, double change) {
  // Motion is linear in the inverse of inertia.
  constexpr double kMostRatio = 4.0;
  if (coefficient.effect == "inertia" && value > 0.0) {
    return value / std::clamp(1.0 - change / value, 1.0 / kMostRatio, kMostRatio);
  }
  return value + change;
}

/// Surrogates of a flight's noise: as it may have been, shifted in time, its sign random; by
/// column.
MatrixXd SurrogatesOf(const FlightRegression& flight, int count, std::mt19937* random) {
  const auto n = static_cast<Index>(flight.rows().size());
  const Index least = std::min(n / 4, static_cast<Index>(kLeastShift_s / flight.flight().step_s()));
  std::uniform_int_distribution<Index> shift(least, std::max(least, n - least));
  std::bernoulli_distribution flip;
  std::normal_distribution<double> normal;
  VectorXd z(flight.num_noise_columns());
  for (Index k = 0; k < z.size(); ++k) z[k] = normal(*random);
  const VectorXd noise = flight.NoiseDraw(z);
  MatrixXd shifted(noise.size(), count);
  for (int k = 0; k < count; ++k) {
    const Index by = shift(*random);
    const double sign = flip(*random) ? 1.0 : -1.0;
    for (int c = 0; c < flight.num_channels(); ++c) {
      const auto from = noise.segment(c * n, n);
      shifted.col(k).segment(c * n, n - by) = sign * from.tail(n - by);
      shifted.col(k).segment(c * n + n - by, by) = sign * from.head(by);
    }
  }
  return shifted;
}

}  // namespace

double LogSignOdds(PhysicalSign sign, bool is_certain, double value, double sigma) {
  if (sign == PhysicalSign::kAny) return 0.0;
  const double towards = sign == PhysicalSign::kPositive ? 1.0 : -1.0;
  const double right = Phi(towards * value / std::max(sigma, 1e-300));
  const double wrong = is_certain ? 0.0 : Evidence::kOutlierPriorShare;
  return std::log(std::max(1e-300, (1.0 - wrong) * right + wrong * (1.0 - right)) / 0.5);
}

Evidence::Evidence(const std::vector<FlightWithInstruments>& flights, const ModelPoint& point,
                   int jobs)
    : point_(point), jobs_(jobs) {
  if (flights.empty()) throw std::invalid_argument("evidence needs a flight");
  std::vector<std::optional<FlightRegression>> made(flights.size());
  ForEachOf(static_cast<int>(flights.size()), jobs, [&](int f) {
    const FlightWithInstruments& flight = flights[static_cast<size_t>(f)];
    made[static_cast<size_t>(f)].emplace(flight.residual, flight.instruments,
                                         point.OfFlight(static_cast<size_t>(f)),
                                         flights.size() == 1 ? jobs : 1);
  });
  for (auto& regression : made) flights_.push_back(std::move(*regression));
  num_channels_ = kNumChannels;
  for (const FlightRegression& r : flights_) {
    num_channels_ = std::min(num_channels_, r.num_channels());
  }
  place_.resize(flights_.size());
  added_.resize(flights_.size());
  for (const auto& [name, value] : flights_.front().point().values) {
    if (point.own.empty() || point.own.front().count(name) == 0) point_.values[name] = value;
  }
  std::map<std::string, int> shared;
  std::vector<int> columns;
  double samples = 0.0;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const FlightRegression& r = flights_[f];
    std::vector<int> local(static_cast<size_t>(r.num_base()));
    for (size_t k = 0; k < local.size(); ++k) local[k] = static_cast<int>(k);
    Place(f, local, &shared, &columns);
    for (int c = 0; c < kNumChannels; ++c) plain_sigma_[c] += r.y().col(c).squaredNorm();
    samples += static_cast<double>(r.y().rows());
  }
  for (double& sigma : plain_sigma_) sigma = std::sqrt(sigma / std::max(1.0, samples));
  num_base_ = num_columns();
}

bool Evidence::IsOwn(const ResidualCoefficient& coefficient) const {
  return flights_.size() > 1 && coefficient.belongs_to_flight;
}

void Evidence::Place(size_t f, const std::vector<int>& local, std::map<std::string, int>* shared,
                     std::vector<int>* columns) {
  for (const int k : local) {
    const ResidualCoefficient& coefficient = flights_[f].column(k);
    const bool is_own = IsOwn(coefficient);
    // Of a single flight nothing is shared.
    const auto known =
        flights_.size() > 1 && !is_own ? shared->find(coefficient.name) : shared->end();
    int at = num_columns();
    if (known != shared->end()) {
      at = known->second;
    } else {
      Column column{coefficient};
      column.flight = is_own ? static_cast<int>(f) : -1;
      columns_.push_back(std::move(column));
      columns->push_back(at);
      if (!is_own) (*shared)[coefficient.name] = at;
    }
    place_[f].push_back(at);
  }
}

std::vector<int> Evidence::AddAll(const std::vector<EffectCandidate>& candidates) {
  const size_t n = flights_.size();
  std::vector<FlightRegression::Seen> seen(candidates.size() * n);
  ForEachOf(static_cast<int>(seen.size()), jobs_, [&](int i) {
    const auto at = static_cast<size_t>(i);
    seen[at] = flights_[at % n].ActingColumns(candidates[at / n]);
  });
  std::vector<int> variants;
  auto next = std::make_move_iterator(seen.begin());
  for (const EffectCandidate& candidate : candidates) {
    variants.push_back(Append(candidate, {next, next + static_cast<Index>(n)}));
    next += static_cast<Index>(n);
  }
  return variants;
}

int Evidence::Append(const EffectCandidate& candidate, std::vector<FlightRegression::Seen> seen) {
  std::vector<FlightRegression::Added> added;
  for (size_t f = 0; f < flights_.size(); ++f) {
    added.push_back(flights_[f].Append(candidate.effect, std::move(seen[f])));
  }
  EffectVariant variant;
  variant.candidate = candidate;
  std::map<std::string, int> shared;
  for (size_t f = 0; f < flights_.size(); ++f) {
    Place(f, added[f].columns, &shared, &variant.columns);
    if (added[f].offset < 0) continue;
    std::vector<int> offset;
    Place(f, {added[f].offset}, &shared, &offset);
    variant.offset = place_[f].back();
  }
  if (variant.columns.empty()) return -1;
  for (size_t f = 0; f < flights_.size(); ++f) added_[f].push_back(added[f]);
  variants_.push_back(std::move(variant));
  return static_cast<int>(variants_.size()) - 1;
}

Evidence::VariantValues Evidence::LinearizedAt(int v) const {
  VariantValues at(flights_.size());
  for (size_t f = 0; f < flights_.size(); ++f) {
    for (const int k : added_[f][static_cast<size_t>(v)].columns) {
      const ResidualCoefficient& column = flights_[f].column(k);
      at[f][column.name] = column.linearized_at;
    }
  }
  return at;
}

Evidence::VariantValues Evidence::FoundBy(const EffectFit& fit, int v) const {
  const EffectCandidate& candidate = variants_[static_cast<size_t>(v)].candidate;
  VariantValues found(flights_.size());
  for (size_t f = 0; f < flights_.size(); ++f) {
    for (size_t k = 0; k < fit.columns.size(); ++k) {
      const Column& column = columns_[static_cast<size_t>(fit.columns[k])];
      if (column.effect != candidate.effect) continue;
      if (column.flight >= 0 && column.flight != static_cast<int>(f)) continue;
      found[f][column.name] = fit.coefficients[static_cast<Index>(k)];
    }
    std::vector<ResidualCoefficient> before;
    for (const int k : added_[f][static_cast<size_t>(v)].columns) {
      before.push_back(flights_[f].column(k));
    }
    Rescale(candidate, before, &found[f]);
  }
  return found;
}

void Evidence::Relinearize(const std::map<int, VariantValues>& at) {
  struct Task {
    int variant;
    size_t flight;
    const std::map<std::string, double>* at;
    FlightRegression::Seen seen;
  };
  std::vector<Task> tasks;
  for (const auto& [v, values] : at) {
    for (size_t f = 0; f < flights_.size(); ++f) tasks.push_back({v, f, &values[f], {}});
  }
  ForEachOf(static_cast<int>(tasks.size()), jobs_, [&](int i) {
    Task& task = tasks[static_cast<size_t>(i)];
    task.seen = flights_[task.flight].LinearizedAt(
        variants_[static_cast<size_t>(task.variant)].candidate, *task.at);
  });
  auto task = tasks.begin();
  for (const auto& entry : at) {
    std::vector<FlightRegression::Seen> seen;
    for (size_t f = 0; f < flights_.size(); ++f, ++task) seen.push_back(std::move(task->seen));
    Replace(entry.first, std::move(seen));
  }
}

void Evidence::Replace(int v, std::vector<FlightRegression::Seen> seen) {
  EffectVariant& variant = variants_[static_cast<size_t>(v)];
  std::map<std::string, int> shared;
  if (variant.offset >= 0) shared["offset"] = variant.offset;
  for (size_t f = 0; f < flights_.size(); ++f) {
    FlightRegression::Added& added = added_[f][static_cast<size_t>(v)];
    const int before = added.offset;
    flights_[f].Replace(std::move(seen[f]), &added);
    for (const int k : added.columns) {
      columns_[static_cast<size_t>(place_[f][static_cast<size_t>(k)])].linearized_at =
          flights_[f].column(k).linearized_at;
    }
    if (added.offset == before) continue;
    std::vector<int> offset;
    Place(f, {added.offset}, &shared, &offset);
    variant.offset = place_[f].back();
  }
}

double Evidence::StepInSigmas(int v, const EffectFit& fit) const {
  const EffectVariant& variant = variants_[static_cast<size_t>(v)];
  double most = 0.0;
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    const Column& column = columns_[static_cast<size_t>(fit.columns[k])];
    if (column.effect != variant.candidate.effect) continue;
    const auto at = static_cast<Index>(k);
    double value = fit.coefficients[at];
    const auto bounds = variant.candidate.bounds.find(column.name);
    if (bounds != variant.candidate.bounds.end()) {
      value = std::clamp(value, bounds->second.first, bounds->second.second);
    }
    const double sigma = std::sqrt(std::max(1e-300, fit.covariance(at, at)));
    most = std::max(most, std::abs(value - column.linearized_at) / sigma);
  }
  return most;
}

void Evidence::SetAside(const VariantSet& variants) {
  for (size_t f = 0; f < flights_.size(); ++f) {
    flights_[f].SetNothingAside();
    for (const int v : variants) flights_[f].SetAside(added_[f][static_cast<size_t>(v)]);
  }
}

void Evidence::EstimateNoise() {
  ForEachOf(num_flights(), jobs_, [&](int f) { flights_[static_cast<size_t>(f)].EstimateNoise(); });
  Assemble();
}

void Evidence::AddTo(const MatrixXd& local, size_t f, MatrixXd* gram) const {
  std::vector<int> to = place_[f];
  to.push_back(num_columns());
  Scatter(local, to, gram);
}

void Evidence::Assemble() {
  gram_.setZero(num_columns() + 1, num_columns() + 1);
  for (size_t f = 0; f < flights_.size(); ++f) AddTo(flights_[f].gram(), f, &gram_);
}

int Evidence::num_folds() const {
  return flights_.size() > 1 ? num_flights() : Instruments::kFolds;
}

MatrixXd Evidence::GramWithout(int fold) const {
  MatrixXd of_fold = MatrixXd::Zero(gram_.rows(), gram_.cols());
  if (flights_.size() > 1) {
    AddTo(flights_[static_cast<size_t>(fold)].gram(), static_cast<size_t>(fold), &of_fold);
  } else {
    AddTo(flights_.front().fold_gram(fold), 0, &of_fold);
  }
  return gram_ - of_fold;
}

std::string Evidence::FlexibleGain::Text(const FlexibleFeatures& features) const {
  const auto k = static_cast<size_t>(feature);
  return channel ? std::string(ChannelName(*channel)) + " by \"" + features.names[k] + "\""
                 : "a force by \"" + features.world_names[k];
}

MatrixXd Evidence::AddTo(FlexibleSums* sums, size_t flight, int c, const MatrixXd& foreseen,
                         double unit, const EffectFit& fit, const VectorXd& errors,
                         const VectorXd* effect) const {
  const FlightRegression& r = flights_[flight];
  const auto n = static_cast<Index>(r.rows().size());
  MatrixXd phi(n, foreseen.cols());
  for (Index k = 0; k < phi.cols(); ++k) phi.col(k) = r.WhitenedFeature(c, foreseen.col(k), unit);
  sums->g += phi.transpose() * errors.segment(c * n, n);
  sums->size += phi.colwise().squaredNorm().transpose();
  if (effect != nullptr) sums->along_effect += phi.transpose() * effect->segment(c * n, n);
  MatrixXd own = MatrixXd::Zero(n, sums->cross.rows());
  for (size_t l = 0; l < place_[flight].size(); ++l) {
    const auto at = std::find(fit.columns.begin(), fit.columns.end(), place_[flight][l]);
    if (at == fit.columns.end()) continue;
    own.col(at - fit.columns.begin()) = r.white().col(static_cast<Index>(l)).segment(c * n, n);
  }
  sums->cross.noalias() += own.transpose() * phi;
  return phi;
}

VectorXd Evidence::Products(size_t flight, const EffectFit& fit, const VectorXd& white) const {
  VectorXd products = VectorXd::Zero(static_cast<Index>(fit.columns.size()));
  for (size_t l = 0; l < place_[flight].size(); ++l) {
    const auto at = std::find(fit.columns.begin(), fit.columns.end(), place_[flight][l]);
    if (at == fit.columns.end()) continue;
    products[at - fit.columns.begin()] +=
        flights_[flight].white().col(static_cast<Index>(l)).dot(white);
  }
  return products;
}

Evidence::FlexibleGain Evidence::BestFlexible(const VariantSet& set,
                                              const FlexibleFeatures& features,
                                              const FlexibleChoice& choice) const {
  constexpr double kCopy = 0.9;  // squared correlation beside the fit's columns
  const EffectFit fit = Solve(set);
  const auto m = static_cast<Index>(fit.columns.size());
  const auto along_body = static_cast<Index>(features.names.size());
  const auto along_world = static_cast<Index>(features.world_names.size());
  const double tried = static_cast<double>(num_channels_ * along_body + along_world);
  FlexibleGain best;
  best.nats = -std::numeric_limits<double>::infinity();
  VectorXd effect_cross = VectorXd::Zero(m);
  double effect_size = 0.0;
  for (size_t f = 0; choice.effect != nullptr && f < flights_.size(); ++f) {
    effect_cross += Products(f, fit, (*choice.effect)[f]);
    effect_size += (*choice.effect)[f].squaredNorm();
  }
  const VectorXd effect_taken = fit.covariance * effect_cross;
  effect_size -= effect_cross.dot(effect_taken);
  const auto look = [&](const FlexibleSums& sums, std::optional<int> channel) {
    const VectorXd taken =
        sums.cross.cwiseProduct(fit.covariance * sums.cross).colwise().sum().transpose();
    for (Index k = 0; k < sums.g.size(); ++k) {
      // Its coefficient has a prior of the residual's size: one, in these units.
      const double s = std::max(0.0, sums.size[k] - taken[k]);
      if (choice.effect != nullptr) {
        const double along = sums.along_effect[k] - sums.cross.col(k).dot(effect_taken);
        if (along * along > kCopy * effect_size * s) continue;
      }
      const double nats =
          0.5 * (sums.g[k] * sums.g[k] / (1.0 + s) - std::log(1.0 + s)) - std::log(tried);
      if (nats > best.nats) best = {channel, static_cast<int>(k), nats};
    }
  };
  const auto effect_of = [&](size_t f) {
    return choice.effect != nullptr ? &(*choice.effect)[f] : nullptr;
  };
  std::vector<VectorXd> errors;
  for (size_t f = 0; f < flights_.size(); ++f) errors.push_back(ErrorsOf(f, set, fit));
  std::vector<FlexibleSums> by_channel(static_cast<size_t>(num_channels_),
                                       FlexibleSums(m, along_body));
  ForEachOf(num_channels_, jobs_, [&](int c) {
    for (size_t f = 0; f < flights_.size(); ++f) {
      AddTo(&by_channel[static_cast<size_t>(c)], f, c, features.foreseen[f], plain_sigma_[c], fit,
            errors[f], effect_of(f));
    }
  });
  for (int c = 0; c < num_channels_; ++c) look(by_channel[static_cast<size_t>(c)], c);
  if (!choice.with_world) return best;
  FlexibleSums sums(m, along_world);
  for (size_t f = 0; f < flights_.size(); ++f) {
    for (int c = 0; c < kForceChannels; ++c) {
      AddTo(&sums, f, c, features.world_foreseen[f][c], ForceSigma(), fit, errors[f], effect_of(f));
    }
  }
  look(sums, std::nullopt);
  return best;
}

double Evidence::ForceSigma() const {
  double square = 0.0;
  for (int c = 0; c < kForceChannels; ++c) square += plain_sigma_[c] * plain_sigma_[c];
  return std::sqrt(square / kForceChannels);
}

int Evidence::AddFlexible(const FlexibleGain& gain, const FlexibleFeatures& features) {
  EffectVariant variant;
  variant.candidate.effect = gain.Text(features);
  std::map<std::string, int> shared;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const FlightRegression& r = flights_[f];
    const auto n = static_cast<Index>(r.rows().size());
    VectorXd whitened = VectorXd::Zero(r.num_channels() * n);  // torque, too, where it has one
    if (gain.channel) {
      const int c = *gain.channel;
      whitened.segment(c * n, n) =
          r.WhitenedFeature(c, features.foreseen[f].col(gain.feature), plain_sigma_[c]);
    } else {
      for (int c = 0; c < kForceChannels; ++c) {
        whitened.segment(c * n, n) =
            r.WhitenedFeature(c, features.world_foreseen[f][c].col(gain.feature), ForceSigma());
      }
    }
    const int local = flights_[f].AddFeature(whitened, variant.candidate.effect);
    Place(f, {local}, &shared, &variant.columns);
    added_[f].push_back({{local}, -1});
  }
  variants_.push_back(std::move(variant));
  Assemble();
  return static_cast<int>(variants_.size()) - 1;
}

std::vector<int> Evidence::ColumnsOf(const VariantSet& set) const {
  std::vector<int> columns;
  for (int k = 0; k < num_base_; ++k) columns.push_back(k);
  for (const int v : set) {
    columns.insert(columns.end(), variants_[v].columns.begin(), variants_[v].columns.end());
  }
  return columns;
}

double Evidence::SignTerm(const std::vector<int>& columns, const VectorXd& coefficients,
                          const VectorXd& sigma) const {
  double sum = 0.0;
  for (size_t k = 0; k < columns.size(); ++k) {
    const Column& column = columns_[columns[k]];
    const auto i = static_cast<Index>(k);
    // Motion is linear in the inverse of inertia, which a coefficient as large as the inertia makes
    // zero.
    const double change = column.effect == "inertia" ? -coefficients[i] : coefficients[i];
    sum += LogSignOdds(column.sign, column.certain_sign, column.about + change, sigma[i]);
  }
  return sum;
}

double Evidence::BeliefIn(const EffectFit& fit) const {
  VectorXd sigma = fit.covariance.diagonal().cwiseSqrt();
  double belief = 0.0;
  std::vector<int> base;
  for (size_t k = 0; k < fit.columns.size() && fit.columns[k] < num_base_; ++k) {
    const Column& column = columns_[fit.columns[k]];
    base.push_back(fit.columns[k]);
    const double z =
        (fit.coefficients[static_cast<Index>(k)] - column.prior_mean) / column.prior_sigma;
    belief -= 0.5 * z * z;
  }
  const auto n = static_cast<Index>(base.size());
  return belief + SignTerm(base, fit.coefficients.head(n), sigma.head(n));
}

/// A regression, and the priors of its coefficients.
struct Evidence::NormalEquations {
  std::vector<int> columns;
  MatrixXd XX;
  VectorXd Xy;
  double yy = 0.0;
  VectorXd mean, sigma;  // of the priors
};

VectorXd Evidence::WithoutOffsets(const VariantSet& set) const {
  VectorXd u = VectorXd::Zero(num_columns() + 1);
  u[num_columns()] = 1.0;
  for (const int v : set) {
    if (variants_[v].offset >= 0) u[variants_[v].offset] = -1.0;
  }
  return u;
}

Evidence::NormalEquations Evidence::EquationsOf(const MatrixXd& gram,
                                                const std::vector<int>& columns,
                                                const VariantSet& set) const {
  const VectorXd u = WithoutOffsets(set);
  const VectorXd gram_u = gram * u;
  const auto n = static_cast<Index>(columns.size());
  NormalEquations e;
  e.columns = columns;
  e.XX = Picked(gram, columns, columns);
  e.Xy.resize(n);
  e.yy = u.dot(gram_u);
  e.mean.resize(n);
  e.sigma.resize(n);
  for (Index k = 0; k < n; ++k) {
    const Column& column = columns_[columns[static_cast<size_t>(k)]];
    e.mean[k] = column.prior_mean;
    e.sigma[k] = column.prior_sigma;
    e.Xy[k] = gram_u[columns[static_cast<size_t>(k)]];
  }
  return e;
}

EffectFit Evidence::FitOf(const NormalEquations& e, const VectorXd& prior_sigma) const {
  // In units of the priors' sigmas, in which all is of the order of one.
  EffectFit p;
  p.columns = e.columns;
  const Index n = prior_sigma.size();
  const VectorXd centre = e.mean.cwiseQuotient(prior_sigma);
  MatrixXd H = prior_sigma.asDiagonal() * e.XX * prior_sigma.asDiagonal();
  H.diagonal().array() += 1.0;
  const Eigen::LLT<MatrixXd> llt(H);
  const VectorXd b = prior_sigma.cwiseProduct(e.Xy) + centre;
  const VectorXd x = llt.solve(b);
  const MatrixXd covariance = llt.solve(MatrixXd::Identity(n, n));
  p.coefficients = prior_sigma.cwiseProduct(x);
  p.covariance = prior_sigma.asDiagonal() * covariance * prior_sigma.asDiagonal();
  p.log_evidence = 0.5 * (b.dot(x) - e.yy - centre.squaredNorm()) - 0.5 * LogDeterminant(llt) +
                   SignTerm(e.columns, p.coefficients, p.covariance.diagonal().cwiseSqrt());
  if (!std::isfinite(p.log_evidence)) {
    p.log_evidence = -std::numeric_limits<double>::infinity();
  }
  return p;
}

int Evidence::WidenStrange(const VariantSet& set, const NormalEquations& e, const EffectFit& fit,
                           VectorXd* prior_sigma) const {
  Index at = num_base_;
  int wide = 0;
  for (const int v : set) {
    const auto size = static_cast<Index>(variants_[v].columns.size());
    const VectorXd z =
        (fit.coefficients - e.mean).segment(at, size).cwiseQuotient(e.sigma.segment(at, size));
    if (z.cwiseAbs().maxCoeff() > kWideFrom) {
      prior_sigma->segment(at, size) *= kWide;
      ++wide;
    }
    at += size;
  }
  return wide;
}

EffectFit Evidence::SolveWith(const MatrixXd& gram, const std::vector<int>& columns,
                              const VariantSet& set) const {
  const NormalEquations equations = EquationsOf(gram, columns, set);
  double log_prior = 0.0;
  for (const int v : set) log_prior += variants_[v].log_prior;
  const double usual = static_cast<double>(set.size()) * std::log(1.0 - kOutlierPriorShare);
  EffectFit best = FitOf(equations, equations.sigma);
  best.log_evidence += log_prior;
  best.log_evidence += usual;
  VectorXd widened = equations.sigma;
  const int wide = WidenStrange(set, equations, best, &widened);
  if (wide > 0) {
    EffectFit other = FitOf(equations, widened);
    other.log_evidence +=
        log_prior + usual +
        wide * (std::log(kOutlierPriorShare) - std::log(1.0 - kOutlierPriorShare));
    if (other.log_evidence > best.log_evidence) return other;
  }
  return best;
}

EffectFit Evidence::Solve(const VariantSet& set) const {
  return SolveWith(gram_, ColumnsOf(set), set);
}

double Evidence::LogEvidenceWhereLinearized(int variant) const {
  const EffectVariant& v = variants_[static_cast<size_t>(variant)];
  NormalEquations e = EquationsOf(gram_, ColumnsOf({}), {variant});
  VectorXd at = VectorXd::Zero(gram_.rows());
  double log_prior = v.log_prior;
  for (const int k : v.columns) {
    const Column& column = columns_[static_cast<size_t>(k)];
    at[k] = column.linearized_at;
    const double z = (column.linearized_at - column.prior_mean) / column.prior_sigma;
    log_prior -=
        0.5 * std::min(z * z, z * z / (kWide * kWide) - 2.0 * std::log(kOutlierPriorShare));
  }
  const VectorXd gram_at = gram_ * at;
  e.yy += at.dot(gram_at) - 2.0 * WithoutOffsets({variant}).dot(gram_at);
  for (size_t k = 0; k < e.columns.size(); ++k) {
    e.Xy[static_cast<Index>(k)] -= gram_at[e.columns[k]];
  }
  return FitOf(e, e.sigma).log_evidence + log_prior;
}

void Evidence::CountWhatIsBorneOut(int variant) {
  EffectVariant& v = variants_[static_cast<size_t>(variant)];
  const double beyond = Solve({variant}).log_evidence - LogEvidenceWhereLinearized(variant);
  if (!(beyond > 0.0)) return;
  v.linearization_penalty += beyond;
  v.log_prior -= beyond;
}

double Evidence::GainInNats(const VariantSet& set) const {
  return Solve(set).log_evidence - Solve({}).log_evidence;
}

VectorXd Evidence::PriorSigmas(const std::vector<int>& columns) const {
  VectorXd sigmas(static_cast<Index>(columns.size()));
  for (size_t k = 0; k < columns.size(); ++k) {
    sigmas[static_cast<Index>(k)] = column(columns[k]).prior_sigma;
  }
  return sigmas;
}

Evidence::GainBound Evidence::GainBoundOf(const EffectCandidate& candidate) const {
  std::vector<FlightRegression::QuickSums> glances(flights_.size());
  ForEachOf(num_flights(), jobs_, [&](int f) {
    glances[static_cast<size_t>(f)] = flights_[static_cast<size_t>(f)].QuickSumsOf(candidate, {});
  });
  // Places of the candidate's columns behind the base's.
  std::map<std::string, int> shared;
  std::vector<double> sigmas;
  std::vector<std::vector<int>> places(flights_.size());
  for (size_t f = 0; f < flights_.size(); ++f) {
    for (int k = 0; k < flights_[f].num_base(); ++k) {
      places[f].push_back(place_[f][static_cast<size_t>(k)]);
    }
    for (const ResidualCoefficient& c : glances[f].columns) {
      const auto known = IsOwn(c) ? shared.end() : shared.find(c.name);
      const int at =
          known != shared.end() ? known->second : num_base_ + static_cast<int>(sigmas.size());
      if (known == shared.end()) sigmas.push_back(c.prior_sigma);
      if (!IsOwn(c)) shared[c.name] = at;
      places[f].push_back(at);
    }
  }
  if (sigmas.empty()) return {};
  const VectorXd sigma = VectorXd::Map(sigmas.data(), static_cast<Index>(sigmas.size()));
  std::vector<int> base(static_cast<size_t>(num_base_));
  for (int k = 0; k < num_base_; ++k) base[static_cast<size_t>(k)] = k;
  const auto gain = [&](MatrixXd FlightRegression::QuickSums::*of) {
    const Index size = num_base_ + sigma.size() + 1;
    MatrixXd sum = MatrixXd::Zero(size, size);
    for (size_t f = 0; f < flights_.size(); ++f) {
      if (glances[f].columns.empty()) continue;  // it moves nothing there
      std::vector<int> to = places[f];
      to.push_back(static_cast<int>(size) - 1);
      Scatter(glances[f].*of, to, &sum);
    }
    const double most = MostGain(sum, PriorSigmas(base), sigma);
    return std::isfinite(most) ? most : 0.0;
  };
  return {gain(&FlightRegression::QuickSums::serial), gain(&FlightRegression::QuickSums::white)};
}

VectorXd Evidence::LocalCoefficients(size_t f, const EffectFit& fit, const VariantSet& set) const {
  VectorXd global = VectorXd::Zero(num_columns());
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    global[fit.columns[k]] = fit.coefficients[static_cast<Index>(k)];
  }
  for (const int v : set) {
    if (variants_[v].offset >= 0) global[variants_[v].offset] = 1.0;
  }
  VectorXd local(static_cast<Index>(place_[f].size()));
  for (size_t k = 0; k < place_[f].size(); ++k) local[static_cast<Index>(k)] = global[place_[f][k]];
  return local;
}

VectorXd Evidence::ErrorsOf(size_t f, const VariantSet& set, const EffectFit& fit) const {
  const MatrixXd& white = flights_[f].white();
  return white.col(white.cols() - 1) - Combined(white, LocalCoefficients(f, fit, set));
}

std::vector<VectorXd> Evidence::DoneBy(int variant, const EffectFit& fit) const {
  EffectFit own;
  own.coefficients = VectorXd::Zero(fit.coefficients.size());
  own.columns = fit.columns;
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    if (column(fit.columns[k]).effect != variants_[variant].candidate.effect) continue;
    own.coefficients[static_cast<Index>(k)] = fit.coefficients[static_cast<Index>(k)];
  }
  std::vector<VectorXd> done;
  for (size_t f = 0; f < flights_.size(); ++f) {
    done.push_back(Combined(flights_[f].white(), LocalCoefficients(f, own, {variant})));
  }
  return done;
}

std::array<double, kNumChannels> Evidence::EnergyOf(int variant, const EffectFit& fit) const {
  const std::vector<VectorXd> done = DoneBy(variant, fit);
  std::array<double, kNumChannels> energy{};
  for (size_t f = 0; f < flights_.size(); ++f) {
    const VectorXd& does = done[f];
    const auto n = static_cast<Index>(flights_[f].rows().size());
    for (int c = 0; c < num_channels_; ++c) {
      for (const double x : does.segment(c * n, n)) energy[c] += 0.5 * WildShare(x) * x * x;
    }
  }
  return energy;
}

double Evidence::GivenUp(const EffectFit& with, const EffectFit& without) const {
  VectorXd change = VectorXd::Zero(gram_.rows());
  for (size_t l = 0; l < without.columns.size(); ++l) {
    for (size_t k = 0; k < with.columns.size(); ++k) {
      if (with.columns[k] != without.columns[l]) continue;
      change[with.columns[k]] =
          with.coefficients[static_cast<Index>(k)] - without.coefficients[static_cast<Index>(l)];
    }
  }
  return 0.5 * change.dot(gram_ * change);
}

Evidence::Unforeseen Evidence::UnforeseenChange(const VariantSet& set,
                                                const VariantSet& without) const {
  VectorXd change = VectorXd::Zero(gram_.rows());
  const auto add = [&](const VariantSet& of, double sign) {
    const EffectFit fit = Solve(of);
    for (size_t k = 0; k < fit.columns.size(); ++k) {
      change[fit.columns[k]] += sign * fit.coefficients[static_cast<Index>(k)];
    }
    for (const int v : of) {
      if (variants_[v].offset >= 0) change[variants_[v].offset] += sign;
    }
  };
  add(set, 1.0);
  add(without, -1.0);
  Unforeseen unforeseen;
  double kept = 0.0;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const FlightRegression& flight = flights_[f];
    VectorXd local = VectorXd::Zero(flight.unforeseen_gram().rows());
    for (size_t k = 0; k < place_[f].size(); ++k)
      local[static_cast<Index>(k)] = change[place_[f][k]];
    const double nats = 0.5 * local.dot(flight.unforeseen_gram() * local);
    const double samples = static_cast<double>(flight.rows().size()) * flight.num_channels();
    unforeseen.nats += nats;
    kept += nats * flight.num_noise_columns() / samples;
  }
  unforeseen.kept_share = unforeseen.nats > 0.0 ? kept / unforeseen.nats : 0.0;
  return unforeseen;
}

double Evidence::PredictiveGain(const VariantSet& set, const VariantSet& over) const {
  double gain = 0.0;
  if (flights_.size() > 1) {
    for (const double of_flight : GainByFlight(set, over)) gain += of_flight;
    return gain;
  }
  for (int fold = 0; fold < num_folds(); ++fold) {
    const MatrixXd others = GramWithout(fold);
    const auto error = [&](const VariantSet& of) {
      const EffectFit fit = SolveWith(others, ColumnsOf(of), of);
      VectorXd u = VectorXd::Zero(gram_.rows());
      u[gram_.rows() - 1] = 1.0;
      for (const int v : of) {
        if (variants_[v].offset >= 0) u[variants_[v].offset] = -1.0;
      }
      for (size_t k = 0; k < fit.columns.size(); ++k) {
        u[fit.columns[k]] = -fit.coefficients[static_cast<Index>(k)];
      }
      return u.dot((gram_ - others) * u);
    };
    gain += 0.5 * (error(over) - error(set));
  }
  return gain;
}

std::vector<double> Evidence::GainByFlight(const VariantSet& set, const VariantSet& over) const {
  // p(this flight | all others) = p(all) / p(all others), what is this flight's own integrated out.
  const auto evidence = [&](const MatrixXd& gram, const VariantSet& of) {
    return SolveWith(gram, ColumnsOf(of), of).log_evidence;
  };
  const double all = evidence(gram_, set) - evidence(gram_, over);
  std::vector<double> gains;
  for (int f = 0; f < num_flights(); ++f) {
    const MatrixXd others = GramWithout(f);
    gains.push_back(all - (evidence(others, set) - evidence(others, over)));
  }
  return gains;
}

EffectFit Evidence::SolveOfFlight(int f, const VariantSet& set) const {
  MatrixXd gram = MatrixXd::Zero(gram_.rows(), gram_.cols());
  AddTo(flights_[static_cast<size_t>(f)].gram(), static_cast<size_t>(f), &gram);
  return SolveWith(gram, ColumnsOf(set), set);
}

double Evidence::HeldOutLoss(const VariantSet& set, FlightRegression::Part part) const {
  // Uncertain coefficients make a prediction's variance larger; 1 is the noise's.
  const EffectFit fit = Solve(set);
  double sum = 0.0;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const MatrixXd& white = flights_[f].held_out_white(part);
    const Index n = white.cols() - 1;
    const VectorXd e = white.col(n) - Combined(white, LocalCoefficients(f, fit, set).head(n));
    MatrixXd X = MatrixXd::Zero(white.rows(), static_cast<Index>(fit.columns.size()));
    for (Index l = 0; l < n; ++l) {
      const auto at =
          std::find(fit.columns.begin(), fit.columns.end(), place_[f][static_cast<size_t>(l)]);
      if (at != fit.columns.end()) X.col(at - fit.columns.begin()) = white.col(l);
    }
    const VectorXd variance = 1.0 + (X * fit.covariance).cwiseProduct(X).rowwise().sum().array();
    sum += 0.5 * (e.cwiseAbs2().cwiseQuotient(variance).sum() + variance.array().log().sum());
  }
  return sum;
}

double Evidence::HeldOutGain(const VariantSet& set, const VariantSet& over) const {
  const auto gain = [&](FlightRegression::Part part) {
    return HeldOutLoss(over, part) - HeldOutLoss(set, part);
  };
  return std::max(gain(FlightRegression::kForeseen), gain(FlightRegression::kWhole));
}

Evidence::Lead Evidence::LeadOf(const VariantSet& a, const VariantSet& b) const {
  const EffectFit fit_a = Solve(a), fit_b = Solve(b);
  std::map<std::pair<size_t, int>, double> blocks;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const FlightRegression& r = flights_[f];
    const VectorXd lead =
        0.5 * (ErrorsOf(f, b, fit_b).cwiseAbs2() - ErrorsOf(f, a, fit_a).cwiseAbs2());
    const auto n = static_cast<Index>(r.rows().size());
    for (Index k = 0; k < n; ++k) {
      const double t_s = r.flight().sample(r.rows()[static_cast<size_t>(k)]).t_s;
      double& block = blocks[{f, static_cast<int>(t_s / kBlock_s)}];
      for (int c = 0; c < num_channels_; ++c) block += lead[c * n + k];
    }
  }
  Lead lead;
  for (const auto& entry : blocks) lead.nats += entry.second;
  const double mean = lead.nats / static_cast<double>(blocks.size());
  for (const auto& entry : blocks) lead.sigma += std::pow(entry.second - mean, 2);
  lead.sigma = std::sqrt(lead.sigma);
  return lead;
}

struct Evidence::GainTest {
  std::vector<int> columns, own;  // what it stands beside and then its own; its own
  MatrixXd estimate;              // own coefficients by X'y
  MatrixXd information;           // of these
  VectorXd sigma, own_sigma;      // posterior, prior
  double occam;
};

std::vector<Evidence::GainTest> Evidence::GainTests(const VariantSet& beside) const {
  const std::vector<int> base = ColumnsOf(beside);
  std::vector<GainTest> tests;
  for (const EffectVariant& variant : variants_) {
    const bool has = std::any_of(beside.begin(), beside.end(), [&](int other) {
      return variants_[other].candidate.effect == variant.candidate.effect;
    });
    if (has) continue;
    GainTest test;
    test.own = variant.columns;
    test.columns = base;
    test.columns.insert(test.columns.end(), test.own.begin(), test.own.end());
    const auto k = static_cast<Index>(test.own.size());
    const VectorXd sigma = PriorSigmas(test.columns);
    MatrixXd H =
        sigma.asDiagonal() * Picked(gram_, test.columns, test.columns) * sigma.asDiagonal();
    H.diagonal().array() += 1.0;
    const MatrixXd inverse = H.llt().solve(MatrixXd::Identity(sigma.size(), sigma.size()));
    const MatrixXd covariance = inverse.bottomRightCorner(k, k);
    const Eigen::LLT<MatrixXd> of_own(covariance);
    test.estimate = inverse.bottomRows(k) * sigma.asDiagonal();
    test.information = of_own.solve(MatrixXd::Identity(k, k));
    test.own_sigma = sigma.tail(k);
    test.sigma = test.own_sigma.cwiseProduct(covariance.diagonal().cwiseSqrt());
    test.occam =
        0.5 * LogDeterminant(of_own) + std::log(1.0 - kOutlierPriorShare) + variant.log_prior;
    tests.push_back(std::move(test));
  }
  return tests;
}

double Evidence::GainOf(const GainTest& test, const VectorXd& Xe) const {
  VectorXd g(static_cast<Index>(test.columns.size()));
  for (size_t k = 0; k < test.columns.size(); ++k) g[static_cast<Index>(k)] = Xe[test.columns[k]];
  const VectorXd x = test.estimate * g;
  return 0.5 * x.dot(test.information * x) + test.occam +
         SignTerm(test.own, x.cwiseProduct(test.own_sigma), test.sigma);
}

MatrixXd Evidence::SurrogateProducts(std::mt19937* random) const {
  MatrixXd Xe = MatrixXd::Zero(num_columns() + 1, kShiftsOfADraw);
  for (size_t f = 0; f < flights_.size(); ++f) {
    const MatrixXd of_flight =
        flights_[f].white().transpose() * SurrogatesOf(flights_[f], kShiftsOfADraw, random);
    for (size_t k = 0; k < place_[f].size(); ++k) {
      Xe.row(place_[f][k]) += of_flight.row(static_cast<Index>(k));
    }
  }
  return Xe;
}

std::vector<double> Evidence::SurrogateGains(const VariantSet& beside, int count,
                                             unsigned seed) const {
  const std::vector<GainTest> tests = GainTests(beside);
  std::mt19937 random(seed);
  std::vector<double> largest;
  MatrixXd Xe;
  for (int s = 0; s < count; ++s) {
    if (s % kShiftsOfADraw == 0) Xe = SurrogateProducts(&random);
    const VectorXd of_surrogate = Xe.col(s % kShiftsOfADraw);
    double most = -std::numeric_limits<double>::infinity();
    for (const GainTest& test : tests) most = std::max(most, GainOf(test, of_surrogate));
    largest.push_back(most);
  }
  std::sort(largest.begin(), largest.end());
  return largest;
}

bool Evidence::IsFitted(const VariantSet& set, const std::string& name) const {
  return std::any_of(set.begin(), set.end(), [&](int v) {
    return variants_[static_cast<size_t>(v)].candidate.fitted.count(name) > 0;
  });
}

ModelPoint Evidence::Moved(const VariantSet& set, const EffectFit& fit) const {
  ModelPoint next = point_;
  next.own.resize(flights_.size() > 1 ? flights_.size() : 0);
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    const Column& column = columns_[static_cast<size_t>(fit.columns[k])];
    if (column.effect.empty()) continue;  // nothing of the model
    const double change = fit.coefficients[static_cast<Index>(k)];
    if (column.flight >= 0) {
      next.own[static_cast<size_t>(column.flight)][column.name] = column.about + change;
      continue;
    }
    if (IsFitted(set, column.name)) {
      next.values[column.name] = column.linearized_at;
      continue;
    }
    const auto known = next.values.find(column.name);
    const bool is_shared = flights_.size() > 1 && known != next.values.end();
    next.values[column.name] = Changed(column, is_shared ? known->second : column.about, change);
  }
  for (const int v : set) {
    // From now on what was fitted of its settings is held.
    EffectCandidate candidate = variants_[static_cast<size_t>(v)].candidate;
    for (const std::string& name : candidate.fitted) {
      candidate.settings[name] = next.values.at(name);
    }
    candidate.fitted.clear();
    for (const auto& [name, value] : candidate.settings) next.values[name] = value;
    next.vehicle = VehicleWith(next.vehicle, candidate);
  }
  return next;
}

std::vector<Wrenches> Evidence::ResidualsOf(const VariantSet& set, const EffectFit& fit) const {
  std::vector<Wrenches> residuals;
  for (size_t f = 0; f < flights_.size(); ++f) {
    const VectorXd local = LocalCoefficients(f, fit, set);
    Wrenches e = flights_[f].y();
    for (Index k = 0; k < local.size(); ++k) {
      if (local[k] != 0.0) e -= local[k] * flights_[f].column(static_cast<int>(k)).d_wrench;
    }
    residuals.push_back(std::move(e));
  }
  return residuals;
}

}  // namespace odmc

#include "odmc/attribution/evidence.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <utility>

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using Wrenches = ResidualModel::Wrenches;

// Rounds of the noise's estimate: rough ones until the residual is no longer the effects', then
// expectation steps.
struct NoiseRounds {
  int rough, expectation;
};
constexpr NoiseRounds kFirstNoise = {3, 3};
constexpr NoiseRounds kMoreColumns = {1, 2};
constexpr NoiseRounds kMovedColumns = {0, 1};
constexpr Index kMostDraws = 32;       // of the fit, for an expectation: its sums to some per cent
constexpr double kAveraged = 40.0;     // values of which a spectrum's ordinate is the mean: to 22 %
constexpr double kWildSigmas = 5.0;    // innovations beyond count as this many
constexpr double kWide = 5.0;          // natural sizes of what is strangely large
constexpr double kWideFrom = 2.0;      // natural sizes from which that is looked at
constexpr double kBias_m_s2 = 0.3;     // of an accelerometer
constexpr int kFolds = Instruments::kFolds;
constexpr double kBlock_s = 1.0;       // of Lead: a manoeuvre spans more than one
constexpr double kCollinear = 1e-6;    // of a column's sum of squares, for columns that are one
constexpr int kShiftsOfADraw = 10;     // surrogates of one draw of the noise
constexpr double kLeastShift_s = 2.0;  // of surrogates: beyond the noise's correlation

/// Normal distribution's cumulative.
double Phi(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

/// Samples whose `order` predecessors follow each other and are, with it, in use or held out.
std::vector<int> RowsOf(const ThinnedFlight& flight, const Instruments& instruments, bool held_out,
                        int order) {
  std::vector<int> rows;
  int run = 0;
  for (int i = 0; i < flight.size(); ++i) {
    const bool counts = flight.held_out(i) == held_out && instruments.Sees(i);
    run = !counts ? 0 : flight.next(i) ? run + 1 : 1;
    if (run > order) rows.push_back(i);
  }
  return rows;
}

MatrixXd Picked(const MatrixXd& gram, const std::vector<int>& rows, const std::vector<int>& cols) {
  MatrixXd picked(static_cast<Index>(rows.size()), static_cast<Index>(cols.size()));
  for (size_t i = 0; i < rows.size(); ++i) {
    for (size_t k = 0; k < cols.size(); ++k) {
      picked(static_cast<Index>(i), static_cast<Index>(k)) = gram(rows[i], cols[k]);
    }
  }
  return picked;
}

double LogDeterminant(const Eigen::LLT<MatrixXd>& llt) {
  return 2.0 * MatrixXd(llt.matrixL()).diagonal().array().log().sum();
}

}  // namespace

Evidence::Evidence(const ResidualModel* residual, const Instruments* instruments,
                   const Stage& stage)
    : residual_(residual),
      instruments_(instruments),
      likely_(&instruments->likely_flight(), &residual->file_vehicle(),
              residual->num_channels() == kNumChannels),
      stage_(stage),
      num_channels_(residual->num_channels()) {
  rows_ = RowsOf(residual->flight(), *instruments, false, kOrder);
  held_out_rows_ = RowsOf(residual->flight(), *instruments, true, kOrder);
  AddBase();
}

void Evidence::AddBase() {
  const DynamicModel model(stage_.vehicle, stage_.vehicle.effects);
  const ModelValues values = ValuesOf(model, stage_.values);
  y_ = residual_->Residual(model, values);
  if (!model.pendulum()) likely_y_ = likely_.Residual(model, values);
  for (int c = 0; c < kNumChannels; ++c) {
    plain_sigma_[c] = std::sqrt(y_.col(c).squaredNorm() / std::max<double>(1.0, y_.rows()));
  }
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    stage_.values[p.full_name] = values[k];
    // Inertia that the file freezes may be wrong: whatever else moves with torque would make up for
    // it.
    if (!p.estimated && p.effect != "inertia") continue;
    Column column{p.full_name,      p.effect,    values[k],
                  p.spec.prior_value - values[k], p.spec.prior_sigma, p.spec.sign,
                  p.spec.certain_sign, p.spec.initial_state, residual_->Derivative(model, values, k),
                  model.pendulum() ? Wrenches(Wrenches::Zero(y_.rows(), kNumChannels))
                                   : likely_.Derivative(model, values, k), {}};
    column.foreseen = instruments_->Foreseen(column.d_wrench, column.likely);
    if (column.d_wrench.squaredNorm() > 0.0) columns_.push_back(std::move(column));
  }
  AddNuisances();
  num_base_ = static_cast<int>(columns_.size());
  // What of other columns the base has, each channel in its own units.
  base_.resize(y_.size(), num_base_);
  for (int k = 0; k < num_base_; ++k) base_.col(k) = Stacked(columns_[k].d_wrench);
  base_size_ = base_.colwise().norm().transpose().array().max(1e-300);
  MatrixXd H = base_.transpose() * base_;
  H = base_size_.cwiseInverse().asDiagonal() * H * base_size_.cwiseInverse().asDiagonal();
  H.diagonal().array() += kCollinear;
  base_gram_.compute(H);
}

VectorXd Evidence::Stacked(const Wrenches& column) const {
  const Index n = column.rows();
  VectorXd stacked(n * kNumChannels);
  for (int c = 0; c < kNumChannels; ++c) {
    stacked.segment(c * n, n) = column.col(c) / std::max(1e-300, plain_sigma_[c]);
  }
  for (int i = 0; i < n; ++i) {
    if (instruments_->Sees(i) && !residual_->flight().held_out(i)) continue;
    for (int c = 0; c < kNumChannels; ++c) stacked[c * n + i] = 0.0;
  }
  return stacked;
}

Wrenches Evidence::Foreseen(const Column& column) const {
  const VectorXd share = base_size_.cwiseInverse().cwiseProduct(
      base_gram_.solve(base_size_.cwiseInverse().cwiseProduct(base_.transpose() * Stacked(column.d_wrench))));
  Wrenches own = column.d_wrench, likely = column.likely;
  Wrenches of_base = Wrenches::Zero(own.rows(), kNumChannels);
  for (int k = 0; k < num_base_; ++k) {
    own -= share[k] * columns_[k].d_wrench;
    likely -= share[k] * columns_[k].likely;
    of_base += share[k] * columns_[k].foreseen;
  }
  if (column.likely.isZero(0.0)) likely.setZero();
  return of_base + instruments_->Foreseen(own, likely);
}

void Evidence::AddNuisances() {
  const auto add = [this](const char* name, double sigma, Wrenches d_wrench) {
    Column column;
    column.name = name;
    column.prior_sigma = sigma;
    column.foreseen = column.likely = column.d_wrench = std::move(d_wrench);
    columns_.push_back(std::move(column));
  };
  if (residual_->from_accelerometer()) {
    for (int axis = 0; axis < 3; ++axis) {
      Wrenches ones = Wrenches::Zero(y_.rows(), kNumChannels);
      ones.col(axis).setOnes();
      add("accelerometer bias", kBias_m_s2 * stage_.vehicle.mass_kg, std::move(ones));
    }
  }
}

Evidence::Seen Evidence::See(const Candidate& candidate, const std::map<std::string, double>& at,
                             What what) const {
  const Vehicle extended = With(stage_.vehicle, candidate);
  const DynamicModel model(extended, extended.effects);
  ModelValues values = ValuesOf(model, stage_.values);
  for (const auto* some : {&candidate.start, &at}) {
    for (const auto& [name, value] : *some) values[model.IndexOf(name)] = value;
  }
  // From an onset on an effect acts as one that has acted all along, so all onsets share a column.
  const auto own = std::find(model.effect_names().begin(), model.effect_names().end(),
                             candidate.effect);
  const std::string onset =
      model.effect(static_cast<int>(own - model.effect_names().begin())).onset_parameter();
  double from_s = 0.0;
  if (!onset.empty()) {
    double& setting = values[model.IndexOf(candidate.effect + "." + onset)];
    from_s = setting;
    setting = 0.0;
  }
  const std::string key = onset.empty() || !at.empty() ? "" : candidate.effect;
  const auto known = seen_.find(key);
  Seen seen = known != seen_.end() ? known->second : SeeFully(candidate, model, values, key.empty() ? what : kAll);
  if (!key.empty() && known == seen_.end()) seen_[key] = seen;
  if (!onset.empty()) {
    for (int i = 0; i < residual_->flight().size(); ++i) {
      if (residual_->flight().sample(i).t_s >= from_s) break;
      for (Column& column : seen.columns) {
        column.d_wrench.row(i).setZero();
        column.likely.row(i).setZero();
      }
      if (!seen.offset) continue;
      seen.offset->d_wrench.row(i).setZero();
      seen.offset->likely.row(i).setZero();
    }
  }
  for (Column& column : seen.columns) column.foreseen = Foreseen(column);
  if (seen.offset) seen.offset->foreseen = Foreseen(*seen.offset);
  if (what != kAll) {
    seen.columns.erase(std::remove_if(seen.columns.begin(), seen.columns.end(),
                                      [&](const Column& c) {
                                        return c.d_wrench.squaredNorm() == 0.0 ||
                                               (what == kAtAGlance && c.initial_state);
                                      }),
                       seen.columns.end());
  }
  return seen;
}

Evidence::Seen Evidence::SeeFully(const Candidate& candidate, const DynamicModel& model,
                                  const ModelValues& values, What what) const {
  Seen seen;
  const Wrenches residual = residual_->Residual(model, values);
  const Wrenches nothing = Wrenches::Zero(residual.rows(), kNumChannels);
  // A pendulum swings through the whole recording, not from one thinned sample to the next.
  const bool is_likely = !model.pendulum();
  const Wrenches likely = is_likely ? likely_.Residual(model, values) : nothing;
  Wrenches offset = y_ - residual;
  Wrenches likely_offset = is_likely ? Wrenches(likely_y_ - likely) : nothing;
  const double size = offset.norm();
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    if (p.effect != candidate.effect || !p.estimated) continue;
    if (what == kAtAGlance && p.spec.initial_state) continue;
    Column column{p.full_name,          p.effect,           0.0,
                  p.spec.prior_value,   p.spec.prior_sigma, p.spec.sign,
                  p.spec.certain_sign,  p.spec.initial_state,
                  residual_->Derivative(model, values, k, residual),
                  is_likely ? likely_.Derivative(model, values, k, likely) : nothing, {}};
    offset -= values[k] * column.d_wrench;
    likely_offset -= values[k] * column.likely;
    seen.columns.push_back(std::move(column));
  }
  constexpr double kNothing = 1e-6;
  if (offset.norm() > kNothing * size + 1e-300 && size > 0.0) {
    seen.offset.emplace();
    seen.offset->d_wrench = std::move(offset);
    seen.offset->likely = std::move(likely_offset);
  }
  return seen;
}

int Evidence::Add(const Candidate& candidate, const std::map<std::string, double>& at) {
  Seen seen = See(candidate, at, kActing);
  if (seen.columns.empty()) return -1;
  Variant variant;
  variant.candidate = candidate;
  for (Column& column : seen.columns) {
    variant.columns.push_back(static_cast<int>(columns_.size()));
    columns_.push_back(std::move(column));
  }
  if (seen.offset) {
    variant.offset = static_cast<int>(columns_.size());
    seen.offset->name = "offset";
    seen.offset->effect = candidate.effect;
    columns_.push_back(std::move(*seen.offset));
  }
  variants_.push_back(std::move(variant));
  return static_cast<int>(variants_.size()) - 1;
}

void Evidence::Relinearize(int v, const std::map<std::string, double>& at) {
  Variant& variant = variants_[static_cast<size_t>(v)];
  Seen seen = See(variant.candidate, at, kAll);
  for (const int k : variant.columns) {
    for (Column& column : seen.columns) {
      if (column.name == columns_[k].name) columns_[k] = column;
    }
  }
  if (!seen.offset) {
    const Wrenches nothing = Wrenches::Zero(y_.rows(), kNumChannels);
    seen.offset.emplace();
    seen.offset->d_wrench = seen.offset->likely = seen.offset->foreseen = nothing;
  }
  seen.offset->name = "offset";
  seen.offset->effect = variant.candidate.effect;
  if (variant.offset < 0) {
    variant.offset = static_cast<int>(columns_.size());
    columns_.emplace_back();
  }
  columns_[variant.offset] = std::move(*seen.offset);
}

VectorXd Evidence::Whitened(const Wrenches& column, const std::vector<int>& rows,
                            const MatrixXd& weight) const {
  const auto n = static_cast<Index>(rows.size());
  VectorXd white(n * num_channels_);
  for (int c = 0; c < num_channels_; ++c) {
    const double scale = 1.0 / std::sqrt(noise_[c].variance);
    for (Index k = 0; k < n; ++k) {
      const int i = rows[static_cast<size_t>(k)];
      double value = column(i, c);
      for (int lag = 0; lag < kOrder; ++lag) {
        value -= noise_[c].coefficients[lag] * column(i - 1 - lag, c);
      }
      white[c * n + k] = scale * weight(k, c) * value;
    }
  }
  return white;
}

void Evidence::WhitenAll() {
  const auto n = static_cast<Index>(columns_.size());
  white_.resize(static_cast<Index>(rows_.size()) * num_channels_, n + 1);
  for (Index k = 0; k < n; ++k) {
    white_.col(k) = Whitened(columns_[static_cast<size_t>(k)].foreseen, rows_, weight_);
  }
  white_.col(n) = Whitened(y_, rows_, weight_);
  SumUp(false);
}

void Evidence::SumUp(bool by_folds) {
  const Index n = white_.cols() - 1;
  gram_.setZero(n + 1, n + 1);
  gram_.selfadjointView<Eigen::Lower>().rankUpdate(white_.transpose());
  gram_.triangularView<Eigen::StrictlyUpper>() = gram_.transpose();
  if (!by_folds) return;
  // The same sums by folds of blocks of time.
  fold_gram_.assign(kFolds, MatrixXd::Zero(n + 1, n + 1));
  const auto rows = static_cast<Index>(rows_.size());
  for (int c = 0; c < num_channels_; ++c) {
    for (Index from = 0; from < rows;) {
      Index to = from;
      const int fold = FoldOf(from);
      while (to < rows && FoldOf(to) == fold) ++to;
      fold_gram_[fold].selfadjointView<Eigen::Lower>().rankUpdate(
          white_.middleRows(c * rows + from, to - from).transpose());
      from = to;
    }
  }
  for (MatrixXd& gram : fold_gram_) {
    gram.triangularView<Eigen::StrictlyUpper>() = gram.transpose();
  }
}

VectorXd Evidence::WhitenedFeature(int c, const VectorXd& foreseen) const {
  const double scale = plain_sigma_[c] / std::sqrt(noise_[c].variance);
  VectorXd white(static_cast<Index>(rows_.size()));
  for (Index k = 0; k < white.size(); ++k) {
    const int i = rows_[static_cast<size_t>(k)];
    double value = foreseen[i];
    for (int lag = 0; lag < kOrder; ++lag) {
      value -= noise_[c].coefficients[lag] * foreseen[i - 1 - lag];
    }
    white[k] = scale * weight_(k, c) * value;
  }
  return white;
}

Evidence::FlexibleGain Evidence::BestFlexible(const VariantSet& set,
                                              const FlexibleFeatures& features) const {
  const EffectFit fit = Solve(set);
  const VectorXd e = ErrorsOf(white_, set, fit);
  const auto n = static_cast<Index>(rows_.size());
  const auto m = static_cast<Index>(fit.columns.size());
  const auto tried = static_cast<double>(num_channels_) *
                     static_cast<double>(features.foreseen.cols());
  FlexibleGain best;
  best.nats = -std::numeric_limits<double>::infinity();
  for (int c = 0; c < num_channels_; ++c) {
    MatrixXd own(n, m);
    for (Index k = 0; k < m; ++k) {
      own.col(k) = white_.col(fit.columns[static_cast<size_t>(k)]).segment(c * n, n);
    }
    MatrixXd phi(n, features.foreseen.cols());
    for (Index f = 0; f < phi.cols(); ++f) {
      phi.col(f) = WhitenedFeature(c, features.foreseen.col(f));
    }
    const MatrixXd cross = own.transpose() * phi;
    const VectorXd g = phi.transpose() * e.segment(c * n, n);
    const VectorXd taken = cross.cwiseProduct(fit.covariance * cross).colwise().sum();
    for (Index f = 0; f < phi.cols(); ++f) {
      // Its coefficient has a prior of the residual's size: one, in these units.
      const double s = std::max(0.0, phi.col(f).squaredNorm() - taken[f]);
      const double nats = 0.5 * (g[f] * g[f] / (1.0 + s) - std::log(1.0 + s)) -
                          std::log(tried);
      if (nats > best.nats) best = {c, static_cast<int>(f), nats};
    }
  }
  return best;
}

int Evidence::AddFlexible(const FlexibleGain& gain, const FlexibleFeatures& features) {
  const Index y_at = white_.cols() - 1, n = static_cast<Index>(rows_.size());
  Variant variant;
  variant.candidate.effect = features.names[static_cast<size_t>(gain.feature)] + " " +
                             std::to_string(gain.channel);
  variant.columns = {static_cast<int>(y_at)};
  Column column;
  column.name = variant.candidate.effect;
  column.effect = variant.candidate.effect;
  columns_.push_back(std::move(column));
  variants_.push_back(std::move(variant));
  white_.conservativeResize(Eigen::NoChange, y_at + 2);
  white_.col(y_at + 1) = white_.col(y_at);
  white_.col(y_at).setZero();
  white_.col(y_at).segment(gain.channel * n, n) =
      WhitenedFeature(gain.channel, features.foreseen.col(gain.feature));
  SumUp();
  return static_cast<int>(variants_.size()) - 1;
}

int Evidence::FoldOf(Index row) const {
  const double t_s = residual_->flight().sample(rows_[static_cast<size_t>(row)]).t_s;
  return Instruments::FoldAt(t_s);
}

Evidence::Noise Evidence::FitNoise(const MatrixXd& e) const {
  using Moments = Eigen::Matrix<double, kOrder + 1, kOrder + 1>;
  Moments S = Moments::Zero();  // of a sample, first, and its predecessors
  const MatrixXd by_sample = e.transpose();
  for (const int i : rows_) {
    const auto past = by_sample.middleCols<kOrder + 1>(i - kOrder).rowwise().reverse();
    S.noalias() += past.transpose().lazyProduct(past);
  }
  // A short flight's spectrum to a resolution at which an ordinate is the mean of many values. A
  // finer one takes the few cycles of a manoeuvre, and with them all that follows it, for noise
  // (Blackman and Tukey, The Measurement of Power Spectra, 1958; a Gaussian window).
  const double step_s = residual_->flight().step_s();
  const double bandwidth_Hz =
      0.5 * kAveraged / (static_cast<double>(rows_.size()) * step_s);
  const double sigma_rad = std::sqrt(M_PI) * bandwidth_Hz * step_s;
  for (int i = 0; i <= kOrder; ++i) {
    for (int k = 0; k <= kOrder; ++k) S(i, k) *= std::exp(-0.5 * std::pow(sigma_rad * (i - k), 2));
  }
  Moments A = S;
  A.diagonal().array() += 1e-3 * A.diagonal().maxCoeff() + 1e-300;
  Noise noise;
  noise.coefficients =
      A.bottomRightCorner<kOrder, kOrder>().ldlt().solve(S.bottomLeftCorner<kOrder, 1>());
  Eigen::Matrix<double, kOrder + 1, 1> innovation;
  innovation << 1.0, -noise.coefficients;
  noise.variance =
      std::max(innovation.dot(S * innovation) / static_cast<double>(rows_.size()), 1e-300);
  return noise;
}

void Evidence::EstimateNoise() {
  const auto n = static_cast<Index>(rows_.size());
  const auto m = static_cast<Index>(columns_.size());
  VectorXd sigma(m), mean(m);
  for (Index k = 0; k < m; ++k) {
    const Column& column = columns_[static_cast<size_t>(k)];
    sigma[k] = column.prior_sigma;
    mean[k] = column.prior_mean;
  }
  NoiseRounds rounds = noise_columns_ == m ? kMovedColumns : kMoreColumns;
  if (noise_columns_ < 0) {
    rounds = kFirstNoise;
    weight_ = MatrixXd::Ones(n, kNumChannels);
    for (int c = 0; c < num_channels_; ++c) {
      noise_[c] = Noise();
      noise_[c].variance = std::max(y_.col(c).squaredNorm() / double(y_.rows()), 1e-300);
    }
  }
  noise_columns_ = static_cast<int>(m);
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  for (int round = 0;; ++round) {
    WhitenAll();
    MatrixXd H = sigma.asDiagonal() * gram_.topLeftCorner(m, m) * sigma.asDiagonal();
    H.diagonal().array() += 1.0;
    const VectorXd b = sigma.cwiseProduct(gram_.col(m).head(m));
    const Eigen::LLT<MatrixXd> llt(H);
    const VectorXd x = sigma.cwiseProduct(llt.solve(b + mean.cwiseQuotient(sigma)));
    // Root of the covariance of what was fitted.
    fitted_root_ = sigma.asDiagonal() * MatrixXd(llt.matrixU().solve(MatrixXd::Identity(m, m)));
    if (round == rounds.rough + rounds.expectation) {
      fitted_ = white_.leftCols(m);
      innovation_ = white_.col(m) - fitted_ * x;
      break;
    }
    // The noise is not what is left: the fit has taken a part of it. Its second moments are those of
    // the rest and of what the fit may as well have been (expectation step; Dempster, Laird and
    // Rubin, J. R. Stat. Soc. B 39, 1977), by a few draws of that.
    // (Not before the residual's size is the noise's: what the fit may have taken would be of the
    // size of the effects.)
    MatrixXd draws = MatrixXd::Zero(m, 0);
    if (round >= rounds.rough) {
      draws = fitted_root_;
      if (m > kMostDraws) {
        MatrixXd z(m, kMostDraws);
        for (Index k = 0; k < z.size(); ++k) z.data()[k] = normal(random);
        draws = fitted_root_ * z / std::sqrt(static_cast<double>(kMostDraws));
      }
    }
    MatrixXd fitted(m, 1 + draws.cols());
    fitted << -x, draws;
    MatrixXd columns(y_.rows(), m);
    for (int c = 0; c < num_channels_; ++c) {
      for (Index k = 0; k < m; ++k) {
        columns.col(k) = columns_[static_cast<size_t>(k)].foreseen.col(c);
      }
      MatrixXd likely = columns * fitted;
      likely.col(0) += y_.col(c);
      noise_[c] = FitNoise(likely);
      for (Index k = 0; k < n; ++k) {
        const int i = rows_[static_cast<size_t>(k)];
        double innovation = likely(i, 0);
        for (int lag = 0; lag < kOrder; ++lag) {
          innovation -= noise_[c].coefficients[lag] * likely(i - 1 - lag, 0);
        }
        const double sigmas = std::abs(innovation) / std::sqrt(noise_[c].variance);
        weight_(k, c) = sigmas > kWildSigmas ? std::sqrt(kWildSigmas / sigmas) : 1.0;
      }
    }
  }
  held_out_weight_ = MatrixXd::Ones(static_cast<Index>(held_out_rows_.size()), kNumChannels);
  held_out_white_.resize(static_cast<Index>(held_out_rows_.size()) * num_channels_, m + 1);
  for (Index k = 0; k <= m; ++k) {
    const Wrenches& column = k < m ? columns_[static_cast<size_t>(k)].foreseen : y_;
    held_out_white_.col(k) = Whitened(column, held_out_rows_, held_out_weight_);
  }
  Project();
}

void Evidence::Project() {
  const auto n = static_cast<Index>(columns_.size());
  MatrixXd of_whole(n, n);
  constexpr Index kBatch = 16;
  MatrixXd whole(white_.rows(), kBatch);
  for (Index from = 0; from < n; from += kBatch) {
    const Index size = std::min(kBatch, n - from);
    for (Index k = 0; k < size; ++k) {
      whole.col(k) = Whitened(columns_[static_cast<size_t>(from + k)].d_wrench, rows_, weight_);
    }
    of_whole.middleCols(from, size).noalias() =
        white_.leftCols(n).transpose() * whole.leftCols(size);
  }
  MatrixXd gram = gram_.topLeftCorner(n, n);
  const VectorXd size = gram.diagonal().cwiseSqrt();
  const VectorXd unit = (size.array() > 0.0).select(size.cwiseInverse(), 0.0);  // 0: unforeseen
  gram = unit.asDiagonal() * gram * unit.asDiagonal();
  gram.diagonal().array() = 1.0 + kCollinear;
  const MatrixXd share = unit.asDiagonal() * gram.ldlt().solve(unit.asDiagonal() * of_whole);
  white_.leftCols(n) = (white_.leftCols(n) * share).eval();
  // Held-out columns stay as they were foreseen: how many of them combine was fitted elsewhere.
  SumUp();
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
    if (column.sign == PhysicalSign::kAny) continue;
    const auto i = static_cast<Index>(k);
    const double towards = column.sign == PhysicalSign::kPositive ? 1.0 : -1.0;
    const double right =
        Phi(towards * (column.about + coefficients[i]) / std::max(sigma[i], 1e-300));
    const double wrong = column.certain_sign ? 0.0 : kStrange;
    sum += std::log(std::max(1e-300, (1.0 - wrong) * right + wrong * (1.0 - right)) / 0.5);
  }
  return sum;
}

EffectFit Evidence::SolveWith(const MatrixXd& gram, const std::vector<int>& columns,
                              const VariantSet& set) const {
  const int y_at = static_cast<int>(columns_.size());
  const auto n = static_cast<Index>(columns.size());
  // The residual without what the variants do beyond their linearization.
  VectorXd u = VectorXd::Zero(gram.rows());
  u[y_at] = 1.0;
  double log_prior = 0.0;
  for (const int v : set) {
    if (variants_[v].offset >= 0) u[variants_[v].offset] = -1.0;
    log_prior += variants_[v].log_prior;
  }
  const VectorXd gram_u = gram * u;
  const double yy = u.dot(gram_u);
  const MatrixXd XX = Picked(gram, columns, columns);
  VectorXd mean(n), sigma(n), Xy(n);
  for (Index k = 0; k < n; ++k) {
    const Column& column = columns_[columns[static_cast<size_t>(k)]];
    mean[k] = column.prior_mean;
    sigma[k] = column.prior_sigma;
    Xy[k] = gram_u[columns[static_cast<size_t>(k)]];
  }
  // In units of the priors' sigmas, in which all is of the order of one.
  const auto solve = [&](const VectorXd& prior_sigma) {
    EffectFit p;
    p.columns = columns;
    const VectorXd centre = mean.cwiseQuotient(prior_sigma);
    MatrixXd H = prior_sigma.asDiagonal() * XX * prior_sigma.asDiagonal();
    H.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(H);
    const VectorXd b = prior_sigma.cwiseProduct(Xy) + centre;
    const VectorXd x = llt.solve(b);
    const MatrixXd covariance = llt.solve(MatrixXd::Identity(n, n));
    p.coefficients = prior_sigma.cwiseProduct(x);
    p.covariance = prior_sigma.asDiagonal() * covariance * prior_sigma.asDiagonal();
    p.log_evidence = 0.5 * (b.dot(x) - yy - centre.squaredNorm()) - 0.5 * LogDeterminant(llt) +
                     SignTerm(columns, p.coefficients, p.covariance.diagonal().cwiseSqrt());
    if (!std::isfinite(p.log_evidence)) {
      p.log_evidence = -std::numeric_limits<double>::infinity();
    }
    return p;
  };
  EffectFit best = solve(sigma);
  best.log_evidence += log_prior;
  // Variants whose coefficients are strangely large.
  Index at = num_base_;
  VectorXd widened = sigma;
  int wide = 0;
  for (const int v : set) {
    const auto size = static_cast<Index>(variants_[v].columns.size());
    const VectorXd z = (best.coefficients - mean).segment(at, size).cwiseQuotient(
        sigma.segment(at, size));
    if (z.cwiseAbs().maxCoeff() > kWideFrom) {
      widened.segment(at, size) *= kWide;
      ++wide;
    }
    at += size;
  }
  const double usual = static_cast<double>(set.size()) * std::log(1.0 - kStrange);
  best.log_evidence += usual;
  if (wide > 0) {
    EffectFit other = solve(widened);
    other.log_evidence +=
        log_prior + usual + wide * (std::log(kStrange) - std::log(1.0 - kStrange));
    if (other.log_evidence > best.log_evidence) return other;
  }
  return best;
}

EffectFit Evidence::Solve(const VariantSet& set) const {
  return SolveWith(gram_, ColumnsOf(set), set);
}

double Evidence::Gain(const VariantSet& set) const {
  return Solve(set).log_evidence - Solve({}).log_evidence;
}

Evidence::Promise Evidence::PromiseOf(const Candidate& candidate,
                                      const std::map<std::string, double>& at) const {
  const Seen seen = See(candidate, at, kAtAGlance);
  if (seen.columns.empty()) return {};
  const auto k = static_cast<Index>(seen.columns.size());
  Promise promise;
  // By the noise, beside the declared model.
  const auto gain = [&](const MatrixXd& B, const VectorXd& y, const MatrixXd& X) {
    MatrixXd H = B.transpose() * B;
    for (Index i = 0; i < H.rows(); ++i) H(i, i) += std::pow(columns_[i].prior_sigma, -2);
    const Eigen::LLT<MatrixXd> llt(H);
    const MatrixXd BX = B.transpose() * X;
    MatrixXd S = X.transpose() * X - BX.transpose() * llt.solve(BX);
    for (Index i = 0; i < k; ++i) S(i, i) += std::pow(seen.columns[i].prior_sigma, -2);
    const VectorXd g = X.transpose() * y - BX.transpose() * llt.solve(B.transpose() * y);
    return 0.5 * g.dot(S.llt().solve(g));
  };
  MatrixXd X(white_.rows(), k);
  for (Index i = 0; i < k; ++i) X.col(i) = Whitened(seen.columns[i].foreseen, rows_, weight_);
  VectorXd y = white_.col(white_.cols() - 1);
  if (seen.offset) y -= Whitened(seen.offset->foreseen, rows_, weight_);
  promise.serial = gain(white_.leftCols(num_base_), y, X);
  // As if the noise were white, as large as what the declared model leaves.
  const auto raw = [&](const Wrenches& column) {
    const auto n = static_cast<Index>(rows_.size());
    VectorXd stacked(n * num_channels_);
    for (int c = 0; c < num_channels_; ++c) {
      const double scale = 1.0 / std::max(1e-300, plain_sigma_[c]);
      for (Index r = 0; r < n; ++r) stacked[c * n + r] = scale * column(rows_[r], c);
    }
    return stacked;
  };
  MatrixXd B(white_.rows(), num_base_);
  for (Index i = 0; i < num_base_; ++i) B.col(i) = raw(columns_[i].foreseen);
  for (Index i = 0; i < k; ++i) X.col(i) = raw(seen.columns[i].foreseen);
  promise.white = gain(B, raw(seen.offset ? Wrenches(y_ - seen.offset->d_wrench) : y_), X);
  return promise;
}

VectorXd Evidence::ErrorsOf(const MatrixXd& white, const VariantSet& set,
                            const EffectFit& posterior) const {
  VectorXd e = white.col(white.cols() - 1);
  for (const int v : set) {
    if (variants_[v].offset >= 0) e -= white.col(variants_[v].offset);
  }
  for (size_t k = 0; k < posterior.columns.size(); ++k) {
    e -= posterior.coefficients[static_cast<Index>(k)] * white.col(posterior.columns[k]);
  }
  return e;
}

std::array<double, kNumChannels> Evidence::EnergyOf(int variant, const EffectFit& fit) const {
  VectorXd does = VectorXd::Zero(white_.rows());
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    if (columns_[fit.columns[k]].effect != variants_[variant].candidate.effect) continue;
    does += fit.coefficients[static_cast<Index>(k)] * white_.col(fit.columns[k]);
  }
  if (variants_[variant].offset >= 0) does += white_.col(variants_[variant].offset);
  std::array<double, kNumChannels> energy{};
  const auto n = static_cast<Index>(rows_.size());
  for (int c = 0; c < num_channels_; ++c) energy[c] = 0.5 * does.segment(c * n, n).squaredNorm();
  return energy;
}

double Evidence::GivenUp(const EffectFit& with, const EffectFit& without) const {
  VectorXd change = VectorXd::Zero(white_.rows());
  for (size_t k = 0; k < with.columns.size(); ++k) {
    for (size_t l = 0; l < without.columns.size(); ++l) {
      if (with.columns[k] != without.columns[l]) continue;
      change += (with.coefficients[static_cast<Index>(k)] -
                 without.coefficients[static_cast<Index>(l)]) *
                white_.col(with.columns[k]);
    }
  }
  return 0.5 * change.squaredNorm();
}

double Evidence::PredictiveGain(const VariantSet& set, const VariantSet& over) const {
  const auto error = [&](const VariantSet& of, int fold) {
    const EffectFit fit = SolveWith(gram_ - fold_gram_[fold], ColumnsOf(of), of);
    VectorXd u = VectorXd::Zero(gram_.rows());
    u[gram_.rows() - 1] = 1.0;
    for (const int v : of) {
      if (variants_[v].offset >= 0) u[variants_[v].offset] = -1.0;
    }
    for (size_t k = 0; k < fit.columns.size(); ++k) {
      u[fit.columns[k]] = -fit.coefficients[static_cast<Index>(k)];
    }
    return u.dot(fold_gram_[fold] * u);
  };
  double gain = 0.0;
  for (int fold = 0; fold < kFolds; ++fold) gain += 0.5 * (error(over, fold) - error(set, fold));
  return gain;
}

double Evidence::HeldOutGain(const VariantSet& set) const {
  const auto loss = [&](const VariantSet& of) {
    // Uncertain coefficients make a prediction's variance larger; 1 is the noise's.
    const EffectFit p = Solve(of);
    const VectorXd e = ErrorsOf(held_out_white_, of, p);
    const Eigen::LLT<MatrixXd> llt(p.covariance +
                                   1e-12 * MatrixXd::Identity(p.covariance.rows(),
                                                              p.covariance.cols()));
    double sum = 0.0;
    VectorXd x(static_cast<Index>(p.columns.size()));
    for (Index i = 0; i < e.size(); ++i) {
      for (Index k = 0; k < x.size(); ++k) {
        x[k] = held_out_white_(i, p.columns[static_cast<size_t>(k)]);
      }
      const double variance = 1.0 + x.dot(p.covariance * x);
      sum += 0.5 * (e[i] * e[i] / variance + std::log(variance));
    }
    return sum;
  };
  return loss({}) - loss(set);
}

Evidence::Lead Evidence::LeadOf(const VariantSet& a, const VariantSet& b) const {
  const VectorXd of_a = ErrorsOf(white_, a, Solve(a)).cwiseAbs2(),
                 of_b = ErrorsOf(white_, b, Solve(b)).cwiseAbs2();
  std::map<int, double> blocks;
  const auto n = static_cast<Index>(rows_.size());
  for (Index k = 0; k < n; ++k) {
    double& block = blocks[static_cast<int>(
        residual_->flight().sample(rows_[static_cast<size_t>(k)]).t_s / kBlock_s)];
    for (int c = 0; c < num_channels_; ++c) block += 0.5 * (of_b - of_a)[c * n + k];
  }
  Lead lead;
  for (const auto& entry : blocks) lead.nats += entry.second;
  const double mean = lead.nats / static_cast<double>(blocks.size());
  for (const auto& entry : blocks) lead.sigma += std::pow(entry.second - mean, 2);
  lead.sigma = std::sqrt(lead.sigma);
  return lead;
}

std::vector<double> Evidence::SurrogateGains(const VariantSet& beside, int count,
                                             unsigned seed) const {
  const auto n = static_cast<Index>(rows_.size());
  const std::vector<int> base = ColumnsOf(beside);
  const auto sigmas = [&](const std::vector<int>& of) {
    VectorXd s(static_cast<Index>(of.size()));
    for (size_t k = 0; k < of.size(); ++k) s[static_cast<Index>(k)] = columns_[of[k]].prior_sigma;
    return s;
  };
  struct Test {
    std::vector<int> columns;   // the base's, then its own
    MatrixXd estimate;          // own coefficients by X'y
    MatrixXd information;       // of these
    VectorXd sigma, own_sigma;  // posterior, prior
    double occam;
  };
  std::vector<Test> tests;
  for (size_t v = 0; v < variants_.size(); ++v) {
    const bool has = std::any_of(beside.begin(), beside.end(), [&](int other) {
      return variants_[other].candidate.effect == variants_[v].candidate.effect;
    });
    if (has) continue;
    const std::vector<int>& own = variants_[v].columns;
    const auto k = static_cast<Index>(own.size());
    Test test;
    test.columns = base;
    test.columns.insert(test.columns.end(), own.begin(), own.end());
    const VectorXd sigma = sigmas(test.columns);
    MatrixXd H = sigma.asDiagonal() * Picked(gram_, test.columns, test.columns) *
                 sigma.asDiagonal();
    H.diagonal().array() += 1.0;
    const MatrixXd inverse = H.llt().solve(MatrixXd::Identity(sigma.size(), sigma.size()));
    const MatrixXd covariance = inverse.bottomRightCorner(k, k);
    const Eigen::LLT<MatrixXd> of_own(covariance);
    test.estimate = inverse.bottomRows(k) * sigma.asDiagonal();
    test.information = of_own.solve(MatrixXd::Identity(k, k));
    test.own_sigma = sigma.tail(k);
    test.sigma = test.own_sigma.cwiseProduct(covariance.diagonal().cwiseSqrt());
    test.occam = 0.5 * LogDeterminant(of_own) + std::log(1.0 - kStrange) + variants_[v].log_prior;
    tests.push_back(std::move(test));
  }
  const Index least =
      std::min(n / 4, static_cast<Index>(kLeastShift_s / residual_->flight().step_s()));
  std::mt19937 random(seed);
  std::uniform_int_distribution<Index> shift(least, std::max(least, n - least));
  std::bernoulli_distribution flip;
  std::vector<double> largest;
  std::normal_distribution<double> normal;
  MatrixXd shifted(innovation_.size(), kShiftsOfADraw), Xe;
  for (int s = 0; s < count; ++s) {
    if (s % kShiftsOfADraw == 0) {
      // As the noise may have been.
      VectorXd z(fitted_root_.cols());
      for (Index k = 0; k < z.size(); ++k) z[k] = normal(random);
      const VectorXd noise = innovation_ - fitted_ * (fitted_root_ * z);
      for (int k = 0; k < kShiftsOfADraw; ++k) {
        const Index by = shift(random);
        const double sign = flip(random) ? 1.0 : -1.0;
        for (int c = 0; c < num_channels_; ++c) {
          const auto from = noise.segment(c * n, n);
          shifted.col(k).segment(c * n, n - by) = sign * from.tail(n - by);
          shifted.col(k).segment(c * n + n - by, by) = sign * from.head(by);
        }
      }
      Xe.noalias() = white_.transpose() * shifted;
    }
    double most = -std::numeric_limits<double>::infinity();
    for (const Test& test : tests) {
      VectorXd g(static_cast<Index>(test.columns.size()));
      for (size_t k = 0; k < test.columns.size(); ++k) {
        g[static_cast<Index>(k)] = Xe(test.columns[k], s % kShiftsOfADraw);
      }
      const VectorXd x = test.estimate * g;
      const std::vector<int> own(test.columns.end() - x.size(), test.columns.end());
      most = std::max(most, 0.5 * x.dot(test.information * x) + test.occam +
                                SignTerm(own, x.cwiseProduct(test.own_sigma), test.sigma));
    }
    largest.push_back(most);
  }
  std::sort(largest.begin(), largest.end());
  return largest;
}

std::map<std::string, double> Evidence::Values(const VariantSet& set,
                                               const EffectFit& posterior) const {
  std::map<std::string, double> values = stage_.values;
  for (size_t k = 0; k < posterior.columns.size(); ++k) {
    const Column& column = columns_[posterior.columns[k]];
    if (column.effect.empty()) continue;  // a bias
    const double change = posterior.coefficients[static_cast<Index>(k)];
    values[column.name] = column.about + change;
    // Motion is linear in the inverse of inertia.
    constexpr double kMostRatio = 4.0;
    if (column.effect == "inertia" && column.about > 0.0) {
      values[column.name] =
          column.about / std::clamp(1.0 - change / column.about, 1.0 / kMostRatio, kMostRatio);
    }
  }
  for (const int v : set) {
    for (const auto& [name, value] : variants_[v].candidate.settings) values[name] = value;
  }
  return values;
}

Wrenches Evidence::ResidualOf(const VariantSet& set, const EffectFit& posterior) const {
  Wrenches e = y_;
  for (const int v : set) {
    if (variants_[v].offset >= 0) e -= columns_[variants_[v].offset].d_wrench;
  }
  for (size_t k = 0; k < posterior.columns.size(); ++k) {
    e -= posterior.coefficients[static_cast<Index>(k)] * columns_[posterior.columns[k]].d_wrench;
  }
  return e;
}

}  // namespace odmc

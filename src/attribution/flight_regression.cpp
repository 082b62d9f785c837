#include "odmc/attribution/flight_regression.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <iterator>
#include <numeric>
#include <random>
#include <utility>

#include "odmc/analysis/parallel.h"

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
constexpr Index kMostDraws = 32;    // of the fit, for an expectation: its sums to some per cent
constexpr double kBias_m_s2 = 0.3;  // of an accelerometer
constexpr int kForceChannels = 3;
constexpr int kFolds = Instruments::kFolds;
constexpr double kCollinear = 1e-6;  // of a column's sum of squares, for columns that are one

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

ResidualCoefficient CoefficientOf(const DynamicModel& model, const ModelParameter& p, double about,
                                  double prior_mean) {
  return {p.full_name,
          p.effect,
          about,
          prior_mean,
          p.spec.prior_sigma,
          p.spec.sign,
          p.spec.certain_sign,
          p.spec.initial_state,
          BelongsToFlight(model, p)};
}

/// What candidates with an onset share, whatever that is: the effect, and where it is linearized.
std::string KeyOf(const EffectCandidate& candidate) {
  std::string key = candidate.effect;
  for (const auto& [name, value] : candidate.start) key += ' ' + name + ' ' + std::to_string(value);
  return key;
}

/// Sums of products of a part that is known, of further columns, and of what they explain.
MatrixXd GramOf(const MatrixXd& B, const MatrixXd& BB, const MatrixXd& X, const VectorXd& y) {
  const Index n = B.cols(), k = X.cols();
  MatrixXd gram(n + k + 1, n + k + 1);
  gram.topLeftCorner(n, n) = BB;
  gram.block(0, n, n, k) = B.transpose() * X;
  gram.block(0, n + k, n, 1) = B.transpose() * y;
  gram.block(n, n, k, k) = X.transpose() * X;
  gram.block(n, n + k, k, 1) = X.transpose() * y;
  gram(n + k, n + k) = y.squaredNorm();
  gram.triangularView<Eigen::StrictlyLower>() = gram.transpose();
  return gram;
}

/// A column more, before the last, in sums of products. @param products with all columns
void InsertBeforeLast(const VectorXd& products, MatrixXd* gram) {
  const Index at = gram->rows() - 1;
  gram->conservativeResize(at + 2, at + 2);
  gram->col(at + 1) = gram->col(at);
  gram->row(at + 1) = gram->row(at);
  gram->col(at) = products;
  gram->row(at) = products.transpose();
}

// An inertia is told by the torque about its axis. Where nothing of that is foreseen, w x I w is
// all that is left of the column, and whatever else acts about the other axes would move the
// inertia to where its own axis cannot be.
bool IsOfUnforeseenAxis(const Regressor& column) {
  constexpr std::array<const char*, 3> kAxes = {"inertia.x", "inertia.y", "inertia.z"};
  const auto axis = std::find(kAxes.begin(), kAxes.end(), column.name);
  return axis != kAxes.end() && column.foreseen.col(3 + (axis - kAxes.begin())).isZero(0.0);
}

/// Where between two residuals, both whitened, the smallest is: 0 at the first, 1 at the second.
double SmallestBetween(const VectorXd& first, const VectorXd& second) {
  const VectorXd way = first - second;
  const double size = way.squaredNorm();
  return size > 0.0 ? std::clamp(way.dot(first) / size, 0.0, 1.0) : 0.0;
}

/// Errors that coefficients may have, a few of them as columns; all second moments where there are
/// few coefficients. @param root of their covariance
MatrixXd DrawsOf(const MatrixXd& root, const std::function<double()>& normal) {
  if (root.cols() <= kMostDraws) return root;
  MatrixXd z(root.cols(), kMostDraws);
  for (Index k = 0; k < z.size(); ++k) z.data()[k] = normal();
  return root * z / std::sqrt(static_cast<double>(kMostDraws));
}

}  // namespace

double WildShare(double innovation) {
  constexpr double kWildSigmas = 5.0;
  return kWildSigmas / std::max(std::abs(innovation), kWildSigmas);
}

FlightRegression::FlightRegression(const ResidualModel* residual, const Instruments* instruments,
                                   const ModelPoint& point, int jobs)
    : residual_(residual),
      instruments_(instruments),
      likely_(&instruments->likely_flight(), &residual->file_vehicle(),
              residual->num_channels() == kNumChannels),
      point_(point),
      jobs_(jobs),
      num_channels_(residual->num_channels()) {
  likely_.BlendAs(*residual);
  rows_ = RowsOf(residual->flight(), *instruments, false, SerialNoise::kOrder);
  held_out_rows_ = RowsOf(residual->flight(), *instruments, true, SerialNoise::kOrder);
  AddBase();
}

void FlightRegression::AddBase() {
  const DynamicModel model(point_.vehicle, point_.vehicle.effects);
  const ModelValues values = ValuesOf(model, point_.values);
  y_ = residual_->Residual(model, values);
  if (!model.pendulum()) likely_y_ = likely_.Residual(model, values);
  for (int c = 0; c < kNumChannels; ++c) {
    plain_sigma_[c] = std::sqrt(y_.col(c).squaredNorm() / std::max<double>(1.0, y_.rows()));
  }
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    point_.values[p.full_name] = values[k];
    // Inertia that the file freezes may be wrong: whatever else moves with torque would make up for
    // it.
    if (!p.estimated && p.effect != "inertia") continue;
    Regressor column{CoefficientOf(model, p, values[k], p.spec.prior_value - values[k]),
                     residual_->Derivative(model, values, k),
                     model.pendulum() ? Wrenches(Wrenches::Zero(y_.rows(), kNumChannels))
                                      : likely_.Derivative(model, values, k),
                     {}};
    column.foreseen = instruments_->Foreseen(column.d_wrench, column.likely);
    if (IsOfUnforeseenAxis(column)) column.foreseen.setZero();
    if (column.d_wrench.squaredNorm() > 0.0) columns_.push_back(std::move(column));
  }
  AddNuisances();
  num_base_ = static_cast<int>(columns_.size());
  // What of other columns the base has, each channel in its own units.
  base_.resize(y_.size(), num_base_);
  for (MatrixXd* of : {&base_whole_, &base_likely_, &base_foreseen_}) {
    of->resize(y_.size(), num_base_);
  }
  for (int k = 0; k < num_base_; ++k) {
    const Regressor& column = columns_[static_cast<size_t>(k)];
    base_.col(k) = Stacked(column.d_wrench);
    base_whole_.col(k) = VectorXd::Map(column.d_wrench.data(), y_.size());
    base_likely_.col(k) = VectorXd::Map(column.likely.data(), y_.size());
    base_foreseen_.col(k) = VectorXd::Map(column.foreseen.data(), y_.size());
  }
  base_size_ = base_.colwise().norm().transpose().array().max(1e-300);
  MatrixXd H = base_.transpose() * base_;
  H = base_size_.cwiseInverse().asDiagonal() * H * base_size_.cwiseInverse().asDiagonal();
  H.diagonal().array() += kCollinear;
  base_gram_.compute(H);
  raw_base_.resize(static_cast<Index>(rows_.size()) * num_channels_, num_base_);
  for (int k = 0; k < num_base_; ++k) raw_base_.col(k) = Raw(columns_[k].foreseen);
  raw_gram_ = raw_base_.transpose() * raw_base_;
}

VectorXd FlightRegression::Stacked(const Wrenches& column) const {
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

Wrenches FlightRegression::Foreseen(const Regressor& column) const {
  const VectorXd share = base_size_.cwiseInverse().cwiseProduct(base_gram_.solve(
      base_size_.cwiseInverse().cwiseProduct(base_.transpose() * Stacked(column.d_wrench))));
  const auto of_base_by = [&](const MatrixXd& columns) {
    Wrenches sum(y_.rows(), kNumChannels);
    VectorXd::Map(sum.data(), sum.size()).noalias() = columns * share;
    return sum;
  };
  const Wrenches of_base = of_base_by(base_foreseen_);
  Wrenches own = column.d_wrench - of_base_by(base_whole_);
  Wrenches likely = Wrenches::Zero(y_.rows(), kNumChannels);
  if (!column.likely.isZero(0.0)) likely = column.likely - of_base_by(base_likely_);
  return of_base + instruments_->Foreseen(own, likely);
}

void FlightRegression::AddNuisances() {
  const auto add = [this](const std::string& name, double sigma, Wrenches d_wrench) {
    Regressor column;
    column.name = name;
    column.belongs_to_flight = true;
    column.prior_sigma = sigma;
    column.foreseen = column.likely = column.d_wrench = std::move(d_wrench);
    columns_.push_back(std::move(column));
  };
  for (const auto& [name, scatter] : point_.scatter) {
    const auto own = std::find_if(columns_.begin(), columns_.end(),
                                  [&name = name](const Regressor& c) { return c.name == name; });
    if (own == columns_.end() || own->belongs_to_flight || !(scatter > 0.0)) continue;
    Regressor column = *own;
    column.name += " of this flight";
    column.effect.clear();
    column.about = column.prior_mean = 0.0;
    column.prior_sigma = scatter;
    column.sign = PhysicalSign::kAny;
    column.belongs_to_flight = true;
    columns_.push_back(std::move(column));
  }
  if (residual_->from_accelerometer()) {
    for (int axis = 0; axis < 3; ++axis) {
      const double share = residual_->felt_share_of_constant(axis);
      if (share == 0.0) continue;
      Wrenches ones = Wrenches::Zero(y_.rows(), kNumChannels);
      ones.col(axis).setConstant(share);
      add(std::string("accelerometer bias ") + "xyz"[axis], kBias_m_s2 * point_.vehicle.mass_kg,
          std::move(ones));
    }
  }
}

FlightRegression::Seen FlightRegression::See(const EffectCandidate& candidate,
                                             const std::map<std::string, double>& at,
                                             What what) const {
  const Vehicle extended = VehicleWith(point_.vehicle, candidate);
  const DynamicModel model(extended, extended.effects);
  ModelValues values = ValuesOf(model, point_.values);
  for (const auto* some : {&candidate.start, &at}) {
    for (const auto& [name, value] : *some) values[model.IndexOf(name)] = value;
  }
  // From an onset on an effect acts as one that has acted all along, so all onsets share a column.
  const auto own =
      std::find(model.effect_names().begin(), model.effect_names().end(), candidate.effect);
  const Effect& effect = model.effect(static_cast<int>(own - model.effect_names().begin()));
  const std::string onset = effect.onset_parameter();
  double from_s = 0.0;
  if (!onset.empty()) {
    double& setting = values[model.IndexOf(candidate.effect + "." + onset)];
    from_s = setting;
    setting = 0.0;
  }
  // What follows from the motion alone needs no instruments: no rotor answers to it, and noise of
  // the motion makes it seem less than it is, not more.
  const auto foresee = [&](const Regressor& column) -> Wrenches {
    return effect.is_kinematic() && !residual_->from_accelerometer() ? column.d_wrench
                                                                     : Foreseen(column);
  };
  const auto see = [&](What of) {
    Seen seen = SeeFully(candidate, model, values, of);
    for (Regressor& column : seen.columns) column.foreseen = foresee(column);
    if (seen.offset) seen.offset->foreseen = foresee(*seen.offset);
    return seen;
  };
  const std::string key = onset.empty() || !at.empty() ? "" : KeyOf(candidate);
  Seen seen = key.empty() ? see(what) : SeenBeforeOr(key, [&] { return see(kAll); });
  // When it begins is the candidate's, and not for the past to foresee.
  if (!onset.empty()) BeginAt(from_s, &seen);
  if (what != kAll) {
    seen.columns.erase(std::remove_if(seen.columns.begin(), seen.columns.end(),
                                      [&](const Regressor& c) {
                                        return c.d_wrench.squaredNorm() == 0.0 ||
                                               (what == kQuick && c.initial_state);
                                      }),
                       seen.columns.end());
  }
  return seen;
}

void FlightRegression::BeginAt(double from_s, Seen* seen) const {
  const ThinnedFlight& flight = residual_->flight();
  int before = 0;
  while (before < flight.size() && flight.sample(before).t_s < from_s) ++before;
  const auto begin = [&](Regressor* column) {
    for (Wrenches* of : {&column->d_wrench, &column->likely, &column->foreseen}) {
      of->topRows(before).setZero();
    }
  };
  for (Regressor& column : seen->columns) begin(&column);
  if (seen->offset) begin(&*seen->offset);
}

FlightRegression::Seen FlightRegression::SeenBeforeOr(const std::string& key,
                                                      const std::function<Seen()>& see) const {
  const auto known = [&]() -> const Seen* {
    const std::lock_guard<std::mutex> lock(seen_before_->mutex);
    const auto found = seen_before_->by_key.find(key);
    return found != seen_before_->by_key.end() ? &found->second : nullptr;
  };
  if (const Seen* before = known()) return *before;
  Seen seen = see();
  const std::lock_guard<std::mutex> lock(seen_before_->mutex);
  seen_before_->by_key.emplace(key, seen);
  return seen;
}

FlightRegression::Seen FlightRegression::SeeFully(const EffectCandidate& candidate,
                                                  const DynamicModel& model,
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
    if (what == kQuick && (p.spec.initial_state || candidate.fitted.count(p.full_name) > 0)) {
      continue;
    }
    // A place in the world is as likely about each start: the origin is none.
    const auto start = candidate.start.find(p.full_name);
    const bool is_about_start = p.spec.in_world && start != candidate.start.end();
    const double prior_mean = is_about_start ? start->second : p.spec.prior_value;
    Regressor column{CoefficientOf(model, p, 0.0, prior_mean),
                     residual_->Derivative(model, values, k, residual),
                     is_likely ? likely_.Derivative(model, values, k, likely) : nothing,
                     {}};
    column.linearized_at = values[k];
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

VectorXd FlightRegression::Whitened(const Wrenches& column, const std::vector<int>& rows,
                                    const MatrixXd& weight) const {
  const auto n = static_cast<Index>(rows.size());
  VectorXd white(n * num_channels_);
  for (int c = 0; c < num_channels_; ++c) {
    white.segment(c * n, n) = weight.col(c).cwiseProduct(noise_[c].Whiten(column.col(c), rows));
  }
  return white;
}

FlightRegression::WhiteColumns FlightRegression::WhitenedOf(const std::vector<int>& which) const {
  const auto k = static_cast<Index>(which.size());
  const Index rows = static_cast<Index>(rows_.size()) * num_channels_;
  WhiteColumns white{MatrixXd(rows, k), MatrixXd(rows, k), {}};
  ForEachOf(static_cast<int>(k), jobs_, [&](int i) {
    const Regressor& column = columns_[static_cast<size_t>(which[static_cast<size_t>(i)])];
    white.foreseen.col(i) = Whitened(column.foreseen, rows_, weight_);
    white.whole.col(i) = Whitened(column.d_wrench, rows_, weight_);
  });
  const MatrixXd of_whole = white.foreseen.transpose() * white.whole;
  MatrixXd gram = MatrixXd::Zero(k, k);
  gram.selfadjointView<Eigen::Lower>().rankUpdate(white.foreseen.transpose());
  gram.triangularView<Eigen::StrictlyUpper>() = gram.transpose();
  const VectorXd size = gram.diagonal().cwiseSqrt();
  const VectorXd unit = (size.array() > 0.0).select(size.cwiseInverse(), 0.0);  // 0: unforeseen
  gram = unit.asDiagonal() * gram * unit.asDiagonal();
  gram.diagonal().array() = 1.0 + kCollinear;
  white.projected.noalias() =
      white.foreseen * (unit.asDiagonal() * gram.ldlt().solve(unit.asDiagonal() * of_whole));
  return white;
}

void FlightRegression::ForEachStretch(int channel,
                                      const std::function<void(int, Index, Index)>& use) const {
  const auto rows = static_cast<Index>(rows_.size());
  for (Index from = 0; from < rows;) {
    Index to = from;
    const int fold = FoldOf(from);
    while (to < rows && FoldOf(to) == fold) ++to;
    use(fold, channel * rows + from, to - from);
    from = to;
  }
}

void FlightRegression::SumUp() {
  const Index n = white_.cols();
  std::vector<std::vector<MatrixXd>> by_channel(static_cast<size_t>(num_channels_));
  ForEachOf(num_channels_, jobs_, [&](int c) {
    std::vector<MatrixXd>& grams = by_channel[static_cast<size_t>(c)];
    grams.assign(kFolds, MatrixXd::Zero(n, n));
    ForEachStretch(c, [&](int fold, Index from, Index count) {
      grams[static_cast<size_t>(fold)].selfadjointView<Eigen::Lower>().rankUpdate(
          white_.middleRows(from, count).transpose());
    });
  });
  gram_.setZero(n, n);
  fold_gram_.assign(kFolds, MatrixXd::Zero(n, n));
  for (size_t fold = 0; fold < kFolds; ++fold) {
    for (const auto& grams : by_channel) fold_gram_[fold] += grams[fold];
    fold_gram_[fold].triangularView<Eigen::StrictlyUpper>() = fold_gram_[fold].transpose();
    gram_ += fold_gram_[fold];
  }
}

int FlightRegression::FoldOf(Index row) const {
  const double t_s = residual_->flight().sample(rows_[static_cast<size_t>(row)]).t_s;
  return Instruments::FoldAt(t_s);
}

void FlightRegression::BeginWithWhiteNoise() {
  weight_ = MatrixXd::Ones(static_cast<Index>(rows_.size()), kNumChannels);
  for (int c = 0; c < num_channels_; ++c) {
    noise_[c] =
        SerialNoise(std::max(y_.col(c).squaredNorm() / static_cast<double>(y_.rows()), 1e-300));
  }
}

FlightRegression::ColumnFit FlightRegression::FitOf(const std::vector<int>& which,
                                                    const MatrixXd& white,
                                                    const VectorXd& white_y) const {
  const auto k = static_cast<Index>(which.size());
  VectorXd sigma(k), mean_in_sigmas(k);
  for (Index i = 0; i < k; ++i) {
    const Regressor& column = columns_[static_cast<size_t>(which[static_cast<size_t>(i)])];
    sigma[i] = column.prior_sigma;
    mean_in_sigmas[i] = column.prior_mean / column.prior_sigma;
  }
  MatrixXd H = MatrixXd::Zero(k, k);
  H.selfadjointView<Eigen::Lower>().rankUpdate((white * sigma.asDiagonal()).transpose());
  H.diagonal().array() += 1.0;
  const VectorXd b = sigma.cwiseProduct(white.transpose() * white_y);
  const Eigen::LLT<MatrixXd> llt(H);
  ColumnFit fit;
  fit.root = sigma.asDiagonal() * MatrixXd(llt.matrixU().solve(MatrixXd::Identity(k, k)));
  fit.x = sigma.cwiseProduct(llt.solve(b + mean_in_sigmas));
  return fit;
}

// What foreseen columns leave of a force is its noise and what was not foreseen of each effect.
// Whole columns, with the coefficients of two-stage least squares, leave the noise alone
// (Wooldridge, Econometric Analysis of Cross Section and Panel Data, 2010, sec. 5.2.2), but for the
// errors of these: large columns of what is not there add to it. So it is the smallest residual
// between both. Not so of a torque: the rates' controller answers it within the time by which
// columns are foreseen, and whole columns, angular acceleration and rotor torque among them, could
// explain all of it away.
void FlightRegression::ReestimateNoise(const std::vector<int>& which, const ColumnFit& fit,
                                       const VectorXd& of_whole, const MatrixXd& draws) {
  const auto k = static_cast<Index>(which.size());
  ForEachOf(num_channels_, jobs_, [&](int c) {
    VectorXd left = y_.col(c), whole_left = y_.col(c);
    MatrixXd foreseen(y_.rows(), draws.cols() > 0 ? k : 0);
    for (Index i = 0; i < k; ++i) {
      const Regressor& column = columns_[static_cast<size_t>(which[static_cast<size_t>(i)])];
      left -= fit.x[i] * column.foreseen.col(c);
      whole_left -= of_whole[i] * column.d_wrench.col(c);
      if (draws.cols() > 0) foreseen.col(i) = column.foreseen.col(c);
    }
    if (c < kForceChannels) {
      const VectorXd weight = weight_.col(c);
      const double share =
          SmallestBetween(weight.cwiseProduct(noise_[c].Whiten(left, rows_)),
                          weight.cwiseProduct(noise_[c].Whiten(whole_left, rows_)));
      left += share * (whole_left - left);
    }
    MatrixXd likely(y_.rows(), 1 + draws.cols());
    likely.col(0) = left;
    if (draws.cols() > 0) likely.rightCols(draws.cols()).noalias() = foreseen * draws;
    const bool is_blended_force = c < kForceChannels && residual_->is_blend(c);
    noise_[c] = SerialNoise::Fit(likely, rows_, flight().step_s(), flight().takes_means(),
                                 is_blended_force);
    const VectorXd innovation = noise_[c].Whiten(left, rows_);
    for (Index i = 0; i < innovation.size(); ++i) {
      weight_(i, c) = std::sqrt(WildShare(innovation[i]));
    }
  });
}

void FlightRegression::WhitenHeldOut() {
  const auto m = static_cast<Index>(columns_.size());
  held_out_weight_ = MatrixXd::Ones(static_cast<Index>(held_out_rows_.size()), kNumChannels);
  const auto rows = static_cast<Index>(held_out_rows_.size()) * num_channels_;
  for (MatrixXd& white : held_out_white_) white.resize(rows, m + 1);
  ForEachOf(static_cast<int>(m) + 1, jobs_, [&](int k) {
    for (const Part part : {kForeseen, kWhole}) {
      const Wrenches* column = &y_;
      if (k < m) {
        const Regressor& of = columns_[static_cast<size_t>(k)];
        column = part == kWhole ? &of.d_wrench : &of.foreseen;
      }
      held_out_white_[part].col(k) = Whitened(*column, held_out_rows_, held_out_weight_);
    }
  });
}

void FlightRegression::SetAside(const Added& added) {
  aside_.insert(added.columns.begin(), added.columns.end());
  if (added.offset >= 0) aside_.insert(added.offset);
}

void FlightRegression::EstimateNoise() {
  const auto m = static_cast<Index>(columns_.size());
  const bool is_same = noise_columns_ == m && noise_aside_ == aside_;
  NoiseRounds rounds = is_same ? kMovedColumns : kMoreColumns;
  if (noise_columns_ < 0) {
    rounds = kFirstNoise;
    BeginWithWhiteNoise();
  }
  noise_columns_ = static_cast<int>(m);
  noise_aside_ = aside_;
  std::vector<int> all(columns_.size()), in_use;
  std::iota(all.begin(), all.end(), 0);
  std::copy_if(all.begin(), all.end(), std::back_inserter(in_use),
               [this](int k) { return aside_.count(k) == 0; });
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  const auto draw = [&] { return normal(random); };
  for (int round = 0; round < rounds.rough + rounds.expectation; ++round) {
    const WhiteColumns white = WhitenedOf(in_use);
    const VectorXd white_y = Whitened(y_, rows_, weight_);
    const ColumnFit fit = FitOf(in_use, white.foreseen, white_y);
    // The noise is not what is left: the fit has taken a part of it. Its second moments are those
    // of the rest and of what the fit may as well have been (expectation step; Dempster, Laird and
    // Rubin, J. R. Stat. Soc. B 39, 1977), by a few draws of that.
    // (Not before the residual's size is the noise's: what the fit may have taken would be of the
    // size of the effects.)
    const bool is_rough = round < rounds.rough;
    const MatrixXd none(static_cast<Index>(in_use.size()), 0);
    ReestimateNoise(in_use, fit, FitOf(in_use, white.projected, white_y).x,
                    is_rough ? none : DrawsOf(fit.root, draw));
  }
  WhitenAll(all, in_use);
  WhitenHeldOut();
}

void FlightRegression::WhitenAll(const std::vector<int>& all, const std::vector<int>& in_use) {
  const auto m = static_cast<Index>(all.size());
  WhiteColumns white = WhitenedOf(all);
  const VectorXd white_y = Whitened(y_, rows_, weight_);
  fitted_ = white.foreseen(Eigen::all, in_use);
  const ColumnFit fit = FitOf(in_use, fitted_, white_y);
  fitted_root_ = fit.root;
  innovation_ = white_y - fitted_ * fit.x;
  const VectorXd whole_left =
      white_y - white.whole(Eigen::all, in_use) *
                    FitOf(in_use, white.projected(Eigen::all, in_use), white_y).x;
  const auto rows = static_cast<Index>(rows_.size());
  for (int c = 0; c < kForceChannels; ++c) {
    auto left = innovation_.segment(c * rows, rows);
    const auto whole = whole_left.segment(c * rows, rows);
    left += SmallestBetween(left, whole) * (whole - left);
  }
  white_.resize(white.foreseen.rows(), m + 1);
  white_ << white.projected, white_y;
  white.whole -= white.projected;
  unforeseen_gram_.setZero(m + 1, m + 1);
  unforeseen_gram_.topLeftCorner(m, m).selfadjointView<Eigen::Lower>().rankUpdate(
      white.whole.transpose());
  unforeseen_gram_.triangularView<Eigen::StrictlyUpper>() = unforeseen_gram_.transpose();
  // Held-out columns stay as they are: how many of them combine was fitted elsewhere.
  SumUp();
}

bool FlightRegression::Seen::IsFinite() const {
  const auto is_finite = [](const Regressor& c) {
    return c.d_wrench.allFinite() && c.likely.allFinite() && c.foreseen.allFinite();
  };
  return std::all_of(columns.begin(), columns.end(), is_finite) && (!offset || is_finite(*offset));
}

FlightRegression::Seen FlightRegression::ActingColumns(const EffectCandidate& candidate) const {
  Seen seen = See(candidate, {}, kActing);
  return seen.IsFinite() ? seen : Seen();
}

FlightRegression::Added FlightRegression::Append(const std::string& effect, Seen seen) {
  Added added;
  if (seen.columns.empty()) return added;
  for (Regressor& column : seen.columns) {
    added.columns.push_back(num_columns());
    columns_.push_back(std::move(column));
  }
  if (seen.offset) {
    added.offset = num_columns();
    seen.offset->name = "offset";
    seen.offset->effect = effect;
    columns_.push_back(std::move(*seen.offset));
  }
  return added;
}

void FlightRegression::Replace(Seen seen, Added* added) {
  if (added->columns.empty() || seen.columns.empty()) return;
  // Where the model has no value, the linearization before is the better one.
  if (!seen.IsFinite()) return;
  for (const int k : added->columns) {
    for (Regressor& column : seen.columns) {
      if (column.name == columns_[k].name) columns_[k] = column;
    }
  }
  if (!seen.offset) {
    const Wrenches nothing = Wrenches::Zero(y_.rows(), kNumChannels);
    seen.offset.emplace();
    seen.offset->d_wrench = seen.offset->likely = seen.offset->foreseen = nothing;
  }
  seen.offset->name = "offset";
  seen.offset->effect = seen.columns.front().effect;
  if (added->offset < 0) {
    added->offset = num_columns();
    columns_.emplace_back();
  }
  columns_[added->offset] = std::move(*seen.offset);
}

VectorXd FlightRegression::Raw(const Wrenches& column) const {
  const auto n = static_cast<Index>(rows_.size());
  VectorXd stacked(n * num_channels_);
  for (int c = 0; c < num_channels_; ++c) {
    const double scale = 1.0 / std::max(1e-300, plain_sigma_[c]);
    for (Index r = 0; r < n; ++r) stacked[c * n + r] = scale * column(rows_[r], c);
  }
  return stacked;
}

FlightRegression::QuickSums FlightRegression::QuickSumsOf(
    const EffectCandidate& candidate, const std::map<std::string, double>& at) const {
  const Seen seen = See(candidate, at, kQuick);
  QuickSums glance;
  glance.columns.assign(seen.columns.begin(), seen.columns.end());
  const auto k = static_cast<Index>(seen.columns.size());
  if (k == 0) return glance;
  MatrixXd X(white_.rows(), k);
  for (Index i = 0; i < k; ++i) X.col(i) = Whitened(seen.columns[i].foreseen, rows_, weight_);
  VectorXd y = white_.col(white_.cols() - 1);
  if (seen.offset) y -= Whitened(seen.offset->foreseen, rows_, weight_);
  glance.serial =
      GramOf(white_.leftCols(num_base_), gram_.topLeftCorner(num_base_, num_base_), X, y);
  // As if the noise were white, as large as what the declared model leaves.
  for (Index i = 0; i < k; ++i) X.col(i) = Raw(seen.columns[i].foreseen);
  glance.white =
      GramOf(raw_base_, raw_gram_, X, Raw(seen.offset ? Wrenches(y_ - seen.offset->d_wrench) : y_));
  return glance;
}

VectorXd FlightRegression::WhitenedFeature(int c, const VectorXd& foreseen, double unit) const {
  return unit * weight_.col(c).cwiseProduct(noise_[c].Whiten(foreseen, rows_));
}

int FlightRegression::AddFeature(const VectorXd& whitened, const std::string& name) {
  const Index y_at = white_.cols() - 1;
  Regressor column;
  column.name = column.effect = name;
  columns_.push_back(std::move(column));
  white_.conservativeResize(Eigen::NoChange, y_at + 2);
  white_.col(y_at + 1) = white_.col(y_at);
  white_.col(y_at) = whitened;
  unforeseen_gram_.conservativeResizeLike(MatrixXd::Zero(y_at + 2, y_at + 2));
  std::vector<VectorXd> products(kFolds, VectorXd::Zero(y_at + 2));
  for (int c = 0; c < num_channels_; ++c) {
    ForEachStretch(c, [&](int fold, Index from, Index count) {
      products[static_cast<size_t>(fold)] +=
          white_.middleRows(from, count).transpose() * whitened.segment(from, count);
    });
  }
  VectorXd all = VectorXd::Zero(y_at + 2);
  for (size_t fold = 0; fold < kFolds; ++fold) {
    InsertBeforeLast(products[fold], &fold_gram_[fold]);
    all += products[fold];
  }
  InsertBeforeLast(all, &gram_);
  return static_cast<int>(y_at);
}

VectorXd FlightRegression::NoiseDraw(const VectorXd& normal) const {
  return innovation_ - fitted_ * (fitted_root_ * normal);
}

}  // namespace odmc

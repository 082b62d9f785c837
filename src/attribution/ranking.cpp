#include "odmc/attribution/ranking.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <set>
#include <utility>

namespace odmc {
namespace {

constexpr double kHighest_Hz = 7.0;   // edge of the filter
constexpr double kSignificant = 3.0;  // sigmas of at least one coefficient
constexpr double kSignSigmas = 2.0;   // a wrong sign by this many is an objection
constexpr double kBetter = 0.975;     // on some channel, out of sample
constexpr double kWorse = 1.06;       // on any channel, out of sample
constexpr double kMuchWorse = 1.12;
constexpr double kWorseShare = 0.5;   // or this share of what it makes the best channel better
constexpr double kFoldBlock_s = 1.0;  // of cross-validation: a manoeuvre spans more than one
constexpr double kStray = 2.0;
constexpr size_t kFittedSettings = 3;
constexpr double kSame = 2.0;         // nats, or
constexpr double kSameShare = 0.01;   // this share of the gain: no reason for more parameters
constexpr int kRounds = 6;            // of linearization, at most
constexpr double kConverged = 0.3;    // nats a round gains
constexpr double kLeastShare = 0.05;  // of a step
constexpr int kCorrelationLags = 26;  // of 40 ms: one second
const char* const kBiasName = "accelerometer bias";
const char* const kChannelNames[] = {"force_x",  "force_y",  "force_z",
                                     "torque_x", "torque_y", "torque_z"};

bool Has(const Candidates& candidates, const std::string& effect) {
  return std::any_of(candidates.begin(), candidates.end(),
                     [&](const Candidate& c) { return c.effect == effect; });
}

/// Fills in the parameters of one of the candidates of a fit, and what speaks against it.
RankedEffect Judge(const Stage& stage, const Candidates& candidates, const Candidate& candidate,
                   const Regressor::Result& result, const WrenchFit& base, int num_channels) {
  RankedEffect ranked;
  ranked.name = candidate.effect;
  ranked.settings = candidate.settings;
  ranked.score = CrossValidatedGain(base, result.fit).nats;
  double best = 1.0, worst = 0.0;
  int worst_channel = 0;
  for (int c = 0; c < num_channels; ++c) {
    const double change = std::sqrt(result.fit.plain_mean_square[c] / base.plain_mean_square[c]);
    best = std::min(best, change);
    if (change > worst) {
      worst = change;
      worst_channel = c;
    }
  }
  if (IsClearlyWorse(worst, best) && IsWorseThroughout(base, result.fit, worst_channel)) {
    ranked.sound = false;
    ranked.objection = std::string("makes ") + kChannelNames[worst_channel] + " worse by " +
                       Text(100.0 * (worst - 1.0)) + " %";
  } else if (best > kBetter) {
    ranked.sound = false;
    ranked.objection = "makes no channel better";
  }
  const Vehicle extended = With(stage.vehicle, candidates);
  const DynamicModel model(extended, extended.effects);
  std::vector<Eigen::Index> own;
  std::vector<double> sizes;
  Eigen::VectorXd estimate(0);
  for (size_t i = 0; i < result.names.size(); ++i) {
    const int k = model.IndexOf(result.names[i]);
    if (k < 0) continue;  // a bias
    const ModelParameter& p = model.parameters()[k];
    if (p.effect != candidate.effect) continue;
    const double value = result.values.at(p.full_name);
    const auto at = static_cast<Eigen::Index>(i);
    const double sigma = std::sqrt(std::max(0.0, result.fit.covariance(at, at)));
    ranked.parameters.push_back(
        {p.full_name, p.spec.unit, value, sigma, true, sigma < 0.5 * p.spec.prior_sigma});
    if (!p.spec.initial_state) {
      own.push_back(at);
      sizes.push_back((value - p.spec.prior_value) / p.spec.prior_sigma);
      estimate.conservativeResize(estimate.size() + 1);
      estimate[estimate.size() - 1] = value - p.spec.prior_value;
    }
    if (HasWrongSign(p.spec.sign, value, kSignSigmas * sigma)) {
      ranked.sound = false;
      ranked.objection = p.full_name + " = " + Text(value) + " has an unphysical sign";
    } else if (std::abs(value - p.spec.prior_value) > kTooLarge * p.spec.prior_sigma) {
      ranked.sound = false;
      ranked.objection = p.full_name + " = " + Text(value) + " is too large";
    }
  }
  for (const auto& [name, value] : candidate.settings) {
    const int k = model.IndexOf(name);
    ranked.parameters.push_back({name, model.parameters()[k].spec.unit, value, 0.0, false, false});
  }
  if (ranked.sound && AreTooLargeTogether(sizes)) {
    ranked.sound = false;
    ranked.objection = "its coefficients together are too large";
  }
  ranked.covariance = result.fit.covariance(own, own);
  const bool significant = IsSignificant(estimate, ranked.covariance);
  if (ranked.sound && IsNegligible(ranked)) {
    ranked.sound = false;
    ranked.objection = "is too small to matter, and no larger than feedback can feign";
  }
  if (ranked.sound && !significant) {
    ranked.sound = false;
    ranked.objection = "its coefficients do not differ from zero by three sigma";
  }
  return ranked;
}

/// Holds at zero what has the wrong sign of the declared parameters. @returns true if there were
/// any
bool HoldUnphysical(const DynamicModel& model, const Candidates& candidates,
                    std::map<std::string, double>* values, std::set<std::string>* held) {
  const size_t before = held->size();
  for (const ModelParameter& p : model.parameters()) {
    if (!p.estimated || Has(candidates, p.effect)) continue;
    double& value = values->at(p.full_name);
    if (!HasWrongSign(p.spec.sign, value) || !held->insert(p.full_name).second) continue;
    value = 0.0;
  }
  return held->size() > before;
}

/// Of sound candidates that explain the same, the one with the fewest parameters goes first.
void PreferFewParameters(std::vector<Tried>* tried) {
  if (tried->empty() || !tried->front().ranked.sound) return;
  const double best = tried->front().ranked.score;
  const double close = std::max(kSame, kSameShare * best);
  const auto size = [](const Tried& t) { return t.columns[0].cols(); };
  auto fewest = tried->begin();
  for (auto it = tried->begin(); it != tried->end(); ++it) {
    if (!it->ranked.sound || it->ranked.score < best - close) continue;
    if (size(*it) < size(*fewest)) fewest = it;
  }
  std::rotate(tried->begin(), fewest, fewest + 1);
}

}  // namespace

std::string Text(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

Vehicle With(const Vehicle& vehicle, const Candidate& candidate) {
  Vehicle extended = vehicle;
  extended.effects.push_back(candidate.effect);
  for (const auto& [name, value] : candidate.settings) {
    extended.parameters[name].value = value;
    extended.parameters[name].estimated = false;
  }
  return extended;
}

Vehicle With(const Vehicle& vehicle, const Candidates& candidates) {
  Vehicle extended = vehicle;
  for (const Candidate& candidate : candidates) extended = With(extended, candidate);
  return extended;
}

bool IsClearlyWorse(double worst, double best) {
  const double bearable =
      std::min(std::log(kMuchWorse), std::max(std::log(kWorse), -kWorseShare * std::log(best)));
  return std::log(worst) > bearable;
}

Stage StageOf(const DynamicModel& model, const ModelValues& values,
              const std::vector<bool>& observable, const ResidualModel& residual) {
  Stage stage;
  stage.vehicle = model.vehicle();
  const std::array<bool, 3> shows = residual.ShowsInertia();
  int axis = 0;
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    double& value = stage.values[p.full_name];
    value = values[i];
    if (p.effect != "inertia" || shows[axis++]) continue;
    if (!observable[i]) value = p.spec.prior_value;
    stage.vehicle.parameters[p.full_name].value = value;
    stage.vehicle.parameters[p.full_name].estimated = false;
  }
  return stage;
}

ModelValues ValuesOf(const DynamicModel& model, const std::map<std::string, double>& known) {
  ModelValues values = model.InitialValues();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const auto it = known.find(model.parameters()[i].full_name);
    if (it != known.end()) values[i] = it->second;
  }
  return values;
}

Regressor::Regressor(const ResidualModel* residual, Stage* stage) : residual_(residual) {
  base_ = Fit(*stage, {}, kRounds, &regression_);
  stage->values = base_.values;
  quick_ = std::make_unique<QuickGain>(regression_, base_.fit);
  quick_white_ = std::make_unique<QuickGain>(regression_, base_.fit, false);
}

WrenchColumns Regressor::ColumnsOf(const Stage& stage, const Candidate& candidate) const {
  const Vehicle extended = With(stage.vehicle, candidate);
  const DynamicModel model(extended, extended.effects);
  ModelValues values = ValuesOf(model, stage.values);
  for (const auto& [name, value] : candidate.start) values[model.IndexOf(name)] = value;
  WrenchColumns columns;
  for (Eigen::MatrixXd& c : columns) c.resize(residual_->flight().size(), 0);
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    if (p.effect != candidate.effect || !p.estimated) continue;
    const ResidualModel::Wrenches column = residual_->Derivative(model, values, k);
    if (column.squaredNorm() == 0.0) continue;
    for (int c = 0; c < kNumChannels; ++c) {
      columns[c].conservativeResize(column.rows(), columns[c].cols() + 1);
      columns[c].rightCols<1>() = column.col(c);
    }
  }
  return columns;
}

double Regressor::Promise(const WrenchColumns& columns, bool serial) const {
  if (columns[0].cols() == 0) return 0.0;
  return (serial ? quick_ : quick_white_)->Of(columns);
}

Regressor::Result Regressor::FitWith(const Stage& stage, const Candidates& candidates) const {
  WrenchRegression regression;
  return Fit(stage, candidates, kRounds, &regression);
}

Regressor::Result Regressor::Fit(const Stage& stage, const Candidates& candidates, int rounds,
                                 WrenchRegression* regression) const {
  const Vehicle extended = With(stage.vehicle, candidates);
  const DynamicModel model(extended, extended.effects);
  Result result;
  result.values = stage.values;
  for (const Candidate& candidate : candidates) {
    for (const auto& [name, value] : candidate.start) result.values[name] = value;
  }
  std::set<std::string> held;
  for (int round = 0;; ++round) {
    const ModelValues values = ValuesOf(model, result.values);
    result.names.clear();
    *regression = Rows();
    regression->y = residual_->Residual(model, values);
    for (int k = 0; k < model.num_parameters(); ++k) {
      const ModelParameter& p = model.parameters()[k];
      result.values[p.full_name] = values[k];
      if (!p.estimated || held.count(p.full_name) > 0) continue;
      const ResidualModel::Wrenches column = residual_->Derivative(model, values, k);
      WrenchColumns columns;
      for (int c = 0; c < kNumChannels; ++c) columns[c] = column.col(c);
      double sigma = p.spec.prior_sigma;
      if (!Has(candidates, p.effect)) {
        // Priors of files are wide. What a few transients tell apart must not run off where a
        // fold leaves these out, so no declared parameter strays far from what it is.
        const auto was = stage.values.find(p.full_name);
        const double size = was == stage.values.end() ? 0.0 : was->second - p.spec.prior_value;
        sigma = std::min(sigma, std::max(kStray * std::abs(size), p.spec.scale));
      }
      AddColumn(columns, sigma, p.spec.prior_value - values[k], regression);
      result.names.push_back(p.full_name);
    }
    if (residual_->from_accelerometer()) AddBiases(stage.vehicle.mass_kg, regression, &result);
    result.fit = FitWrench(*regression);
    const double gain = Advance(model, *regression, &result);
    if (HoldUnphysical(model, candidates, &result.values, &held)) continue;
    if (gain < kConverged || round + 1 >= rounds) break;
  }
  return result;
}

double Regressor::Advance(const DynamicModel& model, const WrenchRegression& regression,
                          Result* result) const {
  std::vector<double> biases(kNumChannels, 0.0);
  int axis = 0;
  for (size_t i = 0; i < result->names.size(); ++i) {
    if (result->names[i] != kBiasName) continue;
    biases[axis++] = result->fit.plain_step[static_cast<Eigen::Index>(i)];
  }
  const auto cost = [&](const ResidualModel::Wrenches& y,
                        const std::map<std::string, double>& values) {
    double sum = 0.0;
    for (int c = 0; c < regression.num_channels; ++c) {
      double square = 0.0;
      for (Eigen::Index i = 0; i < y.rows(); ++i) {
        if (regression.used[i]) square += std::pow(y(i, c) - biases[c], 2);
      }
      sum += 0.5 * square / result->fit.plain_variance[c];
    }
    for (size_t i = 0; i < result->names.size(); ++i) {
      const auto it = values.find(result->names[i]);
      if (it == values.end()) continue;  // a bias
      const auto at = static_cast<Eigen::Index>(i);
      const double centre = result->values.at(it->first) + regression.prior_offset[at];
      sum += 0.5 * std::pow((it->second - centre) / regression.prior_sigma[at], 2);
    }
    return sum;
  };
  const double before = cost(regression.y, result->values);
  for (double share = 1.0; share > kLeastShare; share *= 0.5) {
    std::map<std::string, double> values = result->values;
    for (size_t i = 0; i < result->names.size(); ++i) {
      const int k = model.IndexOf(result->names[i]);
      if (k < 0) continue;  // a bias
      const double step = share * result->fit.plain_step[static_cast<Eigen::Index>(i)];
      double& value = values[result->names[i]];
      const ModelParameter& p = model.parameters()[k];
      if (p.effect == "inertia") {
        value /= std::clamp(1.0 - step / value, 0.3, 3.0);  // what is seen is linear in 1/I
      } else if (p.spec.transform == ParameterTransform::kLog) {
        value *= std::exp(std::clamp(step / value, -1.0, 1.0));
      } else {
        value += step;
      }
    }
    ResidualModel::Wrenches y = residual_->Residual(model, ValuesOf(model, values));
    // Torque says nothing of the thrust coefficient, here as in the derivatives.
    std::map<std::string, double> anchored = values;
    for (auto& [name, value] : anchored) {
      if (IsAnchoredByForce(name)) value = result->values.at(name);
    }
    y.rightCols<3>() = residual_->Residual(model, ValuesOf(model, anchored)).rightCols<3>();
    const double after = cost(y, values);
    if (after < before) {
      result->values = std::move(values);
      return before - after;
    }
  }
  return 0.0;
}

WrenchRegression Regressor::Rows() const {
  const ThinnedFlight& flight = residual_->flight();
  WrenchRegression rows;
  rows.num_channels = residual_->num_channels();
  for (int i = 0; i < flight.size(); ++i) {
    rows.next.push_back(flight.next(i));
    rows.block.push_back(static_cast<int>(flight.sample(i).t_s / kFoldBlock_s));
    rows.used.push_back(!flight.held_out(i));
  }
  for (Eigen::MatrixXd& c : rows.columns) c.resize(flight.size(), 0);
  return rows;
}

void Regressor::AddBiases(double mass_kg, WrenchRegression* regression, Result* result) const {
  constexpr double kBias_m_s2 = 0.3;
  for (int axis = 0; axis < 3; ++axis) {
    WrenchColumns columns;
    for (int c = 0; c < kNumChannels; ++c) {
      columns[c] = Eigen::VectorXd::Constant(regression->y.rows(), c == axis ? 1.0 : 0.0);
    }
    AddColumn(columns, kBias_m_s2 * mass_kg, 0.0, regression);
    result->names.push_back(kBiasName);
  }
}

void Regressor::AddColumn(const WrenchColumns& column, double prior_sigma, double prior_offset,
                          WrenchRegression* regression) {
  const Eigen::Index n = regression->prior_sigma.size();
  for (int c = 0; c < kNumChannels; ++c) {
    regression->columns[c].conservativeResize(Eigen::NoChange, n + 1);
    regression->columns[c].col(n) = column[c];
  }
  regression->prior_sigma.conservativeResize(n + 1);
  regression->prior_offset.conservativeResize(n + 1);
  regression->prior_sigma[n] = prior_sigma;
  regression->prior_offset[n] = prior_offset;
}

bool IsSignificant(const Eigen::VectorXd& estimate, const Eigen::MatrixXd& covariance) {
  const auto n = static_cast<double>(estimate.size());
  if (estimate.size() == 0) return false;
  Eigen::MatrixXd C = covariance;
  C.diagonal() *= 1.0 + 1e-9;
  const double square = estimate.dot(C.ldlt().solve(estimate));
  return square > kSignificant * kSignificant + 2.0 * (n - 1.0);
}

bool AreTooLargeTogether(const std::vector<double>& sizes) {
  double squares = 0.0;
  for (const double size : sizes) squares += size * size;
  return squares > kTooLarge * kTooLarge + 2.0 * (static_cast<double>(sizes.size()) - 1.0);
}

bool IsNegligible(const RankedEffect& ranked) {
  constexpr double kDelay_s = 0.003;
  if (ranked.name != "rotor_delay") return false;
  return std::all_of(ranked.parameters.begin(), ranked.parameters.end(),
                     [](const ParameterEstimate& p) { return p.value < kDelay_s; });
}

bool IsSpecialCase(const Tried& special, const Tried& general) {
  constexpr double kSpanned = 1e-4;  // of the norm may stick out
  const Eigen::Index k = general.columns[0].cols(), rows = general.columns[0].rows();
  if (special.columns[0].cols() == 0 || special.columns[0].cols() >= k) return false;
  const auto stacked = [rows](const WrenchColumns& columns) {
    Eigen::MatrixXd all(rows * kNumChannels, columns[0].cols());
    for (int c = 0; c < kNumChannels; ++c) all.middleRows(c * rows, rows) = columns[c];
    return all;
  };
  const Eigen::MatrixXd of_general = stacked(general.columns),
                        of_special = stacked(special.columns);
  const Eigen::MatrixXd M = of_general.colPivHouseholderQr().solve(of_special);
  if ((of_special - of_general * M).norm() > kSpanned * of_special.norm()) return false;

  // The general one's own parameters, natural size zero.
  const Regressor::Result& result = general.result;
  std::vector<Eigen::Index> own;
  Eigen::VectorXd estimate(0);
  for (size_t i = 0; i < result.names.size(); ++i) {
    if (result.names[i].rfind(general.ranked.name + ".", 0) != 0) continue;
    own.push_back(static_cast<Eigen::Index>(i));
    estimate.conservativeResize(estimate.size() + 1);
    estimate[estimate.size() - 1] = result.values.at(result.names[i]);
  }
  if (estimate.size() != k) return false;
  const Eigen::LLT<Eigen::MatrixXd> llt(Eigen::MatrixXd(result.fit.covariance(own, own)));
  if (llt.info() != Eigen::Success) return false;
  const Eigen::VectorXd white = llt.matrixL().solve(estimate);
  const Eigen::MatrixXd white_M = llt.matrixL().solve(M);
  const Eigen::VectorXd rest = white - white_M * white_M.colPivHouseholderQr().solve(white);
  const auto more = static_cast<double>(k - M.cols());
  return rest.squaredNorm() <= kSignificant * kSignificant + 2.0 * (more - 1.0);
}

std::vector<Tried> TryAll(const Stage& stage, const std::vector<Candidate>& candidates,
                          const Regressor& regressor, const WrenchFit& base, int num_channels,
                          const std::function<bool()>& give_up) {
  struct Promising {
    double serial, white;
    const Candidate* candidate;
  };
  std::map<std::string, std::vector<Promising>> settings;
  for (const Candidate& candidate : candidates) {
    if (give_up && give_up()) return {};
    const std::vector<std::string>& have = stage.vehicle.effects;
    if (std::find(have.begin(), have.end(), candidate.effect) != have.end()) continue;
    Promising p{0.0, 0.0, &candidate};
    if (!candidate.settings.empty()) {
      const WrenchColumns columns = regressor.ColumnsOf(stage, candidate);
      p.serial = regressor.Promise(columns);
      p.white = regressor.Promise(columns, false);
    }
    settings[candidate.effect].push_back(p);
  }
  std::vector<Tried> tried;
  for (auto& entry : settings) {
    // Of an effect with several settings, the most promising ones are fitted, by either measure.
    std::vector<Promising>& of = entry.second;
    std::set<size_t> chosen;
    const auto choose = [&](double Promising::*by) {
      std::vector<size_t> order(of.size());
      std::iota(order.begin(), order.end(), size_t{0});
      std::sort(order.begin(), order.end(),
                [&](size_t a, size_t b) { return of[a].*by > of[b].*by; });
      chosen.insert(order.begin(), order.begin() + std::min(order.size(), kFittedSettings));
    };
    choose(&Promising::serial);
    choose(&Promising::white);
    const auto refined = [&](const Candidate& candidate) {
      return Refined(candidate, [&](const Candidate& other) {
        return regressor.Promise(regressor.ColumnsOf(stage, other), false);
      });
    };
    std::optional<Tried> best;
    const auto fit = [&](const Candidate& candidate) {
      Tried t{candidate, regressor.ColumnsOf(stage, candidate), {}, {}};
      t.result = regressor.FitWith(stage, {candidate});
      if (!t.result.fit.step.allFinite()) return;
      t.ranked = Judge(stage, {candidate}, candidate, t.result, base, num_channels);
      const auto worth = [](const Tried& x) {
        return std::make_pair(x.ranked.sound, x.ranked.score);
      };
      if (!best || worth(t) > worth(*best)) best = std::move(t);
    };
    for (const size_t i : chosen) {
      if (give_up && give_up()) return {};
      fit(*of[i].candidate);
    }
    if (!best) continue;
    // Between the grid's settings, about the most promising and about the best.
    const Candidate so_far = best->candidate;
    const size_t most = static_cast<size_t>(
        std::max_element(of.begin(), of.end(),
                         [](const Promising& a, const Promising& b) { return a.white < b.white; }) -
        of.begin());
    for (const Candidate* from : {of[most].candidate, &so_far}) {
      const Candidate between = refined(*from);
      if (between.settings != from->settings) fit(between);
    }
    tried.push_back(std::move(*best));
  }
  std::sort(tried.begin(), tried.end(), [](const Tried& a, const Tried& b) {
    return std::make_pair(a.ranked.sound, a.ranked.score) >
           std::make_pair(b.ranked.sound, b.ranked.score);
  });
  PreferFewParameters(&tried);
  return tried;
}

std::optional<Pair> TryPairs(const Stage& stage, const std::vector<Tried>& tried,
                             const Regressor& regressor, const WrenchFit& base, int num_channels,
                             double least) {
  constexpr size_t kFitted = 12;  // pairs
  struct Promising {
    double together;  // more than each on its own
    size_t a, b;
  };
  std::vector<Promising> promising;
  std::vector<double> alone;
  alone.reserve(tried.size());
  for (const Tried& t : tried) alone.push_back(regressor.Promise(t.columns));
  for (size_t a = 0; a < tried.size(); ++a) {
    for (size_t b = a + 1; b < tried.size(); ++b) {
      WrenchColumns both = tried[a].columns;
      for (int c = 0; c < kNumChannels; ++c) {
        const Eigen::MatrixXd& second = tried[b].columns[c];
        both[c].conservativeResize(Eigen::NoChange, both[c].cols() + second.cols());
        both[c].rightCols(second.cols()) = second;
      }
      const double promise = regressor.Promise(both);
      const double together = promise - alone[a] - alone[b];
      if (together > least) promising.push_back({together, a, b});
    }
  }
  std::sort(promising.begin(), promising.end(),
            [](const Promising& a, const Promising& b) { return a.together > b.together; });
  if (promising.size() > kFitted) promising.resize(kFitted);
  std::optional<Pair> best;
  for (const Promising& p : promising) {
    const Tried &a = tried[p.a], &b = tried[p.b];
    const Candidates both = {a.candidate, b.candidate};
    Pair pair;
    pair.result = regressor.FitWith(stage, both);
    if (!pair.result.fit.step.allFinite()) continue;
    pair.ranked = {Judge(stage, both, a.candidate, pair.result, base, num_channels),
                   Judge(stage, both, b.candidate, pair.result, base, num_channels)};
    pair.score = pair.ranked[0].score;
    pair.ranked[0].score = pair.score - b.ranked.score;
    pair.ranked[1].score = pair.score - a.ranked.score;
    bool earned = true;
    for (const RankedEffect& r : pair.ranked) {
      earned = earned && r.sound && r.score >= least;
    }
    // Together more than each on its own.
    earned = earned && pair.score > a.ranked.score + b.ranked.score + least;
    if (earned && (!best || pair.score > best->score)) best = std::move(pair);
  }
  return best;
}

std::vector<ChannelStructure> Structure(const ThinnedFlight& flight,
                                        const ResidualModel::Wrenches& residual, int num_channels) {
  std::vector<ChannelStructure> all;
  const double rate_Hz = 1.0 / flight.step_s();
  for (int c = 0; c < num_channels; ++c) {
    ChannelStructure channel;
    channel.name = kChannelNames[c];
    channel.unit = c < 3 ? "N" : "N m";
    const Eigen::VectorXd y = residual.col(c);
    channel.rmse = std::sqrt(y.squaredNorm() / std::max<Eigen::Index>(1, y.size()));
    const auto runs = flight.Runs(y);
    channel.whiteness = TestWhiteness(runs, rate_Hz, std::min(kHighest_Hz, 0.4 * rate_Hz));
    channel.autocorrelation = Autocorrelation(runs, kCorrelationLags);
    const auto share = [&](auto quantity) {
      Eigen::MatrixXd A(y.size(), 3);
      for (int i = 0; i < flight.size(); ++i) {
        const double x = quantity(flight.sample(i));
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
        {"speed", share([](const FilteredMotion& m) { return m.v_WS.norm(); })},
        {"forward_speed",
         share([](const FilteredMotion& m) { return (m.R_WS.transpose() * m.v_WS).x(); })},
        {"side_speed",
         share([](const FilteredMotion& m) { return (m.R_WS.transpose() * m.v_WS).y(); })},
        {"axial_speed",
         share([](const FilteredMotion& m) { return (m.R_WS.transpose() * m.v_WS).z(); })},
        {"roll_rate", share([](const FilteredMotion& m) { return m.w_S.x(); })},
        {"pitch_rate", share([](const FilteredMotion& m) { return m.w_S.y(); })},
        {"yaw_rate", share([](const FilteredMotion& m) { return m.w_S.z(); })},
        {"thrust", share([](const FilteredMotion& m) { return m.rotors.speed_squared.sum(); })},
        {"height", share([](const FilteredMotion& m) { return m.p_WS.z(); })},
        {"time", share([](const FilteredMotion& m) { return m.t_s; })},
    };
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

}  // namespace odmc

#include "odmc/attribution/close_loop.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <memory>
#include <stdexcept>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/gust_test.h"

namespace odmc {
namespace {

constexpr double kHighest_Hz = 7.0;      // edge of the filter
constexpr double kSignificant = 3.0;     // sigmas of at least one coefficient
constexpr double kSignSigmas = 2.0;      // a wrong sign by this many is an objection
constexpr double kTooLarge = 4.0;        // natural sizes (prior sigmas) beyond which too
constexpr double kBetter = 0.975;        // on some channel, out of sample
constexpr double kWorse = 1.06;          // on any channel, out of sample
constexpr double kBetterOnline = 0.985;  // on some channel
constexpr double kWorseOnline = 1.06;    // the same for the online estimator
constexpr double kFoldBlock_s = 1.0;     // of cross-validation: a manoeuvre spans more than one
constexpr double kStray = 2.0;
constexpr double kOvershadows = 5.0;
constexpr double kTie = 3.0;          // nats by which a free force may explain better than gusts
constexpr double kTieShare = 0.01;    // or this share of the gain: they differ little
constexpr double kOneSided = 0.9;     // share of the wind's variance along one line
constexpr int kLeastSamples = 50;     // to look for effects in
constexpr int kRounds = 3;            // of linearization
constexpr int kCorrelationLags = 26;  // of 40 ms: one second
constexpr double kKnownThrustShare = 0.05;
const char* const kBiasName = "accelerometer bias";
const char* const kChannelNames[] = {"force_x",  "force_y",  "force_z",
                                     "torque_x", "torque_y", "torque_z"};

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

/// A model with the values and columns of what it lets free.
struct Stage {
  Vehicle vehicle;
  std::map<std::string, double> values;  // by full name
};

ModelValues ValuesOf(const DynamicModel& model, const std::map<std::string, double>& known) {
  ModelValues values = model.InitialValues();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const auto it = known.find(model.parameters()[i].full_name);
    if (it != known.end()) values[i] = it->second;
  }
  return values;
}

/// Regression of the residual of a model on what it lets free.
class Regressor {
 public:
  Regressor(const ResidualModel* residual, const Stage& stage) : residual_(residual) {
    const DynamicModel model(stage.vehicle, stage.vehicle.effects);
    const ModelValues values = ValuesOf(model, stage.values);
    const ThinnedFlight& flight = residual->flight();
    base_.num_channels = residual->num_channels();
    base_.y = residual->Residual(model, values);
    for (int i = 0; i < flight.size(); ++i) {
      base_.next.push_back(flight.next(i));
      base_.block.push_back(static_cast<int>(flight.sample(i).t_s / kFoldBlock_s));
      base_.used.push_back(!flight.held_out(i));
    }
    for (int k = 0; k < model.num_parameters(); ++k) {
      if (model.parameters()[k].estimated) AddColumn(model, values, k, &base_);
    }
    if (residual->from_accelerometer()) AddBiases(stage.vehicle.mass_kg, &base_);
    base_names_ = names_;
  }

  struct Result {
    WrenchFit fit;
    std::vector<std::string> names;
    std::map<std::string, double> values;  // of what was let free, after the fit
  };

  Result FitBase(const Stage& stage) {
    Result result = Finish(base_, names_, stage);
    quick_ = std::make_unique<QuickGain>(base_, result.fit);
    return result;
  }

  /// What a candidate could gain at most, seen quickly. @pre FitBase() was called
  double Promise(const Stage& stage, const Candidate& candidate) const {
    const Vehicle extended = With(stage.vehicle, candidate);
    const DynamicModel model(extended, extended.effects);
    ModelValues values = ValuesOf(model, stage.values);
    for (const auto& [name, value] : candidate.start) values[model.IndexOf(name)] = value;
    std::array<Eigen::MatrixXd, kNumChannels> columns;
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
    return columns[0].cols() == 0 ? 0.0 : quick_->Of(columns);
  }

  /// Fits with a candidate on top, linearized again about what came out.
  Result FitWith(const Stage& stage, const Candidate& candidate) {
    const Vehicle extended = With(stage.vehicle, candidate);
    const DynamicModel model(extended, extended.effects);
    Result result;
    // Only where a parameter scales what another one does, the columns depend on the estimate.
    const bool bilinear = !candidate.start.empty() || candidate.effect == "wind";
    std::map<std::string, double> about = stage.values;
    for (const auto& [name, value] : candidate.start) about[name] = value;
    for (int round = 0; round < (bilinear ? kRounds : 1); ++round) {
      const ModelValues values = ValuesOf(model, about);
      for (int k = 0; k < model.num_parameters(); ++k) {
        about[model.parameters()[k].full_name] = values[k];
      }
      // The first time the base's columns are those without the candidate.
      WrenchRegression regression = base_;
      names_ = base_names_;
      if (round > 0) Clear(&regression);
      regression.y = residual_->Residual(model, values);
      for (int k = 0; k < model.num_parameters(); ++k) {
        const ModelParameter& p = model.parameters()[k];
        const bool own = p.effect == candidate.effect;
        if (p.estimated && (own || round > 0)) AddColumn(model, values, k, &regression);
      }
      if (round > 0 && residual_->from_accelerometer()) {
        AddBiases(stage.vehicle.mass_kg, &regression);
      }
      Stage at = stage;
      at.values = about;
      result = Finish(regression, names_, at);
      // Torque is explained best by an inertia without bounds: round upon round it would run off.
      for (const auto& [name, value] : result.values) {
        if (name.rfind("inertia.", 0) != 0) about[name] = value;
      }
      names_ = base_names_;
    }
    return result;
  }

 private:
  /// The accelerometer's bias, along each axis.
  void AddBiases(double mass_kg, WrenchRegression* regression) {
    constexpr double kBias_m_s2 = 0.3;
    for (int axis = 0; axis < 3; ++axis) {
      const auto n = regression->prior_sigma.size();
      for (int c = 0; c < kNumChannels; ++c) {
        regression->columns[c].conservativeResize(regression->y.rows(), n + 1);
        regression->columns[c].col(n).setConstant(c == axis ? 1.0 : 0.0);
      }
      regression->prior_sigma.conservativeResize(n + 1);
      regression->prior_offset.conservativeResize(n + 1);
      regression->prior_sigma[n] = kBias_m_s2 * mass_kg;
      regression->prior_offset[n] = 0.0;
      names_.push_back(kBiasName);
    }
  }

  /// Takes all columns out, names too.
  void Clear(WrenchRegression* regression) {
    for (Eigen::MatrixXd& c : regression->columns) c.resize(regression->y.rows(), 0);
    regression->prior_sigma.resize(0);
    regression->prior_offset.resize(0);
    names_.clear();
  }

  void AddColumn(const DynamicModel& model, const ModelValues& values, int k,
                 WrenchRegression* regression) {
    const ResidualModel::Wrenches column = residual_->Derivative(model, values, k);
    const int n = static_cast<int>(regression->prior_sigma.size());
    for (int c = 0; c < kNumChannels; ++c) {
      regression->columns[c].conservativeResize(column.rows(), n + 1);
      regression->columns[c].col(n) = column.col(c);
    }
    regression->prior_sigma.conservativeResize(n + 1);
    regression->prior_offset.conservativeResize(n + 1);
    // Priors of files are wide. What a few transients tell apart must not run off where a fold
    // leaves these out, so no parameter strays far from what it is and what is natural for it.
    const ParameterSpec& spec = model.parameters()[k].spec;
    regression->prior_sigma[n] = std::min(
        spec.prior_sigma, std::max(kStray * std::abs(values[k] - spec.prior_value), spec.scale));
    regression->prior_offset[n] = model.parameters()[k].spec.prior_value - values[k];
    names_.push_back(model.parameters()[k].full_name);
  }

  Result Finish(const WrenchRegression& regression, const std::vector<std::string>& names,
                const Stage& stage) const {
    Result result;
    result.fit = FitWrench(regression);
    result.names = names;
    result.values = stage.values;
    for (size_t i = 0; i < names.size(); ++i) {
      if (names[i] == kBiasName) continue;
      result.values[names[i]] += result.fit.plain_step[static_cast<Eigen::Index>(i)];
    }
    return result;
  }

  const ResidualModel* residual_;
  std::unique_ptr<QuickGain> quick_;
  WrenchRegression base_;
  std::vector<std::string> names_, base_names_;
};

/// True if parameters differ from zero together by kSignificant sigmas (Wald's test; the limit
/// grows with their number).
bool IsSignificant(const Eigen::VectorXd& estimate, const Eigen::MatrixXd& covariance) {
  const auto n = static_cast<double>(estimate.size());
  if (estimate.size() == 0) return false;
  Eigen::MatrixXd C = covariance;
  C.diagonal() *= 1.0 + 1e-9;
  const double square = estimate.dot(C.ldlt().solve(estimate));
  return square > kSignificant * kSignificant + 2.0 * (n - 1.0);
}

/// Rotors answer disturbances through the controller, so that a little of any torque noise lines up
/// with their acceleration: sizes that this alone can make count for nothing.
bool IsNegligible(const RankedEffect& ranked) {
  constexpr double kDelay_s = 0.003;
  if (ranked.name != "rotor_delay") return false;
  return std::all_of(ranked.parameters.begin(), ranked.parameters.end(),
                     [](const ParameterEstimate& p) { return std::abs(p.value) < kDelay_s; });
}

/// Fills in a candidate's parameters, and what speaks against them.
RankedEffect Judge(const Stage& stage, const Candidate& candidate, const Regressor::Result& result,
                   const WrenchFit& base, int num_channels) {
  RankedEffect ranked;
  ranked.name = candidate.effect;
  ranked.settings = candidate.settings;
  ranked.score = CrossValidatedGain(base, result.fit);
  double best = 1.0;
  for (int c = 0; c < num_channels; ++c) {
    const double change = std::sqrt(result.fit.plain_mean_square[c] / base.plain_mean_square[c]);
    best = std::min(best, change);
    if (change > kWorse && IsWorseThroughout(base, result.fit, c)) {
      ranked.sound = false;
      ranked.objection = std::string("makes ") + kChannelNames[c] + " worse by " +
                         Text(100.0 * (change - 1.0)) + " %";
    }
  }
  if (ranked.sound && best > kBetter) {
    ranked.sound = false;
    ranked.objection = "makes no channel better";
  }
  const Vehicle extended = With(stage.vehicle, candidate);
  const DynamicModel model(extended, extended.effects);
  std::vector<Eigen::Index> own;
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
      estimate.conservativeResize(estimate.size() + 1);
      estimate[estimate.size() - 1] = value - p.spec.prior_value;
    }
    const double sign = p.spec.sign == PhysicalSign::kPositive   ? 1.0
                        : p.spec.sign == PhysicalSign::kNegative ? -1.0
                                                                 : 0.0;
    if (sign * value < -kSignSigmas * sigma) {
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
  Eigen::MatrixXd covariance(estimate.size(), estimate.size());
  for (Eigen::Index a = 0; a < estimate.size(); ++a) {
    for (Eigen::Index b = 0; b < estimate.size(); ++b) {
      covariance(a, b) = result.fit.covariance(own[a], own[b]);
    }
  }
  const bool significant = IsSignificant(estimate, covariance);
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

/// Every candidate at its best setting, best first; fits of the sound ones in `fits`.
std::vector<RankedEffect> RankAll(const Stage& stage, const std::vector<Candidate>& candidates,
                                  Regressor* regressor, const WrenchFit& base, int num_channels,
                                  std::map<std::string, Regressor::Result>* fits) {
  std::map<std::string, RankedEffect> best;
  // Of an effect with several settings, the most promising one is fitted.
  std::map<std::string, std::pair<double, const Candidate*>> promising;
  for (const Candidate& candidate : candidates) {
    const std::vector<std::string>& have = stage.vehicle.effects;
    if (std::find(have.begin(), have.end(), candidate.effect) != have.end()) continue;
    const double promise = candidate.settings.empty() ? 0.0 : regressor->Promise(stage, candidate);
    const auto it = promising.find(candidate.effect);
    if (it == promising.end() || promise > it->second.first) {
      promising[candidate.effect] = {promise, &candidate};
    }
  }
  for (const auto& entry : promising) {
    const Candidate candidate = Refined(*entry.second.second, [&](const Candidate& other) {
      return regressor->Promise(stage, other);
    });
    Regressor::Result result = regressor->FitWith(stage, candidate);
    if (!result.fit.step.allFinite()) continue;
    const RankedEffect ranked = Judge(stage, candidate, result, base, num_channels);
    best[candidate.effect] = ranked;
    (*fits)[candidate.effect] = std::move(result);
  }
  std::vector<RankedEffect> ranking;
  for (const auto& entry : best) ranking.push_back(entry.second);
  std::sort(ranking.begin(), ranking.end(), [](const RankedEffect& a, const RankedEffect& b) {
    return std::make_pair(a.sound, a.score) > std::make_pair(b.sound, b.score);
  });
  return ranking;
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

/// Largest share of a structured channel's structured variance that a fit explains; 1 if no channel
/// is structured.
double ExplainedStructure(const std::vector<ChannelStructure>& before,
                          const std::vector<ChannelStructure>& after, double whiteness_p) {
  double best = 0.0;
  bool any = false;
  for (size_t c = 0; c < before.size(); ++c) {
    if (before[c].whiteness.p >= whiteness_p) continue;
    any = true;
    const double was = before[c].whiteness.structured_share * before[c].rmse * before[c].rmse;
    const double is = after[c].whiteness.structured_share * after[c].rmse * after[c].rmse;
    if (was > 0.0) best = std::max(best, 1.0 - is / was);
  }
  return any ? best : 1.0;
}

std::string Where(const std::vector<ChannelStructure>& structure, const ThinnedFlight& flight,
                  const ResidualModel::Wrenches& residual) {
  if (structure.empty()) return "";
  const auto worst = std::min_element(structure.begin(), structure.end(), [](auto& a, auto& b) {
    return std::make_pair(a.whiteness.p, -a.whiteness.structured_share) <
           std::make_pair(b.whiteness.p, -b.whiteness.structured_share);
  });
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
      worst->name + ", strongest near " + Text(worst->whiteness.peak_Hz) + " Hz and in ";
  text +=
      "block " + std::to_string(block) + " (RMS " + Text(std::sqrt(most)) + " " + worst->unit + ")";
  return text + "; of the quantities it lines up best with " + quantity->first + " (" +
         Text(100.0 * quantity->second) + " % of its variance)";
}

/// One pass of the online estimator, blocks held out, with its prediction of everything.
struct Pass {
  ReplayResult replay;
  ParameterSet parameters;
  Prediction prediction;
  PredictionFigures held_out;
};

Pass Run(const FlightLog& log, const Vehicle& file_vehicle, const DynamicModel& model,
         const EstimatorOptions& options, const CloseLoopOptions& loop,
         const std::function<void(double)>& progress) {
  Pass pass;
  const bool with_torque = !log.rotor_rms_only;
  Estimator estimator(&model, options, with_torque);
  const Stamp first = log.odometry.empty() ? 0 : log.odometry.front().stamp;
  const bool varies = !model.processes().empty();
  if (!varies) {
    estimator.SetHeldOut(
        [=](Stamp stamp) { return loop.blocks.IsHeldOut(ToSeconds(stamp - first)); });
  }
  pass.replay = Replay(log, &estimator, progress);
  if (!pass.replay.last) throw std::invalid_argument(log.file + ": never airborne");
  pass.parameters = Estimator::ToParameterSet(model, *pass.replay.last);
  ValueVariation vary;
  if (varies) {
    // What varies is predicted from before the sample's own filter window.
    constexpr double kAhead_s = 0.1;
    const auto& history = pass.replay.history;
    const double offset = ToSeconds(pass.replay.last->stamp - first) - pass.replay.last->time_s;
    vary = [&history, &model, offset](double t_s, ModelValues* values) {
      auto it = std::upper_bound(history.begin(), history.end(), t_s - offset - kAhead_s,
                                 [](double t, const HistoryRow& row) { return t < row.t_s; });
      for (const DynamicModel::ProcessParameter& p : model.processes()) {
        (*values)[p.index] = it == history.begin() ? 0.0 : std::prev(it)->values[p.index];
      }
    };
  }
  pass.prediction =
      Predict(log, file_vehicle, model, pass.replay.last->values, pass.replay.ground_spans, vary);
  std::vector<PredictionSample> unseen;
  for (const PredictionSample& s : pass.prediction.samples) {
    if (loop.blocks.IsHeldOut(s.t_s)) unseen.push_back(s);
  }
  pass.held_out =
      SummarisePrediction(unseen, with_torque, file_vehicle, model, pass.replay.last->values);
  return pass;
}

int EffectIndex(const DynamicModel& model, const std::string& name) {
  const std::vector<std::string>& names = model.effect_names();
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
}

/// True if an estimate of the effect differs from zero and matters.
bool IsConfirmed(const RankedEffect& effect, const ParameterSet& online,
                 const DynamicModel& model) {
  RankedEffect estimate = effect;
  std::vector<Eigen::Index> own;
  for (ParameterEstimate& p : estimate.parameters) {
    const ParameterEstimate* found = online.Find(p.full_name);
    if (found == nullptr || !found->estimated) continue;
    p = *found;
    // The warm start is no prior: natural sizes are about zero.
    bool initial_state = false;
    const Effect& catalogue = model.effect(EffectIndex(model, effect.name));
    for (const ParameterSpec& spec : catalogue.parameters()) {
      if (effect.name + "." + spec.name != p.full_name) continue;
      if (std::abs(p.value - spec.prior_value) > kTooLarge * spec.prior_sigma) return false;
      const bool wrong = (spec.sign == PhysicalSign::kPositive && p.value < 0.0) ||
                         (spec.sign == PhysicalSign::kNegative && p.value > 0.0);
      if (wrong) return false;
      initial_state = spec.initial_state;
    }
    if (!initial_state) own.push_back(found - online.parameters.data());
  }
  const auto n = static_cast<Eigen::Index>(own.size());
  Eigen::VectorXd values(n);
  Eigen::MatrixXd covariance(n, n);
  for (Eigen::Index a = 0; a < n; ++a) {
    values[a] = online.parameters[own[a]].value;
    for (Eigen::Index b = 0; b < n; ++b) covariance(a, b) = online.covariance(own[a], own[b]);
  }
  return IsSignificant(values, covariance) && !IsNegligible(estimate);
}

/// What moves by itself is started near what the regression found of it, and so is its place. They
/// are no evidence for the effect, and the first second of flight alone would lead the online
/// estimate astray.
void HoldInitialState(const RankedEffect& effect, Vehicle* vehicle) {
  constexpr double kSigmas = 1.0;  // of the regression's
  const DynamicModel model(*vehicle, vehicle->effects);
  const auto spec = [&model](const ParameterEstimate& p) -> const ParameterSpec& {
    return model.parameters()[model.IndexOf(p.full_name)].spec;
  };
  const bool moves = std::any_of(effect.parameters.begin(), effect.parameters.end(),
                                 [&](const ParameterEstimate& p) { return spec(p).initial_state; });
  for (const ParameterEstimate& p : effect.parameters) {
    if (!moves || !p.estimated || spec(p).sign != PhysicalSign::kAny) continue;
    vehicle->parameters[p.full_name].sigma = std::min(kSigmas * p.sigma, spec(p).prior_sigma);
  }
}

/// RMSE of the accelerometer's force on blocks held out; empty without an accelerometer.
PredictionFigures::Axes HeldOutForce(const ResidualModel& residual, const DynamicModel& model,
                                     const Snapshot& last) {
  if (!residual.from_accelerometer()) return std::nullopt;
  const ResidualModel::Wrenches y = residual.Residual(model, last.values);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero(), mean = sum;
  double count = 0.0;
  for (int i = 0; i < residual.flight().size(); ++i) {
    if (!residual.flight().held_out(i)) continue;
    mean += y.row(i).head<3>().transpose();
    sum += y.row(i).head<3>().transpose().cwiseAbs2();
    count += 1.0;
  }
  if (count < 10.0) return std::nullopt;
  mean /= count;  // the accelerometer's bias
  return Eigen::Vector3d((sum / count - mean.cwiseAbs2()).cwiseMax(0.0).cwiseSqrt());
}

/// "force after/before 1.00 1.01 0.98, torque 1.00 0.97 1.02".
std::string ChangeText(const PredictionFigures& before, const PredictionFigures& after) {
  const auto axes = [](const PredictionFigures::Axes& b, const PredictionFigures::Axes& a) {
    std::string text;
    if (!a || !b) return std::string(" unknown");
    for (int i = 0; i < 3; ++i) text += " " + Text((*a)[i] / (*b)[i]);
    return text;
  };
  return "after/before: force" + axes(before.force_rmse_N, after.force_rmse_N) +
         ", angular acceleration" +
         axes(before.angular_acceleration_rmse_rad_s2, after.angular_acceleration_rmse_rad_s2);
}

/// Angular acceleration of the axes along which the declared model predicts torque better than
/// nothing does; the others' error says nothing about an effect.
PredictionFigures::Axes TellingAcceleration(const PredictionFigures& declared,
                                            const PredictionFigures& figures) {
  PredictionFigures::Axes axes = figures.angular_acceleration_rmse_rad_s2;
  if (!axes || !declared.torque_explained) return axes;
  for (int i = 0; i < 3; ++i) {
    if ((*declared.torque_explained)[i] < 0.0) (*axes)[i] = 1.0;
  }
  return axes;
}

/// True if some channel is better and none is clearly worse.
bool IsBetter(const PredictionFigures& before, const PredictionFigures& after) {
  double sum = 0.0, worst = 0.0, best = 1.0;
  const auto add = [&](const PredictionFigures::Axes& b, const PredictionFigures::Axes& a) {
    if (!a || !b) return;
    for (int i = 0; i < 3; ++i) {
      const double change = (*a)[i] / (*b)[i];
      sum += std::log(change);
      worst = std::max(worst, change);
      best = std::min(best, change);
    }
  };
  add(before.force_rmse_N, after.force_rmse_N);
  // Not the torque, which holds the file's inertia against a model that has found a better one.
  add(TellingAcceleration(before, before), TellingAcceleration(before, after));
  return sum < 0.0 && worst < kWorseOnline && best < kBetterOnline;
}

}  // namespace

std::string ToString(Verdict verdict) {
  switch (verdict) {
    case Verdict::kEffect:
      return "effect";
    case Verdict::kUnexplained:
      return "unexplained";
    default:
      return "none";
  }
}

void HoldKnownThrust(Vehicle* vehicle) {
  const auto it = vehicle->parameters.find("thrust.k_f");
  if (it == vehicle->parameters.end() || !it->second.value || !it->second.sigma) return;
  if (*it->second.sigma < kKnownThrustShare * *it->second.value) it->second.estimated = false;
}

ClosedLoop CloseLoop(const FlightLog& log, const Vehicle& file_vehicle, const Vehicle& vehicle,
                     const CloseLoopOptions& given, const std::function<void(double)>& progress) {
  CloseLoopOptions options = given;
  if (!log.odometry.empty()) {
    options.blocks.FitTo(ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp));
  }
  const auto part = [&](double from, double to) {
    return [&progress, from, to](double share) {
      if (progress) progress(from + share * (to - from));
    };
  };
  ClosedLoop result;
  const bool with_torque = !log.rotor_rms_only;
  const DynamicModel declared(vehicle, vehicle.effects);
  const Pass before = Run(log, file_vehicle, declared, options.estimator, options, part(0.0, 0.4));
  const ReplayResult& replay = before.replay;
  result.declared_parameters = result.parameters = before.parameters;
  result.effect_names = vehicle.effects;
  result.before = result.after = before.held_out;
  result.warnings = log.warnings;
  result.flight.file = log.file;
  result.flight.duration_s = ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp);
  result.flight.on_ground_s = replay.counters.on_ground_s;
  result.flight.keyframes = replay.counters.keyframes;
  result.flight.dropped =
      log.dropped + replay.stream_counters.not_finite + replay.stream_counters.out_of_order;

  const auto fill_samples = [&](const Prediction& after) {
    const size_t n = std::min(before.prediction.samples.size(), after.samples.size());
    for (size_t i = 0; i < n; ++i) {
      const PredictionSample &b = before.prediction.samples[i], &a = after.samples[i];
      LoopSample sample{b.t_s, options.blocks.IsHeldOut(b.t_s), b.speed_m_s, {}, {}};
      for (int k = 0; k < 3; ++k) {
        sample.before[k] = b.measured_force[k] - b.predicted_force[k];
        sample.before[k + 3] = b.measured_torque[k] - b.predicted_torque[k];
        sample.after[k] = a.measured_force[k] - a.predicted_force[k];
        sample.after[k + 3] = a.measured_torque[k] - a.predicted_torque[k];
      }
      result.samples.push_back(sample);
    }
  };

  const ThinnedFlight flight(FilterFlight(log, file_vehicle.num_rotors(), replay.ground_spans),
                             options.blocks);
  int in_use = 0;
  for (int i = 0; i < flight.size(); ++i) in_use += flight.held_out(i) ? 0 : 1;
  if (in_use < kLeastSamples) {
    result.warnings.push_back("too little flight to look for effects: " + std::to_string(in_use) +
                              " samples of 40 ms, at least " + std::to_string(kLeastSamples) +
                              " are needed");
    fill_samples(before.prediction);
    return result;
  }
  const ResidualModel residual(&flight, &file_vehicle, with_torque);
  Stage stage;
  stage.vehicle = vehicle;
  for (int i = 0; i < declared.num_parameters(); ++i) {
    const std::string& name = declared.parameters()[i].full_name;
    stage.values[name] = replay.last->values[i];
  }

  std::vector<Candidate> candidates = CandidatesFor(vehicle, flight.motion());
  // A mass over the whole flight is one with the thrust coefficient.
  const int k_f = declared.IndexOf("thrust.k_f");
  if (k_f >= 0 && declared.parameters()[k_f].estimated) {
    candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                    [](const Candidate& c) {
                                      const auto from = c.settings.find("mass_change.from");
                                      return from != c.settings.end() && from->second <= 0.0;
                                    }),
                     candidates.end());
  }
  ResidualModel::Wrenches unexplained, first_residual;
  double scores = 0.0;
  std::vector<AddedEffect> added;
  for (int step = 0; step <= options.most_effects; ++step) {
    Regressor regressor(&residual, stage);
    const Regressor::Result base = regressor.FitBase(stage);
    unexplained = base.fit.plain_residual;
    if (step == 0) first_residual = unexplained;
    if (step == options.most_effects) break;
    std::map<std::string, Regressor::Result> fits;
    const std::vector<RankedEffect> ranking =
        RankAll(stage, candidates, &regressor, base.fit, residual.num_channels(), &fits);
    if (step == 0) result.ranking = ranking;
    if (progress) progress(0.4 + 0.2 * (step + 1) / options.most_effects);
    if (ranking.empty() || !ranking.front().sound) break;
    const RankedEffect& best = ranking.front();
    const double least =
        step == 0 ? options.least_score
                  : std::max(1.25 * options.least_score, options.least_share_of_first * scores);
    if (best.score < least) break;
    AddedEffect effect;
    effect.effect = best;
    const double close = std::max(options.close_score, options.close_share * best.score);
    for (size_t i = 1; i < ranking.size(); ++i) {
      if (!ranking[i].sound || ranking[i].score < best.score - close) continue;
      effect.alternatives.push_back(ranking[i].name);
      if (effect.manoeuvre.empty()) {
        effect.manoeuvre = TellingManoeuvre(best.name, ranking[i].name);
      }
    }
    added.push_back(effect);
    scores += best.score;
    Candidate chosen{best.name, best.settings};
    stage.vehicle = With(stage.vehicle, chosen);
    for (const auto& [name, value] : fits[best.name].values) stage.values[name] = value;
  }

  result.structure = Structure(flight, first_residual, residual.num_channels());
  for (const ChannelStructure& channel : result.structure) {
    result.structured_share = std::max(result.structured_share, channel.whiteness.structured_share);
    result.whiteness_p =
        std::min(result.whiteness_p,
                 std::min(1.0, channel.whiteness.p * static_cast<double>(result.structure.size())));
  }
  bool structured = false;
  for (const ChannelStructure& channel : result.structure) {
    structured = structured || (channel.whiteness.p < options.whiteness_p &&
                                channel.whiteness.structured_share > options.least_structured);
  }

  std::vector<AddedEffect> shadows;  // come back if gusts do not hold
  // Gusts vary: no fixed regressor shows them.
  Vehicle airy = stage.vehicle;
  const bool has_wind =
      std::find(airy.effects.begin(), airy.effects.end(), "wind") != airy.effects.end();
  const bool has_gust =
      std::find(airy.effects.begin(), airy.effects.end(), "gust") != airy.effects.end();
  if (!has_gust && structured) {
    if (!has_wind) airy.effects.push_back("wind");
    const DynamicModel model(airy, airy.effects);
    const ModelValues values = ValuesOf(model, stage.values);
    std::array<ResidualModel::Wrenches, 3> d_wind;
    for (int k = 0; k < 3; ++k) {
      d_wind[k] =
          residual.Derivative(model, values, model.IndexOf(std::string("wind.w_") + "xyz"[k]));
    }
    const GustTest gust = TestGusts(flight, unexplained, d_wind);
    RankedEffect ranked;
    ranked.name = "gust";
    ranked.score = gust.gain;
    ranked.settings = {{"gust.sigma", std::max(0.1, gust.sigma_m_s)},
                       {"gust.time_constant", std::max(0.1, gust.time_constant_s)}};
    for (const auto& [name, value] : ranked.settings) {
      ranked.parameters.push_back(
          {name, name == "gust.sigma" ? "m/s" : "s", value, 0.0, false, false});
    }
    ranked.sound = gust.over_others > -kTie - kTieShare * gust.gain && gust.sigma_m_s < 8.0 &&
                   gust.one_sidedness < kOneSided;
    if (gust.one_sidedness >= kOneSided) {
      ranked.objection = "it would blow along one line only";
    } else if (!ranked.sound) {
      ranked.objection =
          "a force free of the drag explains it better by " + Text(-gust.over_others) + " nats";
    }
    const double least = std::max(3.0 * options.least_score, 0.5 * scores);
    if (ranked.sound && gust.gain > least) {
      // What was found beside a much larger gust is its shadow.
      if (gust.gain > kOvershadows * scores) shadows.swap(added);
      added.push_back({ranked, {}, ""});
    }
    result.ranking.push_back(ranked);
  }

  if (!added.empty()) {
    const bool with_gust = added.back().effect.name == "gust";
    const bool explains =
        with_gust || ExplainedStructure(result.structure,
                                        Structure(flight, unexplained, residual.num_channels()),
                                        options.whiteness_p) >= options.least_explained;
    if (explains) result.verdict = Verdict::kEffect;
  }
  if (result.verdict != Verdict::kEffect && structured) result.verdict = Verdict::kUnexplained;

  while (result.verdict == Verdict::kEffect && !added.empty()) {
    Vehicle extended = vehicle;
    for (const AddedEffect& effect : added) {
      extended = With(extended, {effect.effect.name, effect.effect.settings});
      for (const ParameterEstimate& p : effect.effect.parameters) {
        if (p.estimated) extended.parameters[p.full_name].value = p.value;  // a warm start
      }
      HoldInitialState(effect.effect, &extended);
    }
    const DynamicModel model(extended, extended.effects);
    const Pass after = Run(log, file_vehicle, model, options.estimator, options, part(0.6, 1.0));
    // What the online estimator does not confirm goes again.
    const auto faded = std::find_if(added.begin(), added.end(), [&](const AddedEffect& effect) {
      return effect.effect.name != "gust" && !IsConfirmed(effect.effect, after.parameters, model);
    });
    if (faded != added.end()) {
      result.warnings.push_back(faded->effect.name +
                                " was chosen, but the online estimate does not confirm it");
      added.erase(faded);
      continue;
    }
    result.accelerometer_before = HeldOutForce(residual, declared, *replay.last);
    result.accelerometer_after = HeldOutForce(residual, model, *after.replay.last);
    PredictionFigures was = before.held_out, is = after.held_out;
    if (result.accelerometer_before && result.accelerometer_after) {
      was.force_rmse_N = result.accelerometer_before;
      is.force_rmse_N = result.accelerometer_after;
    }
    if (IsBetter(was, is)) {
      result.after = after.held_out;
      result.parameters = after.parameters;
      result.effect_names = extended.effects;
      for (AddedEffect& effect : added) {
        for (ParameterEstimate& p : effect.effect.parameters) {
          const ParameterEstimate* online = after.parameters.Find(p.full_name);
          if (online != nullptr) p = *online;
        }
        effect.derived = DerivedFigures(vehicle, effect.effect.name, after.parameters);
      }
      result.effects = added;
      fill_samples(after.prediction);
      return result;
    }
    result.warnings.push_back(added.back().effect.name +
                              " was chosen, but did not predict blocks held out any better (" +
                              ChangeText(was, is) + ")");
    const bool was_gust = added.back().effect.name == "gust";
    added.pop_back();
    if (was_gust && added.empty()) added.swap(shadows);
  }
  if (result.verdict == Verdict::kEffect) {
    result.verdict = structured ? Verdict::kUnexplained : Verdict::kNone;
  }
  if (result.verdict == Verdict::kUnexplained) {
    result.where = Where(result.structure, flight, first_residual);
  }
  fill_samples(before.prediction);
  return result;
}

}  // namespace odmc

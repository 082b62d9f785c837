#include "odmc/fleet/joint_loop.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <boost/math/distributions/chi_squared.hpp>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>

#include "odmc/analysis/flight_motion.h"
#include "odmc/analysis/parallel.h"
#include "odmc/attribution/attribution.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/model_point.h"
#include "odmc/attribution/sampling_change.h"
#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kLeastOfAFlight_s = 60.0;  // looked at, however many there are

/// A flight as attribution looks at it.
struct Looked {
  std::optional<ThinnedFlight> flight;
  std::optional<ResidualModel> residual;
  std::optional<ThinnedFlight> halved;  ///< WithEverySecondRotorSample()
  ResidualContext context;              ///< as declared
};

/// Every flight that the joint estimate uses, thinned.
std::vector<Looked> LookAt(const FleetCalibration& fleet, const FlightSource& source,
                           const Vehicle& file_vehicle, const JointLoopOptions& options) {
  const std::vector<int> used = fleet.used();
  const double most_s = std::max(
      kLeastOfAFlight_s, options.attribution.most_flight_s / static_cast<double>(used.size()));
  std::vector<Looked> looked(used.size());
  ForEachOf(static_cast<int>(used.size()), options.calibration.jobs, [&](int k) {
    const FleetFlight& flight = fleet.flights[static_cast<size_t>(used[static_cast<size_t>(k)])];
    const FlightLog log = source(flight.file).log;
    BlockSplit all_in_use;
    all_in_use.hold_out_every = 0;
    Looked& look = looked[static_cast<size_t>(k)];
    StampSpans left_out = flight.not_flown;
    AddGroundTouches(log, flight.phases, file_vehicle, &left_out);
    FlightMotion motion = FilterFlight(log, file_vehicle.num_rotors(), left_out);
    motion.stood_z_m = StandingHeight(log, flight.phases, file_vehicle.rotors.front().radius_m);
    look.flight.emplace(std::move(motion), all_in_use,
                        file_vehicle.odometry.q_BS.toRotationMatrix(), most_s);
    look.residual.emplace(&*look.flight, &file_vehicle, !log.rotor_rms_only);
    look.halved = WithEverySecondRotorSample(log, *look.flight);
  });
  return looked;
}

/// The declared model as all flights found it, and what each has of its own.
ModelPoint ModelPointOfFleet(const FleetCalibration& fleet, const DynamicModel& model) {
  ModelValues values = model.InitialValues();
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ParameterEstimate* p = fleet.parameters.Find(model.parameters()[k].full_name);
    if (p != nullptr) values[k] = p->value;
  }
  ModelPoint point = ModelPointOf(model, values);
  const std::vector<int> used = fleet.used();
  for (size_t f = 0; f < used.size(); ++f) {
    const FlightFactor& factor = fleet.flights[static_cast<size_t>(used[f])].factor;
    std::map<std::string, double> own;
    for (const ModelParameter& p : model.parameters()) {
      const ParameterEstimate* found = factor.estimate.Find(p.full_name);
      if (BelongsToFlight(model, p) && found != nullptr) own[p.full_name] = found->value;
    }
    point.own.push_back(std::move(own));
  }
  // Where a parameter scatters, steps or was another one on some flight.
  const FlightFactor& first = fleet.flights[static_cast<size_t>(used.front())].factor;
  for (int k = 0; k < first.size(); ++k) {
    double squares = 0.0, noise = 0.0;
    for (size_t f = 0; f < used.size(); ++f) {
      squares += std::pow(fleet.joint.fit.of_flight[f][k] - fleet.joint.value[k], 2);
      noise += std::pow(fleet.flights[static_cast<size_t>(used[f])].factor.sigma[k], -2);
    }
    const double scatter =
        std::max(fleet.joint.fit.scatter[k], std::sqrt(squares / static_cast<double>(used.size())));
    // Beside what all flights together know of it less would not count.
    if (scatter * scatter * noise > 1.0)
      point.scatter[first.names[static_cast<size_t>(k)]] = scatter;
  }
  return point;
}

/// Indices of an effect's parameters among those shared.
std::vector<Eigen::Index> SharedOf(const std::string& effect, const FlightFactor& factor) {
  std::vector<Eigen::Index> own;
  for (int k = 0; k < factor.size(); ++k) {
    if (factor.names[static_cast<size_t>(k)].rfind(effect + ".", 0) == 0) own.push_back(k);
  }
  return own;
}

/// Those that tell how large an effect is.
std::vector<Eigen::Index> SizesOf(const std::string& effect, const FlightFactor& factor,
                                  const Vehicle& vehicle) {
  std::vector<Eigen::Index> sizes = SharedOf(effect, factor);
  sizes.erase(std::remove_if(sizes.begin(), sizes.end(),
                             [&](Eigen::Index k) {
                               return !IsSizeParameter(vehicle,
                                                       factor.names[static_cast<size_t>(k)]);
                             }),
              sizes.end());
  return sizes;
}

/// Chance that parameters which are zero differ from it together by as much (Wald's test).
double ChanceOf(const FleetCalibration& fleet, const std::vector<Eigen::Index>& own) {
  const Eigen::VectorXd value = fleet.joint.value(own);
  Eigen::MatrixXd C = fleet.joint.covariance(own, own);
  C.diagonal() *= 1.0 + 1e-9;
  const double statistic = value.dot(C.ldlt().solve(value));
  if (!(statistic >= 0.0)) return 1.0;
  const boost::math::chi_squared distribution(static_cast<double>(own.size()));
  return boost::math::cdf(boost::math::complement(distribution, statistic));
}

/// Name of a parameter whose sign physics has fixed and which has the other one; empty if none has.
std::string OfImpossibleSign(const FleetCalibration& fleet, const std::vector<Eigen::Index>& own,
                             const Vehicle& vehicle, const std::string& effect) {
  const FlightFactor& factor = fleet.flights[static_cast<size_t>(fleet.used().front())].factor;
  const DynamicModel model(vehicle, {effect});
  for (const Eigen::Index k : own) {
    const std::string& name = factor.names[static_cast<size_t>(k)];
    const ParameterSpec& spec = model.parameters()[static_cast<size_t>(model.IndexOf(name))].spec;
    if (!spec.certain_sign || spec.sign == PhysicalSign::kAny) continue;
    const double towards = spec.sign == PhysicalSign::kPositive ? 1.0 : -1.0;
    if (towards * fleet.joint.value[k] < 0.0) return name;
  }
  return "";
}

/// Share of flights on which an effect points the other way, along the direction in which all
/// flights together tell it from zero best.
double OppositeShare(const FleetCalibration& fleet, const std::vector<Eigen::Index>& own) {
  const Eigen::VectorXd value = fleet.joint.value(own);
  Eigen::MatrixXd C = fleet.joint.covariance(own, own);
  C.diagonal() *= 1.0 + 1e-9;
  const Eigen::VectorXd along = C.ldlt().solve(value);
  const double scatter = along.cwiseProduct(fleet.joint.fit.scatter(own)).norm();
  return 0.5 * std::erfc(along.dot(value) / std::max(scatter, 1e-300) / std::sqrt(2.0));
}

/// Of the flights that say something of an effect, by clear odds, the share that speaks against it.
double AgainstShare(const RankedEffect& effect, double nats) {
  double speak_for = 0.0, against = 0.0;
  for (const FlightEvidence& says : effect.by_flight) {
    speak_for += says.nats > nats ? 1.0 : 0.0;
    against += says.nats < -nats ? 1.0 : 0.0;
  }
  return against / std::max(1.0, speak_for + against);
}

/// How much worse each flight is predicted by the parameters of all others with one model than with
/// another: mean logarithm of the errors' ratio over the flights, by axis of force and torque.
Eigen::Matrix<double, 6, 1> LeftOutLoss(const FleetCalibration& of, const FleetCalibration& over) {
  Eigen::Matrix<double, 6, 1> sum = Eigen::Matrix<double, 6, 1>::Zero();
  Eigen::Matrix<double, 6, 1> count = sum;
  const auto figures = {&PredictionFigures::force_rmse_N, &PredictionFigures::torque_rmse_Nm};
  for (size_t f = 0; f < std::min(of.flights.size(), over.flights.size()); ++f) {
    int at = 0;
    for (const auto figure : figures) {
      const auto &a = of.flights[f].left_out.*figure, &b = over.flights[f].left_out.*figure;
      for (int axis = 0; axis < 3; ++axis, ++at) {
        if (!a || !b || !((*a)[axis] > 0.0 && (*b)[axis] > 0.0)) continue;
        sum[at] += std::log((*a)[axis] / (*b)[axis]);
        count[at] += 1.0;
      }
    }
  }
  return sum.cwiseQuotient(count.cwiseMax(1.0));
}

std::vector<CoefficientSpread> SpreadsOf(const RankedEffect& effect,
                                         const FleetCalibration& fleet) {
  std::vector<CoefficientSpread> spreads;
  const std::vector<int> used = fleet.used();
  std::vector<FlightFactor> factors;
  for (const int i : used) factors.push_back(fleet.flights[static_cast<size_t>(i)].factor);
  const FlightFactor& first = factors.front();
  for (const Eigen::Index k : SharedOf(effect.name, first)) {
    CoefficientSpread spread;
    spread.full_name = first.names[static_cast<size_t>(k)];
    spread.unit = first.units[static_cast<size_t>(k)];
    spread.mean = fleet.joint.value[k];
    spread.sigma = fleet.joint.sigma[k];
    spread.scatter = fleet.joint.fit.scatter[k];
    for (const FlightDeparture& d :
         DeparturesOf(static_cast<int>(k), factors, fleet.joint.model, fleet.joint.fit)) {
      spread.by_flight.push_back({spread.mean + d.value, d.sigma});
      if (std::abs(d.value) < 2.0 * std::hypot(d.sigma, spread.scatter)) ++spread.agreeing;
    }
    spreads.push_back(std::move(spread));
  }
  return spreads;
}

/// How much of the residual's structure is left, see UnexplainedStructure(); mean over the flights
/// on which the effects act, or over all.
double UnexplainedShare(const Attribution& attribution, const std::vector<Looked>& looked,
                        const AttributionOptions& options) {
  double sum = 0.0, of_acting = 0.0;
  int acting = 0;
  for (size_t f = 0; f < looked.size(); ++f) {
    const int channels = looked[f].residual->num_channels();
    const auto structure = [&](const ResidualModel::Wrenches& of) {
      return StructureByChannel(*looked[f].flight, of, channels, looked[f].context,
                                looked[f].residual->file_vehicle());
    };
    const auto &before = attribution.residual_before(f), &after = attribution.residual_after(f);
    const double left =
        UnexplainedStructure(before, after, structure(before), structure(after), options);
    sum += left;
    for (int c = 0; c < channels; ++c) {
      if (!ActsIn(c, before, after, options)) continue;
      of_acting += left;
      ++acting;
      break;
    }
  }
  return acting > 0 ? of_acting / acting : sum / static_cast<double>(looked.size());
}

/// Number of flights on which each channel of what the declared model leaves is structured.
std::vector<std::pair<std::string, int>> StructuredChannels(const Attribution& attribution,
                                                            const std::vector<Looked>& looked,
                                                            const AttributionOptions& options) {
  std::vector<std::pair<std::string, int>> channels;
  for (size_t f = 0; f < looked.size(); ++f) {
    for (const ChannelStructure& channel : StructureByChannel(
             *looked[f].flight, attribution.residual_before(f), looked[f].residual->num_channels(),
             looked[f].context, looked[f].residual->file_vehicle())) {
      const auto known = std::find_if(channels.begin(), channels.end(),
                                      [&](const auto& c) { return c.first == channel.name; });
      const int more = IsStructured(channel, options) ? 1 : 0;
      if (known != channels.end()) {
        known->second += more;
      } else {
        channels.emplace_back(channel.name, more);
      }
    }
  }
  return channels;
}

/// One session.
class JointSession {
 public:
  JointSession(const FlightSource& source, const Vehicle& file_vehicle, const Vehicle& vehicle,
               const JointLoopOptions& options)
      : source_(source), file_vehicle_(file_vehicle), vehicle_(vehicle), options_(options) {}

  JointLoop Run(const std::vector<std::string>& files, const std::vector<std::string>& held_out,
                const std::function<void(double)>& progress);

 private:
  using Progress = std::function<void(double)>;

  void Find(const Progress& progress);
  /// Takes out what is none of the vehicle's, and calibrates with what remains.
  void Confirm(const Progress& progress);
  /// Takes out effects that all flights together show of an impossible sign, or that jump.
  /// @returns true if there were any
  bool TakeOutRefused(const FleetCalibration& fleet);
  /// Takes out the weakest effect whose size all flights together do not tell from zero, unless
  /// flights left out are predicted better with it, on some axis by what counts (`least_ratio`).
  /// `*fleet` is then the calibration without it.
  /// @param kept effects that have proved themselves so
  /// @returns true if one was taken out
  bool TakeOutUnproved(FleetCalibration* fleet, std::set<std::string>* kept,
                       const Progress& progress);
  void Add(const std::vector<std::string>& held_out);
  FleetCalibration CalibrateWith(const Vehicle& vehicle, const Progress& progress) const {
    return CalibrateFleet(files_, source_, file_vehicle_, vehicle, options_.calibration, {},
                          progress);
  }
  Vehicle With(const std::vector<RankedEffect>& effects) const {
    return VehicleWithEffects(vehicle_, point_, effects);
  }
  const FlightSource& source_;
  const Vehicle& file_vehicle_;
  const Vehicle vehicle_;
  const JointLoopOptions& options_;
  std::vector<std::string> files_;
  ModelPoint point_;
  std::vector<RankedEffect> effects_;
  JointLoop loop_;
};

void JointSession::Find(const Progress& progress) {
  std::vector<Looked> looked = LookAt(loop_.before, source_, file_vehicle_, options_);
  if (progress) progress(0.1);
  std::vector<const ResidualModel*> residuals;
  std::vector<const FlightMotion*> motions;
  const DynamicModel declared(vehicle_, vehicle_.effects);
  const ModelPoint point = ModelPointOfFleet(loop_.before, declared);
  for (size_t f = 0; f < looked.size(); ++f) {
    const ModelValues values = ValuesOf(declared, point.OfFlight(f).values);
    looked[f].residual->BlendSensors(declared, values);
    looked[f].context.again = looked[f].residual->ForceByMotion(declared, values);
    if (looked[f].halved) {
      looked[f].context.by_sampling =
          ChangeBySampling(*looked[f].residual, *looked[f].halved, declared, values);
    }
    residuals.push_back(&*looked[f].residual);
    motions.push_back(&looked[f].flight->motion());
  }
  Attribution attribution(residuals, point,
                          WithoutEffects(CandidatesFor(vehicle_, motions), options_.ruled_out),
                          options_.attribution, {}, options_.calibration.jobs);
  attribution.Run();
  point_ = attribution.point();
  effects_ = attribution.effects();
  for (const RankedEffect& ordinary : attribution.ordinary()) {
    loop_.warnings.push_back(OrdinaryText(vehicle_, ordinary));
  }
  loop_.ranking = attribution.ranking();
  loop_.named_gain = attribution.gain();
  loop_.flexible_gain = attribution.flexible().nats();
  loop_.structured = StructuredChannels(attribution, looked, options_.attribution);
  for (RankedEffect& ranked : loop_.ranking) {
    const auto why = attribution.refused().find(ranked.name);
    const bool added = std::any_of(effects_.begin(), effects_.end(),
                                   [&](const auto& e) { return e.name == ranked.name; });
    if (!added && why != attribution.refused().end()) {
      ranked.remarks.push_back("not named: it " + why->second);
    }
  }
  const double unexplained =
      effects_.empty() ? 0.0 : UnexplainedShare(attribution, looked, options_.attribution);
  if (unexplained > options_.attribution.most_unexplained) {
    loop_.warnings.push_back(Rounded(100.0 * unexplained) +
                             " % of the residual's structure stays unexplained beside the effects");
  }
}

bool JointSession::TakeOutRefused(const FleetCalibration& fleet) {
  const size_t before = effects_.size();
  for (size_t k = 0; k < effects_.size();) {
    const std::string why = WhyNotTheVehicles(effects_[k], fleet, vehicle_, options_.attribution);
    if (why.empty()) {
      ++k;
      continue;
    }
    loop_.warnings.push_back(effects_[k].name + " gains " + Rounded(effects_[k].score) +
                             " nats, but " + why);
    effects_.erase(effects_.begin() + static_cast<std::ptrdiff_t>(k));
  }
  return effects_.size() < before;
}

bool JointSession::TakeOutUnproved(FleetCalibration* fleet, std::set<std::string>* kept,
                                   const Progress& progress) {
  while (true) {
    auto weakest = effects_.end();
    for (auto e = effects_.begin(); e != effects_.end(); ++e) {
      if (kept->count(e->name) > 0 ||
          ChanceOfNoSize(e->name, *fleet, vehicle_) <= options_.attribution.false_alarm_rate) {
        continue;
      }
      if (weakest == effects_.end() || e->score < weakest->score) weakest = e;
    }
    if (weakest == effects_.end()) return false;
    std::vector<RankedEffect> others = effects_;
    others.erase(others.begin() + (weakest - effects_.begin()));
    FleetCalibration without =
        others.empty() ? loop_.before : CalibrateWith(With(others), progress);
    const Eigen::Matrix<double, 6, 1> loss = LeftOutLoss(without, *fleet);
    if (loss.sum() > 0.0 && loss.maxCoeff() > -std::log(options_.attribution.least_ratio)) {
      kept->insert(weakest->name);
      continue;
    }
    loop_.warnings.push_back(weakest->name + " gains " + Rounded(weakest->score) +
                             " nats, but what tells its size is zero on all flights together, "
                             "within its uncertainty (p " +
                             Rounded(ChanceOfNoSize(weakest->name, *fleet, vehicle_)) +
                             "), and flights left out are predicted no worse without it");
    effects_ = std::move(others);
    *fleet = std::move(without);
    return true;
  }
}

void JointSession::Confirm(const Progress& progress) {
  if (effects_.empty()) return;
  FleetCalibration fleet = CalibrateWith(With(effects_), progress);
  std::set<std::string> kept;
  while (!effects_.empty()) {
    if (TakeOutRefused(fleet)) {
      if (!effects_.empty()) fleet = CalibrateWith(With(effects_), progress);
    } else if (!TakeOutUnproved(&fleet, &kept, progress)) {
      break;
    }
  }
  if (!effects_.empty()) loop_.after = std::move(fleet);
}

void JointSession::Add(const std::vector<std::string>& held_out) {
  const Vehicle extended = With(effects_);
  for (const RankedEffect& ranked : effects_) {
    JointEffect effect;
    effect.effect = ranked;
    for (ParameterEstimate& p : effect.effect.parameters) {
      const ParameterEstimate* online = loop_.after.parameters.Find(p.full_name);
      if (online != nullptr) p = *online;
    }
    effect.spreads = SpreadsOf(ranked, loop_.after);
    for (const FlightEvidence& says : ranked.by_flight) {
      if (says.nats > options_.attribution.even_odds) ++effect.speak_for;
      if (says.nats < -options_.attribution.even_odds) ++effect.against;
    }
    for (const std::string& name : ranked.alternatives) {
      if (effect.manoeuvre.empty())
        effect.manoeuvre = TellingManoeuvre(vehicle_, ranked.name, name);
    }
    loop_.effects.push_back(std::move(effect));
  }
  loop_.effect_names = extended.effects;
  if (effects_.empty()) loop_.after = loop_.before;
  if (held_out.empty()) return;
  const auto predict = [&](const Vehicle& vehicle, const FleetCalibration& fleet) {
    return PredictHeldOut(held_out, source_, file_vehicle_, vehicle, options_.calibration, fleet);
  };
  loop_.held_out_before = predict(vehicle_, loop_.before);
  loop_.held_out_after = effects_.empty() ? loop_.held_out_before : predict(extended, loop_.after);
}

JointLoop JointSession::Run(const std::vector<std::string>& files,
                            const std::vector<std::string>& held_out, const Progress& progress) {
  const auto part = [&](double from, double to) {
    return [&progress, from, to](double share) {
      if (progress) progress(from + share * (to - from));
    };
  };
  files_ = files;
  loop_.before = CalibrateWith(vehicle_, part(0.0, 0.3));
  for (const int k : loop_.before.used()) {
    loop_.flights.push_back(loop_.before.flights[static_cast<size_t>(k)].file);
  }
  for (const FleetFlight& flight : loop_.before.flights) {
    if (!flight.failure.empty()) loop_.warnings.push_back("not used: " + flight.failure);
  }
  Find(part(0.3, 0.6));
  Confirm(part(0.6, 0.95));
  Add(held_out);
  const bool structured =
      std::any_of(loop_.structured.begin(), loop_.structured.end(), [&](const auto& channel) {
        return 2 * channel.second > static_cast<int>(loop_.flights.size());
      });
  const bool follows = loop_.flexible_gain > 0.0;  // a function of the state
  loop_.verdict = !effects_.empty()       ? Verdict::kEffect
                  : structured || follows ? Verdict::kUnexplained
                                          : Verdict::kNone;
  if (progress) progress(1.0);
  return std::move(loop_);
}

}  // namespace

double ChanceOfNoSize(const std::string& effect, const FleetCalibration& fleet,
                      const Vehicle& vehicle) {
  const FlightFactor& factor = fleet.flights[static_cast<size_t>(fleet.used().front())].factor;
  const std::vector<Eigen::Index> sizes = SizesOf(effect, factor, vehicle);
  return sizes.empty() ? 0.0 : ChanceOf(fleet, sizes);
}

std::string WhyNotTheVehicles(const RankedEffect& effect, const FleetCalibration& fleet,
                              const Vehicle& vehicle, const AttributionOptions& options) {
  const FlightFactor& factor = fleet.flights[static_cast<size_t>(fleet.used().front())].factor;
  const std::vector<Eigen::Index> sizes = SizesOf(effect.name, factor, vehicle);
  if (sizes.empty()) return "";  // each flight's own
  const std::string impossible = OfImpossibleSign(fleet, sizes, vehicle, effect.name);
  if (!impossible.empty()) {
    return impossible + " has a sign that it cannot have on all flights together";
  }
  const double opposite = OppositeShare(fleet, SharedOf(effect.name, factor));
  if (opposite > options.opposite_share &&
      AgainstShare(effect, options.even_odds) > options.opposite_share) {
    return "its coefficient jumps: " + Rounded(100.0 * opposite) +
           " % of flights would have it with the other sign";
  }
  return "";
}

JointLoop CloseLoopOnSeveral(const std::vector<std::string>& files,
                             const std::vector<std::string>& held_out, const FlightSource& source,
                             const Vehicle& file_vehicle, const Vehicle& configured,
                             const JointLoopOptions& options,
                             const std::function<void(double)>& progress) {
  return JointSession(source, file_vehicle, WithPriorsOf(file_vehicle, configured), options)
      .Run(files, held_out, progress);
}

}  // namespace odmc

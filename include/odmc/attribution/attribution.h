#pragma once

#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "odmc/attribution/attribution_options.h"
#include "odmc/attribution/effect_search.h"
#include "odmc/attribution/evidence.h"
#include "odmc/attribution/ranked_effect.h"
#include "odmc/attribution/setting_profile.h"
#include "odmc/attribution/structure.h"

namespace odmc {

/// True if a force's structure is one sensor's own: significantly less than half of it (1 -
/// `most_unexplained`) is in the other measurement, and none significantly.
bool IsSensorNoise(const ChannelStructure& channel, const AttributionOptions& options);

/// True if a lateral force's structure is no more than roll and pitch of the odometry may err:
/// slow, up to `most_lean_rad` of the weight, and not felt by the accelerometer as well.
bool IsLean(const ChannelStructure& channel, const AttributionOptions& options);

/// True if the structure of the force along z is no more than a thrust coefficient may wander in a
/// flight, or an accelerometer's bias: slow, up to `most_thrust_wander` of the weight.
bool IsThrustWander(const ChannelStructure& channel, const AttributionOptions& options);

/// True if a force's structure is no effect that is missing: a lean or a wander.
bool IsSlowError(const ChannelStructure& channel, const AttributionOptions& options);

/// True if a channel of the residual is more than noise.
bool IsStructured(const ChannelStructure& channel, const AttributionOptions& options);

/// True if effects change a channel of the residual by more than a share of its variance
/// (`least_structured`).
bool ActsIn(Eigen::Index channel, const ResidualModel::Wrenches& before,
            const ResidualModel::Wrenches& after, const AttributionOptions& options);

/// Share of the structure of a residual, in nats by which a flexible spectrum explains it beyond
/// noise, that is still there after effects were added, of the channels in which they act, see
/// ActsIn(), and of the one that they change most, however little that is. 0 where there is no
/// structure, 1 where there is and they change nothing.
double UnexplainedStructure(const ResidualModel::Wrenches& before,
                            const ResidualModel::Wrenches& after,
                            const std::vector<ChannelStructure>& of_before,
                            const std::vector<ChannelStructure>& of_after,
                            const AttributionOptions& options);

/// Structure that a fit of the declared model leaves and the estimate of the same model does not is
/// an error of the fit, and nothing for effects to explain: in such channels `of_fit` becomes
/// noise.
void DropErrorsOfFit(const std::vector<ChannelStructure>& of_estimate,
                     const AttributionOptions& options, std::vector<ChannelStructure>* of_fit);

/// What functions of the state explain beside a set of effects.
struct FlexibleRest {
  double of_force = 0.0, of_torque = 0.0;  ///< gained by functions of them [nats]
  std::string first;                       ///< that gains most, as "force_z by \"sideways speed\""
  std::string first_of_torque;             ///< the same of the torque; may be empty

  double nats() const { return of_force + of_torque; }
};

/// Traces the residual of a flight, or of several of one vehicle, to effects: screen, rank,
/// confirm. One session for these.
class Attribution {
 public:
  /// @param residual of the flight; outlives this
  /// @param give_up asked now and then; once true, nothing is found
  /// @param jobs threads
  Attribution(const ResidualModel* residual, ModelPoint point,
              std::vector<EffectCandidate> candidates, const AttributionOptions& options,
              std::function<bool()> give_up = {}, int jobs = 1)
      : Attribution(std::vector<const ResidualModel*>{residual}, std::move(point),
                    std::move(candidates), options, std::move(give_up), jobs) {}
  /// @param residuals of the flights, at least one; outlive this
  /// @param jobs flights looked at at a time
  Attribution(const std::vector<const ResidualModel*>& residuals, ModelPoint point,
              std::vector<EffectCandidate> candidates, const AttributionOptions& options,
              std::function<bool()> give_up = {}, int jobs = 1);
  Attribution(Attribution&&) = default;  // what flights_ points to stays where it is

  /// Does all of it.
  void Run() {
    Search();
    PutOrdinaryAside();
  }

  /// Effects that act, most telling first, and every candidate on its own, best first.
  const std::vector<RankedEffect>& effects() const { return effects_; }
  const std::vector<RankedEffect>& ranking() const { return ranking_; }
  /// Effects that act, but no more than on any recording (IsOrdinary()); part of point().
  const std::vector<RankedEffect>& ordinary() const { return ordinary_; }
  /// The model with the effects, and the values of the joint fit.
  const ModelPoint& point() const { return point_; }
  /// Why what gained more than chance is not among them, by effect.
  const std::map<std::string, std::string>& refused() const { return refused_; }
  /// What functions of the state gain beside the effects.
  const FlexibleRest& flexible() const { return flexible_; }
  /// What the effects do in each channel, over its noise [nats].
  std::array<double, kNumChannels> explained() const;
  double gain() const { return gain_; }  ///< of all effects together [nats]
  double held_out_gain() const { return held_out_gain_; }
  size_t num_flights() const { return flights_.size(); }
  /// Residual that the fit of the declared model leaves, and that of the extended one (N×6).
  const ResidualModel::Wrenches& residual_before(size_t flight = 0) const {
    return before_[flight];
  }
  const ResidualModel::Wrenches& residual_after(size_t flight = 0) const { return after_[flight]; }
  /// Largest gain of any candidate that a given share of flights without effect exceeds [nats].
  double NullGain(double share) const;
  /// Share of flights without effect on which some candidate gains more than `gain`, at most: the
  /// surrogates' share, or Markov's bound where that is larger. (Where the model of the noise is
  /// right, the likelihood ratio of one candidate exceeds 1/p by chance with probability p at
  /// most.)
  double PValue(double gain) const;
  /// By surrogates alone.
  double SurrogatePValue(double gain) const;

 private:
  void Search();
  void PutOrdinaryAside();
  /// One way to try an effect that was looked at closer, and what it promised [nats].
  struct ScreenedWay {
    EffectCandidate candidate;
    double log_prior;
    Evidence::GainBound promise;
  };
  /// Candidates that the model lacks and that were not refuted, by effect.
  std::map<std::string, std::vector<const EffectCandidate*>> OpenCandidates(
      const Evidence& evidence) const;
  /// Of the settings of one effect those that promise most, with their mirrors, and between them.
  std::vector<ScreenedWay> MostPromising(const std::vector<const EffectCandidate*>& settings,
                                         const Evidence& evidence) const;
  void Screen(Evidence* evidence) const;
  void Polish(Evidence* evidence) const;
  void Rank(const Evidence& evidence);
  /// Predictive likelihood, written in two ways: with the coefficients integrated out, and of
  /// blocks of time by the others. Where the model of the noise is right they agree; the smaller
  /// counts.
  double ScoreOf(const Evidence& evidence, const VariantSet& set, const VariantSet& without) const;
  /// What an effect must gain beside others whose form is known only so well, by channel.
  double ShadowOf(const std::array<double, kNumChannels>& energy,
                  const std::array<double, kNumChannels>& others) const;
  /// A set with the functions that gain most beside it, `most` of them at most.
  VariantSet Completed(Evidence* evidence, const VariantSet& set, size_t most, FlexibleRest* rest,
                       const Evidence::FlexibleChoice& choice = {}) const;
  /// What functions of the state gain in the place of an effect of a set, none of them its copy.
  /// @param most functions
  FlexibleRest Rivals(Evidence* evidence, const VariantSet& set, int effect, size_t most) const;
  static std::string NamesOf(const Evidence& evidence, const VariantSet& set);
  /// Variants that gain most on their own, of different effects.
  std::vector<int> BestAlone(const Evidence& evidence) const;
  VariantSet Confirmed(const Evidence& with, VariantSet set);
  /// Counts a force that follows the place where nothing else is found.
  void NoteThePlace(const Evidence& evidence);
  /// The best set's members that are confirmed, or the best effect alone where that says more.
  VariantSet MostConfirmed(const Evidence& evidence, const VariantSet& found);
  RankedEffect Describe(const Evidence& evidence, int variant, const VariantSet& set) const;
  /// Adds what else the effect could be, in its other local minima, to its spread.
  /// @param own columns of its coefficients in the posterior
  void AddOtherValleys(const Evidence& evidence, int variant, const VariantSet& set,
                       const std::vector<Eigen::Index>& own, RankedEffect* ranked) const;
  /// What each of several flights says of an effect of a set.
  std::vector<FlightEvidence> ByFlight(const Evidence& evidence, int variant,
                                       const VariantSet& set) const;
  void FindAlternatives(const Evidence& evidence, const VariantSet& set, int variant,
                        RankedEffect* ranked) const;
  /// The effects of a confirmed set that are looked at first. What is small beside the largest may
  /// be its shadow: it has another look once the model is linearized about the largest.
  VariantSet Largest(const Evidence& evidence, const VariantSet& confirmed) const;
  /// In the place of what has an unphysical sign, the most probable effect that the data do not
  /// tell from it and that has none, if there is one.
  VariantSet WithoutStrangers(const Evidence& evidence, VariantSet set) const;
  /// Holds the settings that a set's effects fit at what SettingProfile says of them.
  /// @returns the profiles of the new set's variants
  static std::map<int, SettingProfile> HoldSettings(Evidence* evidence, VariantSet* set);
  /// Fits all values of the point, linearized anew until they stay.
  std::vector<ResidualModel::Wrenches> Refit(ModelPoint* point) const;
  /// The evidence for effects linearized about what the fit with them has found, inertia near that.
  /// @param vehicle without the effects
  Evidence EvidenceAtFit(const ModelPoint& fitted, const Vehicle& vehicle,
                         std::vector<EffectCandidate> added) const;
  /// What an effect of a fitted set gains on the blocks held out [nats].
  static double HeldOutScore(const Evidence& evidence, const VariantSet& set, int variant);
  /// True where the odds about a fit are against an effect. (What is merely not seen there is none
  /// where other evidence clearly speaks for it.)
  bool IsHollow(double score, double other) const;
  /// Ranks an effect by `score` at most.
  void Refuse(const std::string& effect, double score, const std::string& why);
  /// True for an effect, or one sign of its size, that is looked at no more.
  bool IsHollowCandidate(const EffectCandidate& candidate) const;
  /// Refuses the weakest of the effects that a fit from afar promised and that are not there: the
  /// declared parameters went where they do not act in proportion any more, and about what the fit
  /// with the effects has found the odds are against them; or what they gain is less than they lose
  /// on blocks held out.
  /// @param fitted the point with the set, fitted
  /// @returns true if there is one
  bool RejectByRescoring(const Evidence& evidence, const VariantSet& set, const ModelPoint& fitted);
  /// A set with settings held, and the model fitted with it.
  struct FittedSet {
    VariantSet set;
    std::map<int, SettingProfile> profiles;  ///< HoldSettings()
    ModelPoint point;
    std::vector<ResidualModel::Wrenches> left;  ///< what it leaves of the wrench, by flight
  };
  FittedSet FitSet(Evidence* evidence, const VariantSet& set) const;
  /// An effect, or the other sign of the same, that promises as much in the place of another.
  struct Rival {
    std::string effect, valley;  ///< ValleyNameOf()
    int variant;
    VariantSet set;       ///< with it
    double behind = 0.0;  ///< the set with the other [nats]
  };
  std::vector<Rival> RivalsOf(const Evidence& evidence, const VariantSet& set, int variant) const;
  /// True if Confirmed() would keep all of a set; changes nothing.
  bool IsConfirmed(const Evidence& evidence, const VariantSet& set);
  /// The set with a rival in the place of one of its effects, where the rival's second score is
  /// clearly the larger one, blocks held out included.
  /// @param set with the settings that its effects fit
  std::optional<VariantSet> BetterRival(const Evidence& evidence, const VariantSet& set);
  /// The score of one of a set's effects about what the fit with the set finds, and what it gains
  /// on blocks held out [nats].
  /// @param fit what the fit finds
  double SecondTotal(Evidence evidence, const VariantSet& set, const std::string& effect,
                     ModelPoint* fit) const;
  /// Takes away effects found earlier that one of the newest contains (ContainedEffects()).
  /// @param newest how many at the end of effects_ are
  void DropContained(size_t newest);
  /// Takes away effects found earlier of which nothing is left beside the newest (IsHollow()).
  /// @param newest how many at the end of effects_ are
  /// @returns true if there were any
  bool DropSuperseded(size_t newest);
  /// Forgets what was found, but for superseded_, which is looked at no more.
  /// @param declared the model without effects, fitted
  void StartAgain(const ModelPoint& declared);
  /// Takes effects away, and fits the rest.
  void Drop(const std::set<std::string>& names);
  /// An effect's parameters as the point has them.
  void UpdateValues(RankedEffect* effect) const;
  /// Standard deviations of effects found earlier, beside the newest. Those with a setting that was
  /// profiled keep theirs.
  /// @param at_fit EvidenceAtFit() of all effects
  void UpdateSigmas(const Evidence& at_fit, size_t newest);
  bool GivesUp() const { return give_up_ && give_up_(); }

  std::vector<Instruments> instruments_;  // by flight
  std::vector<FlightWithInstruments> flights_;
  FlexibleFeatures features_;
  FlexibleRest flexible_;
  ModelPoint point_;
  std::vector<EffectCandidate> candidates_;
  AttributionOptions options_;
  std::function<bool()> give_up_;
  int jobs_;
  std::vector<double> null_gains_;
  std::vector<RankedEffect> effects_, ordinary_, ranking_;
  std::map<std::string, std::string> refused_;
  std::map<std::string, EffectCandidate> named_;  // how effects_ were found
  std::map<std::string, double> second_scores_;   // about what the fit with them has found [nats]
  std::map<std::string, double> second_totals_;   // and what they gain on blocks held out
  std::set<std::string> hollow_;                  // ValleyNameOf() those that are looked at no more
  std::set<std::string> superseded_;              // by effects found later: the same
  std::set<std::string> refuted_;  // the same of signs of which the fit bears out less
  std::map<std::string, std::array<double, kNumChannels>> energy_;  // of effects_ [nats]
  double gain_ = 0.0, held_out_gain_ = 0.0;
  std::vector<ResidualModel::Wrenches> before_, after_;  // by flight
};

}  // namespace odmc

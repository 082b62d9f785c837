#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/attribution/evidence.h"
#include "odmc/attribution/ranked_effect.h"

namespace odmc {

/// What a flight says of the one setting that an effect fits, as of the height of the ground, by
/// values of it that are held. With the setting held the effect is linear, and its evidence exact.
/// A fit that steps through the setting stops in the nearest valley, and knows the width of that
/// one only; here each value counts by its evidence, wherever it lies.
class SettingProfile {
 public:
  /// @param variant of the set
  /// @returns nothing unless the variant fits one setting, between bounds, and is linear otherwise
  static std::optional<SettingProfile> Of(const Evidence& evidence, int variant,
                                          const VariantSet& set);

  const std::string& setting() const { return setting_; }  ///< full name
  double mean() const { return mean_; }                    ///< a posteriori
  double sigma() const { return sigma_; }
  /// What having looked for the setting costs, which is as likely anywhere between its bounds a
  /// priori: log of the mean likelihood over the best [nats], at most 0.
  double log_occam() const { return log_occam_; }
  /// The effect with its setting held at the mean.
  EffectCandidate Held() const { return HeldAt(mean_); }

  /// Tells an effect that was described with the setting held how well that is known, and what the
  /// parameters of the whole model owe to it (RankedEffect::spread).
  void AddTo(RankedEffect* ranked) const;

 private:
  /// The model with the setting held.
  struct Point {
    double at = 0.0, log_evidence = 0.0;
    double weight = 0.0;                   ///< probability a posteriori of those looked at
    std::map<std::string, double> values;  ///< of parameters that the flights share, full names
  };

  SettingProfile(EffectCandidate fitted, const Evidence& evidence, int variant,
                 const VariantSet& set);
  EffectCandidate HeldAt(double value) const;
  /// @returns nothing if the effect is not linear with its setting held
  std::vector<Point> PointsAt(const std::vector<double>& values, const Evidence& evidence) const;
  /// @returns false if there is nothing to be found
  bool Find(const Evidence& evidence);
  void Weigh(double step);
  double AtMean(const std::string& name) const;

  EffectCandidate fitted_;
  VariantSet others_;
  std::string setting_;
  double from_ = 0.0, to_ = 0.0;
  std::vector<Point> points_;
  double mean_ = 0.0, sigma_ = 0.0;
  double log_occam_ = 0.0;
};

}  // namespace odmc

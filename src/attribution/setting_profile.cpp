#include "odmc/attribution/setting_profile.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace odmc {
namespace {

constexpr int kPoints = 11;
constexpr int kRounds = 3;      // at most; each closes in on what counts
constexpr double kFine = 1.0;   // steps that need no finer ones [sigma]
constexpr double kCount = 8.0;  // what is further below the best does not [nats]

}  // namespace

SettingProfile::SettingProfile(EffectCandidate fitted, const Evidence& evidence, int variant,
                               const VariantSet& set)
    : fitted_(std::move(fitted)), others_(set), setting_(*fitted_.fitted.begin()) {
  others_.erase(variant);
  std::tie(from_, to_) = fitted_.bounds.at(setting_);
  for (const EffectVariant& other : evidence.variants()) {
    const auto bounds = other.candidate.bounds.find(setting_);
    if (bounds == other.candidate.bounds.end()) continue;
    from_ = std::min(from_, bounds->second.first);
    to_ = std::max(to_, bounds->second.second);
  }
}

std::optional<SettingProfile> SettingProfile::Of(const Evidence& evidence, int variant,
                                                 const VariantSet& set) {
  const EffectCandidate& candidate = evidence.variants()[static_cast<size_t>(variant)].candidate;
  if (candidate.fitted.size() != 1) return std::nullopt;
  if (candidate.bounds.count(*candidate.fitted.begin()) == 0) return std::nullopt;
  SettingProfile profile(candidate, evidence, variant, set);
  if (!profile.Find(evidence)) return std::nullopt;
  return profile;
}

EffectCandidate SettingProfile::HeldAt(double value) const {
  EffectCandidate held = fitted_;
  held.fitted.clear();
  held.bounds.erase(setting_);
  held.start.clear();
  held.size.clear();
  held.settings[setting_] = value;
  return held;
}

std::vector<SettingProfile::Point> SettingProfile::PointsAt(const std::vector<double>& values,
                                                            const Evidence& evidence) const {
  Evidence held = evidence;
  std::vector<std::pair<int, double>> added;
  for (const double value : values) {
    const int variant = held.Add(HeldAt(value));
    if (variant < 0) continue;
    if (held.variants()[static_cast<size_t>(variant)].offset >= 0) return {};
    added.emplace_back(variant, value);
  }
  held.EstimateNoise();
  std::vector<Point> points;
  for (const auto& [variant, value] : added) {
    VariantSet set = others_;
    set.insert(variant);
    const EffectFit fit = held.Solve(set);
    Point point;
    point.at = value;
    point.log_evidence = fit.log_evidence;
    for (size_t k = 0; k < fit.columns.size(); ++k) {
      const Evidence::Column& column = held.column(fit.columns[k]);
      if (column.flight >= 0) continue;
      point.values[column.name] = fit.coefficients[static_cast<Eigen::Index>(k)];
    }
    points.push_back(std::move(point));
  }
  return points;
}

bool SettingProfile::Find(const Evidence& evidence) {
  double from = from_, to = to_;
  for (int round = 0; round < kRounds; ++round) {
    const double step = (to - from) / (kPoints - 1);
    std::vector<double> values(kPoints);
    for (int i = 0; i < kPoints; ++i) values[static_cast<size_t>(i)] = from + i * step;
    points_ = PointsAt(values, evidence);
    if (points_.size() < 2) return false;
    Weigh(step);
    if (step < kFine * sigma_) break;
    const auto counts = [](const Point& p) { return p.weight > std::exp(-kCount); };
    const auto first = std::find_if(points_.begin(), points_.end(), counts);
    const auto last = std::find_if(points_.rbegin(), points_.rend(), counts);
    from = std::max(from_, first->at - step);
    to = std::min(to_, last->at + step);
  }
  return true;
}

void SettingProfile::Weigh(double step) {
  double best = points_.front().log_evidence;
  for (const Point& p : points_) best = std::max(best, p.log_evidence);
  double sum = 0.0;
  for (Point& p : points_) sum += p.weight = std::exp(p.log_evidence - best);
  log_occam_ = std::min(0.0, std::log(sum * step / (to_ - from_)));
  mean_ = 0.0;
  for (Point& p : points_) mean_ += (p.weight /= sum) * p.at;
  double variance = step * step / 12.0;  // between two of them
  for (const Point& p : points_) variance += p.weight * std::pow(p.at - mean_, 2);
  sigma_ = std::sqrt(variance);
}

double SettingProfile::AtMean(const std::string& name) const {
  const auto above = std::find_if(points_.begin() + 1, points_.end() - 1,
                                  [&](const Point& p) { return p.at >= mean_; });
  const Point &a = *(above - 1), &b = *above;
  const double share = (mean_ - a.at) / (b.at - a.at);
  return (1.0 - share) * a.values.at(name) + share * b.values.at(name);
}

void SettingProfile::AddTo(RankedEffect* ranked) const {
  for (ParameterEstimate& p : ranked->parameters) {
    if (p.full_name != setting_) continue;
    p.value = mean_;
    p.sigma = sigma_;
    p.estimated = true;
  }
  const auto n = static_cast<Eigen::Index>(ranked->spread_of.size());
  for (const Point& point : points_) {
    Eigen::VectorXd way(n);
    for (Eigen::Index k = 0; k < n; ++k) {
      const std::string& name = ranked->spread_of[static_cast<size_t>(k)];
      way[k] = point.values.at(name) - AtMean(name);
    }
    ranked->spread += point.weight * way * way.transpose();
  }
  std::vector<Eigen::Index> own;  // of the spread, in the order of the effect's covariance
  for (ParameterEstimate& p : ranked->parameters) {
    const auto it = std::find(ranked->spread_of.begin(), ranked->spread_of.end(), p.full_name);
    if (it == ranked->spread_of.end()) continue;
    own.push_back(it - ranked->spread_of.begin());
    p.sigma = std::sqrt(p.sigma * p.sigma + ranked->spread(own.back(), own.back()));
  }
  ranked->covariance += ranked->spread(own, own);
}

}  // namespace odmc

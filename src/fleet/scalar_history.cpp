#include "odmc/fleet/scalar_history.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

namespace odmc {
namespace {

using Kind = HistoryFinding::Kind;

constexpr int kRefitted = 8;  // candidates of a kind whose scatter is fitted anew
constexpr size_t kMostFindings = 20;
constexpr size_t kLookAhead = 3;
constexpr int kFlightsPerFinding = 5;  // fewer explain anything
constexpr double kKinds = 3.0;         // that a finding is one of

/// Weighted least squares of flights at a variance of the scatter.
struct Fitted {
  Eigen::VectorXd beta, sigma;  // mean first, then one per finding
  double variance = 0.0;
  double residual_variance = 0.0;
  double log_likelihood = 0.0, restricted = 0.0;
};

class Examination {
 public:
  explicit Examination(const ScalarHistory& history) : history_(history) {
    for (size_t i = 0; i < history.value.size(); ++i) {
      if (std::isfinite(history.sigma[i])) used_.push_back(static_cast<int>(i));
    }
    y_.resize(size());
    noise_.resize(size());
    for (int i = 0; i < size(); ++i) {
      y_[i] = history.value[static_cast<size_t>(used_[i])];
      noise_[i] = std::pow(history.sigma[static_cast<size_t>(used_[i])], 2);
    }
  }

  int size() const { return static_cast<int>(used_.size()); }

  HistoryFit Run(double rate) {
    limit_ = std::log(rate);
    std::vector<HistoryFinding> found;
    for (size_t round = 0; round < kMostFindings; ++round) {
      // What hides behind each other (an outlier makes the scatter that a step must beat) is
      // significant only together.
      std::vector<HistoryFinding> next = found;
      bool grew = false;
      for (size_t ahead = 0; ahead < kLookAhead && !grew; ++ahead) {
        if (static_cast<int>(next.size()) >= std::max(1, size() / kFlightsPerFinding)) break;
        const std::optional<HistoryFinding> best = Best(next);
        if (!best) break;
        next.push_back(*best);
        std::vector<HistoryFinding> kept = next;
        Exchange(&kept);
        TakeBack(&kept);
        if (kept.size() <= found.size()) continue;
        // So many sets of that size there are to choose from.
        const auto more = static_cast<double>(kept.size() - found.size());
        if (LogPOf(kept, found) > more * limit_ - (more - 1.0) * std::log(2.0 * size())) continue;
        found = std::move(kept);
        grew = true;
      }
      if (!grew) break;
    }
    const Fitted last = Fit(found, std::nullopt);
    HistoryFit fit;
    fit.mean = size() > 0 ? last.beta[0] : 0.0;
    fit.variance = last.variance;
    for (size_t k = 0; k < found.size(); ++k) {
      std::vector<HistoryFinding> others = found;
      others.erase(others.begin() + static_cast<long>(k));
      fit.findings.push_back(Judge(others, found[k]));
    }
    return fit;
  }

 private:
  /// The likeliest addition; none where nothing can be added.
  std::optional<HistoryFinding> Best(const std::vector<HistoryFinding>& found) const {
    std::optional<HistoryFinding> best;
    double most = -std::numeric_limits<double>::infinity();
    for (const std::vector<HistoryFinding>& kind : Candidates(found, Fit(found, std::nullopt))) {
      for (const HistoryFinding& candidate : kind) {
        const double likelihood = LikelihoodWith(found, candidate);
        if (likelihood <= most) continue;
        best = candidate;
        most = likelihood;
      }
    }
    return best;
  }

  double LikelihoodWith(std::vector<HistoryFinding> found, const HistoryFinding& more) const {
    found.push_back(more);
    return Fit(found, std::nullopt).log_likelihood;
  }

  /// Puts another date, or another kind of change, in the place of a step or trend where that is
  /// likelier.
  void Exchange(std::vector<HistoryFinding>* found) const {
    for (size_t round = 0; round < kMostFindings; ++round) {
      bool changed = false;
      for (size_t k = 0; k < found->size(); ++k) {
        if ((*found)[k].kind == Kind::kOutlier) continue;
        std::vector<HistoryFinding> others = *found;
        others.erase(others.begin() + static_cast<long>(k));
        const std::optional<HistoryFinding> best = Best(others);
        if (!best || best->kind == Kind::kOutlier) continue;
        const HistoryFinding& present = (*found)[k];
        if (best->kind == present.kind && best->flight == present.flight) continue;
        if (LikelihoodWith(others, *best) <= LikelihoodWith(others, present)) continue;
        (*found)[k] = *best;
        changed = true;
      }
      if (!changed) return;
    }
  }

  /// How many of its kind there are to choose from.
  int Count(Kind kind) const {
    return kind == Kind::kOutlier ? size() : kind == Kind::kStep ? std::max(1, size() - 3) : 1;
  }

  Eigen::VectorXd ColumnOf(const HistoryFinding& finding) const {
    Eigen::VectorXd column(size());
    for (int i = 0; i < size(); ++i) column[i] = EffectOf(finding, history_, used_[i]);
    return column;
  }

  Fitted FitColumns(const Eigen::MatrixXd& X, std::optional<double> variance) const {
    Fitted fit;
    const Eigen::Index q = X.cols();
    Eigen::MatrixXd inverse;
    Eigen::VectorXd residual;
    double log_determinant = 0.0;
    const auto solve = [&](double v) {
      const Eigen::VectorXd w = (noise_.array() + v).inverse();
      const Eigen::LDLT<Eigen::MatrixXd> ldlt(X.transpose() * w.asDiagonal() * X);
      fit.beta = ldlt.solve(X.transpose() * w.cwiseProduct(y_));
      inverse = ldlt.solve(Eigen::MatrixXd::Identity(q, q));
      log_determinant = ldlt.vectorD().array().abs().log().sum();
      residual = y_ - X * fit.beta;
      return residual.cwiseAbs2().dot(w);
    };
    const auto freedom = static_cast<double>(size() - q);
    if (variance) {
      fit.variance = *variance;
    } else if (freedom > 0.0 && solve(0.0) > freedom) {
      double low = 0.0, high = residual.cwiseAbs2().sum() / freedom + noise_.maxCoeff();
      while (solve(high) > freedom) high *= 4.0;
      for (int step = 0; step < 60 && high - low > 1e-6 * high; ++step) {
        const double middle = low > 0.0 ? std::sqrt(low * high) : 0.01 * high;
        (solve(middle) > freedom ? low : high) = middle;
        if (low == 0.0 && high < 1e-12 * noise_.maxCoeff()) break;
      }
      fit.variance = high;
    }
    solve(fit.variance);
    fit.sigma = inverse.diagonal().cwiseMax(0.0).cwiseSqrt();
    const Eigen::ArrayXd all = noise_.array() + fit.variance;
    fit.residual_variance = residual.squaredNorm() / std::max(1.0, freedom);
    fit.log_likelihood = -0.5 * (all.log() + residual.array().square() / all).sum();
    fit.restricted = fit.log_likelihood - 0.5 * log_determinant;
    return fit;
  }

  Eigen::MatrixXd DesignOf(const std::vector<HistoryFinding>& findings) const {
    Eigen::MatrixXd X(size(), 1 + static_cast<Eigen::Index>(findings.size()));
    X.col(0).setOnes();
    for (size_t k = 0; k < findings.size(); ++k) {
      X.col(1 + static_cast<Eigen::Index>(k)) = ColumnOf(findings[k]);
    }
    return X;
  }

  Fitted Fit(const std::vector<HistoryFinding>& findings, std::optional<double> variance) const {
    return FitColumns(DesignOf(findings), variance);
  }

  /// By how many of its sigmas each outlier or step would be off if it were added at the present
  /// scatter: a regression of the residuals on what the column has beside those there are
  /// (Frisch, Waugh and Lovell). A column is one flight or all from one on: sums from the end.
  std::vector<double> SigmasOf(const std::vector<HistoryFinding>& candidates,
                               const std::vector<HistoryFinding>& found,
                               const Fitted& present) const {
    const Eigen::MatrixXd X = DesignOf(found);
    const Eigen::VectorXd w = (noise_.array() + present.variance).inverse();
    const Eigen::MatrixXd WX = w.asDiagonal() * X;
    const Eigen::VectorXd Wr = w.cwiseProduct(y_ - X * present.beta);
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(X.transpose() * WX);
    const Eigen::Index q = X.cols();
    Eigen::MatrixXd since = Eigen::MatrixXd::Zero(size() + 1, q + 2);  // sums of [WX, w, Wr]
    for (int i = size() - 1; i >= 0; --i) {
      since.row(i) << WX.row(i), w[i], Wr[i];
      since.row(i) += since.row(i + 1);
    }
    std::vector<double> sigmas;
    for (const HistoryFinding& candidate : candidates) {
      const auto i = std::lower_bound(used_.begin(), used_.end(), candidate.flight) - used_.begin();
      Eigen::RowVectorXd sum = since.row(i);
      if (candidate.kind == Kind::kOutlier) sum -= since.row(i + 1);
      const Eigen::VectorXd shared = sum.head(q).transpose();
      const double information = sum[q] - shared.dot(ldlt.solve(shared));
      sigmas.push_back(information > 1e-12 * sum[q] ? std::abs(sum[q + 1]) / std::sqrt(information)
                                                    : 0.0);
    }
    return sigmas;
  }

  /// What is worth a closer look, by kind: those that gain most at the present scatter.
  std::vector<std::vector<HistoryFinding>> Candidates(const std::vector<HistoryFinding>& found,
                                                      const Fitted& present) const {
    std::vector<std::vector<HistoryFinding>> kinds(3);
    if (size() - static_cast<int>(found.size()) < 4) return kinds;
    const auto known = [&](Kind kind, int flight) {
      return std::any_of(found.begin(), found.end(), [&](const HistoryFinding& f) {
        return f.kind == kind && (kind == Kind::kTrend || f.flight == flight);
      });
    };
    for (int i = 0; i < size(); ++i) {
      if (!known(Kind::kOutlier, used_[i])) kinds[0].push_back({Kind::kOutlier, used_[i]});
      const bool splits = i >= 2 && i <= size() - 2;
      if (splits && !known(Kind::kStep, used_[i])) kinds[1].push_back({Kind::kStep, used_[i]});
    }
    if (!known(Kind::kTrend, 0) && size() >= 5) kinds[2].push_back({Kind::kTrend, 0});
    for (std::vector<HistoryFinding>& kind : kinds) {
      if (static_cast<int>(kind.size()) <= kRefitted) continue;
      const std::vector<double> sigmas = SigmasOf(kind, found, present);
      std::vector<std::pair<double, size_t>> gains;
      for (size_t k = 0; k < kind.size(); ++k) gains.emplace_back(-sigmas[k], k);
      std::sort(gains.begin(), gains.end());
      std::vector<HistoryFinding> best;
      for (int k = 0; k < kRefitted; ++k)
        best.push_back(kind[gains[static_cast<size_t>(k)].second]);
      kind = std::move(best);
    }
    return kinds;
  }

  /// The finding with size and p-value beside others.
  HistoryFinding Judge(const std::vector<HistoryFinding>& others, HistoryFinding finding) const {
    std::vector<HistoryFinding> with = others;
    with.push_back(finding);
    const Fitted fit = Fit(with, std::nullopt);
    const Eigen::Index last = fit.beta.size() - 1;
    finding.size = fit.beta[last];
    finding.sigma = fit.sigma[last];
    const double tail = TailOf(with);
    finding.log_p =
        std::min(0.0, std::log(std::max(tail, 1e-300)) + std::log(kKinds * Count(finding.kind)));
    return finding;
  }

  /// How often chance makes the last of these as large: two-sided, averaged over what the flights
  /// leave open about the scatter (its restricted likelihood, times Jeffreys' prior 1 / (noise +
  /// v)). Where scatter is all there is, this is the t test.
  double TailOf(const std::vector<HistoryFinding>& findings) const {
    constexpr int kPoints = 60;
    constexpr double kFrom = 1e-3,
                     kTo = 1e6;  // in units of the noise's and the residual's variance
    const Eigen::MatrixXd X = DesignOf(findings);
    const double noise = static_cast<double>(size()) / noise_.cwiseInverse().sum();
    const double spread = std::max(noise, FitColumns(X, 0.0).residual_variance);
    const double low = kFrom * std::min(noise, spread),
                 ratio = std::log(kTo * spread / low) / kPoints;
    std::vector<double> log_weight, tail;
    for (int i = -1; i <= kPoints; ++i) {
      const double v = i < 0 ? 0.0 : low * std::exp(ratio * i);
      const Fitted fit = FitColumns(X, v);
      // Width of a cell on the axis of log v; of all below the first one.
      const double width = i < 0 ? low : v * ratio;
      const Eigen::Index last = fit.beta.size() - 1;
      const double z = std::abs(fit.beta[last]) / fit.sigma[last];
      log_weight.push_back(fit.restricted + std::log(width / (noise + v)));
      tail.push_back(std::isfinite(z) ? std::erfc(z / std::sqrt(2.0)) : 1.0);
    }
    const double most = *std::max_element(log_weight.begin(), log_weight.end());
    double all = 0.0, beyond = 0.0;
    for (size_t i = 0; i < tail.size(); ++i) {
      const double weight = std::exp(log_weight[i] - most);
      all += weight;
      beyond += weight * tail[i];
    }
    return beyond / all;
  }

  /// Of all that `found` holds beyond `before` together.
  double LogPOf(const std::vector<HistoryFinding>& found,
                const std::vector<HistoryFinding>& before) const {
    double sum = 0.0;
    for (size_t k = 0; k < found.size(); ++k) {
      const bool is_new = std::none_of(before.begin(), before.end(), [&](const auto& b) {
        return b.kind == found[k].kind && b.flight == found[k].flight;
      });
      if (!is_new) continue;
      std::vector<HistoryFinding> others = found;
      others.erase(others.begin() + static_cast<long>(k));
      sum += Judge(others, found[k]).log_p;
    }
    return sum;
  }

  /// Drops what is not significant beside the rest, the least significant first.
  void TakeBack(std::vector<HistoryFinding>* found) const {
    while (!found->empty()) {
      size_t weakest = 0;
      double most = -std::numeric_limits<double>::infinity();
      for (size_t k = 0; k < found->size(); ++k) {
        std::vector<HistoryFinding> others = *found;
        others.erase(others.begin() + static_cast<long>(k));
        const double log_p = Judge(others, (*found)[k]).log_p;
        if (log_p <= most) continue;
        most = log_p;
        weakest = k;
      }
      if (most <= limit_) return;
      found->erase(found->begin() + static_cast<long>(weakest));
    }
  }

  const ScalarHistory& history_;
  std::vector<int> used_;
  Eigen::VectorXd y_, noise_;
  double limit_ = 0.0;  // of a finding's log_p
};

}  // namespace

double EffectOf(const HistoryFinding& finding, const ScalarHistory& history, int flight) {
  switch (finding.kind) {
    case Kind::kOutlier:
      return flight == finding.flight ? 1.0 : 0.0;
    case Kind::kStep:
      return flight >= finding.flight ? 1.0 : 0.0;
    default: {
      const auto [first, last] = std::minmax_element(history.time.begin(), history.time.end());
      const double range = *last - *first;
      return range > 0.0 ? (history.time[static_cast<size_t>(flight)] - *first) / range : 0.0;
    }
  }
}

HistoryFit ExamineHistory(const ScalarHistory& history, double rate) {
  Examination examination(history);
  if (examination.size() == 0) return {};
  return examination.Run(rate);
}

}  // namespace odmc

#include "odmc/attribution/spectrum.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

namespace odmc {
namespace {

constexpr int kIterations = 300;
constexpr double kPi = 3.14159265358979323846;
// Corner frequencies of structure, in Hz.
constexpr double kCorners_Hz[] = {0.05, 0.15, 0.5, 1.5};

struct Bin {
  double frequency_Hz, power;
};

std::vector<Bin> Periodogram(const std::vector<std::vector<double>>& runs, double rate_Hz,
                             double highest_Hz) {
  std::vector<Bin> bins;
  for (const std::vector<double>& run : runs) {
    const int n = static_cast<int>(run.size());
    if (n < kShortestRun) continue;
    for (int k = 1; 2 * k < n; ++k) {
      const double f = k * rate_Hz / n;
      if (f > highest_Hz) break;
      double re = 0.0, im = 0.0;
      const double step = 2.0 * kPi * k / n;
      for (int i = 0; i < n; ++i) {
        re += run[i] * std::cos(step * i);
        im += run[i] * std::sin(step * i);
      }
      bins.push_back({f, (re * re + im * im) / n});
    }
  }
  return bins;
}

/// Whittle's likelihood of a sum of given spectra, at its best weights.
struct Fit {
  std::vector<double> weights;
  double log_likelihood = 0.0;
};

/// @param most of the weights, of the first shapes
Fit FitSpectrum(const std::vector<Bin>& bins, const std::vector<std::vector<double>>& shapes,
                const std::vector<double>& most) {
  const size_t count = shapes.size();
  double mean = 0.0;
  for (const Bin& bin : bins) mean += bin.power / static_cast<double>(bins.size());
  Fit fit;
  for (size_t j = 0; j < count; ++j) {
    double size = 0.0;
    for (const double s : shapes[j]) size += s / static_cast<double>(bins.size());
    fit.weights.push_back(mean / (size * static_cast<double>(count)));
  }
  std::vector<double> total(bins.size());
  const auto evaluate = [&] {
    for (size_t i = 0; i < bins.size(); ++i) {
      total[i] = 1e-300;
      for (size_t j = 0; j < count; ++j) total[i] += fit.weights[j] * shapes[j][i];
    }
  };
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    evaluate();
    for (size_t j = 0; j < count; ++j) {
      double up = 0.0, down = 1e-300;
      for (size_t i = 0; i < bins.size(); ++i) {
        up += shapes[j][i] * bins[i].power / (total[i] * total[i]);
        down += shapes[j][i] / total[i];
      }
      fit.weights[j] *= std::sqrt(up / down);  // never increases the divergence
      if (j < most.size()) fit.weights[j] = std::min(fit.weights[j], most[j]);
    }
  }
  evaluate();
  for (size_t i = 0; i < bins.size(); ++i) {
    fit.log_likelihood -= std::log(total[i]) + bins[i].power / total[i];
  }
  return fit;
}

/// Spectra of what is no structure, and how much of each there may be.
struct NoiseShapes {
  std::vector<std::vector<double>> shapes;
  std::vector<double> most;

  /// Where the weights of a fit say how much of it there is in bin `i`.
  double Level(const Fit& fit, size_t i) const {
    double level = 0.0;
    for (size_t j = 0; j < shapes.size(); ++j) level += fit.weights[j] * shapes[j][i];
    return level;
  }
};

std::vector<std::vector<double>> StructureShapes(const std::vector<Bin>& bins) {
  std::vector<std::vector<double>> shapes;
  for (const double corner : kCorners_Hz) {
    shapes.emplace_back();
    for (const Bin& bin : bins) {
      const double x = bin.frequency_Hz / corner;
      shapes.back().push_back(1.0 / (1.0 + x * x));
    }
  }
  return shapes;
}

/// Of noise and structure together: a periodogram itself is as scattered as what it is to explain.
std::vector<double> SmoothSpectrum(const std::vector<Bin>& bins,
                                   std::vector<std::vector<double>> shapes) {
  for (std::vector<double>& red : StructureShapes(bins)) shapes.push_back(std::move(red));
  const Fit fit = FitSpectrum(bins, shapes, {});
  std::vector<double> smooth(bins.size(), 0.0);
  for (size_t j = 0; j < shapes.size(); ++j) {
    for (size_t i = 0; i < bins.size(); ++i) smooth[i] += fit.weights[j] * shapes[j][i];
  }
  return smooth;
}

/// @param by_sampling of the same frequencies, or none
NoiseShapes NoiseShapesOf(const std::vector<Bin>& bins, const std::vector<Bin>& by_sampling) {
  constexpr double kAny = std::numeric_limits<double>::infinity();
  NoiseShapes noise;
  noise.shapes.emplace_back(bins.size(), 1.0);
  noise.shapes.emplace_back();
  for (const Bin& bin : bins) {
    noise.shapes.back().push_back(bin.frequency_Hz * bin.frequency_Hz);
  }
  const bool changes = std::any_of(by_sampling.begin(), by_sampling.end(),
                                   [](const Bin& bin) { return bin.power > 0.0; });
  if (!changes || by_sampling.size() != bins.size()) return noise;
  noise.shapes.push_back(SmoothSpectrum(by_sampling, noise.shapes));
  noise.most = {kAny, kAny, kMostOfSampling};
  return noise;
}

/// Chance of a low-pass part that gains as much, or of a line that stands out as much, in noise.
/// @param gain [nats]
/// @param highest power of a bin over the noise's
double ChanceOf(double gain, double highest, size_t bins) {
  // Two degrees of freedom for a low-pass part; a line among this many bins.
  const double p_low = std::exp(-gain);
  const double p_line =
      -std::expm1(static_cast<double>(bins) * std::log1p(-std::exp(-std::min(700.0, highest))));
  return std::min(1.0, 2.0 * std::min(p_low, p_line));
}

}  // namespace

WhitenessResult TestWhiteness(const std::vector<std::vector<double>>& runs, double rate_Hz,
                              double highest_Hz,
                              const std::vector<std::vector<double>>& by_sampling) {
  WhitenessResult result;
  const std::vector<Bin> bins = Periodogram(runs, rate_Hz, highest_Hz);
  if (bins.size() < 20) return result;
  const NoiseShapes noise = NoiseShapesOf(bins, Periodogram(by_sampling, rate_Hz, highest_Hz));
  const size_t noise_end = noise.shapes.size();
  const Fit null = FitSpectrum(bins, noise.shapes, noise.most);
  std::vector<std::vector<double>> shapes = noise.shapes;
  for (std::vector<double>& red : StructureShapes(bins)) shapes.push_back(std::move(red));
  const size_t slow_end =
      noise_end + static_cast<size_t>(
                      std::count_if(std::begin(kCorners_Hz), std::end(kCorners_Hz),
                                    [](double corner_Hz) { return corner_Hz <= kSlowCorner_Hz; }));
  const std::vector<std::vector<double>> slow_shapes(
      shapes.begin(), shapes.begin() + static_cast<std::ptrdiff_t>(slow_end));
  const Fit slow_null = FitSpectrum(bins, slow_shapes, noise.most);
  const Fit full = FitSpectrum(bins, shapes, noise.most);
  const double gain = std::max(0.0, full.log_likelihood - null.log_likelihood);
  double structured = 0.0, slow = 0.0, all = 0.0, highest = 0.0, peak = 0.0, quick_highest = 0.0;
  double sampling = 0.0;
  // A line stands out of all bins by more than chance allows once in ten thousand.
  const double line = std::log(1e4 * static_cast<double>(bins.size()));
  for (size_t i = 0; i < bins.size(); ++i) {
    double red = 0.0, slow_level = 1e-300;
    for (size_t j = noise_end; j < shapes.size(); ++j) red += full.weights[j] * shapes[j][i];
    for (size_t j = 0; j < slow_end; ++j) slow_level += slow_null.weights[j] * shapes[j][i];
    for (size_t j = noise_end; j < slow_end; ++j) slow += slow_null.weights[j] * shapes[j][i];
    for (size_t j = 2; j < noise_end; ++j) sampling += null.weights[j] * shapes[j][i];
    quick_highest = std::max(quick_highest, bins[i].power / slow_level);
    const double rest = noise.Level(full, i);
    const double excess = bins[i].power - (red + rest);
    if (bins[i].power > line * (red + rest)) {
      const double ratio = bins[i].power / (red + rest);
      result.nats += ratio - 1.0 - std::log(ratio);
      red += excess;
    }
    structured += red;
    all += red + rest;
    const double level = noise.Level(null, i) + 1e-300;
    if (bins[i].power / level > highest) {
      highest = bins[i].power / level;
      peak = bins[i].frequency_Hz;
    }
  }
  const double quick_gain = std::max(0.0, full.log_likelihood - slow_null.log_likelihood);
  result.p = ChanceOf(gain, highest, bins.size());
  result.quick_p = ChanceOf(quick_gain, quick_highest, bins.size());
  result.nats += gain;
  result.structured_share = structured / all;
  result.slow_share = slow / all;
  result.sampling_share = std::min(1.0, sampling / all);
  result.peak_Hz = peak;
  return result;
}

std::vector<double> Autocorrelation(const std::vector<std::vector<double>>& runs, int count) {
  std::vector<double> sum(count, 0.0);
  for (const std::vector<double>& run : runs) {
    for (size_t i = 0; i < run.size(); ++i) {
      for (int lag = 0; lag < count && i + lag < run.size(); ++lag) {
        sum[lag] += run[i] * run[i + lag];
      }
    }
  }
  const double power = sum.empty() || sum[0] <= 0.0 ? 1.0 : sum[0];
  for (double& s : sum) s /= power;
  return sum;
}

}  // namespace odmc

#pragma once

#include <vector>

namespace odmc {

/// Samples without a gap that a stretch must have to be looked at.
constexpr int kShortestRun = 50;

/// Structure with corner frequencies up to this is slow: it changes over a second and longer.
constexpr double kSlowCorner_Hz = 0.15;

/// What samples far apart leave out of a signal, over what changes where every second one is left
/// out. Where the signal is smooth, errors of lines between samples grow with the square of the
/// step, and this is (1/3)². Where samples have nothing to do with each other (variance v), lines
/// between them err by v + 2/3 v, and differ from those between every second one by v/2.
constexpr double kMostOfSampling = 10.0 / 3.0;

/// What the spectrum of a residual says: how much of it is structured, and how surely.
struct WhitenessResult {
  double p = 1.0;                 ///< chance of this much structure in unstructured noise
  double structured_share = 0.0;  ///< of the variance, 0 to 1
  double nats = 0.0;              ///< log-likelihood that structure explains beyond noise
  double peak_Hz = 0.0;           ///< where the structure is strongest
  double slow_share = 0.0;        ///< of the variance: structure with corners up to kSlowCorner_Hz
  double quick_p = 1.0;           ///< as p, of structure beyond noise and that
  double sampling_share = 0.0;    ///< of the variance, at most: what slow streams leave out
};

/// Tests a residual against unstructured noise. Noise of a differentiated measurement has the
/// spectrum a + b f² (a: white force or torque, b: white noise of the velocity or rate); structure
/// is what a low-pass spectrum c/(1 + (f/f_c)²) or a line explains on top, by Whittle's likelihood.
/// What a stream leaves out between its samples is no structure, either: it has the spectrum of
/// what changes where every second sample is left out, up to kMostOfSampling times as large.
/// @param runs equally spaced stretches of the residual; short ones (kShortestRun) are left out
/// @param rate_Hz samples a second
/// @param highest_Hz frequencies above it are not looked at (the filter's edge)
/// @param by_sampling that change, at the samples of `runs`; none where streams are fast
WhitenessResult TestWhiteness(const std::vector<std::vector<double>>& runs, double rate_Hz,
                              double highest_Hz,
                              const std::vector<std::vector<double>>& by_sampling = {});

/// Autocorrelation of a residual at lags 0, 1, ... count-1 samples, within the runs.
std::vector<double> Autocorrelation(const std::vector<std::vector<double>>& runs, int count);

}  // namespace odmc

#pragma once

#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {

/// An error that most recordings do not have, after it was measured.
struct RareError {
  double probability = 0.0;
  double mean = 0.0, sigma = 0.0;  ///< if there is one

  /// Root mean square of the error, there or not.
  double rms() const;
};

/// Bayes' rule for an error that is zero, or else Gaussian with mean zero.
/// @param value, sigma what was measured of it, Gaussian
/// @param prior probability that there is one
/// @param size standard deviation of those that there are
RareError RareErrorPosterior(double value, double sigma, double prior, double size);

/// Between samples farther apart than this a vehicle's attitude (time constant 50 ms) does more
/// than the line between them shows: that errs by (step / time constant)^2 / 8, 2 %, of a change.
constexpr double kSparse_s = 0.0205;
/// The same of rotors (time constant 20 ms).
constexpr double kSparseRotors_s = 0.008;

/// What may be wrong with a stream, but not so surely that it was mended: the estimate says by how
/// much it would be another one.
struct StreamDoubt {
  std::string stream;     ///< "rotor_speeds", "odometry", "body_rates", "velocity", "gyro"
  double late_s = 0.0;    ///< its stamps may be late by this
  double factor = 1.0;    ///< its readings may be too large by this
  int rotor = -1;         ///< only this rotor's readings, from 0; -1: the whole stream
  double sparse_s = 0.0;  ///< its samples are this far apart, and what lies between is not known
};

/// What is wrong if it is: "rotor_speeds: 15 ms late", "speed of rotor 2: 4 % too large".
std::string Sentence(const StreamDoubt& doubt);

/// Turns the log into the one that would have been recorded without the error. What lies between
/// samples cannot be had back: there every second sample is left out. The error of lines between
/// samples grows with their distance, or its square, so that twice the distance adds as much again,
/// or more.
void UndoDoubt(const StreamDoubt& doubt, FlightLog* log);

/// Leaves out every second sample of "rotor_speeds" or "odometry" ("" or another: nothing).
void LeaveOutEverySecond(const std::string& stream, FlightLog* log);

}  // namespace odmc

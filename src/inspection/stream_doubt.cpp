#include "odmc/inspection/stream_doubt.h"

#include <cmath>
#include <vector>

#include "odmc/inspection/stream_inspection.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

template <typename Sample>
void KeepEverySecond(std::vector<Sample>* samples) {
  size_t kept = 0;
  for (size_t i = 0; i < samples->size(); i += 2) (*samples)[kept++] = (*samples)[i];
  samples->erase(samples->begin() + static_cast<std::ptrdiff_t>(kept), samples->end());
}

}  // namespace

double RareError::rms() const { return std::sqrt(probability) * std::hypot(mean, sigma); }

RareError RareErrorPosterior(double value, double sigma, double prior, double size) {
  const double all = sigma * sigma + size * size;  // variance of the measurement if there is one
  const double share = size * size / all;
  // Logarithm of the likelihoods' ratio; beyond 500 the answer is known.
  const double nats =
      std::log(sigma / std::sqrt(all)) + 0.5 * value * value * (1.0 / (sigma * sigma) - 1.0 / all);
  const double odds = prior / (1.0 - prior) * std::exp(std::fmin(nats, 500.0));
  return {odds / (1.0 + odds), share * value, std::sqrt(share) * sigma};
}

std::string Sentence(const StreamDoubt& doubt) {
  std::string text =
      doubt.rotor < 0 ? doubt.stream : "speed of rotor " + std::to_string(doubt.rotor + 1);
  if (doubt.late_s != 0.0) {
    text += ": " + Rounded(1e3 * std::abs(doubt.late_s)) + " ms " +
            (doubt.late_s > 0.0 ? "late" : "early");
  }
  if (doubt.sparse_s > 0.0) {
    text += ": one sample in " + Rounded(1e3 * doubt.sparse_s) + " ms, nothing known between";
  }
  if (doubt.factor != 1.0) {
    text += ": " + Rounded(1e2 * std::abs(doubt.factor - 1.0)) + " % too " +
            (doubt.factor > 1.0 ? "large" : "small");
  }
  return text;
}

void LeaveOutEverySecond(const std::string& stream, FlightLog* log) {
  if (stream == "rotor_speeds") KeepEverySecond(&log->rotors);
  if (stream == "odometry") KeepEverySecond(&log->odometry);
}

void UndoDoubt(const StreamDoubt& doubt, FlightLog* log) {
  if (doubt.sparse_s > 0.0) LeaveOutEverySecond(doubt.stream, log);
  if (doubt.late_s != 0.0) ShiftStream(doubt.stream, doubt.late_s, log);
  if (doubt.factor == 1.0) return;
  if (doubt.stream == "rotor_speeds") {
    for (RotorSample& sample : log->rotors) {
      if (doubt.rotor < 0) sample.speed /= doubt.factor;
      if (doubt.rotor >= 0) sample.speed[doubt.rotor] /= doubt.factor;
    }
  }
  if (doubt.stream == "velocity") {
    for (OdometrySample& sample : log->odometry) {
      if (sample.v_WS) *sample.v_WS /= doubt.factor;
    }
  }
}

}  // namespace odmc

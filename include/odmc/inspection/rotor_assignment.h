#pragma once

#include <string>
#include <vector>

#include "odmc/inspection/rotor_regression.h"
#include "odmc/text/finding.h"

namespace odmc {

/// How the places or the spins of the vehicle file compare with the ones that fit best.
struct AssignmentTest {
  double nats = 0.0;        ///< log evidence of the best minus the file's, >= 0
  double lead = 0.0;        ///< log evidence of the best minus that of the next best, >= 0
  double best_share = 0.0;  ///< posterior probability of the best, 0 to 1
  double file_share = 1.0;  ///< posterior probability of the file's, all alike before the flight
  /// Evidence of the file's over the mean of the other orders', over the sum of other spins'.
  double file_odds = 1.0;

  /// The file's is wrong beyond doubt: odds like these meet a right one in one of ten thousand
  /// flights at most.
  bool Refutes() const;
  /// The file's may well be wrong: they meet a right one in one of a thousand flights at most.
  bool Doubts() const;
  /// The best is sure enough to be named: it is right in 99 of a hundred such cases.
  bool Names() const;
};

/// Which place and which spin each column of the rotor speeds has.
struct RotorAssignment {
  bool tested = false;       ///< false: too little flight to say anything
  std::vector<int> order;    ///< per column: the file's rotor (from 0) at whose place it turns
  std::vector<double> spin;  ///< per column: as Rotor::spin
  AssignmentTest places, spins;
  double log_evidence = 0.0;  ///< of the best order, for comparing frames on one response
  double misfit = 1.0;        ///< what nats of orders are divided by, >= 1
  /// Of every pattern of spins (index: bit j set where column j has spin +1), log evidence over
  /// that of the best, <= 0; 2^n.
  std::vector<double> spin_nats;
};

/// Tests every assignment of columns to places and spins (for more than four rotors the likely
/// ones: linear assignment, then swaps) by how well it explains the response.
///
/// Evidence of an assignment: the response's coefficients are the file's levers times a common gain
/// (inertia and thrust may be off by a factor), with a scatter of every rotor, a centre of gravity
/// beside the file's and an error of the regression (feedback, coupling of axes); for yaw, those
/// of reaction torque and rotor inertia, with leaning rotors. These errors bound the evidence, so
/// that a long flight does not make nats out of a slightly wrong model. Where nothing fits, all
/// nats are lowered until the best one does. The lag between the streams is unknown: each
/// assignment has the evidence of all lags that the flight leaves possible, since in a gentle
/// flight another order may fit at another lag as well. Coaxial rotors have the same levers: orders
/// that differ by which of them is the upper one count once.
RotorAssignment TestRotorAssignment(const RotorResponse& response, const Vehicle& vehicle);

/// Spins in words, in the order given: "cw, ccw".
std::string SpinText(const std::vector<double>& spins);

/// What the vehicle file has wrong, if it is refuted or doubtful: checks "rotor_order" and
/// "rotor_spin".
std::vector<Finding> AssignmentFindings(const RotorAssignment& assignment, const Vehicle& vehicle);

}  // namespace odmc

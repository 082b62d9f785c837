#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/inspection/force_balance.h"
#include "odmc/inspection/rotor_assignment.h"
#include "odmc/inspection/stream_inspection.h"
#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Which of several ways a flight says, by Bayes' rule.
struct FittedChoice {
  bool is_told = false;      ///< the flight tells: right in 99 of a hundred such cases
  double probability = 0.0;  ///< of the one taken
  double lead_nats = 0.0;    ///< log odds of the one taken to the next likely one
};

/// A moment of inertia as the motion shows it, for the nominal arm (it grows with it).
struct ShownInertia {
  double value_kg_m2 = 0.0;
  double relative_sigma = 0.0;
};

/// A frame, and how much better or worse its places fit than the nominal vehicle's.
struct FrameFit {
  std::string frame;
  double nats = 0.0;  ///< log evidence over that of the nominal places
};

/// What a recording says about a vehicle of which little is known.
struct VehicleFit {
  StreamInspection streams;             ///< and what was mended before the rest was looked at
  std::optional<ForceBalance> balance;  ///< empty: too little flight
  bool leans = false;  ///< the pose's frame leans against the thrust axis (`balance` says how far)
  bool rotors_tested = false;  ///< false: nothing is known of the rotors, and the rest is empty
  double flight_s = 0.0;       ///< that the rotors were tested on
  std::vector<int> order;  ///< per column of rotor speeds: the nominal rotor at whose place it is
  FittedChoice order_choice;
  double nominal_order_probability = 0.0;  ///< of readings in the order of the nominal rotors
  std::vector<double> spin;                ///< per column: as Rotor::spin
  FittedChoice spin_choice;
  bool spins_are_usual = true;  ///< those of the nominal places, or their mirror image
  std::optional<ShownInertia> inertia_x, inertia_y;  ///< for the nominal arms
  std::vector<FrameFit> other_frames;                ///< of as many rotors
};

/// Fits rotor order, spins, k_f over mass, lean of the pose's frame and inertia to a recording.
/// Streams are evened out, compared with each other and mended first, as before a calibration.
///
///  - order: TestRotorAssignment(), all orders alike before the flight;
///  - spins: the same, the nominal ones and their mirror image (propellers "out") alike before the
///    flight, any other pattern with 1 % for all of them; coaxial pairs may be either way round.
///    Where that tells nothing, the likeliest with 80 % for the nominal ones;
///  - k_f over mass: BalanceForces();
///  - inertia about x and y: I = k_f sum l² / sum l g, with l the lever of each column's thrust and
///  g
///    the angular acceleration per squared speed that RotorOffset() finds for it (its noise model
///    keeps the controller's answers out), where the rotors explain the turning well.
/// @param nominal vehicle with rotors at their nominal places, in the order of its motor numbers;
///   its spins are the usual ones; its inertia is right within a factor of some five
VehicleFit FitVehicle(FlightLog log, const Vehicle& nominal);

/// Names of the findings in `fit.streams` that speak of the nominal vehicle, not of the recording.
bool IsOfVehicle(const Finding& finding);

}  // namespace odmc

#pragma once

#include <array>

#include "odmc/factors/state.h"

namespace odmc {

/// What an incremental solve leaves as it is, and how much it does at once.
struct IncrementalOptions {
  /// A recent state, and any that a sweep passes, is linearized anew where an entry of its tangent
  /// has moved by more than this from the point where it was: position [m], rotation [rad],
  /// velocity [m/s], rate [rad/s].
  std::array<double, kStateTangentSize> relinearise_state = {0.05,  0.05,  0.05,  5e-4, 5e-4, 5e-4,
                                                             0.005, 0.005, 0.005, 1e-3, 1e-3, 1e-3};
  /// Parameters: of their present sigma; further where old linearizations hardly matter.
  double relinearise_parameters = 0.3;
  /// Those in logarithms, which other parameters' Jacobians are in proportion to: of their value.
  double relinearise_share = 0.015;
  /// Back-substitution stops at a state that changes by less than this share of the thresholds
  /// above (wildfire), and goes through the whole window when parameters have moved by this share
  /// of a sigma, or a bias by this share of 0.05 rad/s or m/s².
  double wildfire = 0.04;
  /// Error that old linearizations may bring to a sigma [relative]. Every sweep shows how much the
  /// distance between two points of linearization mattered; where half a tolerance may be reached
  /// before the next one is through, it goes four times as fast (three in short windows), where 0.8
  /// of one, in windows of up to 350 keyframes, as fast as the bounds of a solve allow.
  double sigma_tolerance = 0.05;
  /// Newest keyframes that are eliminated anew at once when their points move, >= 1.
  int recent_keyframes = 3;
  /// How often that is done in one update at most, >= 0.
  int recent_passes = 2;
  /// They are eliminated anew as well where a parameter has moved by more than this [sigmas].
  double relinearise_recent = 0.1;
  /// What is eliminated anew keeps its linearization where parameters have moved by less [sigmas].
  double same_point = 0.01;
  /// Older keyframes eliminated anew per update when parameters have moved, >= 2, or this share of
  /// all if that is more, so that a sweep takes no more than 1/share updates.
  int sweep_keyframes = 6;
  double sweep_share = 0.006;
  /// Older keyframes whose gradients are corrected together (ChainFront::Correct), >= 1; such
  /// segments per update in turn, >= 0, and where the others are expected to change a parameter by
  /// more than this [sigmas], as many as the time bound of a solve allows, the worst first.
  int segment_keyframes = 25;
  int corrected_segments = 1;
  double allowed_lag = 0.03;
  /// Older keyframes back-substituted per update, >= 1.
  int back_substituted_keyframes = 50;
  /// A step of a parameter beyond this share of its own prior's sigma asks for an alignment, or is
  /// damped where that does not fit into the update.
  double largest_step = 0.5;
  /// For parameters that vary (LetPastVary): what leaves joins the window's prior, linearized at
  /// the parameters' first estimates (odmc::MarginalizeOldest), and every update solves the whole
  /// window.
  bool keeps_prior = false;
  /// Keyframes for which there is room from the start, >= 0; more of them cost an update that moves
  /// all.
  int room_for_keyframes = 0;
};

}  // namespace odmc

#pragma once

namespace odmc {

/// One stream of random numbers per subject (see Gaussian), so that none depends on another.
enum RandomStream : int {
  kDisturbanceStream = 1,
  kFeedbackStream,
  kOdometryStream,
  kRotorStream,
  kImuStream,
  kProcessStream,
  kDriftStream,
  kTurbulenceStream,
};

}  // namespace odmc

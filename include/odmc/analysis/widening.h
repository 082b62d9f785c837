#pragma once

namespace odmc {

/// What three sigma of a normal variable become where `freedom` degrees of freedom show its
/// variance, over three: by Student's t. Fewer than two count as two.
double Widening(double freedom);

}  // namespace odmc

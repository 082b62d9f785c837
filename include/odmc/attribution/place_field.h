#pragma once

#include <Eigen/Core>
#include <vector>

namespace odmc {

/// Features of a Gaussian process over position with a squared-exponential kernel, in its
/// approximation by few centres (Rasmussen and Williams, Gaussian Processes for Machine Learning,
/// 2006, sec. 8.1), of unit prior variance.
/// @param places N×3 [m] @param centres rows of places with the centres
/// @param width_m of the kernel @returns N × centres
Eigen::MatrixXd FieldFeatures(const Eigen::MatrixXd& places, const Eigen::MatrixXd& centres,
                              double width_m);

/// Log-likelihood ratio [nats] of noise of variance 1 with coefficients of an unknown common size
/// to noise alone; the mean likelihood over `sizes` counts.
/// @param A Gram matrix of their columns @param b products of these with the residual
/// @param sizes standard deviations of a coefficient
double GainOfRandomCoefficients(const Eigen::MatrixXd& A, const Eigen::VectorXd& b,
                                const std::vector<double>& sizes);

}  // namespace odmc

#pragma once

#include <Eigen/Core>
#include <cmath>

namespace odmc {

/// A number with its derivatives by N variables.
template <int N>
struct Dual {
  double v = 0.0;
  Eigen::Matrix<double, N, 1> d = Eigen::Matrix<double, N, 1>::Zero();

  Dual() = default;
  Dual(double value) : v(value) {}  // NOLINT: numbers are constants
  Dual(double value, const Eigen::Matrix<double, N, 1>& slope) : v(value), d(slope) {}
  /// Variable `i`.
  static Dual Variable(double value, int i) {
    return Dual(value, Eigen::Matrix<double, N, 1>::Unit(i));
  }

  friend Dual operator-(const Dual& a) { return {-a.v, -a.d}; }
  friend Dual operator+(const Dual& a, const Dual& b) { return {a.v + b.v, a.d + b.d}; }
  friend Dual operator-(const Dual& a, const Dual& b) { return {a.v - b.v, a.d - b.d}; }
  friend Dual operator*(const Dual& a, const Dual& b) { return {a.v * b.v, a.v * b.d + b.v * a.d}; }
  friend Dual operator/(const Dual& a, const Dual& b) {
    const double q = a.v / b.v;
    return {q, (a.d - q * b.d) / b.v};
  }
  // A constant has no derivatives to carry.
  friend Dual operator+(const Dual& a, double b) { return {a.v + b, a.d}; }
  friend Dual operator+(double a, const Dual& b) { return {a + b.v, b.d}; }
  friend Dual operator-(const Dual& a, double b) { return {a.v - b, a.d}; }
  friend Dual operator-(double a, const Dual& b) { return {a - b.v, -b.d}; }
  friend Dual operator*(const Dual& a, double b) { return {a.v * b, a.d * b}; }
  friend Dual operator*(double a, const Dual& b) { return {a * b.v, a * b.d}; }
  friend Dual operator/(const Dual& a, double b) { return {a.v / b, a.d / b}; }
  friend Dual operator/(double a, const Dual& b) {
    const double q = a / b.v;
    return {q, -q / b.v * b.d};
  }
  friend bool operator<(const Dual& a, double b) { return a.v < b; }
  friend Dual sqrt(const Dual& a) {
    const double root = std::sqrt(a.v);
    return {root, a.d * (0.5 / root)};
  }
};

}  // namespace odmc

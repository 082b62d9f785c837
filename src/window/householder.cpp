#include "odmc/window/householder.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>

namespace odmc {
namespace {

// Debian's baseline knows vectors of two numbers only. The kernels are compiled once more for four
// with fused multiply-add and chosen at run time.
#if defined(__x86_64__) && defined(__GNUC__)
#define ODMC_WIDE_VECTORS __attribute__((target("avx2,fma")))
bool HasWideVectors() {
  static const bool has = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  return has;
}
#endif
#define ODMC_INLINE inline __attribute__((always_inline))

constexpr int kChunk = 8;
static_assert(kChunk <= kRowPadding, "a chunk may reach into the padding only");

/// Applies the reflection I - tau [1; v] [1; v]ᵀ to `top` and the rows of E from column `from` on.
/// @param v one number a row, `rows` of them
ODMC_INLINE void Reflect(const double* v, double tau, double* top, double* E, int e_stride,
                         int rows, int from, int columns) {
  for (int c = from; c < columns; c += kChunk) {
    double w[kChunk];
    for (int k = 0; k < kChunk; ++k) w[k] = top[c + k];
    for (int i = 0; i < rows; ++i) {
      const double* row = E + i * e_stride + c;
      for (int k = 0; k < kChunk; ++k) w[k] += v[i] * row[k];
    }
    for (int k = 0; k < kChunk; ++k) {
      w[k] *= tau;
      top[c + k] -= w[k];
    }
    for (int i = 0; i < rows; ++i) {
      double* row = E + i * e_stride + c;
      for (int k = 0; k < kChunk; ++k) row[k] -= v[i] * w[k];
    }
  }
}

/// Makes the reflection that takes column `j` of (top; E) to its first entry, and applies it.
/// @returns false if the column is zero
ODMC_INLINE bool Eliminate(double* top, double* E, int e_stride, int rows, int j, int columns,
                           double* v) {
  int last = rows;
  while (last > 0 && E[(last - 1) * e_stride + j] == 0.0) --last;
  double below = 0.0;
  for (int i = 0; i < last; ++i) {
    v[i] = E[i * e_stride + j];
    below += v[i] * v[i];
  }
  const double alpha = top[j];
  const double norm = std::sqrt(alpha * alpha + below);
  for (int i = 0; i < last; ++i) E[i * e_stride + j] = 0.0;
  if (norm < kLeastPivot) {
    top[j] = 0.0;
    return false;
  }
  if (below == 0.0) return true;
  const double beta = alpha > 0.0 ? -norm : norm;
  const double scale = 1.0 / (alpha - beta);
  for (int i = 0; i < last; ++i) v[i] *= scale;
  top[j] = beta;
  Reflect(v, (beta - alpha) / beta, top, E, e_stride, last, j + 1, columns);
  return true;
}

constexpr int kMostRows = 256;

ODMC_INLINE void AbsorbInto(double* U, int u_stride, double* E, int e_stride, int rows, int pivots,
                            int columns) {
  double v[kMostRows];
  while (rows > 0) {
    const int some = std::min(rows, kMostRows);
    for (int j = 0; j < pivots; ++j) {
      Eliminate(U + j * u_stride, E, e_stride, some, j, columns, v);
    }
    rows -= some;
    E += some * e_stride;
  }
}

ODMC_INLINE int TriangulariseInto(double* E, int e_stride, int rows, int pivots, int columns,
                                  double* U, int u_stride) {
  assert(rows <= kMostRows);
  double v[kMostRows];
  int taken = 0;
  for (int j = 0; j < pivots; ++j) {
    double* row = U + j * u_stride;
    std::memset(row, 0, sizeof(double) * static_cast<size_t>(columns + kRowPadding));
    if (taken == rows) continue;
    double* top = E + taken * e_stride;
    if (!Eliminate(top, top + e_stride, e_stride, rows - taken - 1, j, columns, v)) continue;
    std::memcpy(row + j, top + j, sizeof(double) * static_cast<size_t>(columns - j));
    ++taken;
  }
  return taken;
}

#ifdef ODMC_WIDE_VECTORS
ODMC_WIDE_VECTORS void AbsorbWide(double* U, int u_stride, double* E, int e_stride, int rows,
                                  int pivots, int columns) {
  AbsorbInto(U, u_stride, E, e_stride, rows, pivots, columns);
}
ODMC_WIDE_VECTORS int TriangulariseWide(double* E, int e_stride, int rows, int pivots, int columns,
                                        double* U, int u_stride) {
  return TriangulariseInto(E, e_stride, rows, pivots, columns, U, u_stride);
}
#endif

}  // namespace

void AbsorbRows(double* U, int u_stride, double* E, int e_stride, int rows, int pivots,
                int columns) {
#ifdef ODMC_WIDE_VECTORS
  if (HasWideVectors()) return AbsorbWide(U, u_stride, E, e_stride, rows, pivots, columns);
#endif
  AbsorbInto(U, u_stride, E, e_stride, rows, pivots, columns);
}

int Triangularise(double* E, int e_stride, int rows, int pivots, int columns, double* U,
                  int u_stride) {
#ifdef ODMC_WIDE_VECTORS
  if (HasWideVectors()) {
    return TriangulariseWide(E, e_stride, rows, pivots, columns, U, u_stride);
  }
#endif
  return TriangulariseInto(E, e_stride, rows, pivots, columns, U, u_stride);
}

}  // namespace odmc

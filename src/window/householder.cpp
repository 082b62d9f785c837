#include "odmc/window/householder.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <cstring>

namespace odmc {
namespace {

// Debian's baseline knows vectors of two numbers only. The kernels are compiled once more for four
// and for eight, with fused multiply-add, and chosen at run time.
#if defined(__x86_64__) && defined(__GNUC__)
#define ODMC_WIDE_VECTORS
#define ODMC_VECTORS_OF_4 __attribute__((target("avx2,fma")))
#ifdef __clang__  // which takes the width from the types
#define ODMC_VECTORS_OF_8 __attribute__((target("avx512f,avx512vl,avx512dq,fma")))
#else
#define ODMC_VECTORS_OF_8 \
  __attribute__((target("avx512f,avx512vl,avx512dq,fma,prefer-vector-width=512")))
#endif
int VectorWidth() {
  static const int width = [] {
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512dq")) {
      return 8;
    }
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? 4 : 2;
  }();
  return width;
}
#endif
#define ODMC_INLINE inline __attribute__((always_inline))

constexpr int kChunk = 8;
static_assert(kChunk <= kRowPadding, "a chunk may reach into the padding only");
// As wide as the machine has it, or in pieces.
using Chunk = double __attribute__((vector_size(kChunk * sizeof(double))));
/// A chunk of a row. Rows begin anywhere: what reads it must not count on a chunk's own alignment.
struct __attribute__((may_alias)) RowChunk {
  Chunk numbers __attribute__((packed, aligned(sizeof(double))));
};
static_assert(alignof(RowChunk) == alignof(double) && sizeof(RowChunk) == sizeof(Chunk), "");

ODMC_INLINE RowChunk* At(double* p) { return reinterpret_cast<RowChunk*>(p); }
ODMC_INLINE const RowChunk* At(const double* p) { return reinterpret_cast<const RowChunk*>(p); }

/// A row of a matrix whose rows begin `stride` numbers apart.
template <typename Number>
ODMC_INLINE Number* RowOf(Number* matrix, int stride, int row) {
  return matrix + static_cast<std::ptrdiff_t>(stride) * row;
}

/// Applies the reflection I - tau [1; v] [1; v]ᵀ to N chunks of `top` and of the rows of E, side by
/// side: one sum would wait for itself.
template <int N>
ODMC_INLINE void ReflectChunks(const double* v, double tau, double* top, double* E, int e_stride,
                               int rows) {
  Chunk w[N];
  for (int k = 0; k < N; ++k) w[k] = At(top)[k].numbers;
  for (int i = 0; i < rows; ++i) {
    const RowChunk* row = At(RowOf(E, e_stride, i));
    for (int k = 0; k < N; ++k) w[k] += v[i] * row[k].numbers;
  }
  for (int k = 0; k < N; ++k) {
    w[k] *= tau;
    At(top)[k].numbers -= w[k];
  }
  for (int i = 0; i < rows; ++i) {
    RowChunk* row = At(RowOf(E, e_stride, i));
    for (int k = 0; k < N; ++k) row[k].numbers -= v[i] * w[k];
  }
}

/// Applies a reflection to `top` and the rows of E from column `from` on, up to `kMost` chunks at a
/// time: as many as there are registers for.
/// @param v one number a row, `rows` of them
template <int kMost>
ODMC_INLINE void Reflect(const double* v, double tau, double* top, double* E, int e_stride,
                         int rows, int from, int columns) {
  int c = from;
  for (; c + (kMost - 1) * kChunk < columns; c += kMost * kChunk) {
    ReflectChunks<kMost>(v, tau, top + c, E + c, e_stride, rows);
  }
  const int left = (columns - c + kChunk - 1) / kChunk;
  if constexpr (kMost > 4) {
    if (left == 7) return ReflectChunks<7>(v, tau, top + c, E + c, e_stride, rows);
    if (left == 6) return ReflectChunks<6>(v, tau, top + c, E + c, e_stride, rows);
    if (left == 5) return ReflectChunks<5>(v, tau, top + c, E + c, e_stride, rows);
    if (left == 4) return ReflectChunks<4>(v, tau, top + c, E + c, e_stride, rows);
  }
  if (left == 3) return ReflectChunks<3>(v, tau, top + c, E + c, e_stride, rows);
  if (left == 2) return ReflectChunks<2>(v, tau, top + c, E + c, e_stride, rows);
  if (left == 1) return ReflectChunks<1>(v, tau, top + c, E + c, e_stride, rows);
}

/// Makes the reflection that takes column `j` of (top; E) to its first entry, and applies it.
/// @returns false if the column is zero
template <int kMost>
ODMC_INLINE bool Eliminate(double* top, double* E, int e_stride, int rows, int j, int columns,
                           double* v) {
  int last = rows;
  while (last > 0 && E[(last - 1) * e_stride + j] == 0.0) --last;
  double even = 0.0, odd = 0.0;  // side by side: one sum would wait for itself
  int i = 0;
  for (; i + 1 < last; i += 2) {
    v[i] = E[i * e_stride + j];
    v[i + 1] = E[(i + 1) * e_stride + j];
    even += v[i] * v[i];
    odd += v[i + 1] * v[i + 1];
  }
  if (i < last) {
    v[i] = E[i * e_stride + j];
    even += v[i] * v[i];
  }
  const double below = even + odd;
  const double alpha = top[j];
  const double norm = std::sqrt(alpha * alpha + below);
  for (i = 0; i < last; ++i) E[i * e_stride + j] = 0.0;
  if (norm < kLeastPivot) {
    top[j] = 0.0;
    return false;
  }
  if (below == 0.0) return true;
  const double beta = alpha > 0.0 ? -norm : norm;
  const double scale = 1.0 / (alpha - beta);
  for (i = 0; i < last; ++i) v[i] *= scale;
  top[j] = beta;
  Reflect<kMost>(v, (beta - alpha) / beta, top, E, e_stride, last, j + 1, columns);
  return true;
}

constexpr int kMostRows = 256;

template <int kMost>
ODMC_INLINE void AbsorbInto(double* U, int u_stride, double* E, int e_stride, int rows, int pivots,
                            int columns) {
  double v[kMostRows];
  while (rows > 0) {
    const int some = std::min(rows, kMostRows);
    for (int j = 0; j < pivots; ++j) {
      Eliminate<kMost>(RowOf(U, u_stride, j), E, e_stride, some, j, columns, v);
    }
    rows -= some;
    E = RowOf(E, e_stride, some);
  }
}

template <int kMost>
ODMC_INLINE int TriangulariseInto(double* E, int e_stride, int rows, int pivots, int columns,
                                  double* U, int u_stride) {
  assert(rows <= kMostRows);
  double v[kMostRows];
  int taken = 0;
  for (int j = 0; j < pivots; ++j) {
    double* row = RowOf(U, u_stride, j);
    std::memset(row, 0, sizeof(double) * static_cast<size_t>(columns + kRowPadding));
    if (taken == rows) continue;
    double* top = RowOf(E, e_stride, taken);
    if (!Eliminate<kMost>(top, top + e_stride, e_stride, rows - taken - 1, j, columns, v)) continue;
    std::memcpy(row + j, top + j, sizeof(double) * static_cast<size_t>(columns - j));
    ++taken;
  }
  return taken;
}

/// 1 over each pivot, 0 where nobody measured it: divisions need not wait for the solution.
ODMC_INLINE void InvertPivots(const double* U, int u_stride, int pivots, double* inverse) {
  assert(pivots <= kMostRows);
  for (int i = 0; i < pivots; ++i) {
    const double pivot = U[i * u_stride + i];
    inverse[i] = std::abs(pivot) < kLeastPivot ? 0.0 : 1.0 / pivot;
  }
}

ODMC_INLINE double ForwardSubstituteIn(double* U, int u_stride, int pivots, int columns, int rhs,
                                       double* g, double most) {
  double inverse[kMostRows];
  InvertPivots(U, u_stride, pivots, inverse);
  double squares = 0.0;
  for (int i = 0; i < pivots; ++i) {
    double* row = RowOf(U, u_stride, i);
    if (g[i] == 0.0 || inverse[i] == 0.0) continue;
    const double y = std::clamp(g[i] * inverse[i], -most, most);
    squares += y * y;
    for (int j = i; j < columns; j += kChunk) {
      At(g + j)->numbers -= y * At(row + j)->numbers;
    }
    if (rhs >= 0) row[rhs] += y;
  }
  return std::sqrt(squares);
}

ODMC_INLINE double SumOf(const Chunk& c) {
  return ((c[0] + c[1]) + (c[2] + c[3])) + ((c[4] + c[5]) + (c[6] + c[7]));
}

ODMC_INLINE void BackSubstituteIn(const double* U, int u_stride, int pivots, int columns,
                                  double* x) {
  double inverse[kMostRows];
  InvertPivots(U, u_stride, pivots, inverse);
  // What is known beforehand, for all rows; no row waits for another.
  for (int i = 0; i < pivots; ++i) {
    const double* row = RowOf(U, u_stride, i);
    Chunk sums = {};
    for (int j = pivots; j < columns; j += kChunk) {
      sums += At(row + j)->numbers * At(x + j)->numbers;
    }
    x[i] = SumOf(sums);
  }
  // Each solution goes to the rows above, which wait for nothing else.
  for (int i = pivots - 1; i >= 0; --i) {
    const double solution = -x[i] * inverse[i];
    x[i] = solution;
    for (int k = 0; k < i; ++k) x[k] += U[k * u_stride + i] * solution;
  }
}

#ifdef ODMC_WIDE_VECTORS
ODMC_VECTORS_OF_4 double ForwardSubstitute4(double* U, int u_stride, int pivots, int columns,
                                            int rhs, double* g, double most) {
  return ForwardSubstituteIn(U, u_stride, pivots, columns, rhs, g, most);
}
ODMC_VECTORS_OF_8 double ForwardSubstitute8(double* U, int u_stride, int pivots, int columns,
                                            int rhs, double* g, double most) {
  return ForwardSubstituteIn(U, u_stride, pivots, columns, rhs, g, most);
}
ODMC_VECTORS_OF_4 void BackSubstitute4(const double* U, int u_stride, int pivots, int columns,
                                       double* x) {
  BackSubstituteIn(U, u_stride, pivots, columns, x);
}
ODMC_VECTORS_OF_8 void BackSubstitute8(const double* U, int u_stride, int pivots, int columns,
                                       double* x) {
  BackSubstituteIn(U, u_stride, pivots, columns, x);
}
ODMC_VECTORS_OF_4 void Absorb4(double* U, int u_stride, double* E, int e_stride, int rows,
                               int pivots, int columns) {
  AbsorbInto<4>(U, u_stride, E, e_stride, rows, pivots, columns);
}
ODMC_VECTORS_OF_8 void Absorb8(double* U, int u_stride, double* E, int e_stride, int rows,
                               int pivots, int columns) {
  AbsorbInto<8>(U, u_stride, E, e_stride, rows, pivots, columns);
}
ODMC_VECTORS_OF_4 int Triangularise4(double* E, int e_stride, int rows, int pivots, int columns,
                                     double* U, int u_stride) {
  return TriangulariseInto<4>(E, e_stride, rows, pivots, columns, U, u_stride);
}
ODMC_VECTORS_OF_8 int Triangularise8(double* E, int e_stride, int rows, int pivots, int columns,
                                     double* U, int u_stride) {
  return TriangulariseInto<8>(E, e_stride, rows, pivots, columns, U, u_stride);
}
#endif

}  // namespace

void AbsorbRows(double* U, int u_stride, double* E, int e_stride, int rows, int pivots,
                int columns) {
#ifdef ODMC_WIDE_VECTORS
  const int width = VectorWidth();
  if (width == 8) return Absorb8(U, u_stride, E, e_stride, rows, pivots, columns);
  if (width == 4) return Absorb4(U, u_stride, E, e_stride, rows, pivots, columns);
#endif
  AbsorbInto<4>(U, u_stride, E, e_stride, rows, pivots, columns);
}

int Triangularise(double* E, int e_stride, int rows, int pivots, int columns, double* U,
                  int u_stride) {
#ifdef ODMC_WIDE_VECTORS
  const int width = VectorWidth();
  if (width == 8) return Triangularise8(E, e_stride, rows, pivots, columns, U, u_stride);
  if (width == 4) return Triangularise4(E, e_stride, rows, pivots, columns, U, u_stride);
#endif
  return TriangulariseInto<4>(E, e_stride, rows, pivots, columns, U, u_stride);
}

double ForwardSubstitute(double* U, int u_stride, int pivots, int columns, int rhs, double* g,
                         double most) {
#ifdef ODMC_WIDE_VECTORS
  const int width = VectorWidth();
  if (width == 8) return ForwardSubstitute8(U, u_stride, pivots, columns, rhs, g, most);
  if (width == 4) return ForwardSubstitute4(U, u_stride, pivots, columns, rhs, g, most);
#endif
  return ForwardSubstituteIn(U, u_stride, pivots, columns, rhs, g, most);
}

void BackSubstitute(const double* U, int u_stride, int pivots, int columns, double* x) {
#ifdef ODMC_WIDE_VECTORS
  const int width = VectorWidth();
  if (width == 8) return BackSubstitute8(U, u_stride, pivots, columns, x);
  if (width == 4) return BackSubstitute4(U, u_stride, pivots, columns, x);
#endif
  BackSubstituteIn(U, u_stride, pivots, columns, x);
}

}  // namespace odmc

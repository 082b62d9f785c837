#pragma once

#include <limits>

namespace odmc {

/// Rows of a least-squares system |A x + b|², row-major, b the last column. Behind the last column
/// every row has at least kRowPadding numbers that are zero and stay so; the kernels run over them
/// instead of counting.
constexpr int kRowPadding = 8;

/// Pivots below this count as zero: a standard deviation of 1e8 in variables of order one is no
/// information. What elimination leaves of a column that nobody measured lies far below, what any
/// sensor says far above.
constexpr double kLeastPivot = 1e-8;

/// Row length for `columns` numbers: padded, and of no multiple of 512 byte, at which all rows of a
/// column would share one set of the cache.
constexpr int PaddedRow(int columns) {
  const int padded = (columns + kRowPadding + 7) / 8 * 8;
  return padded % 64 == 0 ? padded + 8 : padded;
}

/// Rotates the rows of E into the triangle U by Householder reflections, one pivot column after the
/// other: afterwards E's first `pivots` columns are zero and |U x|² + |E x|² is what it was. Each
/// reflection touches one row of U and those of E up to the last that is not zero in its column, so
/// rows sorted by where they begin are cheap. Pivots that nobody measured (kLeastPivot) stay zero.
/// @param U upper triangular in its first `pivots` columns (pivots × columns)
/// @param E any rows (rows × columns), same columns as U
/// @param u_stride, e_stride row lengths, >= columns + kRowPadding
void AbsorbRows(double* U, int u_stride, double* E, int e_stride, int rows, int pivots,
                int columns);

/// Brings the rows of E into echelon form over their first `pivots` columns, in place, and takes
/// those with a pivot to U, whose other rows become zero.
/// @param U becomes upper triangular (pivots × columns)
/// @pre rows <= 256
/// @returns how many of E's rows were taken; the rest, behind them, is zero in the pivots' columns
int Triangularise(double* E, int e_stride, int rows, int pivots, int columns, double* U,
                  int u_stride);

/// Solves Uᵀ y = g for the first `pivots` rows of a triangle: takes Uᵀ y off g and adds y to the
/// triangle's right-hand side, so that |U x + b|² gains the gradient g as far as it knows of it.
/// @param columns of g that are wanted; g has room for kRowPadding more
/// @pre pivots <= 256
/// @param rhs column of b, >= columns; -1: only g changes
/// @param most what lies beyond it in an entry of y is left out
/// @returns the norm of y
double ForwardSubstitute(double* U, int u_stride, int pivots, int columns, int rhs, double* g,
                         double most = std::numeric_limits<double>::infinity());

/// Solves U x = 0 for the first `pivots` entries of x, given the others. Those that nobody measured
/// (kLeastPivot) become zero.
/// @param x columns, and kRowPadding zeros behind them
/// @pre pivots <= 256
void BackSubstitute(const double* U, int u_stride, int pivots, int columns, double* x);

}  // namespace odmc

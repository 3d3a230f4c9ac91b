// Gaussian process implicit surface: kernels, and a Cholesky factor that grows by one row per contact.
// A factor L (lower triangular) is packed by rows: L[i][j] = factor[i (i + 1) / 2 + j], j <= i.
#pragma once

#include <cmath>
#include <cstddef>

namespace touchnet {

enum class Kernel : int { rbf = 0, matern32 = 1, matern52 = 2, thin_plate = 3 };

// k(x, y) as a function of the distance r of x and y. `scale` is the length scale, or the radius R of the thin plate
// 2 r^3 - 3 R r^2 + R^3, divided by R^3 so that k(x, x) = 1 as for the others.
inline double kernel_value(Kernel kernel, double scale, double r2) {
  const double r = std::sqrt(r2);
  switch (kernel) {
    case Kernel::rbf:
      return std::exp(-0.5 * r2 / (scale * scale));
    case Kernel::matern32: {
      const double t = std::sqrt(3.0) * r / scale;
      return (1 + t) * std::exp(-t);
    }
    case Kernel::matern52: {
      const double t = std::sqrt(5.0) * r / scale;
      return (1 + t + t * t / 3) * std::exp(-t);
    }
    default: {
      const double t = r / scale;
      return (2 * t - 3) * t * t + 1;
    }
  }
}

// The factor h(r) of the gradient: dk(x, y) / dx = h(r) (x - y).
inline double kernel_slope(Kernel kernel, double scale, double r2) {
  const double r = std::sqrt(r2), s2 = scale * scale;
  switch (kernel) {
    case Kernel::rbf:
      return -std::exp(-0.5 * r2 / s2) / s2;
    case Kernel::matern32:
      return -3 / s2 * std::exp(-std::sqrt(3.0) * r / scale);
    case Kernel::matern52: {
      const double t = std::sqrt(5.0) * r / scale;
      return -5 / (3 * s2) * (1 + t) * std::exp(-t);
    }
    default:
      return 6 * (r / scale - 1) / s2;
  }
}

// out (m, n) = k(x_a, y_b) for x (m, 3), y (n, 3).
void gp_kernel(Kernel kernel, double scale, const double* x, std::size_t m, const double* y, std::size_t n,
               double* out);

// row (n) = L^-T row, in place.
void gp_backward(const double* factor, std::size_t n, double* row);

// What is known of x before it is added: row (n) = L^-1 k(X, x); returns k(x, x) - |row|^2, the variance at x, and its
// gradient (3) by x, -2 row . L^-1 dk(X, x)/dx. The kernel and its three slopes are solved side by side in `work`
// (4 n), so the factor, which is what takes the time, is read once.
double gp_touch(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t n,
                const double* x, double* row, double* work, double* gradient);

// Points in batches of gp_lanes share one pass over the factor. solved (groups, capacity, gp_lanes) holds L^-1 k(X, x)
// of the points x (groups * gp_lanes, 3), rows start..n of it are computed here from rows 0..start, which the caller
// keeps; variance (groups * gp_lanes) is lowered by the squares of the new rows.
constexpr std::size_t gp_lanes = 8;
void gp_extend(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t start,
               std::size_t n, const double* x, std::size_t groups, std::size_t capacity, double* solved,
               double* variance);

// solved (groups, capacity, gp_lanes): rows 0..n are replaced by L^-T of themselves.
void gp_backward_batch(const double* factor, std::size_t n, std::size_t groups, std::size_t capacity, double* solved);

// The point of highest variance among groups * gp_lanes candidates, brought up to date lazily: a stale variance is an
// upper bound, since contacts only lower it, so groups are extended (as in gp_extend) in the order of their bounds
// until the highest value is current. known (groups) counts the rows each group has seen. Returns the candidate's
// index.
std::size_t gp_highest(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t n,
                       const double* x, std::size_t groups, std::size_t capacity, double* solved, double* variance,
                       std::size_t* known);

}  // namespace touchnet

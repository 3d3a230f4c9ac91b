#include "gp.h"

#include <algorithm>

// The loops are bound by reading the factor; wider vectors help where the compiler can choose them at load time. Sums
// are kept in a fixed number of partial sums, so every width gives the same bits.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define TOUCHNET_WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define TOUCHNET_WIDE
#endif

namespace touchnet {
namespace {

// Eight doubles that are added and multiplied side by side.
#if defined(__GNUC__) || defined(__clang__)
typedef double Lanes __attribute__((vector_size(8 * sizeof(double)), aligned(alignof(double)), may_alias));
#else
struct Lanes {
  double at[8];
  double& operator[](std::size_t k) { return at[k]; }
  Lanes& operator+=(const Lanes& b) {
    for (int k = 0; k < 8; ++k) at[k] += b.at[k];
    return *this;
  }
  Lanes& operator-=(const Lanes& b) {
    for (int k = 0; k < 8; ++k) at[k] -= b.at[k];
    return *this;
  }
};
inline Lanes operator*(const Lanes& a, const Lanes& b) {
  Lanes c;
  for (int k = 0; k < 8; ++k) c.at[k] = a.at[k] * b.at[k];
  return c;
}
inline Lanes operator*(double a, const Lanes& b) {
  Lanes c;
  for (int k = 0; k < 8; ++k) c.at[k] = a * b.at[k];
  return c;
}
inline Lanes operator-(const Lanes& a, const Lanes& b) {
  Lanes c = a;
  c -= b;
  return c;
}
#endif
static_assert(sizeof(Lanes) == gp_lanes * sizeof(double), "a group of points fills one Lanes");

inline double squared_distance(const double* a, const double* b) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

inline const double* row_of(const double* factor, std::size_t i) { return factor + i * (i + 1) / 2; }

}  // namespace

void gp_kernel(Kernel kernel, double scale, const double* x, std::size_t m, const double* y, std::size_t n,
               double* out) {
  for (std::size_t a = 0; a < m; ++a)
    for (std::size_t b = 0; b < n; ++b)
      out[a * n + b] = kernel_value(kernel, scale, squared_distance(x + 3 * a, y + 3 * b));
}

TOUCHNET_WIDE
double gp_forward(const double* factor, std::size_t n, double* row) {
  double squares = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double* line = row_of(factor, i);
    Lanes even = {}, odd = {};
    std::size_t j = 0;
    for (; j + 16 <= i; j += 16) {
      even += *reinterpret_cast<const Lanes*>(line + j) * *reinterpret_cast<const Lanes*>(row + j);
      odd += *reinterpret_cast<const Lanes*>(line + j + 8) * *reinterpret_cast<const Lanes*>(row + j + 8);
    }
    double sum = 0;
    for (; j < i; ++j) sum += line[j] * row[j];
    even += odd;
    sum += ((even[0] + even[4]) + (even[1] + even[5])) + ((even[2] + even[6]) + (even[3] + even[7]));
    row[i] = (row[i] - sum) / line[i];
    squares += row[i] * row[i];
  }
  return squares;
}

TOUCHNET_WIDE
void gp_backward(const double* factor, std::size_t n, double* row) {
  std::size_t i = n;
  for (; i >= 2; i -= 2) {  // two rows a pass: half the traffic on `row`
    const double *upper = row_of(factor, i - 2), *lower = row_of(factor, i - 1);
    const double b = row[i - 1] / lower[i - 1];
    const double a = (row[i - 2] - b * lower[i - 2]) / upper[i - 2];
    row[i - 1] = b;
    row[i - 2] = a;
    std::size_t j = 0;
    for (; j + 8 <= i - 2; j += 8) {
      Lanes& out = *reinterpret_cast<Lanes*>(row + j);
      out -= a * *reinterpret_cast<const Lanes*>(upper + j);
      out -= b * *reinterpret_cast<const Lanes*>(lower + j);
    }
    for (; j < i - 2; ++j) {
      row[j] -= upper[j] * a;
      row[j] -= lower[j] * b;
    }
  }
  if (i == 1) row[0] /= factor[0];
}

double gp_variance(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t n,
                   const double* x, double* row) {
  gp_kernel(kernel, scale, x, 1, contacts, n, row);
  return kernel_value(kernel, scale, 0) - gp_forward(factor, n, row);
}

void gp_variance_gradient(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t n,
                          const double* x, const double* row, double* work, double* gradient) {
  std::copy(row, row + n, work);
  gp_backward(factor, n, work);
  gradient[0] = gradient[1] = gradient[2] = 0;
  for (std::size_t j = 0; j < n; ++j) {
    const double* y = contacts + 3 * j;
    const double slope = -2 * work[j] * kernel_slope(kernel, scale, squared_distance(x, y));
    for (int axis = 0; axis < 3; ++axis) gradient[axis] += slope * (x[axis] - y[axis]);
  }
}

// Rows start..n of L^-1 applied to one group, `rows` at a time so that what is solved already is read once for them.
TOUCHNET_WIDE
static void extend_group(const double* factor, std::size_t start, std::size_t n, Lanes* solved, Lanes* variance) {
  constexpr std::size_t rows = 6;
  std::size_t i = start;
  for (; i + rows <= n; i += rows) {
    const double* line[rows];
    Lanes sum[rows] = {};
    for (std::size_t a = 0; a < rows; ++a) line[a] = row_of(factor, i + a);
    for (std::size_t j = 0; j < i; ++j) {
      const Lanes known = solved[j];
      for (std::size_t a = 0; a < rows; ++a) sum[a] += line[a][j] * known;
    }
    for (std::size_t a = 0; a < rows; ++a) {
      for (std::size_t b = 0; b < a; ++b) sum[a] += line[a][i + b] * solved[i + b];
      solved[i + a] = (1 / line[a][i + a]) * (solved[i + a] - sum[a]);
      *variance -= solved[i + a] * solved[i + a];
    }
  }
  for (; i < n; ++i) {
    const double* line = row_of(factor, i);
    Lanes sum = {};
    for (std::size_t j = 0; j < i; ++j) sum += line[j] * solved[j];
    solved[i] = (1 / line[i]) * (solved[i] - sum);
    *variance -= solved[i] * solved[i];
  }
}

void gp_extend(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t start,
               std::size_t n, const double* x, std::size_t groups, std::size_t capacity, double* solved,
               double* variance) {
  for (std::size_t g = 0; g < groups; ++g) {
    double* group = solved + g * capacity * gp_lanes;
    for (std::size_t i = start; i < n; ++i)
      for (std::size_t k = 0; k < gp_lanes; ++k)
        group[i * gp_lanes + k] =
            kernel_value(kernel, scale, squared_distance(x + 3 * (g * gp_lanes + k), contacts + 3 * i));
    extend_group(factor, start, n, reinterpret_cast<Lanes*>(group), reinterpret_cast<Lanes*>(variance + g * gp_lanes));
  }
}

TOUCHNET_WIDE
void gp_backward_batch(const double* factor, std::size_t n, std::size_t groups, std::size_t capacity, double* solved) {
  for (std::size_t g = 0; g < groups; ++g) {
    Lanes* group = reinterpret_cast<Lanes*>(solved + g * capacity * gp_lanes);
    std::size_t i = n;
    for (; i >= 2; i -= 2) {
      const double *upper = row_of(factor, i - 2), *lower = row_of(factor, i - 1);
      const Lanes b = (1 / lower[i - 1]) * group[i - 1];
      const Lanes a = (1 / upper[i - 2]) * (group[i - 2] - lower[i - 2] * b);
      group[i - 1] = b;
      group[i - 2] = a;
      for (std::size_t j = 0; j < i - 2; ++j) {
        group[j] -= upper[j] * a;
        group[j] -= lower[j] * b;
      }
    }
    if (i == 1) group[0] = (1 / factor[0]) * group[0];
  }
}

std::size_t gp_highest(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t n,
                       const double* x, std::size_t groups, std::size_t capacity, double* solved, double* variance,
                       std::size_t* known) {
  while (true) {
    const std::size_t best = std::max_element(variance, variance + groups * gp_lanes) - variance;
    const std::size_t g = best / gp_lanes;
    if (known[g] == n) return best;
    gp_extend(kernel, scale, contacts, factor, known[g], n, x + 3 * g * gp_lanes, 1, capacity,
              solved + g * capacity * gp_lanes, variance + g * gp_lanes);
    known[g] = n;
  }
}

}  // namespace touchnet

#include "gp.h"

#include <algorithm>

#include "cell.h"

// The loops are bound by reading the factor; wider vectors help where the compiler can choose them at load time. Each
// sum runs over the columns in order in one lane, so every width gives the same bits.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define TOUCHNET_WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define TOUCHNET_WIDE
#endif

namespace touchnet {
namespace {

// Four doubles that are added and multiplied side by side. (Longer ones spill wherever the registers are shorter.)
#if defined(__GNUC__) || defined(__clang__)
typedef double Quad __attribute__((vector_size(4 * sizeof(double)), aligned(alignof(double)), may_alias));
#else
struct Quad {
  double at[4];
  double& operator[](std::size_t k) { return at[k]; }
  Quad& operator+=(const Quad& b) {
    for (int k = 0; k < 4; ++k) at[k] += b.at[k];
    return *this;
  }
  Quad& operator-=(const Quad& b) {
    for (int k = 0; k < 4; ++k) at[k] -= b.at[k];
    return *this;
  }
};
inline Quad operator*(Quad a, const Quad& b) {
  for (int k = 0; k < 4; ++k) a.at[k] *= b.at[k];
  return a;
}
inline Quad operator*(double a, Quad b) {
  for (int k = 0; k < 4; ++k) b.at[k] *= a;
  return b;
}
inline Quad operator-(Quad a, const Quad& b) { return a -= b; }
#endif
constexpr std::size_t quads = gp_lanes / 4;  // of a group of points
static_assert(quads * sizeof(Quad) == gp_lanes * sizeof(double), "a group of points fills its Quads");

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
void gp_backward(const double* factor, std::size_t n, double* row) {
  for (std::size_t i = n; i-- > 0;) {
    const double* line = row_of(factor, i);
    const double known = row[i] /= line[i];
    for (std::size_t j = 0; j < i; ++j) row[j] -= line[j] * known;
  }
}

// Rows start..n of L^-1 applied to solved (n, width), `rows` at a time so that what is solved already is read once for
// them. Inlined, or it would not be compiled for the wider vectors of its callers.
template <std::size_t rows, std::size_t width>
TN_INLINE void forward(const double* factor, std::size_t start, std::size_t n, Quad* solved) {
  std::size_t i = start;
  for (; i + rows <= n; i += rows) {
    const double* line[rows];
    Quad sum[rows][width] = {};
    for (std::size_t a = 0; a < rows; ++a) line[a] = row_of(factor, i + a);
    for (std::size_t j = 0; j < i; ++j) {
      Quad known[width];
      for (std::size_t q = 0; q < width; ++q) known[q] = solved[j * width + q];
      for (std::size_t a = 0; a < rows; ++a)
        for (std::size_t q = 0; q < width; ++q) sum[a][q] += line[a][j] * known[q];
    }
    for (std::size_t a = 0; a < rows; ++a)
      for (std::size_t q = 0; q < width; ++q) {
        Quad& out = solved[(i + a) * width + q];
        for (std::size_t b = 0; b < a; ++b) sum[a][q] += line[a][i + b] * solved[(i + b) * width + q];
        out = (1 / line[a][i + a]) * (out - sum[a][q]);
      }
  }
  for (; i < n; ++i) {
    const double* line = row_of(factor, i);
    for (std::size_t q = 0; q < width; ++q) {
      Quad sum = {};
      for (std::size_t j = 0; j < i; ++j) sum += line[j] * solved[j * width + q];
      solved[i * width + q] = (1 / line[i]) * (solved[i * width + q] - sum);
    }
  }
}

TOUCHNET_WIDE
static void touch(const double* factor, std::size_t n, Quad* solved) { forward<6, 1>(factor, 0, n, solved); }

double gp_touch(Kernel kernel, double scale, const double* contacts, const double* factor, std::size_t n,
                const double* x, double* row, double* work, double* gradient) {
  for (std::size_t j = 0; j < n; ++j) {
    const double* y = contacts + 3 * j;
    const double r2 = squared_distance(x, y), slope = kernel_slope(kernel, scale, r2);
    work[4 * j] = kernel_value(kernel, scale, r2);
    for (int axis = 0; axis < 3; ++axis) work[4 * j + 1 + axis] = slope * (x[axis] - y[axis]);
  }
  touch(factor, n, reinterpret_cast<Quad*>(work));
  double sums[4] = {};
  for (std::size_t j = 0; j < n; ++j) {
    row[j] = work[4 * j];
    for (int k = 0; k < 4; ++k) sums[k] += row[j] * work[4 * j + k];
  }
  for (int axis = 0; axis < 3; ++axis) gradient[axis] = -2 * sums[1 + axis];
  return kernel_value(kernel, scale, 0) - sums[0];
}

TOUCHNET_WIDE
static void extend_group(const double* factor, std::size_t start, std::size_t n, Quad* solved, Quad* variance) {
  forward<4, quads>(factor, start, n, solved);
  for (std::size_t i = start; i < n; ++i)
    for (std::size_t q = 0; q < quads; ++q) variance[q] -= solved[i * quads + q] * solved[i * quads + q];
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
    extend_group(factor, start, n, reinterpret_cast<Quad*>(group), reinterpret_cast<Quad*>(variance + g * gp_lanes));
  }
}

TOUCHNET_WIDE
void gp_backward_batch(const double* factor, std::size_t n, std::size_t groups, std::size_t capacity, double* solved) {
  for (std::size_t g = 0; g < groups; ++g) {
    Quad* group = reinterpret_cast<Quad*>(solved + g * capacity * gp_lanes);
    std::size_t i = n;
    for (; i >= 2; i -= 2) {  // two rows a pass: half the traffic on `group`
      const double *upper = row_of(factor, i - 2), *lower = row_of(factor, i - 1);
      Quad a[quads], b[quads];
      for (std::size_t q = 0; q < quads; ++q) {
        b[q] = group[(i - 1) * quads + q] = (1 / lower[i - 1]) * group[(i - 1) * quads + q];
        a[q] = group[(i - 2) * quads + q] = (1 / upper[i - 2]) * (group[(i - 2) * quads + q] - lower[i - 2] * b[q]);
      }
      for (std::size_t j = 0; j < i - 2; ++j)
        for (std::size_t q = 0; q < quads; ++q) {
          Quad& out = group[j * quads + q];
          out -= upper[j] * a[q];
          out -= lower[j] * b[q];
        }
    }
    if (i == 1)
      for (std::size_t q = 0; q < quads; ++q) group[q] = (1 / factor[0]) * group[q];
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

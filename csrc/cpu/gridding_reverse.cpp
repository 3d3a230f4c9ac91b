#include "gridding_reverse.h"

#include <algorithm>
#include <vector>

#include "parallel.h"

namespace touchnet {
namespace {

// Cells are taken along z in runs of at most kRun, so that every inner loop is one over contiguous vertices.
constexpr std::int32_t kRun = 256;

// A run of cells along z: the four rows of vertices around it.
template <typename T>
struct Rows {
  const T *v00, *v01, *v10, *v11;  // rows (i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)
};

template <typename T>
TN_INLINE Rows<T> rows_of(const T* item, const VolumeShape& shape, std::int64_t i, std::int64_t j, std::int64_t k) {
  const std::int64_t nz = shape.nz, plane = shape.ny * nz;
  const T* v = item + i * plane + j * nz + k;
  return {v, v + nz, v + plane, v + plane + nz};
}

// Fractions of the way from the lower corner along x, y and z (0 where the cell is empty) and 1 / total (0 where
// empty).
template <typename T>
TN_INLINE void fractions(const Rows<T>& rows, std::int64_t k, T* x, T* y, T* z, T* inverse) {
  const T a00 = rows.v00[k] + rows.v00[k + 1], a01 = rows.v01[k] + rows.v01[k + 1];
  const T a10 = rows.v10[k] + rows.v10[k + 1], a11 = rows.v11[k] + rows.v11[k + 1];
  const T upper_z = (rows.v00[k + 1] + rows.v01[k + 1]) + (rows.v10[k + 1] + rows.v11[k + 1]);
  const T total = (a00 + a01) + (a10 + a11);
  const bool filled = total >= T(kLeastWeight);
  *inverse = filled ? T(1) / (filled ? total : T(1)) : T(0);
  *x = (a10 + a11) * *inverse;
  *y = (a01 + a11) * *inverse;
  *z = upper_z * *inverse;
}

template <typename T>
T spacing(std::int32_t n) {
  return T(2) / T(n - 1);
}

}  // namespace

template <typename T>
void gridding_reverse_forward(const T* volume, VolumeShape shape, T fill, T* points, int threads) {
  const std::int64_t ny = shape.ny, nz = shape.nz, item_size = shape.nx * ny * nz;
  const double microseconds = shape.batch * item_size * 1e-3;
  std::vector<T> z_of(nz);
  for (std::int32_t k = 0; k < nz; ++k) z_of[k] = vertex_coordinate<T>(k, shape.nz);
  const T step_x = spacing<T>(shape.nx), step_y = spacing<T>(shape.ny), step_z = spacing<T>(shape.nz);
  parallel_for(0, shape.batch * shape.nx, worth_threads(microseconds, threads),
               [&](std::int64_t first, std::int64_t last) {
                 run_vectorised([&]() TN_LAMBDA_INLINE {
                   T x[kRun], y[kRun], z[kRun], inverse[kRun];
                   for (std::int64_t row = first; row < last; ++row) {
                     const std::int32_t i = static_cast<std::int32_t>(row % shape.nx);
                     const T* item = volume + row / shape.nx * item_size;
                     T* out = points + 3 * row * ny * nz;
                     if (i == shape.nx - 1) {
                       std::fill(out, out + 3 * ny * nz, fill);
                       continue;
                     }
                     const T x0 = vertex_coordinate<T>(i, shape.nx);
                     for (std::int32_t j = 0; j < ny - 1; ++j) {
                       const T y0 = vertex_coordinate<T>(j, shape.ny);
                       T* line = out + 3 * j * nz;
                       for (std::int64_t start = 0; start < nz - 1; start += kRun) {
                         const int count = static_cast<int>(std::min<std::int64_t>(kRun, nz - 1 - start));
                         const Rows<T> rows = rows_of(item, shape, i, j, start);
                         for (int k = 0; k < count; ++k) fractions(rows, k, x + k, y + k, z + k, inverse + k);
                         for (int k = 0; k < count; ++k) {
                           x[k] = x0 + step_x * x[k];
                           y[k] = y0 + step_y * y[k];
                           z[k] = z_of[start + k] + step_z * z[k];
                         }
                         for (int k = 0; k < count; ++k) {
                           x[k] = inverse[k] != T(0) ? x[k] : fill;
                           y[k] = inverse[k] != T(0) ? y[k] : fill;
                           z[k] = inverse[k] != T(0) ? z[k] : fill;
                         }
                         T* __restrict point = line + 3 * start;
                         for (int k = 0; k < count; ++k) {
                           point[3 * k] = x[k];
                           point[3 * k + 1] = y[k];
                           point[3 * k + 2] = z[k];
                         }
                       }
                       std::fill(line + 3 * (nz - 1), line + 3 * nz, fill);
                     }
                     std::fill(out + 3 * (ny - 1) * nz, out + 3 * ny * nz, fill);
                   }
                 });
               });
}

template <typename T>
void gridding_reverse_backward(const T* grad_points, const T* volume, VolumeShape shape, T* grad_volume, int threads) {
  const std::int64_t ny = shape.ny, nz = shape.nz, plane = ny * nz, item_size = shape.nx * plane;
  const double microseconds = shape.batch * item_size * 3e-3;
  const T step_x = spacing<T>(shape.nx), step_y = spacing<T>(shape.ny), step_z = spacing<T>(shape.nz);
  // Each thread owns planes of vertices and visits the two layers of cells around each, in the order of the cells.
  parallel_for(0, shape.batch * shape.nx, worth_threads(microseconds, threads),
               [&](std::int64_t first, std::int64_t last) {
                 run_vectorised([&]() TN_LAMBDA_INLINE {
                   T x[kRun], y[kRun], z[kRun], inverse[kRun], at_y0[kRun], at_y1[kRun], along_z[kRun];
                   for (std::int64_t row = first; row < last; ++row) {
                     const std::int64_t owned = row % shape.nx;
                     const T* item = volume + row / shape.nx * item_size;
                     const T* item_grad = grad_points + 3 * (row / shape.nx) * item_size;
                     T* result = grad_volume + row * plane;
                     std::fill(result, result + plane, T(0));
                     for (std::int64_t i = std::max<std::int64_t>(owned - 1, 0); i <= owned && i < shape.nx - 1; ++i) {
                       const T upper_x = i < owned ? T(1) : T(0);  // the owned plane is the cells' upper or lower side
                       for (std::int64_t j = 0; j < ny - 1; ++j) {
                         for (std::int64_t start = 0; start < nz - 1; start += kRun) {
                           const int count = static_cast<int>(std::min<std::int64_t>(kRun, nz - 1 - start));
                           const Rows<T> rows = rows_of(item, shape, i, j, start);
                           for (int k = 0; k < count; ++k) fractions(rows, k, x + k, y + k, z + k, inverse + k);
                           const T* g = item_grad + 3 * (i * plane + j * nz + start);
                           for (int k = 0; k < count; ++k) {
                             const T gx = step_x * g[3 * k], gy = step_y * g[3 * k + 1], gz = step_z * g[3 * k + 2];
                             const T base = gx * (upper_x - x[k]) - gy * y[k] - gz * z[k];
                             at_y0[k] = base * inverse[k];
                             at_y1[k] = (base + gy) * inverse[k];
                             along_z[k] = gz * inverse[k];
                           }
                           for (int k = 0; k < count; ++k) {  // an empty cell passes nothing on, not even NaN
                             at_y0[k] = inverse[k] != T(0) ? at_y0[k] : T(0);
                             at_y1[k] = inverse[k] != T(0) ? at_y1[k] : T(0);
                             along_z[k] = inverse[k] != T(0) ? along_z[k] : T(0);
                           }
                           T* __restrict y0 = result + j * nz + start;
                           T* __restrict y1 = y0 + nz;
                           for (int k = 0; k < count; ++k) y0[k] += at_y0[k];
                           for (int k = 0; k < count; ++k) y0[k + 1] += at_y0[k] + along_z[k];
                           for (int k = 0; k < count; ++k) y1[k] += at_y1[k];
                           for (int k = 0; k < count; ++k) y1[k + 1] += at_y1[k] + along_z[k];
                         }
                       }
                     }
                   }
                 });
               });
}

#define TN_INSTANTIATE(T)                                                       \
  template void gridding_reverse_forward<T>(const T*, VolumeShape, T, T*, int); \
  template void gridding_reverse_backward<T>(const T*, const T*, VolumeShape, T*, int);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)
#undef TN_INSTANTIATE

}  // namespace touchnet

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

// How many cells to compute for `count` wanted ones from `start` along the row of cells (i, j): one more, which has no
// upper vertex, makes whole vectors of the usual rows of 2^n vertices. Its upper vertices are read from the row behind,
// which the last row of the volume does not have.
TN_INLINE int padded_count(int count, std::int64_t start, const VolumeShape& shape, std::int64_t i, std::int64_t j) {
  const bool ends_row = start + count == shape.nz - 1, ends_volume = i == shape.nx - 2 && j == shape.ny - 2;
  return ends_row && !ends_volume && count < kRun ? count + 1 : count;
}

// Coordinates from the fractions of the way; `fill` where the cell is empty. `from` of type T or const T*.
template <typename T>
TN_INLINE T at(T from, int) {
  return from;
}
template <typename T>
TN_INLINE T at(const T* from, int k) {
  return from[k];
}
template <typename From, typename T>
TN_INLINE void place(int count, From from, T step, T fill, const T* __restrict inverse, T* __restrict fraction) {
  for (int k = 0; k < count; ++k) {
    const T placed = at(from, k) + step * fraction[k];
    fraction[k] = inverse[k] > T(0) ? placed : fill;
  }
}

template <typename T>
TN_INLINE void empty_to_zero(int count, const T* __restrict inverse, T* __restrict value) {
  for (int k = 0; k < count; ++k) {
    const T kept = value[k];
    value[k] = inverse[k] > T(0) ? kept : T(0);
  }
}

template <typename T>
TN_INLINE void add(int count, const T* __restrict part, T* __restrict sum) {
  for (int k = 0; k < count; ++k) sum[k] += part[k];
}

template <typename T>
struct Steps {
  T x, y, z;
};

// What each cell passes on to its vertices at y0 and y1 with the lower z, and to those above them, from the gradients g
// of the cells' points; nothing, not even NaN, where the cell is empty.
template <typename T>
TN_INLINE void gradients(int count, const T* __restrict g, T upper_x, Steps<T> step, const T* __restrict x,
                         const T* __restrict y, const T* __restrict z, const T* __restrict inverse, T* __restrict at_y0,
                         T* __restrict at_y1, T* __restrict above_y0, T* __restrict above_y1) {
  for (int k = 0; k < count; ++k) {
    const T gx = step.x * g[3 * k], gy = step.y * g[3 * k + 1], gz = step.z * g[3 * k + 2];
    const T base = gx * (upper_x - x[k]) - gy * y[k] - gz * z[k];
    at_y0[k] = base * inverse[k];
    at_y1[k] = (base + gy) * inverse[k];
    above_y0[k] = at_y0[k] + gz * inverse[k];
    above_y1[k] = at_y1[k] + gz * inverse[k];
  }
  empty_to_zero(count, inverse, at_y0);
  empty_to_zero(count, inverse, at_y1);
  empty_to_zero(count, inverse, above_y0);
  empty_to_zero(count, inverse, above_y1);
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
                         const int padded = padded_count(count, start, shape, i, j);
                         for (int k = 0; k < padded; ++k) fractions(rows, k, x + k, y + k, z + k, inverse + k);
                         place(padded, x0, step_x, fill, inverse, x);
                         place(padded, y0, step_y, fill, inverse, y);
                         place<const T*>(padded, z_of.data() + start, step_z, fill, inverse, z);
                         T* __restrict point = line + 3 * start;
                         for (int k = 0; k < padded; ++k) {  // the row's last point is overwritten below
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
                   T x[kRun], y[kRun], z[kRun], inverse[kRun], at_y0[kRun], at_y1[kRun], above_y0[kRun], above_y1[kRun];
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
                           const int padded = padded_count(count, start, shape, i, j);
                           for (int k = 0; k < padded; ++k) fractions(rows, k, x + k, y + k, z + k, inverse + k);
                           const T* g = item_grad + 3 * (i * plane + j * nz + start);
                           gradients(padded, g, upper_x, {step_x, step_y, step_z}, x, y, z, inverse, at_y0, at_y1,
                                     above_y0, above_y1);
                           if (padded > count) at_y0[count] = at_y1[count] = above_y0[count] = above_y1[count] = T(0);
                           // Above the padding lies the next row, which a plane's last one does not have.
                           const int added = j < ny - 2 ? padded : count;
                           T* line = result + j * nz + start;
                           add(added, at_y0, line);
                           add(added, above_y0, line + 1);
                           add(added, at_y1, line + nz);
                           add(added, above_y1, line + nz + 1);
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

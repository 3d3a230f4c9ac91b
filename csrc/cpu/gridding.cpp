#include "gridding.h"

#include "slabs.h"

namespace touchnet {
namespace {

// Adds batch item b's points to rows [low, high) of its volume. kOnlyDensity: no values.
template <bool kOnlyDensity, typename T>
TN_INLINE void add_points(const T* points, const T* values, std::int64_t n, T* item, const VolumeShape& shape,
                          std::int64_t low, std::int64_t high) {
  const std::int64_t count = shape.channels - 1;
  const bool whole = low == 0 && high == shape.nx;
  for (std::int64_t p = 0; p < n; ++p) {
    const T* point = points + 3 * p;
    if (!inside_cube(point[0], point[1], point[2])) continue;
    const Cell<T> cell = locate_point(point, shape.nx, shape.ny, shape.nz);
    if (!whole && (cell.x.index + 1 < low || cell.x.index >= high)) continue;
    T* base = item + shape.offset(cell);
    for (int corner = 0; corner < 8; ++corner) {
      const std::int64_t row = cell.x.index + (corner >> 2);
      if (!whole && (row < low || row >= high)) continue;
      T* vertex = base + shape.corner(corner);
      const T weight = cell.weight(corner);
      vertex[0] += weight;
      if (!kOnlyDensity)
        for (std::int64_t k = 0; k < count; ++k) vertex[(k + 1) * shape.stride_c] += weight * values[p * count + k];
    }
  }
}

}  // namespace

template <typename T>
void gridding_forward(const T* points, const T* values, std::int64_t n, T* volume, VolumeShape shape, int threads) {
  const std::int64_t count = shape.channels - 1;
  scatter_in_slabs(volume, shape, points, n, 8.0 + 4.0 * count, threads,
                   [&](std::int64_t b, std::int64_t low, std::int64_t high) {
                     T* item = volume + b * shape.stride_b;
                     if (count == 0)
                       add_points<true>(points + 3 * b * n, values, n, item, shape, low, high);
                     else
                       add_points<false>(points + 3 * b * n, values + b * n * count, n, item, shape, low, high);
                   });
}

template <typename T>
void gridding_backward(const T* grad_volume, VolumeShape shape, const T* points, const T* values, std::int64_t n,
                       T* grad_points, T* grad_values, int threads) {
  const std::int64_t count = shape.channels - 1;
  const double microseconds = shape.batch * n * (8.0 + 4.0 * count) * 1e-3;
  parallel_for(0, shape.batch * n, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    for (std::int64_t p = first; p < last; ++p) {
      const T* point = points + 3 * p;
      T gradient[3] = {T(0), T(0), T(0)};
      if (grad_values)
        for (std::int64_t k = 0; k < count; ++k) grad_values[p * count + k] = T(0);
      if (inside_cube(point[0], point[1], point[2])) {
        const Cell<T> cell = locate_point(point, shape.nx, shape.ny, shape.nz);
        const T* base = grad_volume + (p / n) * shape.stride_b + shape.offset(cell);
        for (int corner = 0; corner < 8; ++corner) {
          const T* vertex = base + shape.corner(corner);
          T along = vertex[0];  // d loss / d weight of this corner
          for (std::int64_t k = 0; k < count; ++k) {
            const T g = vertex[(k + 1) * shape.stride_c];
            along += values[p * count + k] * g;
            if (grad_values) grad_values[p * count + k] += cell.weight(corner) * g;
          }
          gradient[0] += cell.weight_dx(corner) * along;
          gradient[1] += cell.weight_dy(corner) * along;
          gradient[2] += cell.weight_dz(corner) * along;
        }
      }
      if (grad_points)
        for (int axis = 0; axis < 3; ++axis) grad_points[3 * p + axis] = gradient[axis];
    }
  });
}

#define TN_INSTANTIATE(T)                                                                    \
  template void gridding_forward<T>(const T*, const T*, std::int64_t, T*, VolumeShape, int); \
  template void gridding_backward<T>(const T*, VolumeShape, const T*, const T*, std::int64_t, T*, T*, int);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)
#undef TN_INSTANTIATE

}  // namespace touchnet

#include "cuda/launch.h"
#include "cuda/scatter.h"
#include "gridding.h"

namespace touchnet::cuda {

template <typename T>
struct GriddedPoints {
  const T *points, *values;
  std::int64_t count;
  std::int32_t nx, ny, nz;

  TN_INLINE bool counts(std::int64_t p) const {
    return inside_cube(points[3 * p], points[3 * p + 1], points[3 * p + 2]);
  }
  TN_INLINE Cell<T> cell(std::int64_t p) const { return locate_point(points + 3 * p, nx, ny, nz); }
  TN_INLINE T value(std::int64_t p, const Cell<T>& cell, int corner, std::int64_t channel) const {
    return channel == 0 ? cell.weight(corner) : cell.weight(corner) * values[p * count + channel - 1];
  }
};

template <typename T>
void gridding_forward(const T* points, const T* values, std::int64_t n, T* volume, VolumeShape shape,
                      const std::int64_t* order, const std::int64_t* starts, std::uintptr_t stream) {
  const GriddedPoints<T> source{points, values, shape.channels - 1, shape.nx, shape.ny, shape.nz};
  scatter("gridding", volume, shape, n, Sorted{order, starts}, source, stream);
}

template <typename T>
void gridding_backward(const T* grad_volume, VolumeShape shape, const T* points, const T* values, std::int64_t n,
                       T* grad_points, T* grad_values, std::uintptr_t stream) {
  const std::int64_t count = shape.channels - 1;
  for_each("gridding backward", shape.batch * n, stream, [=] TN_BODY(std::int64_t p) {
    const T* point = points + 3 * p;
    const bool counts = inside_cube(point[0], point[1], point[2]);
    const T zero[3] = {T(0), T(0), T(0)};
    const Cell<T> cell = locate_point(counts ? point : zero, shape.nx, shape.ny, shape.nz);
    const T* base = grad_volume + p / n * shape.stride_b + shape.offset(cell);
    T along[8];  // d loss / d weight of each corner
    for (int corner = 0; corner < 8; ++corner) along[corner] = base[shape.corner(corner)];
    for (std::int64_t k = 0; k < count; ++k) {
      const T value = values[p * count + k];
      T sum = T(0);
      for (int corner = 0; corner < 8; ++corner) {
        const T g = base[shape.corner(corner) + (k + 1) * shape.stride_c];
        along[corner] += value * g;
        sum += cell.weight(corner) * g;
      }
      if (grad_values) grad_values[p * count + k] = counts ? sum : T(0);
    }
    if (!grad_points) return;
    const CellGradient<T> change = cell.gradient(along);
    grad_points[3 * p] = counts ? cell.x.slope * change.x : T(0);
    grad_points[3 * p + 1] = counts ? cell.y.slope * change.y : T(0);
    grad_points[3 * p + 2] = counts ? cell.z.slope * change.z : T(0);
  });
}

template <bool kClamped, typename T>
void cell_numbers(const T* points, std::int64_t n, VolumeShape shape, std::int64_t* numbers, std::uintptr_t stream) {
  for_each("cell numbers", shape.batch * n, stream, [=] TN_BODY(std::int64_t p) {
    const T* point = points + 3 * p;
    const bool counts = kClamped ? all_finite(point[0], point[1], point[2]) : inside_cube(point[0], point[1], point[2]);
    std::int64_t number = shape.batch * cells_of_item(shape);
    if (counts) {
      const Cell<T> cell = locate_point(point, shape.nx, shape.ny, shape.nz);
      number = p / n * cells_of_item(shape) +
               (cell.x.index * std::int64_t(shape.ny - 1) + cell.y.index) * (shape.nz - 1) + cell.z.index;
    }
    numbers[p] = number;
  });
}

#define TN_INSTANTIATE(T)                                                                                              \
  template void gridding_forward<T>(const T*, const T*, std::int64_t, T*, VolumeShape, const std::int64_t*,            \
                                    const std::int64_t*, std::uintptr_t);                                              \
  template void gridding_backward<T>(const T*, VolumeShape, const T*, const T*, std::int64_t, T*, T*, std::uintptr_t); \
  template void cell_numbers<true, T>(const T*, std::int64_t, VolumeShape, std::int64_t*, std::uintptr_t);             \
  template void cell_numbers<false, T>(const T*, std::int64_t, VolumeShape, std::int64_t*, std::uintptr_t);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)
#undef TN_INSTANTIATE

}  // namespace touchnet::cuda

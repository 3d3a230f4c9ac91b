#include "cuda/launch.h"
#include "gridding_reverse.h"

namespace touchnet::cuda {

// What the cell with lower corner (i, j, k) says: fractions of the way along each axis and 1 / total; 0 where it is
// empty.
template <typename T>
struct Mean {
  T x, y, z, inverse;
};

template <typename T>
TN_INLINE Mean<T> mean_of_cell(const T* v, std::int64_t plane, std::int64_t row) {
  const T a00 = v[0] + v[1], a01 = v[row] + v[row + 1];
  const T a10 = v[plane] + v[plane + 1], a11 = v[plane + row] + v[plane + row + 1];
  const T upper_z = (v[1] + v[row + 1]) + (v[plane + 1] + v[plane + row + 1]);
  const T total = (a00 + a01) + (a10 + a11);
  if (!(total >= T(kLeastWeight))) return {T(0), T(0), T(0), T(0)};
  const T inverse = T(1) / total;
  return {(a10 + a11) * inverse, (a01 + a11) * inverse, upper_z * inverse, inverse};
}

template <typename T>
void gridding_reverse_forward(const T* volume, VolumeShape shape, T fill, T* points, std::uintptr_t stream) {
  const std::int64_t nx = shape.nx, ny = shape.ny, nz = shape.nz;
  for_each("gridding_reverse", shape.batch * nx * ny * nz, stream, [=] TN_BODY(std::int64_t vertex) {
    const std::int64_t k = vertex % nz, j = vertex / nz % ny, i = vertex / nz / ny % nx;
    T* point = points + 3 * vertex;
    Mean<T> mean{T(0), T(0), T(0), T(0)};
    if (i < nx - 1 && j < ny - 1 && k < nz - 1) mean = mean_of_cell(volume + vertex, ny * nz, nz);
    const bool filled = mean.inverse != T(0);
    point[0] = filled ? vertex_coordinate<T>(i, nx) + T(2) / T(nx - 1) * mean.x : fill;
    point[1] = filled ? vertex_coordinate<T>(j, ny) + T(2) / T(ny - 1) * mean.y : fill;
    point[2] = filled ? vertex_coordinate<T>(k, nz) + T(2) / T(nz - 1) * mean.z : fill;
  });
}

template <typename T>
void gridding_reverse_backward(const T* grad_points, const T* volume, VolumeShape shape, T* grad_volume,
                               std::uintptr_t stream) {
  const std::int64_t nx = shape.nx, ny = shape.ny, nz = shape.nz;
  for_each("gridding_reverse backward", shape.batch * nx * ny * nz, stream, [=] TN_BODY(std::int64_t vertex) {
    const std::int64_t k = vertex % nz, j = vertex / nz % ny, i = vertex / nz / ny % nx;
    T sum = T(0);
    for (int corner = 7; corner >= 0; --corner) {  // this vertex is that corner of a cell
      const int di = corner >> 2 & 1, dj = corner >> 1 & 1, dk = corner & 1;
      if (i < di || j < dj || k < dk || i - di >= nx - 1 || j - dj >= ny - 1 || k - dk >= nz - 1) continue;
      const std::int64_t cell = vertex - di * ny * nz - dj * nz - dk;
      const Mean<T> mean = mean_of_cell(volume + cell, ny * nz, nz);
      if (mean.inverse == T(0)) continue;
      const T* g = grad_points + 3 * cell;
      sum += mean.inverse * (T(2) / T(nx - 1) * g[0] * (T(di) - mean.x) + T(2) / T(ny - 1) * g[1] * (T(dj) - mean.y) +
                             T(2) / T(nz - 1) * g[2] * (T(dk) - mean.z));
    }
    grad_volume[vertex] = sum;
  });
}

#define TN_INSTANTIATE(T)                                                                  \
  template void gridding_reverse_forward<T>(const T*, VolumeShape, T, T*, std::uintptr_t); \
  template void gridding_reverse_backward<T>(const T*, const T*, VolumeShape, T*, std::uintptr_t);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)
#undef TN_INSTANTIATE

}  // namespace touchnet::cuda

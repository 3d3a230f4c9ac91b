#include <cmath>

#include "cuda/launch.h"
#include "cuda/scatter.h"
#include "sampling.h"

#ifdef __CUDACC__
#include <cuda_bf16.h>
#include <cuda_fp16.h>
#endif

namespace touchnet::cuda {

template <typename T, typename A>
TN_INLINE A read(const T* address) {
  return static_cast<A>(*address);
}

template <typename A>
TN_INLINE Cell<A> cell_or_origin(const A* point, bool finite, const VolumeShape& shape) {
  const A zero[3] = {A(0), A(0), A(0)};
  return locate_point(finite ? point : zero, shape.nx, shape.ny, shape.nz);
}

// One thread an element of the result, channels innermost: with a channels-last volume, reads and writes coalesce.
template <Sampler kSampler, typename T, typename A>
void sample_forward(const T* volume, VolumeShape shape, const A* points, std::int64_t m, T* out,
                    std::uintptr_t stream) {
  const std::int64_t channels = shape.channels;
  constexpr int kRows = kSampler == Sampler::cubic ? 8 : 1;
  for_each("sampling", shape.batch * m * kRows * channels, stream, [=] TN_BODY(std::int64_t index) {
    const std::int64_t channel = index % channels, row = index / channels, p = row / kRows;
    const A* point = points + 3 * p;
    if (!all_finite(point[0], point[1], point[2])) {
      out[index] = static_cast<T>(A(NAN));
      return;
    }
    const Cell<A> cell = locate_point(point, shape.nx, shape.ny, shape.nz);
    const T* base = volume + p / m * shape.stride_b + channel * shape.stride_c + shape.offset(cell);
    if (kSampler == Sampler::cubic) {
      out[index] = base[shape.corner(static_cast<int>(row % kRows))];
      return;
    }
    A sum = A(0);
    for (int corner = 0; corner < 8; ++corner) {
      const A value = read<T, A>(base + shape.corner(corner));
      sum += kSampler == Sampler::trilinear ? cell.weight(corner) * value : value;
    }
    out[index] = static_cast<T>(sum);
  });
}

template <Sampler kSampler, typename T, typename A>
struct SampledPoints {
  const T* grad_out;
  const A* points;
  VolumeShape shape;

  TN_INLINE bool counts(std::int64_t p) const {
    return all_finite(points[3 * p], points[3 * p + 1], points[3 * p + 2]);
  }
  TN_INLINE Cell<A> cell(std::int64_t p) const { return locate_point(points + 3 * p, shape.nx, shape.ny, shape.nz); }
  TN_INLINE A value(std::int64_t p, const Cell<A>& cell, int corner, std::int64_t channel) const {
    if (kSampler == Sampler::cubic) return read<T, A>(grad_out + (p * 8 + corner) * shape.channels + channel);
    const A gradient = read<T, A>(grad_out + p * shape.channels + channel);
    return kSampler == Sampler::trilinear ? cell.weight(corner) * gradient : gradient;
  }
};

template <Sampler kSampler, typename T, typename A>
void sample_backward_volume(const T* grad_out, const A* points, std::int64_t m, A* grad_volume, VolumeShape shape,
                            const std::int64_t* order, const std::int64_t* starts, std::uintptr_t stream) {
  const SampledPoints<kSampler, T, A> source{grad_out, points, shape};
  scatter("sampling backward to the volume", grad_volume, shape, m, Sorted{order, starts}, source, stream);
}

// A group of threads a point, each with every kGroup-th channel.
template <typename T, typename A>
void trilinear_backward_points(const T* grad_out, const T* volume, VolumeShape shape, const A* points, std::int64_t m,
                               A* grad_points, std::uintptr_t stream) {
  for_each("sampling backward to the points", shape.batch * m * kGroup, stream, [=] TN_BODY(std::int64_t index) {
    const std::int64_t p = index / kGroup, lane = index % kGroup;
    const A* point = points + 3 * p;
    const bool finite = all_finite(point[0], point[1], point[2]);
    const Cell<A> cell = cell_or_origin(point, finite, shape);
    const T* base = volume + p / m * shape.stride_b + shape.offset(cell);
    A x = A(0), y = A(0), z = A(0);
    for (std::int64_t channel = lane; channel < shape.channels; channel += kGroup) {
      const A gradient = read<T, A>(grad_out + p * shape.channels + channel);
      A values[8];
      for (int corner = 0; corner < 8; ++corner)
        values[corner] = read<T, A>(base + channel * shape.stride_c + shape.corner(corner));
      const CellGradient<A> along = cell.gradient(values);
      x += gradient * along.x;
      y += gradient * along.y;
      z += gradient * along.z;
    }
    x = group_sum(x);
    y = group_sum(y);
    z = group_sum(z);
    if (lane != 0) return;
    grad_points[3 * p] = finite ? cell.x.slope * x : A(0);
    grad_points[3 * p + 1] = finite ? cell.y.slope * y : A(0);
    grad_points[3 * p + 2] = finite ? cell.z.slope * z : A(0);
  });
}

#define TN_INSTANTIATE_SAMPLER(S, T, A)                                                                     \
  template void sample_forward<S, T, A>(const T*, VolumeShape, const A*, std::int64_t, T*, std::uintptr_t); \
  template void sample_backward_volume<S, T, A>(const T*, const A*, std::int64_t, A*, VolumeShape,          \
                                                const std::int64_t*, const std::int64_t*, std::uintptr_t);
#define TN_INSTANTIATE(T, A)                                                                                 \
  TN_INSTANTIATE_SAMPLER(Sampler::trilinear, T, A)                                                           \
  TN_INSTANTIATE_SAMPLER(Sampler::addition, T, A)                                                            \
  TN_INSTANTIATE_SAMPLER(Sampler::cubic, T, A)                                                               \
  template void trilinear_backward_points<T, A>(const T*, const T*, VolumeShape, const A*, std::int64_t, A*, \
                                                std::uintptr_t);
TN_INSTANTIATE(float, float)
TN_INSTANTIATE(double, double)
#ifdef __CUDACC__
TN_INSTANTIATE(__half, float)
TN_INSTANTIATE(__nv_bfloat16, float)
#endif
#undef TN_INSTANTIATE
#undef TN_INSTANTIATE_SAMPLER

}  // namespace touchnet::cuda

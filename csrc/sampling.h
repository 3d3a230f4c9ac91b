// Reading a volume [B, C, X, Y, Z] of any strides at points (B, M, 3), contiguous.
//   trilinear: (B, M, C), the weighted mean of the eight corners of the point's cell
//   addition:  (B, M, C), the sum of the eight corners
//   cubic:     (B, M, 8, C), the eight corners one by one, corner 4 di + 2 dj + dk
// Coordinates are clamped to the cube. The row of a point that is not finite is NaN and has no gradient.
// Gradients of the volume are written, not added, into a dense tensor (contiguous or channels last).
#pragma once

#include "cell.h"

namespace touchnet {

template <typename T>
void trilinear_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads);
template <typename T>
void trilinear_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                               int threads);
template <typename T>
void trilinear_backward_points(const T* grad_out, const T* volume, VolumeShape shape, const T* points, std::int64_t m,
                               T* grad_points, int threads);

template <typename T>
void addition_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads);
template <typename T>
void addition_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                              int threads);

template <typename T>
void cubic_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads);
template <typename T>
void cubic_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                           int threads);

namespace cuda {

// On CUDA the volume and the rows read from it may be half precision (T) while points, weights and sums are float (A);
// the gradient of such a volume is summed in float. `order` and `starts`: see cuda/scatter.h.
enum class Sampler { trilinear, addition, cubic };

template <Sampler kSampler, typename T, typename A>
void sample_forward(const T* volume, VolumeShape shape, const A* points, std::int64_t m, T* out, std::uintptr_t stream);
template <Sampler kSampler, typename T, typename A>
void sample_backward_volume(const T* grad_out, const A* points, std::int64_t m, A* grad_volume, VolumeShape shape,
                            const std::int64_t* order, const std::int64_t* starts, std::uintptr_t stream);
template <typename T, typename A>
void trilinear_backward_points(const T* grad_out, const T* volume, VolumeShape shape, const A* points, std::int64_t m,
                               A* grad_points, std::uintptr_t stream);

}  // namespace cuda
}  // namespace touchnet

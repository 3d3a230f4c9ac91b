// Gridding: every point spreads its weight, and its values times the weight, over the eight vertices of its cell.
// Points are (B, N, 3) and values (B, N, K) contiguous (values null where K = 0). The volume has 1 + K channels and is
// dense, either contiguous or channels last. Points outside the cube, or not finite, have no weight and no gradient.
#pragma once

#include "cell.h"

namespace touchnet {

template <typename T>
void gridding_forward(const T* points, const T* values, std::int64_t n, T* volume, VolumeShape shape, int threads);

// Either gradient may be null where it is not wanted.
template <typename T>
void gridding_backward(const T* grad_volume, VolumeShape shape, const T* points, const T* values, std::int64_t n,
                       T* grad_points, T* grad_values, int threads);

namespace cuda {

// `order` and `starts`: see cuda/scatter.h; null for atomic addition. `stream`: a cudaStream_t.
template <typename T>
void gridding_forward(const T* points, const T* values, std::int64_t n, T* volume, VolumeShape shape,
                      const std::int64_t* order, const std::int64_t* starts, std::uintptr_t stream);
template <typename T>
void gridding_backward(const T* grad_volume, VolumeShape shape, const T* points, const T* values, std::int64_t n,
                       T* grad_points, T* grad_values, std::uintptr_t stream);

// The number of each point's cell, by which `order` sorts: kClamped for samplers, where a point outside belongs to the
// nearest cell. A point that does not count gets the number after the last cell.
template <bool kClamped, typename T>
void cell_numbers(const T* points, std::int64_t n, VolumeShape shape, std::int64_t* numbers, std::uintptr_t stream);

}  // namespace cuda
}  // namespace touchnet

// Gridding reversed: one point for each cell of a density (B, X, Y, Z), contiguous, the mean of the cell's corners
// weighted by the density. Row (i ny + j) nz + k of (B, X Y Z, 3) belongs to the cell whose lower corner is vertex (i,
// j, k); rows of the last vertices have no cell. A cell whose weights sum to less than kLeastWeight, and a row without
// a cell, hold `fill` and have no gradient.
#pragma once

#include "cell.h"

namespace touchnet {

template <typename T>
void gridding_reverse_forward(const T* volume, VolumeShape shape, T fill, T* points, int threads);
template <typename T>
void gridding_reverse_backward(const T* grad_points, const T* volume, VolumeShape shape, T* grad_volume, int threads);

namespace cuda {
template <typename T>
void gridding_reverse_forward(const T* volume, VolumeShape shape, T fill, T* points, std::uintptr_t stream);
template <typename T>
void gridding_reverse_backward(const T* grad_points, const T* volume, VolumeShape shape, T* grad_volume,
                               std::uintptr_t stream);
}  // namespace cuda

constexpr double kLeastWeight = 1e-6;

}  // namespace touchnet

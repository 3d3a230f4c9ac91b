// Points located a block at a time: the map of cell.h on arrays, so that it vectorises and the loads of a block
// overlap.
#pragma once

#include <algorithm>
#include <limits>

#include "cell.h"
#include "parallel.h"

namespace touchnet {

enum class Outside { ignore, clamp };  // points outside the cube: gridding ignores them, samplers clamp

template <typename T>
struct Block {
  static constexpr int kSize = 64;
  T x[3][kSize];                   // coordinates, by axis
  std::int32_t index[3][kSize];    // lower vertex of the cell
  T t[3][kSize], slope[3][kSize];  // weight of the upper vertex, its derivative
  T weight[8][kSize];              // of each corner
  std::int64_t offset[kSize];      // lower corner, in elements from the start of the batch item
  std::int32_t counts[kSize];      // 0 for points that are ignored, or not finite

  TN_INLINE void locate(const T* points, int count, const VolumeShape& shape, Outside outside) {
    for (int p = 0; p < count; ++p) {
      x[0][p] = points[3 * p];
      x[1][p] = points[3 * p + 1];
      x[2][p] = points[3 * p + 2];
    }
    const std::int32_t extents[3] = {shape.nx, shape.ny, shape.nz};
    if (outside == Outside::clamp) {
      for (int p = 0; p < count; ++p) counts[p] = all_finite(x[0][p], x[1][p], x[2][p]);
    } else {
      for (int p = 0; p < count; ++p) counts[p] = inside_cube(x[0][p], x[1][p], x[2][p]);
    }
    for (int axis = 0; axis < 3; ++axis) {
      const std::int32_t n = extents[axis];
      for (int p = 0; p < count; ++p) {
        const AxisCell<T> cell = touchnet::locate(counts[p] ? x[axis][p] : T(0), n);
        index[axis][p] = cell.index;
        t[axis][p] = cell.t;
        slope[axis][p] = cell.slope;
      }
    }
    if (shape.spans_int32()) {  // AVX2 has no 64-bit products
      const std::int32_t sx = static_cast<std::int32_t>(shape.stride_x), sy = static_cast<std::int32_t>(shape.stride_y),
                         sz = static_cast<std::int32_t>(shape.stride_z);
      for (int p = 0; p < count; ++p) offset[p] = index[0][p] * sx + index[1][p] * sy + index[2][p] * sz;
    } else {
      for (int p = 0; p < count; ++p)
        offset[p] = index[0][p] * shape.stride_x + index[1][p] * shape.stride_y + index[2][p] * shape.stride_z;
    }
  }

  TN_INLINE void trilinear_weights(int count) {
    for (int corner = 0; corner < 8; ++corner)
      for (int p = 0; p < count; ++p) weight[corner][p] = cell(p).weight(corner);
  }

  TN_INLINE void unit_weights(int count) {
    for (int corner = 0; corner < 8; ++corner) std::fill(weight[corner], weight[corner] + count, T(1));
  }

  TN_INLINE Cell<T> cell(int p) const {
    return {
        {index[0][p], t[0][p], slope[0][p]}, {index[1][p], t[1][p], slope[1][p]}, {index[2][p], t[2][p], slope[2][p]}};
  }
};

// Splits [first, last) of batch * m points into blocks within a batch item and calls fn(b, first point, count).
template <typename T, typename Fn>
TN_INLINE void for_blocks(std::int64_t first, std::int64_t last, std::int64_t m, const Fn& fn) {
  while (first < last) {
    const std::int64_t b = first / m;
    const std::int64_t end = std::min({last, (b + 1) * m, first + Block<T>::kSize});
    fn(b, first, static_cast<int>(end - first));
    first = end;
  }
}

// The points of a block with corners in rows [low, high) along x, in order, and which corners [first[p], last[p]) of
// point p do: all eight but for points at the edges of the rows.
template <typename T>
struct SlabPoints {
  std::int32_t point[Block<T>::kSize], first[Block<T>::kSize], last[Block<T>::kSize];
  int count;

  TN_INLINE void select(const Block<T>& block, int size, std::int64_t low, std::int64_t high) {
    const std::int32_t begin = static_cast<std::int32_t>(low), end = static_cast<std::int32_t>(high);
    std::int32_t all = 8;
    for (int p = 0; p < size; ++p) {
      const std::int32_t row = block.index[0][p];
      const std::int32_t lower = row >= begin && row < end ? 4 : 0, upper = row + 1 >= begin && row + 1 < end ? 4 : 0;
      const std::int32_t some = block.counts[p] ? lower | upper : 0;
      first[p] = 4 - lower;
      last[p] = some ? 4 + upper : 4 - lower;
      point[p] = p;
      all = last[p] - first[p] < all ? last[p] - first[p] : all;
    }
    count = size;
    if (all == 8) return;
    count = 0;
    for (int p = 0; p < size; ++p) {  // without branches: which slab a point falls into cannot be predicted
      point[count] = p;
      count += last[p] > first[p];
    }
  }
};

// Distances in elements from a cell's lower corner to its corners.
struct Corners {
  std::int64_t at[8];
  explicit Corners(const VolumeShape& shape) {
    for (int c = 0; c < 8; ++c) at[c] = shape.corner(c);
  }
};

}  // namespace touchnet

// Scattering points into volumes on several threads with the same bits for any number of them.
//
// The x-rows of all batch items are dealt out to the threads in contiguous slabs. Each thread zeroes its slab and goes
// through all points of the batch items it meets, in order, adding only what falls into its slab: every vertex is
// accumulated by one thread in the order of the points.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "cell.h"
#include "parallel.h"
#include "stream.h"

namespace touchnet {

// Zeroes rows [low, high) along x of batch item b of a dense volume.
template <typename T>
void zero_rows(T* volume, const VolumeShape& shape, std::int64_t b, std::int64_t low, std::int64_t high) {
  const std::int64_t plane = std::int64_t(shape.ny) * shape.nz;
  T* item = volume + b * shape.stride_b;
  if (shape.channels > 1 && shape.stride_c == 1) {  // channels last
    T* begin = item + low * shape.stride_x;
    const std::size_t bytes = sizeof(T) * (high - low) * plane * shape.channels;
    if (worth_streaming(sizeof(T) * shape.batch * shape.channels * shape.nx * plane)) {
      stream_zero(begin, bytes);
      stream_fence();
    } else {
      std::memset(begin, 0, bytes);
    }
  } else {
    for (std::int64_t c = 0; c < shape.channels; ++c)
      std::memset(item + c * shape.stride_c + low * shape.stride_x, 0, sizeof(T) * (high - low) * plane);
  }
}

// Bounds of `threads` slabs of about equal work: zeroing a row, and the points in its cells (from every 16th point: the
// bounds decide the speed only, never the result).
template <typename T>
std::vector<std::int64_t> balanced_slabs(const VolumeShape& shape, const T* points, std::int64_t n, double row_cost,
                                         double point_cost, int threads) {
  const std::int64_t rows = shape.batch * shape.nx;
  std::vector<double> cost(rows, row_cost);
  constexpr std::int64_t kEvery = 16;
  for (std::int64_t b = 0; b < shape.batch; ++b) {
    for (std::int64_t p = 0; p < n; p += kEvery) {
      const T x = points[3 * (b * n + p)];
      if (!(x - x == T(0))) continue;
      const std::int64_t row = b * shape.nx + locate(x, shape.nx).index;
      cost[row] += point_cost * kEvery / 2;
      cost[row + 1] += point_cost * kEvery / 2;
    }
  }
  double total = 0;
  for (const double c : cost) total += c;
  std::vector<std::int64_t> bounds(threads + 1, rows);
  bounds[0] = 0;
  double sum = 0;
  int t = 1;
  for (std::int64_t row = 0; row < rows && t < threads; ++row) {
    sum += cost[row];
    while (t < threads && sum >= total * t / threads) bounds[t++] = row + 1;
  }
  // A few rows of a batch item cost a look at all of its points: leave them to the thread that has the rest.
  for (t = 1; t < threads; ++t) {
    const std::int64_t item = (bounds[t] + shape.nx / 2) / shape.nx * shape.nx;
    if (std::abs(bounds[t] - item) <= shape.nx / 8) bounds[t] = item;
  }
  return bounds;
}

// Calls add(b, low, high) for every batch item and slab of rows; add scatters the item's points into these rows only.
template <typename T, typename Add>
void scatter_in_slabs(T* volume, const VolumeShape& shape, const T* points, std::int64_t n, double point_nanoseconds,
                      int threads, const Add& add) {
  const double row_elements = double(shape.ny) * shape.nz * shape.channels;
  const double row_nanoseconds = row_elements * sizeof(T) / 10.0;  // zeroing runs at some 10 GB/s a core
  const double total = shape.batch * (shape.nx * row_nanoseconds + n * point_nanoseconds);
  const int used = static_cast<int>(
      std::min<std::int64_t>(worth_threads(total * 1e-3, threads), std::max<std::int64_t>(shape.batch * shape.nx, 1)));
  const std::vector<std::int64_t> bounds =
      used == 1 ? std::vector<std::int64_t>{0, shape.batch * shape.nx}
                : balanced_slabs(shape, points, n, row_nanoseconds, point_nanoseconds, used);
  parallel_for(0, used, used, [&](std::int64_t first, std::int64_t last) {
    for (std::int64_t row = bounds[first]; row < bounds[last];) {
      const std::int64_t b = row / shape.nx;
      const std::int64_t end = std::min(bounds[last], (b + 1) * shape.nx);
      const std::int64_t low = row - b * shape.nx, high = end - b * shape.nx;
      zero_rows(volume, shape, b, low, high);
      add(b, low, high);
      row = end;
    }
  });
}

}  // namespace touchnet

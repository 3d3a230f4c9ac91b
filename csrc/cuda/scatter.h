// Adding points into volumes on CUDA: by atomic addition, whose order varies from run to run, or, for deterministic
// algorithms, by collecting at each vertex the points of the cells around it in a fixed order.
#pragma once

#include "cell.h"
#include "cuda/launch.h"

namespace touchnet::cuda {

// Points sorted by cell. Cell (i, j, k) of item b has the number ((b (nx - 1) + i) (ny - 1) + j) (nz - 1) + k; its
// points, numbered through all batch items, are order[starts[cell]] ... order[starts[cell + 1] - 1]. Null: add
// atomically.
struct Sorted {
  const std::int64_t* order;
  const std::int64_t* starts;
};

TN_INLINE std::int64_t cells_of_item(const VolumeShape& shape) {
  return std::int64_t(shape.nx - 1) * (shape.ny - 1) * (shape.nz - 1);
}

// Writes the sum of the points' contributions over a dense volume. `source` tells what they are:
//   source.cell(point) -> Cell, source.counts(point) -> bool, source.value(point, cell, corner, channel) -> Accumulated
template <typename T, typename Source>
void scatter(const char* what, T* volume, const VolumeShape& shape, std::int64_t points, const Sorted& sorted,
             const Source& source, std::uintptr_t stream) {
  const std::int64_t channels = shape.channels;
  const std::int64_t vertices = std::int64_t(shape.nx) * shape.ny * shape.nz;
  if (!sorted.order) {
    zero(what, volume, shape.batch * channels * vertices, stream);
    for_each(what, shape.batch * points * channels, stream, [=] TN_BODY(std::int64_t index) {
      const std::int64_t point = index / channels, channel = index % channels;
      if (!source.counts(point)) return;
      const auto cell = source.cell(point);
      T* base = volume + point / points * shape.stride_b + channel * shape.stride_c + shape.offset(cell);
      for (int corner = 0; corner < 8; ++corner)
        atomic_add(base + shape.corner(corner), T(source.value(point, cell, corner, channel)));
    });
    return;
  }
  const bool channels_last = shape.stride_c == 1;  // consecutive threads write consecutive elements
  for_each(what, shape.batch * channels * vertices, stream, [=] TN_BODY(std::int64_t index) {
    const std::int64_t b = index / (channels * vertices), rest = index % (channels * vertices);
    const std::int64_t channel = channels_last ? rest % channels : rest / vertices;
    const std::int64_t vertex = channels_last ? rest / channels : rest % vertices;
    const std::int64_t k = vertex % shape.nz, j = vertex / shape.nz % shape.ny, i = vertex / shape.nz / shape.ny;
    T sum = T(0);
    for (int corner = 0; corner < 8; ++corner) {  // this vertex is that corner of a cell
      const std::int64_t ci = i - (corner >> 2 & 1), cj = j - (corner >> 1 & 1), ck = k - (corner & 1);
      if (ci < 0 || cj < 0 || ck < 0 || ci >= shape.nx - 1 || cj >= shape.ny - 1 || ck >= shape.nz - 1) continue;
      const std::int64_t number =
          b * cells_of_item(shape) + (ci * (shape.ny - 1) + cj) * std::int64_t(shape.nz - 1) + ck;
      for (std::int64_t s = sorted.starts[number]; s < sorted.starts[number + 1]; ++s) {
        const std::int64_t point = sorted.order[s];
        sum += T(source.value(point, source.cell(point), corner, channel));
      }
    }
    volume[b * shape.stride_b + channel * shape.stride_c + i * shape.stride_x + j * shape.stride_y +
           k * shape.stride_z] = sum;
  });
}

}  // namespace touchnet::cuda

#include "sampling.h"

#include <algorithm>
#include <limits>

#include "block.h"
#include "slabs.h"
#include "stream.h"

namespace touchnet {
namespace {

enum class Kind { trilinear, addition };

// Channels are taken in pieces of one cache line. Sums over channels keep one partial sum a lane of the piece, whatever
// the vector width of the processor, so that all give the same bits.
template <typename T>
constexpr int kLanes = 64 / sizeof(T);

// How many points ahead the eight rows of a point are prefetched: they lie anywhere in the volume.
constexpr int kAhead = 3;

template <typename T>
TN_INLINE void prefetch_corners(const T* base, const Corners& corners) {
  for (int c = 0; c < 8; ++c) TN_PREFETCH(base + corners.at[c]);
}

// Locates a block and weighs its corners; a point that is not finite gets NaN weights, which make its row NaN.
template <Kind kind, typename T>
TN_INLINE void prepare(Block<T>& block, const T* points, int count, const VolumeShape& shape) {
  block.locate(points, count, shape, Outside::clamp);
  if (kind == Kind::trilinear)
    block.trilinear_weights(count);
  else
    block.unit_weights(count);
  for (int corner = 0; corner < 8; ++corner)
    for (int p = 0; p < count; ++p)
      block.weight[corner][p] = block.counts[p] ? block.weight[corner][p] : std::numeric_limits<T>::quiet_NaN();
}

// One row of sums over the eight corners; lanes is a compile-time number of channels at base.
template <int lanes, typename T>
TN_INLINE void weighted_sum(const T* base, const Corners& corners, const Block<T>& block, int p, T* out) {
  T sum[lanes];
  for (int l = 0; l < lanes; ++l) sum[l] = block.weight[0][p] * base[corners.at[0] + l];
  for (int c = 1; c < 8; ++c) {
    const T* vertex = base + corners.at[c];
    const T weight = block.weight[c][p];
    for (int l = 0; l < lanes; ++l) sum[l] += weight * vertex[l];
  }
  for (int l = 0; l < lanes; ++l) out[l] = sum[l];
}

template <Kind kind, typename T>
void sample_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads) {
  const Corners corners(shape);
  const std::int64_t channels = shape.channels;
  const double microseconds = shape.batch * m * (6.0 + 0.5 * channels) * 1e-3;
  parallel_for(0, shape.batch * m, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      Block<T> block;
      for_blocks<T>(first, last, m, [&](std::int64_t b, std::int64_t start, int count) TN_LAMBDA_INLINE {
        const T* item = volume + b * shape.stride_b;
        prepare<kind>(block, points + 3 * start, count, shape);
        if (shape.stride_c == 1) {
          for (int p = 0; p < kAhead && p < count; ++p) prefetch_corners(item + block.offset[p], corners);
          for (int p = 0; p < count; ++p) {
            if (p + kAhead < count) prefetch_corners(item + block.offset[p + kAhead], corners);
            const T* base = item + block.offset[p];
            T* row = out + (start + p) * channels;
            std::int64_t c = 0;
            for (; c + kLanes<T> <= channels; c += kLanes<T>)
              weighted_sum<kLanes<T>>(base + c, corners, block, p, row + c);
            for (; c + 4 <= channels; c += 4) weighted_sum<4>(base + c, corners, block, p, row + c);
            for (; c < channels; ++c) weighted_sum<1>(base + c, corners, block, p, row + c);
          }
        } else {
          for (std::int64_t c = 0; c < channels; ++c)
            for (int p = 0; p < count; ++p)
              weighted_sum<1>(item + c * shape.stride_c + block.offset[p], corners, block, p,
                              out + (start + p) * channels + c);
        }
      });
    });
  });
}

// vertex += weight * gradient over the channels.
template <typename T>
TN_INLINE void add_row(T* vertex, T weight, const T* gradient, std::int64_t channels) {
  std::int64_t c = 0;
  for (; c + kLanes<T> <= channels; c += kLanes<T>)
    for (int l = 0; l < kLanes<T>; ++l) vertex[c + l] += weight * gradient[c + l];
  for (; c < channels; ++c) vertex[c] += weight * gradient[c];
}

template <Kind kind, typename T>
void sample_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                            int threads) {
  const Corners corners(shape);
  const std::int64_t channels = shape.channels;
  const auto add = [&](std::int64_t b, std::int64_t low, std::int64_t high) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      T* item = grad_volume + b * shape.stride_b;
      Block<T> block;
      SlabPoints<T> chosen;
      for_blocks<T>(b * m, (b + 1) * m, m, [&](std::int64_t, std::int64_t start, int count) TN_LAMBDA_INLINE {
        prepare<kind>(block, points + 3 * start, count, shape);
        chosen.select(block, count, low, high);
        if (shape.stride_c == 1) {
          for (int s = 0; s < chosen.count; ++s) {
            if (s + kAhead < chosen.count) prefetch_corners(item + block.offset[chosen.point[s + kAhead]], corners);
            const int p = chosen.point[s];
            const T* gradient = grad_out + (start + p) * channels;
            for (int corner = chosen.first[p]; corner < chosen.last[p]; ++corner)
              add_row(item + block.offset[p] + corners.at[corner], block.weight[corner][p], gradient, channels);
          }
        } else {
          for (std::int64_t c = 0; c < channels; ++c) {
            for (int s = 0; s < chosen.count; ++s) {
              const int p = chosen.point[s];
              T* base = item + c * shape.stride_c + block.offset[p];
              const T gradient = grad_out[(start + p) * channels + c];
              for (int corner = chosen.first[p]; corner < chosen.last[p]; ++corner)
                base[corners.at[corner]] += block.weight[corner][p] * gradient;
            }
          }
        }
      });
    });
  };
  scatter_in_slabs(grad_volume, shape, points, m, 10.0 + 1.0 * channels, threads, add);
}

// The gradients of the interpolated values, times the output's gradient, added into sum[axis][lane].
template <int lanes, typename T>
TN_INLINE void add_gradients(const T* base, const Corners& corners, const Cell<T>& cell, const T* gradient, T* sum_x,
                             T* sum_y, T* sum_z) {
  for (int l = 0; l < lanes; ++l) {
    T values[8];
    for (int corner = 0; corner < 8; ++corner) values[corner] = base[corners.at[corner] + l];
    const CellGradient<T> along = cell.gradient(values);
    sum_x[l] += gradient[l] * along.x;
    sum_y[l] += gradient[l] * along.y;
    sum_z[l] += gradient[l] * along.z;
  }
}

template <int lanes, typename T>
TN_INLINE T tree_sum(T* values) {
  for (int width = lanes / 2; width > 0; width /= 2)
    for (int l = 0; l < width; ++l) values[l] += values[l + width];
  return values[0];
}

}  // namespace

template <typename T>
void trilinear_backward_points(const T* grad_out, const T* volume, VolumeShape shape, const T* points, std::int64_t m,
                               T* grad_points, int threads) {
  const Corners corners(shape);
  const std::int64_t channels = shape.channels;
  const double microseconds = shape.batch * m * (10.0 + 1.0 * channels) * 1e-3;
  parallel_for(0, shape.batch * m, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      constexpr int lanes = kLanes<T>;
      Block<T> block;
      for_blocks<T>(first, last, m, [&](std::int64_t b, std::int64_t start, int count) TN_LAMBDA_INLINE {
        const T* item = volume + b * shape.stride_b;
        block.locate(points + 3 * start, count, shape, Outside::clamp);
        for (int p = 0; p < count; ++p) {
          if (p + kAhead < count && shape.stride_c == 1) prefetch_corners(item + block.offset[p + kAhead], corners);
          const Cell<T> cell = block.cell(p);
          const T* base = item + block.offset[p];
          const T* gradient = grad_out + (start + p) * channels;
          T x[lanes] = {}, y[lanes] = {}, z[lanes] = {};
          std::int64_t c = 0;
          if (shape.stride_c == 1)
            for (; c + lanes <= channels; c += lanes)
              add_gradients<lanes>(base + c, corners, cell, gradient + c, x, y, z);
          for (; c < channels; ++c) {
            const int l = static_cast<int>(c % lanes);
            add_gradients<1>(base + c * shape.stride_c, corners, cell, gradient + c, x + l, y + l, z + l);
          }
          T* result = grad_points + 3 * (start + p);
          const bool finite = block.counts[p];
          result[0] = finite ? cell.x.slope * tree_sum<lanes>(x) : T(0);
          result[1] = finite ? cell.y.slope * tree_sum<lanes>(y) : T(0);
          result[2] = finite ? cell.z.slope * tree_sum<lanes>(z) : T(0);
        }
      });
    });
  });
}

template <typename T>
void trilinear_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads) {
  sample_forward<Kind::trilinear>(volume, shape, points, m, out, threads);
}

template <typename T>
void trilinear_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                               int threads) {
  sample_backward_volume<Kind::trilinear>(grad_out, points, m, grad_volume, shape, threads);
}

template <typename T>
void addition_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads) {
  sample_forward<Kind::addition>(volume, shape, points, m, out, threads);
}

template <typename T>
void addition_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                              int threads) {
  sample_backward_volume<Kind::addition>(grad_out, points, m, grad_volume, shape, threads);
}

template <typename T>
void cubic_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads) {
  const Corners corners(shape);
  const std::int64_t channels = shape.channels;
  const double microseconds = shape.batch * m * (6.0 + 3.0 * channels) * 1e-3;
  const bool streams = worth_streaming(sizeof(T) * shape.batch * m * 8 * channels);
  parallel_for(0, shape.batch * m, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    Block<T> block;
    for_blocks<T>(first, last, m, [&](std::int64_t b, std::int64_t start, int count) {
      const T* item = volume + b * shape.stride_b;
      block.locate(points + 3 * start, count, shape, Outside::clamp);
      for (int p = 0; p < count; ++p) {
        T* rows = out + (start + p) * 8 * channels;
        if (!block.counts[p]) {
          std::fill(rows, rows + 8 * channels, std::numeric_limits<T>::quiet_NaN());
          continue;
        }
        for (int corner = 0; corner < 8; ++corner) {
          const T* vertex = item + block.offset[p] + corners.at[corner];
          T* row = rows + corner * channels;
          if (shape.stride_c == 1 && streams)
            stream_copy(row, vertex, sizeof(T) * channels);
          else if (shape.stride_c == 1)
            std::memcpy(row, vertex, sizeof(T) * channels);
          else
            for (std::int64_t c = 0; c < channels; ++c) row[c] = vertex[c * shape.stride_c];
        }
      }
    });
    if (streams) stream_fence();
  });
}

template <typename T>
void cubic_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                           int threads) {
  const Corners corners(shape);
  const std::int64_t channels = shape.channels;
  const auto add = [&](std::int64_t b, std::int64_t low, std::int64_t high) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      T* item = grad_volume + b * shape.stride_b;
      Block<T> block;
      SlabPoints<T> chosen;
      for_blocks<T>(b * m, (b + 1) * m, m, [&](std::int64_t, std::int64_t start, int count) TN_LAMBDA_INLINE {
        block.locate(points + 3 * start, count, shape, Outside::clamp);
        chosen.select(block, count, low, high);
        for (int s = 0; s < chosen.count; ++s) {
          const int p = chosen.point[s];
          for (int corner = chosen.first[p]; corner < chosen.last[p]; ++corner) {
            T* vertex = item + block.offset[p] + corners.at[corner];
            const T* gradient = grad_out + ((start + p) * 8 + corner) * channels;
            if (shape.stride_c == 1)
              add_row(vertex, T(1), gradient, channels);
            else
              for (std::int64_t c = 0; c < channels; ++c) vertex[c * shape.stride_c] += gradient[c];
          }
        }
      });
    });
  };
  scatter_in_slabs(grad_volume, shape, points, m, 10.0 + 1.0 * channels, threads, add);
}

#define TN_INSTANTIATE(T)                                                                                       \
  template void trilinear_forward<T>(const T*, VolumeShape, const T*, std::int64_t, T*, int);                   \
  template void trilinear_backward_volume<T>(const T*, const T*, std::int64_t, T*, VolumeShape, int);           \
  template void trilinear_backward_points<T>(const T*, const T*, VolumeShape, const T*, std::int64_t, T*, int); \
  template void addition_forward<T>(const T*, VolumeShape, const T*, std::int64_t, T*, int);                    \
  template void addition_backward_volume<T>(const T*, const T*, std::int64_t, T*, VolumeShape, int);            \
  template void cubic_forward<T>(const T*, VolumeShape, const T*, std::int64_t, T*, int);                       \
  template void cubic_backward_volume<T>(const T*, const T*, std::int64_t, T*, VolumeShape, int);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)
#undef TN_INSTANTIATE

}  // namespace touchnet

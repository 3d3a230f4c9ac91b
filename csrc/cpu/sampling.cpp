#include "sampling.h"

#include <algorithm>
#include <limits>

#include "slabs.h"

namespace touchnet {
namespace {

enum class Kind { trilinear, addition };

// Channels are taken in pieces of one cache line. Sums over channels keep one partial sum a lane of the piece, whatever
// the vector width of the processor, so that all give the same bits.
template <typename T>
constexpr int kLanes = 64 / sizeof(T);

// Points are located a block at a time, so that the loads of a block overlap.
constexpr int kBlock = 64;

template <typename T>
struct Block {
  std::int64_t offset[kBlock];  // lower corner of the cell, in elements from the start of the batch item
  Cell<T> cell[kBlock];
  bool finite[kBlock];

  TN_INLINE void locate(const T* points, int count, const VolumeShape& shape) {
    for (int p = 0; p < count; ++p) {
      const T* point = points + 3 * p;
      const T zero[3] = {T(0), T(0), T(0)};
      finite[p] = all_finite(point[0], point[1], point[2]);
      cell[p] = locate_point(finite[p] ? point : zero, shape.nx, shape.ny, shape.nz);
      offset[p] = shape.offset(cell[p]);
    }
  }
};

template <typename T>
struct Corners {
  std::int64_t at[8];
  explicit Corners(const VolumeShape& shape) {
    for (int c = 0; c < 8; ++c) at[c] = shape.corner(c);
  }
};

// Weights of the eight corners; NaN for a point that is not finite, which makes its row NaN.
template <Kind kind, typename T>
TN_INLINE void corner_weights(const Cell<T>& cell, bool finite, T* weights) {
  for (int c = 0; c < 8; ++c) {
    const T weight = kind == Kind::trilinear ? cell.weight(c) : T(1);
    weights[c] = finite ? weight : std::numeric_limits<T>::quiet_NaN();
  }
}

// One row of sums over the eight corners; lanes is a compile-time number of channels at base.
template <int lanes, typename T>
TN_INLINE void weighted_sum(const T* base, const Corners<T>& corners, const T* weights, T* out) {
  T sum[lanes];
  for (int l = 0; l < lanes; ++l) sum[l] = weights[0] * base[corners.at[0] + l];
  for (int c = 1; c < 8; ++c) {
    const T* vertex = base + corners.at[c];
    for (int l = 0; l < lanes; ++l) sum[l] += weights[c] * vertex[l];
  }
  for (int l = 0; l < lanes; ++l) out[l] = sum[l];
}

// Splits [0, batch * m) into blocks that stay within a batch item and calls fn(b, first point, count).
template <typename Fn>
TN_INLINE void for_blocks(std::int64_t first, std::int64_t last, std::int64_t m, const Fn& fn) {
  while (first < last) {
    const std::int64_t b = first / m;
    const std::int64_t end = std::min({last, (b + 1) * m, first + kBlock});
    fn(b, first, static_cast<int>(end - first));
    first = end;
  }
}

template <Kind kind, typename T>
void sample_forward(const T* volume, VolumeShape shape, const T* points, std::int64_t m, T* out, int threads) {
  const Corners<T> corners(shape);
  const std::int64_t channels = shape.channels;
  const double microseconds = shape.batch * m * (6.0 + 0.5 * channels) * 1e-3;
  parallel_for(0, shape.batch * m, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      Block<T> block;
      for_blocks(first, last, m, [&](std::int64_t b, std::int64_t start, int count) TN_LAMBDA_INLINE {
        const T* item = volume + b * shape.stride_b;
        block.locate(points + 3 * start, count, shape);
        T weights[kBlock][8];
        for (int p = 0; p < count; ++p) corner_weights<kind>(block.cell[p], block.finite[p], weights[p]);
        if (shape.stride_c == 1) {
          for (int p = 0; p < count; ++p) {
            const T* base = item + block.offset[p];
            T* row = out + (start + p) * channels;
            std::int64_t c = 0;
            for (; c + kLanes<T> <= channels; c += kLanes<T>)
              weighted_sum<kLanes<T>>(base + c, corners, weights[p], row + c);
            for (; c + 4 <= channels; c += 4) weighted_sum<4>(base + c, corners, weights[p], row + c);
            for (; c < channels; ++c) weighted_sum<1>(base + c, corners, weights[p], row + c);
          }
        } else {
          for (std::int64_t c = 0; c < channels; ++c)
            for (int p = 0; p < count; ++p)
              weighted_sum<1>(item + c * shape.stride_c + block.offset[p], corners, weights[p],
                              out + (start + p) * channels + c);
        }
      });
    });
  });
}

template <Kind kind, typename T>
void sample_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                            int threads) {
  const Corners<T> corners(shape);
  const std::int64_t channels = shape.channels;
  scatter_in_slabs(grad_volume, shape, points, m, 10.0 + 1.0 * channels, threads,
                   [&](std::int64_t b, std::int64_t low, std::int64_t high) {
                     run_vectorised([&]() TN_LAMBDA_INLINE {
                       T* item = grad_volume + b * shape.stride_b;
                       Block<T> block;
                       for_blocks(b * m, (b + 1) * m, m,
                                  [&](std::int64_t, std::int64_t start, int count) TN_LAMBDA_INLINE {
                                    block.locate(points + 3 * start, count, shape);
                                    T weights[kBlock][8];
                                    for (int p = 0; p < count; ++p)
                                      corner_weights<kind>(block.cell[p], block.finite[p], weights[p]);
                                    const auto corner_in_slab = [&](int p, int corner) TN_LAMBDA_INLINE {
                                      const std::int64_t row = block.cell[p].x.index + (corner >> 2);
                                      return block.finite[p] && row >= low && row < high;
                                    };
                                    if (shape.stride_c == 1) {
                                      for (int p = 0; p < count; ++p) {
                                        const T* gradient = grad_out + (start + p) * channels;
                                        for (int corner = 0; corner < 8; ++corner) {
                                          if (!corner_in_slab(p, corner)) continue;
                                          T* vertex = item + block.offset[p] + corners.at[corner];
                                          for (std::int64_t c = 0; c < channels; ++c)
                                            vertex[c] += weights[p][corner] * gradient[c];
                                        }
                                      }
                                    } else {
                                      for (std::int64_t c = 0; c < channels; ++c) {
                                        for (int p = 0; p < count; ++p) {
                                          T* base = item + c * shape.stride_c + block.offset[p];
                                          const T gradient = grad_out[(start + p) * channels + c];
                                          for (int corner = 0; corner < 8; ++corner)
                                            if (corner_in_slab(p, corner))
                                              base[corners.at[corner]] += weights[p][corner] * gradient;
                                        }
                                      }
                                    }
                                  });
                     });
                   });
}

// The derivative of the interpolated value along each axis in cell units, times the output's gradient, added into
// sum[axis][lane]. Linear interpolation along x, then y, then z; each stage's difference is the derivative before it.
template <int lanes, typename T>
TN_INLINE void add_derivatives(const T* base, const Corners<T>& corners, const Cell<T>& cell, const T* gradient,
                               T* sum_x, T* sum_y, T* sum_z) {
  const T x = cell.x.t, y = cell.y.t, z = cell.z.t;
  for (int l = 0; l < lanes; ++l) {
    const T* v = base + l;
    const T v000 = v[corners.at[0]], v001 = v[corners.at[1]], v010 = v[corners.at[2]], v011 = v[corners.at[3]];
    const T d00 = v[corners.at[4]] - v000, d01 = v[corners.at[5]] - v001;
    const T d10 = v[corners.at[6]] - v010, d11 = v[corners.at[7]] - v011;
    const T m00 = v000 + x * d00, m01 = v001 + x * d01, m10 = v010 + x * d10, m11 = v011 + x * d11;
    const T e0 = m10 - m00, e1 = m11 - m01;
    const T n0 = m00 + y * e0, n1 = m01 + y * e1;
    sum_x[l] += gradient[l] * (((T(1) - y) * d00 + y * d10) * (T(1) - z) + ((T(1) - y) * d01 + y * d11) * z);
    sum_y[l] += gradient[l] * ((T(1) - z) * e0 + z * e1);
    sum_z[l] += gradient[l] * (n1 - n0);
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
  const Corners<T> corners(shape);
  const std::int64_t channels = shape.channels;
  const double microseconds = shape.batch * m * (10.0 + 1.0 * channels) * 1e-3;
  parallel_for(0, shape.batch * m, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      constexpr int lanes = kLanes<T>;
      Block<T> block;
      for_blocks(first, last, m, [&](std::int64_t b, std::int64_t start, int count) TN_LAMBDA_INLINE {
        const T* item = volume + b * shape.stride_b;
        block.locate(points + 3 * start, count, shape);
        for (int p = 0; p < count; ++p) {
          const Cell<T>& cell = block.cell[p];
          const T* base = item + block.offset[p];
          const T* gradient = grad_out + (start + p) * channels;
          T x[lanes] = {}, y[lanes] = {}, z[lanes] = {};
          std::int64_t c = 0;
          if (shape.stride_c == 1)
            for (; c + lanes <= channels; c += lanes)
              add_derivatives<lanes>(base + c, corners, cell, gradient + c, x, y, z);
          for (; c < channels; ++c) {
            const int l = static_cast<int>(c % lanes);
            add_derivatives<1>(base + c * shape.stride_c, corners, cell, gradient + c, x + l, y + l, z + l);
          }
          T* result = grad_points + 3 * (start + p);
          const bool finite = block.finite[p];
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
  const Corners<T> corners(shape);
  const std::int64_t channels = shape.channels;
  const double microseconds = shape.batch * m * (6.0 + 3.0 * channels) * 1e-3;
  parallel_for(0, shape.batch * m, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    Block<T> block;
    for_blocks(first, last, m, [&](std::int64_t b, std::int64_t start, int count) {
      const T* item = volume + b * shape.stride_b;
      block.locate(points + 3 * start, count, shape);
      for (int p = 0; p < count; ++p) {
        T* rows = out + (start + p) * 8 * channels;
        if (!block.finite[p]) {
          std::fill(rows, rows + 8 * channels, std::numeric_limits<T>::quiet_NaN());
          continue;
        }
        for (int corner = 0; corner < 8; ++corner) {
          const T* vertex = item + block.offset[p] + corners.at[corner];
          T* row = rows + corner * channels;
          if (shape.stride_c == 1)
            std::memcpy(row, vertex, sizeof(T) * channels);
          else
            for (std::int64_t c = 0; c < channels; ++c) row[c] = vertex[c * shape.stride_c];
        }
      }
    });
  });
}

template <typename T>
void cubic_backward_volume(const T* grad_out, const T* points, std::int64_t m, T* grad_volume, VolumeShape shape,
                           int threads) {
  const Corners<T> corners(shape);
  const std::int64_t channels = shape.channels;
  scatter_in_slabs(grad_volume, shape, points, m, 10.0 + 1.0 * channels, threads,
                   [&](std::int64_t b, std::int64_t low, std::int64_t high) {
                     T* item = grad_volume + b * shape.stride_b;
                     Block<T> block;
                     for_blocks(b * m, (b + 1) * m, m, [&](std::int64_t, std::int64_t start, int count) {
                       block.locate(points + 3 * start, count, shape);
                       for (int p = 0; p < count; ++p) {
                         if (!block.finite[p]) continue;
                         for (int corner = 0; corner < 8; ++corner) {
                           const std::int64_t row = block.cell[p].x.index + (corner >> 2);
                           if (row < low || row >= high) continue;
                           T* vertex = item + block.offset[p] + corners.at[corner];
                           const T* gradient = grad_out + ((start + p) * 8 + corner) * channels;
                           if (shape.stride_c == 1)
                             for (std::int64_t c = 0; c < channels; ++c) vertex[c] += gradient[c];
                           else
                             for (std::int64_t c = 0; c < channels; ++c) vertex[c * shape.stride_c] += gradient[c];
                         }
                       }
                     });
                   });
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

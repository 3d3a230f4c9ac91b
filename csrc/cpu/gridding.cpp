#include "gridding.h"

#include <cstring>
#include <memory>

#include "block.h"
#include "slabs.h"

namespace touchnet {
namespace {

// Two neighbours along z, added to in one instruction.
template <typename T>
struct Pair {
  T lower, upper;

  TN_INLINE void add_to(T* vertex) const {
#if defined(__GNUC__)
    typedef T Vector __attribute__((vector_size(2 * sizeof(T))));
    Vector sum;
    std::memcpy(&sum, vertex, sizeof(sum));
    sum += Vector{lower, upper};
    std::memcpy(vertex, &sum, sizeof(sum));
#else
    vertex[0] += lower;
    vertex[1] += upper;
#endif
  }
};

// Adds a batch item's points to rows [low, high) of its volume, a density alone (vertices adjacent along z).
template <typename T>
void add_density(const T* points, std::int64_t n, T* item, const VolumeShape& shape, std::int64_t low,
                 std::int64_t high) {
  run_vectorised([&]() TN_LAMBDA_INLINE {
    Block<T> block;
    SlabPoints<T> chosen;
    T across[4][Block<T>::kSize];  // the part of the weight that the corners of a pair share
    for_blocks<T>(0, n, n, [&](std::int64_t, std::int64_t start, int size) TN_LAMBDA_INLINE {
      block.locate(points + 3 * start, size, shape, Outside::ignore);
      for (int pair = 0; pair < 4; ++pair)
        for (int p = 0; p < size; ++p) across[pair][p] = block.cell(p).weight_xy(2 * pair);
      chosen.select(block, size, low, high);
      for (int s = 0; s < chosen.count; ++s) {
        const int p = chosen.point[s];
        T* base = item + block.offset[p];
        const T z = block.t[2][p];
        const auto add = [&](int pair) TN_LAMBDA_INLINE {
          const T weight = across[pair][p];
          Pair<T>{weight * (T(1) - z), weight * z}.add_to(base + (pair & 2 ? shape.stride_x : 0) +
                                                          (pair & 1 ? shape.stride_y : 0));
        };
        if (chosen.last[p] - chosen.first[p] == 8)
          for (int pair = 0; pair < 4; ++pair) add(pair);
        else
          for (int pair = chosen.first[p] / 2; pair < chosen.last[p] / 2; ++pair) add(pair);
      }
    });
  });
}

// Adds a batch item's points and their values to rows [low, high) of its volume.
template <typename T>
void add_values(const T* points, const T* values, std::int64_t n, T* item, const VolumeShape& shape, std::int64_t low,
                std::int64_t high) {
  const std::int64_t count = shape.channels - 1;
  const Corners corners(shape);
  run_vectorised([&]() TN_LAMBDA_INLINE {
    Block<T> block;
    SlabPoints<T> chosen;
    for_blocks<T>(0, n, n, [&](std::int64_t, std::int64_t start, int size) TN_LAMBDA_INLINE {
      block.locate(points + 3 * start, size, shape, Outside::ignore);
      block.trilinear_weights(size);
      chosen.select(block, size, low, high);
      for (int s = 0; s < chosen.count; ++s) {
        const int p = chosen.point[s];
        T* base = item + block.offset[p];
        const T* point_values = values + (start + p) * count;
        const auto add = [&](int corner) TN_LAMBDA_INLINE {
          T* vertex = base + corners.at[corner];
          const T weight = block.weight[corner][p];
          vertex[0] += weight;
          for (std::int64_t k = 0; k < count; ++k) vertex[(k + 1) * shape.stride_c] += weight * point_values[k];
        };
        if (chosen.last[p] - chosen.first[p] == 8)
          for (int corner = 0; corner < 8; ++corner) add(corner);
        else
          for (int corner = chosen.first[p]; corner < chosen.last[p]; ++corner) add(corner);
      }
    });
  });
}

// Very many points in a small volume: in slabs every thread would look at all of them. Here each share of the points
// has a volume of its own, and the volumes are added in order. The number of shares is fixed, so that the bits do not
// depend on the number of threads.
constexpr int kShares = 4;
constexpr std::int64_t kManyPoints = 1 << 16;

template <typename T>
void add_density_in_shares(const T* points, std::int64_t n, T* item, const VolumeShape& shape, int threads) {
  const std::int64_t elements = std::int64_t(shape.nx) * shape.ny * shape.nz;
  const std::unique_ptr<T[]> others(new T[(kShares - 1) * elements]);
  parallel_for(0, kShares, threads, [&](std::int64_t first, std::int64_t last) {
    for (std::int64_t share = first; share < last; ++share) {
      T* own = share == 0 ? item : others.get() + (share - 1) * elements;
      std::memset(own, 0, sizeof(T) * elements);
      const std::int64_t begin = n * share / kShares, end = n * (share + 1) / kShares;
      add_density(points + 3 * begin, end - begin, own, shape, 0, shape.nx);
    }
  });
  parallel_for(0, elements, threads, [&](std::int64_t first, std::int64_t last) {
    for (int other = 0; other < kShares - 1; ++other)
      for (std::int64_t i = first; i < last; ++i) item[i] += others[other * elements + i];
  });
}

}  // namespace

template <typename T>
void gridding_forward(const T* points, const T* values, std::int64_t n, T* volume, VolumeShape shape, int threads) {
  const std::int64_t count = shape.channels - 1;
  if (count == 0 && n >= kManyPoints && 2 * shape.nx * std::int64_t(shape.ny) * shape.nz <= n) {
    for (std::int64_t b = 0; b < shape.batch; ++b)
      add_density_in_shares(points + 3 * b * n, n, volume + b * shape.stride_b, shape, threads);
    return;
  }
  const auto add = [&](std::int64_t b, std::int64_t low, std::int64_t high) {
    T* item = volume + b * shape.stride_b;
    if (count == 0)
      add_density(points + 3 * b * n, n, item, shape, low, high);
    else
      add_values(points + 3 * b * n, values + b * n * count, n, item, shape, low, high);
  };
  scatter_in_slabs(volume, shape, points, n, 8.0 + 4.0 * count, threads, add);
}

template <typename T>
void gridding_backward(const T* grad_volume, VolumeShape shape, const T* points, const T* values, std::int64_t n,
                       T* grad_points, T* grad_values, int threads) {
  const std::int64_t count = shape.channels - 1;
  const double microseconds = shape.batch * n * (8.0 + 4.0 * count) * 1e-3;
  const Corners corners(shape);
  parallel_for(0, shape.batch * n, worth_threads(microseconds, threads), [&](std::int64_t first, std::int64_t last) {
    run_vectorised([&]() TN_LAMBDA_INLINE {
      Block<T> block;
      T along[8][Block<T>::kSize];  // d loss / d weight of each corner
      for_blocks<T>(first, last, n, [&](std::int64_t b, std::int64_t start, int size) TN_LAMBDA_INLINE {
        block.locate(points + 3 * start, size, shape, Outside::ignore);
        if (count > 0) block.trilinear_weights(size);
        const T* item = grad_volume + b * shape.stride_b;
        for (int p = 0; p < size; ++p) {
          const T* base = item + block.offset[p];
          for (int corner = 0; corner < 8; ++corner) along[corner][p] = base[corners.at[corner]];
          for (std::int64_t k = 0; k < count; ++k) {
            const std::int64_t row = (start + p) * count + k;
            T sum = T(0);
            for (int corner = 0; corner < 8; ++corner) {
              const T g = base[corners.at[corner] + (k + 1) * shape.stride_c];
              along[corner][p] += values[row] * g;
              sum += block.weight[corner][p] * g;
            }
            if (grad_values) grad_values[row] = block.counts[p] ? sum : T(0);
          }
        }
        if (!grad_points) return;
        T gradient[3][Block<T>::kSize];
        for (int p = 0; p < size; ++p) {
          const Cell<T> cell = block.cell(p);
          T values[8];
          for (int corner = 0; corner < 8; ++corner) values[corner] = along[corner][p];
          const CellGradient<T> change = cell.gradient(values);
          gradient[0][p] = block.counts[p] ? cell.x.slope * change.x : T(0);
          gradient[1][p] = block.counts[p] ? cell.y.slope * change.y : T(0);
          gradient[2][p] = block.counts[p] ? cell.z.slope * change.z : T(0);
        }
        for (int p = 0; p < size; ++p)
          for (int axis = 0; axis < 3; ++axis) grad_points[3 * (start + p) + axis] = gradient[axis][p];
      });
    });
  });
}

#define TN_INSTANTIATE(T)                                                                    \
  template void gridding_forward<T>(const T*, const T*, std::int64_t, T*, VolumeShape, int); \
  template void gridding_backward<T>(const T*, VolumeShape, const T*, const T*, std::int64_t, T*, T*, int);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)
#undef TN_INSTANTIATE

}  // namespace touchnet

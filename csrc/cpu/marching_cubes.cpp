#include "marching_cubes.h"

#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

#include "bits.h"
#include "parallel.h"

namespace touchnet {
namespace {

template <typename T>
T smallest_not_below(double level) {
  T value = static_cast<T>(level);
  if (static_cast<double>(value) < level) value = std::nextafter(value, std::numeric_limits<T>::infinity());
  return value;
}

template <typename T>
using Lane = std::conditional_t<sizeof(T) == 4, uint32_t, uint64_t>;

// Bit b says whether values[b] >= threshold; `bad` gets a bit where a value is NaN or infinite. Written as an OR over
// lanes as wide as T, which compilers turn into vector instructions.
template <typename T>
TN_LAMBDA_INLINE inline Lane<T> pack_lane(const T* values, T threshold, Lane<T>& bad) {
  Lane<T> inside = 0, wrong = 0;
  for (int b = 0; b < static_cast<int>(8 * sizeof(T)); ++b) {
    const Lane<T> bit = Lane<T>{1} << b;
    inside |= values[b] >= threshold ? bit : 0;
    wrong |= std::abs(values[b]) <= std::numeric_limits<T>::max() ? 0 : bit;
  }
  bad |= wrong;
  return inside;
}

template <typename T>
TN_LAMBDA_INLINE inline uint64_t pack(const T* values, T threshold, Lane<T>& bad) {
  uint64_t word = pack_lane(values, threshold, bad);
  if constexpr (sizeof(T) == 4) word |= static_cast<uint64_t>(pack_lane(values + 32, threshold, bad)) << 32;
  return word;
}

// The bits of a row moved down by one: bit k of the result is bit k + 1 of the row.
inline uint64_t next_bits(const uint64_t* row, int64_t w, int64_t words) {
  return row[w] >> 1 | (w + 1 < words ? row[w + 1] << 63 : 0);
}

// Four neighbouring rows, and word by word which of the cells between them are crossed.
struct CellRow {
  const uint64_t* row[4];
  int64_t words;
  uint64_t now[4], next[4];

  uint64_t crossed(int64_t w) {
    uint64_t any = 0, all = ~uint64_t{0};
    for (int r = 0; r < 4; ++r) {
      now[r] = row[r][w];
      next[r] = next_bits(row[r], w, words);
      any |= now[r] | next[r];
      all &= now[r] & next[r];
    }
    return any & ~all;
  }
  int cube_case(int bit) const {
    int result = 0;
    for (int r = 0; r < 4; ++r) result |= ((now[r] >> bit & 1) | (next[r] >> bit & 1) << 1) << (2 * r);
    return result;
  }
};

}  // namespace

template <typename T>
DenseCubes<T>::DenseCubes(const T* values, const Lattice& lattice, double level, int threads)
    : values_(values),
      lattice_(lattice),
      points_{lattice.points[0], lattice.points[1], lattice.points[2]},
      level_(level),
      threshold_(smallest_not_below<T>(level)),
      threads_(threads),
      words_((points_[2] + 2 + 63) / 64) {}

// Slices cost as much as the surface in them, so threads take them one by one instead of in equal pieces.
template <typename T>
template <typename Fn>
void DenseCubes<T>::for_slices(int64_t slices, const Fn& fn) const {
  const double microseconds = 1e-3 * static_cast<double>(points_[0] * points_[1] * points_[2]);
  std::atomic<int64_t> next{0};
  parallel_for(0, slices, worth_threads(microseconds, threads_), [&](int64_t, int64_t) {
    for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < slices;) fn(i);
  });
}

template <typename T>
int64_t DenseCubes<T>::classify(int64_t i, int64_t j) {
  const int64_t depth = points_[2];
  const T* values = values_ + (i * points_[1] + j) * depth;
  uint64_t* row = &inside_[((i + 1) * (points_[1] + 2) + j + 1) * words_];
  Lane<T> bad = 0;
  uint64_t carry = 0;
  run_vectorised([&]() TN_LAMBDA_INLINE {
    for (int64_t w = 0; w < words_; ++w) {
      const int64_t first = 64 * w, left = depth - first;
      uint64_t word = 0;
      if (left >= 64) {
        word = pack(values + first, threshold_, bad);
      } else if (left > 0) {
        T rest[64] = {};
        std::memcpy(rest, values + first, left * sizeof(T));
        word = pack(rest, threshold_, bad) & ((uint64_t{1} << left) - 1);
      }
      row[w] = word << 1 | carry;
      carry = word >> 63;
    }
  });
  if (!bad) return 0;
  int64_t count = 0;
  for (int64_t k = 0; k < depth; ++k) count += !std::isfinite(values[k]);
  return count;
}

template <typename T>
void DenseCubes<T>::count_row(int64_t i, int64_t j) {
  CellRow cells{{row(i, j), row(i, j + 1), row(i + 1, j), row(i + 1, j + 1)}, words_, {}, {}};
  RowOffsets& counts = offsets_[i * (points_[1] + 2) + j];
  for (int64_t w = 0; w < words_; ++w) {
    uint64_t crossed = cells.crossed(w);
    if (!crossed) continue;
    counts.vertex[0] += count_bits(cells.now[0] ^ cells.now[2]);
    counts.vertex[1] += count_bits(cells.now[0] ^ cells.now[1]);
    counts.vertex[2] += count_bits(cells.now[0] ^ cells.next[0]);
    for (; crossed; crossed &= crossed - 1) counts.face += kCubeTriangles[cells.cube_case(lowest_bit(crossed))][0];
  }
}

template <typename T>
typename DenseCubes<T>::Counts DenseCubes<T>::count() {
  inside_.assign((points_[0] + 2) * (points_[1] + 2) * words_, 0);
  std::atomic<int64_t> not_finite{0};
  for_slices(points_[0], [&](int64_t i) {
    int64_t found = 0;
    for (int64_t j = 0; j < points_[1]; ++j) found += classify(i, j);
    not_finite.fetch_add(found, std::memory_order_relaxed);
  });
  if (not_finite) return {0, 0, not_finite};

  offsets_.assign((points_[0] + 2) * (points_[1] + 2), RowOffsets{});
  for_slices(points_[0] + 1, [&](int64_t i) {
    for (int64_t j = 0; j <= points_[1]; ++j) count_row(i, j);
  });
  Counts total{0, 0, 0};
  for (RowOffsets& row : offsets_) {
    for (int64_t& vertex : row.vertex) {
      const int64_t count = vertex;
      vertex = total.vertices;
      total.vertices += count;
    }
    const int64_t count = row.face;
    row.face = total.faces;
    total.faces += count;
  }
  return total;
}

template <typename T>
void DenseCubes<T>::emit_vertices(int64_t i, int64_t j, double* vertices, int64_t* low, uint8_t* axis) const {
  const uint64_t *here = row(i, j), *along[2] = {row(i + 1, j), row(i, j + 1)};
  const RowOffsets& offsets = offsets_[i * (points_[1] + 2) + j];
  const int64_t stride[3] = {points_[1] * points_[2], points_[2], 1};
  for (int a = 0; a < 3; ++a) {
    int64_t id = offsets.vertex[a];
    for (int64_t w = 0; w < words_; ++w) {
      uint64_t crossed = here[w] ^ (a < 2 ? along[a][w] : next_bits(here, w, words_));
      for (; crossed; crossed &= crossed - 1, ++id) {
        const int64_t index[3] = {i - 1, j - 1, 64 * w + lowest_bit(crossed) - 1};
        const bool low_outside = index[a] < 0, high_outside = index[a] == points_[a] - 1;
        const int64_t start = index[0] * stride[0] + index[1] * stride[1] + index[2];
        const double t = low_outside || high_outside ? border_crossing(low_outside)
                                                     : crossing(values_[start], values_[start + stride[a]], level_);
        for (int d = 0; d < 3; ++d) vertices[3 * id + d] = vertex_coordinate(lattice_, d, index[d], d == a ? t : 0.0);
        if (low) {
          low[id] = low_outside || high_outside ? -1 : start;
          axis[id] = static_cast<uint8_t>(a);
        }
      }
    }
  }
}

template <typename T>
void DenseCubes<T>::emit_faces(int64_t i, int64_t j, int64_t* faces) const {
  CellRow cells{{row(i, j), row(i, j + 1), row(i + 1, j), row(i + 1, j + 1)}, words_, {}, {}};
  const RowOffsets* offsets = &offsets_[i * (points_[1] + 2) + j];
  const RowOffsets &r00 = offsets[0], &r01 = offsets[1], &r10 = offsets[points_[1] + 2], &r11 = offsets[points_[1] + 3];
  // The next vertex of each row of edges. Every crossed edge lies in a crossed cell, and cells are visited in order of
  // k, so that a counter stands at the number of the first crossed edge at or after the cell.
  int64_t x[2] = {r00.vertex[0], r01.vertex[0]};
  int64_t y[2] = {r00.vertex[1], r10.vertex[1]};
  int64_t z[4] = {r00.vertex[2], r01.vertex[2], r10.vertex[2], r11.vertex[2]};
  int64_t* out = faces + 3 * r00.face;
  for (int64_t w = 0; w < words_; ++w) {
    for (uint64_t crossed = cells.crossed(w); crossed; crossed &= crossed - 1) {
      const int cube = cells.cube_case(lowest_bit(crossed));
      const int across_x = cube ^ cube >> 4, across_y = cube ^ cube >> 2, across_z = cube ^ cube >> 1;
      const int x0 = across_x & 1, x1 = across_x >> 2 & 1, y0 = across_y & 1, y1 = across_y >> 4 & 1;
      const int64_t vertex[12] = {x[0], x[0] + x0, x[1], x[1] + x1, y[0], y[0] + y0,
                                  y[1], y[1] + y1, z[0], z[1],      z[2], z[3]};
      x[0] += x0;
      x[1] += x1;
      y[0] += y0;
      y[1] += y1;
      for (int r = 0; r < 4; ++r) z[r] += across_z >> (2 * r) & 1;
      const int8_t* triangles = kCubeTriangles[cube];
      for (int corner = 0; corner < 3 * triangles[0]; ++corner) *out++ = vertex[triangles[1 + corner]];
    }
  }
}

template <typename T>
void DenseCubes<T>::emit(double* vertices, int64_t* faces, int64_t* low, uint8_t* axis) const {
  for_slices(points_[0] + 1, [&](int64_t i) {
    for (int64_t j = 0; j <= points_[1]; ++j) {
      emit_vertices(i, j, vertices, low, axis);
      emit_faces(i, j, faces);
    }
  });
}

template class DenseCubes<float>;
template class DenseCubes<double>;

}  // namespace touchnet

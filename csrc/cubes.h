// Marching cubes on one cell: corner signs to triangles, and where the surface crosses an edge. Host and device.
//
// Corner c of a cell lies at (c >> 2 & 1, c >> 1 & 1, c & 1). Edge 4 axis + 2 u + v runs along `axis` at the offsets
// (u, v) of the other two axes in order. Why the mesh is closed for every field: docs/marching_cubes.md.
#pragma once

#include <array>
#include <cstdint>

#include "cube_table.h"

#ifdef __CUDACC__
#define TOUCHNET_CUBE_FUNCTION __host__ __device__ inline
#else
#define TOUCHNET_CUBE_FUNCTION inline
#endif

namespace touchnet {

// kCubeTriangles[case] = {number of triangles, edges of the first, edges of the second, ...}
#ifdef __CUDACC__
static __constant__ const int8_t kCubeTriangles[256][16] = {TOUCHNET_CUBE_TABLE};
#else
inline constexpr int8_t kCubeTriangles[256][16] = {TOUCHNET_CUBE_TABLE};
#endif

// A crossing keeps this fraction of its edge from both ends, so that no two vertices coincide, whatever the values.
constexpr double kCrossingMargin = 1e-3;

// Lattice of `points` values per axis; vertices lie at lower + (index + t) * spacing.
struct Lattice {
  int64_t points[3];
  double lower[3];
  double spacing[3];
};

inline Lattice make_lattice(const std::array<int64_t, 3>& points, const std::array<double, 3>& lower,
                            const std::array<double, 3>& spacing) {
  return {{points[0], points[1], points[2]}, {lower[0], lower[1], lower[2]}, {spacing[0], spacing[1], spacing[2]}};
}

// Fraction of the edge from `low` to `high` at which the field meets the level; one end is >= level, the other below.
TOUCHNET_CUBE_FUNCTION double crossing(double low, double high, double level) {
  const double largest = 1.7976931348623157e308;
  double part = level - low, whole = high - low;
  if (!(whole <= largest && whole >= -largest)) {  // overflow: halve everything
    part = 0.5 * level - 0.5 * low;
    whole = 0.5 * high - 0.5 * low;
  }
  double t = part / whole;
  t = t >= kCrossingMargin ? t : kCrossingMargin;  // written so that a NaN (denormals flushed to zero) is clamped too
  return t <= 1 - kCrossingMargin ? t : 1 - kCrossingMargin;
}

// The crossing of an edge whose lower or upper end belongs to the layer around the box, which is outside everywhere.
TOUCHNET_CUBE_FUNCTION double border_crossing(bool low_end_outside) {
  return low_end_outside ? 1 - kCrossingMargin : kCrossingMargin;
}

TOUCHNET_CUBE_FUNCTION double vertex_coordinate(const Lattice& lattice, int axis, int64_t index, double t) {
  return lattice.lower[axis] + (static_cast<double>(index) + t) * lattice.spacing[axis];
}

}  // namespace touchnet

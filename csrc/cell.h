// The one map between coordinates and a volume's vertices, shared by gridding and every sampler, host and device.
//
// A volume is indexed [b, c, i, j, k] with i along x, j along y, k along z. Along an axis of n >= 2 vertices, vertex i
// sits at -1 + 2 i / (n - 1), so the outer vertices lie on the faces of the cube [-1, 1]^3. A coordinate x falls in the
// cell between vertices i and i + 1, at the fraction t of the way; x = +1 belongs to the last cell (i = n - 2, t = 1).
#pragma once

#include <cstdint>
#include <limits>

#ifdef __CUDACC__
#define TN_INLINE __host__ __device__ __forceinline__
#elif defined(_MSC_VER)
#define TN_INLINE __forceinline
#else
#define TN_INLINE inline __attribute__((always_inline))
#endif

namespace touchnet {

// Machine epsilon as a constant that device code can read.
template <typename T>
struct Epsilon;
template <>
struct Epsilon<float> {
  static constexpr float value = 1.1920928955078125e-7f;
};
template <>
struct Epsilon<double> {
  static constexpr double value = 2.220446049250313e-16;
};

template <typename T>
struct AxisCell {
  std::int32_t index;  // lower vertex of the cell, 0 ... n - 2
  T t;                 // weight of the upper vertex, 0 ... 1
  T slope;             // dt/dx; 0 where x was clamped to the cube
};

template <typename T>
TN_INLINE T vertex_coordinate(std::int32_t i, std::int32_t n) {
  return T(-1) + T(2) * T(i) / T(n - 1);  // 2 T(i) is T(2 i): no 64-bit conversion, which AVX2 lacks
}

// The cell of a finite coordinate. t is measured from the rounded vertex and snapped to 0 or 1 within one epsilon of x
// (less than the rounding of x + 1), so that sampling at a vertex returns the vertex's value exactly.
template <typename T>
TN_INLINE AxisCell<T> locate(T x, std::int32_t n) {
  const T half = T(n - 1) * T(0.5);
  const T low = x < T(-1) ? T(-1) : x;
  const T clamped = low > T(1) ? T(1) : low;
  std::int32_t index = static_cast<std::int32_t>((clamped + T(1)) * half);
  index = index > n - 2 ? n - 2 : index;
  const T snap = half * Epsilon<T>::value;
  T t = (clamped - vertex_coordinate<T>(index, n)) * half;
  t = t < snap ? T(0) : t;
  t = t > T(1) - snap ? T(1) : t;
  return {index, t, clamped == x ? half : T(0)};
}

template <typename T>
TN_INLINE bool inside_cube(T x, T y, T z) {  // false for NaN
  return (x >= T(-1)) & (x <= T(1)) & (y >= T(-1)) & (y <= T(1)) & (z >= T(-1)) & (z <= T(1));
}

template <typename T>
TN_INLINE bool all_finite(T x, T y, T z) {
  const T zero = (x - x) + (y - y) + (z - z);  // NaN unless every coordinate is finite
  return zero == T(0);
}

// Change per cell along each axis.
template <typename T>
struct CellGradient {
  T x, y, z;
};

// A cell's trilinear weights: corner c = 4 di + 2 dj + dk with d in {0, 1}.
template <typename T>
struct Cell {
  AxisCell<T> x, y, z;

  TN_INLINE T weight_xy(int c) const { return (c & 4 ? x.t : T(1) - x.t) * (c & 2 ? y.t : T(1) - y.t); }
  TN_INLINE T weight(int c) const { return weight_xy(c) * (c & 1 ? z.t : T(1) - z.t); }

  // The gradient of the interpolated value, sum over c of weight(c) v[c]: linear interpolation along x, then y, then z;
  // the difference of each stage is the derivative of the value before it. Times the slopes it is the one per unit.
  TN_INLINE CellGradient<T> gradient(const T (&v)[8]) const {
    const T tx = x.t, ty = y.t, tz = z.t;
    const T d00 = v[4] - v[0], d01 = v[5] - v[1], d10 = v[6] - v[2], d11 = v[7] - v[3];
    const T m00 = v[0] + tx * d00, m01 = v[1] + tx * d01, m10 = v[2] + tx * d10, m11 = v[3] + tx * d11;
    const T e0 = m10 - m00, e1 = m11 - m01;
    const T n0 = m00 + ty * e0, n1 = m01 + ty * e1;
    return {((T(1) - ty) * d00 + ty * d10) * (T(1) - tz) + ((T(1) - ty) * d01 + ty * d11) * tz,
            (T(1) - tz) * e0 + tz * e1, n1 - n0};
  }
};

template <typename T>
TN_INLINE Cell<T> locate_point(const T* point, std::int32_t nx, std::int32_t ny, std::int32_t nz) {
  return {locate(point[0], nx), locate(point[1], ny), locate(point[2], nz)};
}

// Extents (vertices) and strides (elements) of a volume [b, c, i, j, k].
struct VolumeShape {
  std::int64_t batch, channels;
  std::int32_t nx, ny, nz;
  std::int64_t stride_b, stride_c, stride_x, stride_y, stride_z;

  // Whether the offsets of a batch item's vertices (of one channel) fit into 32 bits.
  TN_INLINE bool spans_int32() const {
    return (nx - 1) * stride_x + (ny - 1) * stride_y + (nz - 1) * stride_z < std::int64_t(1) << 31;
  }
  TN_INLINE std::int64_t corner(int c) const {
    return (c & 4 ? stride_x : 0) + (c & 2 ? stride_y : 0) + (c & 1 ? stride_z : 0);
  }
  template <typename T>
  TN_INLINE std::int64_t offset(const Cell<T>& cell) const {
    return cell.x.index * stride_x + cell.y.index * stride_y + cell.z.index * stride_z;
  }
};

}  // namespace touchnet

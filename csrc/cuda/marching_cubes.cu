#include "cuda/launch.h"
#include "marching_cubes.h"

namespace touchnet::cuda {
namespace {

// The volume with the outside layer around it. Points and cells share one numbering: cell n has point n as its lowest
// corner, and points beyond the last cell have no crossed edge.
template <typename T>
struct Volume {
  const T* values;
  Lattice lattice;
  double level;

  std::int64_t count() const { return (lattice.points[0] + 1) * (lattice.points[1] + 1) * (lattice.points[2] + 1); }
  TN_DEVICE void locate(std::int64_t n, std::int64_t* at) const {  // lattice indices, from -1
    const std::int64_t y = lattice.points[1] + 1, z = lattice.points[2] + 1;
    at[0] = n / (y * z) - 1;
    at[1] = n / z % y - 1;
    at[2] = n % z - 1;
  }
  TN_DEVICE std::int64_t number(const std::int64_t* at) const {
    return ((at[0] + 1) * (lattice.points[1] + 1) + at[1] + 1) * (lattice.points[2] + 1) + at[2] + 1;
  }
  TN_DEVICE std::int64_t flat(const std::int64_t* at) const {
    return (at[0] * lattice.points[1] + at[1]) * lattice.points[2] + at[2];
  }
  TN_DEVICE bool inside(const std::int64_t* at) const {
    for (int d = 0; d < 3; ++d) {
      if (at[d] < 0 || at[d] >= lattice.points[d]) return false;
    }
    return static_cast<double>(values[flat(at)]) >= level;
  }
  TN_DEVICE int cube_case(const std::int64_t* at) const {
    int result = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const std::int64_t point[3] = {at[0] + (corner >> 2 & 1), at[1] + (corner >> 1 & 1), at[2] + (corner & 1)};
      result |= static_cast<int>(inside(point)) << corner;
    }
    return result;
  }
  // Bit a says whether the edge up axis a from the lowest corner is crossed.
  TN_DEVICE static int crossed_edges(int cube) {
    return ((cube ^ cube >> 4) & 1) | ((cube ^ cube >> 2) & 1) << 1 | ((cube ^ cube >> 1) & 1) << 2;
  }
  TN_DEVICE static int bits(int three) { return (three & 1) + (three >> 1 & 1) + (three >> 2 & 1); }
};

}  // namespace

template <typename T>
void cube_counts(const T* values, const Lattice& lattice, double level, std::int32_t* edges, std::int32_t* triangles,
                 std::uintptr_t stream) {
  const Volume<T> volume{values, lattice, level};
  for_each("cube counts", volume.count(), stream, [=] TN_BODY(std::int64_t n) {
    std::int64_t at[3];
    volume.locate(n, at);
    const int cube = volume.cube_case(at);
    edges[n] = volume.bits(volume.crossed_edges(cube));
    triangles[n] = kCubeTriangles[cube][0];
  });
}

template <typename T>
void cube_vertices(const T* values, const Lattice& lattice, double level, const std::int64_t* vertices_until,
                   double* vertices, std::int64_t* low, std::uint8_t* axis_of, std::uintptr_t stream) {
  const Volume<T> volume{values, lattice, level};
  for_each("cube vertices", volume.count(), stream, [=] TN_BODY(std::int64_t n) {
    std::int64_t at[3];
    volume.locate(n, at);
    const int crossed = volume.crossed_edges(volume.cube_case(at));
    std::int64_t id = vertices_until[n] - volume.bits(crossed);
    for (int axis = 0; axis < 3; ++axis) {
      if (!(crossed >> axis & 1)) continue;
      const bool low_outside = at[axis] < 0, high_outside = at[axis] == volume.lattice.points[axis] - 1;
      double t;
      if (low_outside || high_outside) {
        t = border_crossing(low_outside);
      } else {
        std::int64_t end[3] = {at[0], at[1], at[2]};
        ++end[axis];
        t = crossing(volume.values[volume.flat(at)], volume.values[volume.flat(end)], volume.level);
      }
      for (int d = 0; d < 3; ++d) {
        vertices[3 * id + d] = vertex_coordinate(volume.lattice, d, at[d], d == axis ? t : 0.0);
      }
      low[id] = low_outside || high_outside ? -1 : volume.flat(at);
      axis_of[id] = static_cast<std::uint8_t>(axis);
      ++id;
    }
  });
}

template <typename T>
void cube_faces(const T* values, const Lattice& lattice, double level, const std::int64_t* vertices_until,
                const std::int64_t* faces_until, std::int64_t* faces, std::uintptr_t stream) {
  const Volume<T> volume{values, lattice, level};
  for_each("cube faces", volume.count(), stream, [=] TN_BODY(std::int64_t n) {
    std::int64_t at[3];
    volume.locate(n, at);
    const int cube = volume.cube_case(at), count = kCubeTriangles[cube][0];
    std::int64_t* out = faces + 3 * (faces_until[n] - count);
    for (int corner = 0; corner < 3 * count; ++corner) {
      const int edge = kCubeTriangles[cube][1 + corner], axis = edge >> 2, u = edge >> 1 & 1, v = edge & 1;
      const std::int64_t start[3] = {at[0] + (axis == 0 ? 0 : u),
                                     at[1] + (axis == 0   ? u
                                              : axis == 1 ? 0
                                                          : v),
                                     at[2] + (axis == 2 ? 0 : v)};
      const int crossed = volume.crossed_edges(volume.cube_case(start));
      const int later = crossed >> axis;  // this edge and those up the later axes of the same point
      *out++ = vertices_until[volume.number(start)] - volume.bits(later);
    }
  });
}

#define TN_INSTANTIATE(T)                                                                                       \
  template void cube_counts<T>(const T*, const Lattice&, double, std::int32_t*, std::int32_t*, std::uintptr_t); \
  template void cube_vertices<T>(const T*, const Lattice&, double, const std::int64_t*, double*, std::int64_t*, \
                                 std::uint8_t*, std::uintptr_t);                                                \
  template void cube_faces<T>(const T*, const Lattice&, double, const std::int64_t*, const std::int64_t*,       \
                              std::int64_t*, std::uintptr_t);
TN_INSTANTIATE(float)
TN_INSTANTIATE(double)

}  // namespace touchnet::cuda

// Marching cubes over a dense volume (X,Y,Z), z contiguous.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "cubes.h"

namespace touchnet {

// Two passes: count() finds the crossed edges and the triangles, so that the caller can allocate; emit() writes them.
// Vertices are ordered by lattice row (i, j), then axis, then k; faces by cell. Neither depends on `threads`.
template <typename T>
class DenseCubes {
 public:
  // `values` must outlive the object.
  DenseCubes(const T* values, const Lattice& lattice, double level, int threads);

  struct Counts {
    int64_t vertices, faces, not_finite;
  };
  Counts count();

  // vertices (V,3); faces (F,3). Where not null: low (V,) is the index in `values` of the lower end of each vertex's
  // edge, or -1 where the edge leaves the box; axis (V,) is the edge's direction.
  void emit(double* vertices, int64_t* faces, int64_t* low, uint8_t* axis) const;

 private:
  // A row holds the inside bits of k = -1 ... Z, with the outside layer around the box.
  const uint64_t* row(int64_t i, int64_t j) const { return &inside_[(i * (points_[1] + 2) + j) * words_]; }
  int64_t classify(int64_t i, int64_t j);
  void count_row(int64_t i, int64_t j);
  void emit_vertices(int64_t i, int64_t j, double* vertices, int64_t* low, uint8_t* axis) const;
  void emit_faces(int64_t i, int64_t j, int64_t* faces) const;
  template <typename Fn>
  void for_slices(int64_t slices, const Fn& fn) const;

  const T* values_;
  Lattice lattice_;
  std::array<int64_t, 3> points_;
  double level_;
  T threshold_;  // the smallest T >= level: value >= level in float64 is value >= threshold in T
  int threads_;
  int64_t words_;
  struct RowOffsets {
    int64_t vertex[3], face;
  };
  std::vector<uint64_t> inside_;
  std::vector<RowOffsets> offsets_;
};

// The same on a GPU, in three kernels: how many crossed edges each point has and triangles each cell, with the layer
// around the box (extents + 1 on each axis); then, given the running totals of both, the vertices and the faces.
namespace cuda {

template <typename T>
void cube_counts(const T* values, const Lattice& lattice, double level, std::int32_t* edges, std::int32_t* triangles,
                 std::uintptr_t stream);
template <typename T>
void cube_vertices(const T* values, const Lattice& lattice, double level, const std::int64_t* vertices_until,
                   double* vertices, std::int64_t* low, std::uint8_t* axis_of, std::uintptr_t stream);
template <typename T>
void cube_faces(const T* values, const Lattice& lattice, double level, const std::int64_t* vertices_until,
                const std::int64_t* faces_until, std::int64_t* faces, std::uintptr_t stream);

}  // namespace cuda

}  // namespace touchnet

// Bindings of the CUDA half of marching cubes: counts, running totals by the caller, then vertices and faces.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <string>

#include "marching_cubes.h"

namespace touchnet::cuda {

template <class T>
void define_cubes(pybind11::module_& m, const std::string& dtype) {
  using Address = std::uintptr_t;
  using Extents = std::array<std::int64_t, 3>;
  using Corner = std::array<double, 3>;
  using Unlocked = pybind11::call_guard<pybind11::gil_scoped_release>;
  const auto in = [](Address address) { return reinterpret_cast<const T*>(address); };
  const auto totals = [](Address address) { return reinterpret_cast<const std::int64_t*>(address); };

  m.def(("cuda_cube_counts_" + dtype).c_str(),
        [=](Address values, Extents points, Corner lower, Corner spacing, double level, Address edges,
            Address triangles, std::uintptr_t stream) {
          cube_counts(in(values), make_lattice(points, lower, spacing), level, reinterpret_cast<std::int32_t*>(edges),
                      reinterpret_cast<std::int32_t*>(triangles), stream);
        },
        Unlocked());
  m.def(("cuda_cube_vertices_" + dtype).c_str(),
        [=](Address values, Extents points, Corner lower, Corner spacing, double level, Address vertices_until,
            Address vertices, Address low, Address axis, std::uintptr_t stream) {
          cube_vertices(in(values), make_lattice(points, lower, spacing), level, totals(vertices_until),
                        reinterpret_cast<double*>(vertices), reinterpret_cast<std::int64_t*>(low),
                        reinterpret_cast<std::uint8_t*>(axis), stream);
        },
        Unlocked());
  m.def(("cuda_cube_faces_" + dtype).c_str(),
        [=](Address values, Extents points, Corner lower, Corner spacing, double level, Address vertices_until,
            Address faces_until, Address faces, std::uintptr_t stream) {
          cube_faces(in(values), make_lattice(points, lower, spacing), level, totals(vertices_until),
                     totals(faces_until), reinterpret_cast<std::int64_t*>(faces), stream);
        },
        Unlocked());
}

inline void define_extraction(pybind11::module_& m) {
  define_cubes<float>(m, "float32");
  define_cubes<double>(m, "float64");
}

}  // namespace touchnet::cuda

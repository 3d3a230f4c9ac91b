// Bindings of gridding and the samplers, one set for each dtype: addresses and extents in, kernel call out.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cstdint>
#include <string>

#include "gridding.h"
#include "gridding_reverse.h"
#include "sampling.h"

namespace touchnet {

using VolumeExtents = std::array<std::int64_t, 5>;  // shape or strides of [b, c, i, j, k], as torch gives them

inline VolumeShape volume_shape(const VolumeExtents& shape, const VolumeExtents& strides) {
  return {shape[0],
          shape[1],
          static_cast<std::int32_t>(shape[2]),
          static_cast<std::int32_t>(shape[3]),
          static_cast<std::int32_t>(shape[4]),
          strides[0],
          strides[1],
          strides[2],
          strides[3],
          strides[4]};
}

template <class T>
void define_volume_ops(pybind11::module_& m, const std::string& dtype) {
  using Address = std::uintptr_t;
  using Extents = const VolumeExtents&;
  using Unlocked = pybind11::call_guard<pybind11::gil_scoped_release>;
  const auto in = [](Address address) { return reinterpret_cast<const T*>(address); };
  const auto result = [](Address address) { return reinterpret_cast<T*>(address); };

  m.def(
      ("gridding_forward_" + dtype).c_str(),
      [=](Address points, Address values, std::int64_t n, Address volume, Extents shape, Extents strides, int threads) {
        gridding_forward(in(points), in(values), n, result(volume), volume_shape(shape, strides), threads);
      },
      Unlocked());
  m.def(("gridding_backward_" + dtype).c_str(),
        [=](Address grad_volume, Extents shape, Extents strides, Address points, Address values, std::int64_t n,
            Address grad_points, Address grad_values, int threads) {
          gridding_backward(in(grad_volume), volume_shape(shape, strides), in(points), in(values), n,
                            result(grad_points), result(grad_values), threads);
        },
        Unlocked());
  m.def(("gridding_reverse_forward_" + dtype).c_str(),
        [=](Address volume, Extents shape, Extents strides, double fill, Address points, int threads) {
          gridding_reverse_forward(in(volume), volume_shape(shape, strides), static_cast<T>(fill), result(points),
                                   threads);
        },
        Unlocked());
  m.def(("gridding_reverse_backward_" + dtype).c_str(),
        [=](Address grad_points, Address volume, Extents shape, Extents strides, Address grad_volume, int threads) {
          gridding_reverse_backward(in(grad_points), in(volume), volume_shape(shape, strides), result(grad_volume),
                                    threads);
        },
        Unlocked());

  const auto define_forward = [&](const char* name, auto kernel) {
    m.def((name + dtype).c_str(),
          [=](Address volume, Extents shape, Extents strides, Address points, std::int64_t n, Address out,
              int threads) { kernel(in(volume), volume_shape(shape, strides), in(points), n, result(out), threads); },
          Unlocked());
  };
  const auto define_backward_volume = [&](const char* name, auto kernel) {
    m.def((name + dtype).c_str(),
          [=](Address grad_out, Address points, std::int64_t n, Address grad_volume, Extents shape, Extents strides,
              int threads) {
            kernel(in(grad_out), in(points), n, result(grad_volume), volume_shape(shape, strides), threads);
          },
          Unlocked());
  };
  define_forward("trilinear_forward_", &trilinear_forward<T>);
  define_backward_volume("trilinear_backward_volume_", &trilinear_backward_volume<T>);
  m.def(("trilinear_backward_points_" + dtype).c_str(),
        [=](Address grad_out, Address volume, Extents shape, Extents strides, Address points, std::int64_t n,
            Address grad_points, int threads) {
          trilinear_backward_points(in(grad_out), in(volume), volume_shape(shape, strides), in(points), n,
                                    result(grad_points), threads);
        },
        Unlocked());
  define_forward("addition_forward_", &addition_forward<T>);
  define_backward_volume("addition_backward_volume_", &addition_backward_volume<T>);
  define_forward("cubic_forward_", &cubic_forward<T>);
  define_backward_volume("cubic_backward_volume_", &cubic_backward_volume<T>);
}

}  // namespace touchnet

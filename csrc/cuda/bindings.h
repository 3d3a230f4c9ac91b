// Bindings of the CUDA half of gridding and the samplers: as volume_bindings.h, with a stream instead of threads, and
// the points sorted by cell (or zeros) where kernels scatter.
#pragma once

#include "volume_bindings.h"

// Declared by CUDA's headers, which the bindings do not need.
struct __half;
struct __nv_bfloat16;

namespace touchnet::cuda {

template <Sampler kSampler, class T, class A>
void define_sampler(pybind11::module_& m, const std::string& name, const std::string& dtype) {
  using Address = std::uintptr_t;
  using Extents = const VolumeExtents&;
  using Unlocked = pybind11::call_guard<pybind11::gil_scoped_release>;
  m.def(("cuda_" + name + "_forward_" + dtype).c_str(),
        [](Address volume, Extents shape, Extents strides, Address points, std::int64_t n, Address out,
           std::uintptr_t stream) {
          sample_forward<kSampler>(reinterpret_cast<const T*>(volume), volume_shape(shape, strides),
                                   reinterpret_cast<const A*>(points), n, reinterpret_cast<T*>(out), stream);
        },
        Unlocked());
  m.def(("cuda_" + name + "_backward_volume_" + dtype).c_str(),
        [](Address grad_out, Address points, std::int64_t n, Address grad_volume, Extents shape, Extents strides,
           Address order, Address starts, std::uintptr_t stream) {
          sample_backward_volume<kSampler>(reinterpret_cast<const T*>(grad_out), reinterpret_cast<const A*>(points), n,
                                           reinterpret_cast<A*>(grad_volume), volume_shape(shape, strides),
                                           reinterpret_cast<const std::int64_t*>(order),
                                           reinterpret_cast<const std::int64_t*>(starts), stream);
        },
        Unlocked());
}

// T: dtype of the volume, A: of points and sums.
template <class T, class A>
void define_samplers(pybind11::module_& m, const std::string& dtype) {
  using Address = std::uintptr_t;
  define_sampler<Sampler::trilinear, T, A>(m, "trilinear", dtype);
  define_sampler<Sampler::addition, T, A>(m, "addition", dtype);
  define_sampler<Sampler::cubic, T, A>(m, "cubic", dtype);
  m.def(("cuda_trilinear_backward_points_" + dtype).c_str(),
        [](Address grad_out, Address volume, const VolumeExtents& shape, const VolumeExtents& strides, Address points,
           std::int64_t n, Address grad_points, std::uintptr_t stream) {
          trilinear_backward_points(reinterpret_cast<const T*>(grad_out), reinterpret_cast<const T*>(volume),
                                    volume_shape(shape, strides), reinterpret_cast<const A*>(points), n,
                                    reinterpret_cast<A*>(grad_points), stream);
        },
        pybind11::call_guard<pybind11::gil_scoped_release>());
}

template <class T>
void define_gridding(pybind11::module_& m, const std::string& dtype) {
  using Address = std::uintptr_t;
  using Extents = const VolumeExtents&;
  using Unlocked = pybind11::call_guard<pybind11::gil_scoped_release>;
  const auto in = [](Address address) { return reinterpret_cast<const T*>(address); };
  const auto result = [](Address address) { return reinterpret_cast<T*>(address); };
  const auto integers = [](Address address) { return reinterpret_cast<std::int64_t*>(address); };

  m.def(("cuda_cell_numbers_" + dtype).c_str(),
        [=](Address points, std::int64_t n, Extents shape, bool clamped, Address numbers, std::uintptr_t stream) {
          const auto kernel = clamped ? &cell_numbers<true, T> : &cell_numbers<false, T>;
          kernel(in(points), n, volume_shape(shape, shape), integers(numbers), stream);
        },
        Unlocked());
  m.def(("cuda_gridding_forward_" + dtype).c_str(),
        [=](Address points, Address values, std::int64_t n, Address volume, Extents shape, Extents strides,
            Address order, Address starts, std::uintptr_t stream) {
          gridding_forward(in(points), in(values), n, result(volume), volume_shape(shape, strides), integers(order),
                           integers(starts), stream);
        },
        Unlocked());
  m.def(("cuda_gridding_backward_" + dtype).c_str(),
        [=](Address grad_volume, Extents shape, Extents strides, Address points, Address values, std::int64_t n,
            Address grad_points, Address grad_values, std::uintptr_t stream) {
          gridding_backward(in(grad_volume), volume_shape(shape, strides), in(points), in(values), n,
                            result(grad_points), result(grad_values), stream);
        },
        Unlocked());
  m.def(("cuda_gridding_reverse_forward_" + dtype).c_str(),
        [=](Address volume, Extents shape, Extents strides, double fill, Address points, std::uintptr_t stream) {
          gridding_reverse_forward(in(volume), volume_shape(shape, strides), static_cast<T>(fill), result(points),
                                   stream);
        },
        Unlocked());
  m.def(("cuda_gridding_reverse_backward_" + dtype).c_str(),
        [=](Address grad_points, Address volume, Extents shape, Extents strides, Address grad_volume,
            std::uintptr_t stream) {
          gridding_reverse_backward(in(grad_points), in(volume), volume_shape(shape, strides), result(grad_volume),
                                    stream);
        },
        Unlocked());
}

inline void define_volume_ops(pybind11::module_& m) {
  define_gridding<float>(m, "float32");
  define_gridding<double>(m, "float64");
  define_samplers<float, float>(m, "float32");
  define_samplers<double, double>(m, "float64");
#ifdef TOUCHNET_WITH_CUDA
  define_samplers<__half, float>(m, "float16");
  define_samplers<__nv_bfloat16, float>(m, "bfloat16");
#endif
}

}  // namespace touchnet::cuda

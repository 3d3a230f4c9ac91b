// The module touchnet._C, in the order of the pipeline. Tensors arrive as addresses; touchnet/ops checks them.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "closest_point.h"
#include "gp.h"
#include "head.h"
#include "marching_cubes.h"
#include "octree.h"
#include "parallel.h"
#include "volume_bindings.h"
#ifdef TOUCHNET_WITH_CUDA
#include "cuda/bindings.h"
#include "cuda/extraction_bindings.h"
#endif

namespace py = pybind11;

using Address = std::uintptr_t;
using Unlocked = py::call_guard<py::gil_scoped_release>;

template <class T>
static T* at(Address address) {
  return reinterpret_cast<T*>(address);
}

using Extents = std::array<std::int64_t, 3>;
using Corner = std::array<double, 3>;

template <class T>
static void define_dense_cubes(py::module_& m, const char* name) {
  using Cubes = touchnet::DenseCubes<T>;
  py::class_<Cubes>(m, name)
      .def(py::init([](Address values, Extents points, Corner lower, Corner spacing, double level, int threads) {
        return new Cubes(at<const T>(values), touchnet::make_lattice(points, lower, spacing), level, threads);
      }))
      .def(
          "count",
          [](Cubes& cubes) {
            const auto counts = cubes.count();
            return std::array<std::int64_t, 3>{counts.vertices, counts.faces, counts.not_finite};
          },
          Unlocked())
      .def(
          "emit",
          [](const Cubes& cubes, Address vertices, Address faces, Address low, Address axis) {
            cubes.emit(at<double>(vertices), at<std::int64_t>(faces), at<std::int64_t>(low), at<std::uint8_t>(axis));
          },
          Unlocked());
}

static py::dict build_info() {
  py::dict info;
  info["version"] = TOUCHNET_VERSION;
#if defined(__clang__)
  info["compiler"] = "clang " __clang_version__;
#elif defined(__GNUC__)
  info["compiler"] = "gcc " __VERSION__;
#elif defined(_MSC_VER)
  info["compiler"] = "msvc " + std::to_string(_MSC_VER);
#else
  info["compiler"] = "unknown";
#endif
  info["cplusplus"] = static_cast<long>(__cplusplus);
  info["threading"] = touchnet::torch_team() ? "the OpenMP pool of torch" : "std::thread";
  info["openmp"] = touchnet::torch_team() != nullptr;
#ifdef TOUCHNET_WITH_CUDA
  info["cuda_architectures"] = TOUCHNET_CUDA_ARCHITECTURES;
#else
  info["cuda_architectures"] = "";
#endif
  return info;
}

PYBIND11_MODULE(_C, m) {
  m.doc() = "Compiled half of touchnet. Use touchnet.ops.";
  m.def("build_info", &build_info);

  // Gridding and sampling: <op>_<direction>_<dtype>.
  touchnet::define_volume_ops<float>(m, "float32");
  touchnet::define_volume_ops<double>(m, "float64");
#ifdef TOUCHNET_WITH_CUDA
  touchnet::cuda::define_volume_ops(m);
#endif

  // The occupancy head: sampling and MLP in one pass.
  using touchnet::Head;
  py::class_<Head>(m, "Head")
      .def(
          py::init([](const std::vector<std::tuple<Address, touchnet::VolumeExtents, touchnet::VolumeExtents>>& volumes,
                      bool trilinear) {
            std::vector<touchnet::HeadVolume> read;
            for (const auto& [values, shape, strides] : volumes)
              read.push_back({at<const float>(values), touchnet::volume_shape(shape, strides)});
            return new Head(std::move(read),
                            trilinear ? &touchnet::trilinear_forward<float> : &touchnet::addition_forward<float>);
          }))
      .def("add_layer",
           [](Head& head, Address weight, Address bias, std::int64_t inputs, std::int64_t outputs) {
             head.add_layer(at<const float>(weight), at<const float>(bias), inputs, outputs);
           })
      .def(
          "query",
          [](const Head& head, Address points, std::int64_t n, Address values, int threads, bool wide) {
            head.query(at<const float>(points), n, at<float>(values), threads, wide);
          },
          Unlocked())
      .def_static("is_supported", &Head::is_supported);

  // Exploration: closest points on the mesh, Gaussian process of the contacts (touchnet/data).
  py::class_<touchnet::TriangleTree>(m, "TriangleTree")
      .def(py::init([](Address vertices, Address faces, std::size_t f) {
             return touchnet::TriangleTree(at<const double>(vertices), at<const std::int64_t>(faces), f);
           }),
           Unlocked())
      .def(
          "closest",
          [](const touchnet::TriangleTree& tree, Address points, std::size_t m, Address closest, Address face,
             Address distance) {
            tree.closest(at<const double>(points), m, at<double>(closest), at<std::int64_t>(face),
                         at<double>(distance));
          },
          Unlocked());
  m.def(
      "gp_kernel",
      [](int kernel, double scale, Address x, std::size_t m, Address y, std::size_t n, Address out) {
        touchnet::gp_kernel(touchnet::Kernel(kernel), scale, at<const double>(x), m, at<const double>(y), n,
                            at<double>(out));
      },
      Unlocked());
  m.def(
      "gp_backward",
      [](Address factor, std::size_t n, Address row) {
        touchnet::gp_backward(at<const double>(factor), n, at<double>(row));
      },
      Unlocked());
  m.def(
      "gp_touch",
      [](int kernel, double scale, Address contacts, Address factor, std::size_t n, Address x, Address row,
         Address work, Address gradient) {
        return touchnet::gp_touch(touchnet::Kernel(kernel), scale, at<const double>(contacts), at<const double>(factor),
                                  n, at<const double>(x), at<double>(row), at<double>(work), at<double>(gradient));
      },
      Unlocked());
  m.def(
      "gp_extend",
      [](int kernel, double scale, Address contacts, Address factor, std::size_t start, std::size_t n, Address x,
         std::size_t groups, std::size_t capacity, Address solved, Address variance) {
        touchnet::gp_extend(touchnet::Kernel(kernel), scale, at<const double>(contacts), at<const double>(factor),
                            start, n, at<const double>(x), groups, capacity, at<double>(solved), at<double>(variance));
      },
      Unlocked());
  m.def(
      "gp_backward_batch",
      [](Address factor, std::size_t n, std::size_t groups, std::size_t capacity, Address solved) {
        touchnet::gp_backward_batch(at<const double>(factor), n, groups, capacity, at<double>(solved));
      },
      Unlocked());
  m.def(
      "gp_highest",
      [](int kernel, double scale, Address contacts, Address factor, std::size_t n, Address x, std::size_t groups,
         std::size_t capacity, Address solved, Address variance, Address known) {
        return touchnet::gp_highest(touchnet::Kernel(kernel), scale, at<const double>(contacts),
                                    at<const double>(factor), n, at<const double>(x), groups, capacity,
                                    at<double>(solved), at<double>(variance), at<std::size_t>(known));
      },
      Unlocked());

  // Extraction.
  m.def("cube_table", [] {
    std::vector<std::vector<int>> rows;
    for (const auto& row : touchnet::kCubeTriangles) rows.emplace_back(row + 1, row + 1 + 3 * row[0]);
    return rows;
  });
  define_dense_cubes<float>(m, "DenseCubesFloat");
  define_dense_cubes<double>(m, "DenseCubesDouble");
#ifdef TOUCHNET_WITH_CUDA
  touchnet::cuda::define_extraction(m);
#endif
  using touchnet::OctreeCubes;
  py::class_<OctreeCubes>(m, "OctreeCubes")
      .def(py::init([](Extents points, Corner lower, Corner spacing, double level, std::int64_t stride, int threads) {
        return new OctreeCubes(touchnet::make_lattice(points, lower, spacing), level, stride, threads);
      }))
      .def("add_seeds",
           [](OctreeCubes& cubes, Address points, std::int64_t n) { cubes.add_seeds(at<const double>(points), n); })
      .def("pending", &OctreeCubes::pending)
      .def(
          "write_points",
          [](const OctreeCubes& cubes, std::int64_t begin, std::int64_t n, Address points, bool wide) {
            if (wide) {
              cubes.write_points(begin, n, at<double>(points));
            } else {
              cubes.write_points(begin, n, at<float>(points));
            }
          },
          Unlocked())
      .def(
          "read_values",
          [](OctreeCubes& cubes, std::int64_t begin, std::int64_t n, Address values, bool wide) {
            if (wide) {
              cubes.read_values(begin, n, at<const double>(values));
            } else {
              cubes.read_values(begin, n, at<const float>(values));
            }
          },
          Unlocked())
      .def("advance", &OctreeCubes::advance, Unlocked())
      .def(
          "count",
          [](OctreeCubes& cubes) {
            const auto counts = cubes.count();
            return std::make_tuple(counts.vertices, counts.faces, counts.minimum, counts.maximum);
          },
          Unlocked())
      .def(
          "emit",
          [](const OctreeCubes& cubes, Address vertices, Address faces, Address low, Address axis) {
            cubes.emit(at<double>(vertices), at<std::int64_t>(faces), at<std::int64_t>(low), at<std::uint8_t>(axis));
          },
          Unlocked());
}

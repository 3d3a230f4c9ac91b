// The module touchnet._C, in the order of the pipeline. Tensors arrive as addresses; touchnet/ops checks them.
#include <pybind11/pybind11.h>

namespace py = pybind11;

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
  info["threading"] = "std::thread";
  info["openmp"] = false;
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
}

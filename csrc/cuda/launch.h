// Launching a body once for every index on a CUDA stream, with errors raised.
//
// Compiled by a plain C++ compiler, the same source runs the same bodies in a serial loop: that is how the tests
// exercise the CUDA half on machines without a GPU.
#pragma once

#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>

#ifdef __CUDACC__
#include <cuda_runtime.h>
#define TN_DEVICE __device__ __forceinline__
#define TN_BODY __device__  // marks the lambda that runs for each index
#else
#define TN_DEVICE inline
#define TN_BODY
#endif

namespace touchnet::cuda {

// Lanes that share one item in a body with group_sum: threads of one warp, next to each other.
#ifdef __CUDACC__
constexpr int kGroup = 8;
#else
constexpr int kGroup = 1;
#endif

// The sum of a value over the lanes of the calling thread's group, in an order that does not vary.
template <typename T>
TN_DEVICE T group_sum(T value) {
#ifdef __CUDA_ARCH__
  const unsigned group = ((1u << kGroup) - 1u) << (threadIdx.x % 32 / kGroup * kGroup);
  for (int offset = kGroup / 2; offset > 0; offset /= 2) value += __shfl_xor_sync(group, value, offset);
#endif
  return value;
}

template <typename T>
TN_DEVICE void atomic_add(T* address, T value) {
#ifdef __CUDA_ARCH__
  atomicAdd(address, value);
#else
  *address += value;
#endif
}

#ifdef __CUDACC__

inline void check(cudaError_t status, const char* what) {
  if (status != cudaSuccess)
    throw std::runtime_error(std::string("touchnet: CUDA failed in ") + what + ": " + cudaGetErrorString(status));
}

constexpr int kThreads = 256;

template <typename Body>
__global__ void __launch_bounds__(kThreads) each(std::int64_t count, Body body) {
  const std::int64_t step = std::int64_t(gridDim.x) * blockDim.x;
  for (std::int64_t i = std::int64_t(blockIdx.x) * blockDim.x + threadIdx.x; i < count; i += step) body(i);
}

// body(i) for i in [0, count), on the given stream of the current device. `what` names it in an error.
template <typename Body>
void for_each(const char* what, std::int64_t count, std::uintptr_t stream, const Body& body) {
  if (count <= 0) return;
  constexpr std::int64_t kMostBlocks = std::int64_t(1) << 20;
  const std::int64_t blocks = (count + kThreads - 1) / kThreads;
  each<<<static_cast<unsigned>(blocks < kMostBlocks ? blocks : kMostBlocks), kThreads, 0,
         reinterpret_cast<cudaStream_t>(stream)>>>(count, body);
  check(cudaGetLastError(), what);
}

template <typename T>
void zero(const char* what, T* address, std::int64_t count, std::uintptr_t stream) {
  if (count > 0) check(cudaMemsetAsync(address, 0, sizeof(T) * count, reinterpret_cast<cudaStream_t>(stream)), what);
}

#else

template <typename Body>
void for_each(const char*, std::int64_t count, std::uintptr_t, const Body& body) {
  for (std::int64_t i = 0; i < count; ++i) body(i);
}

template <typename T>
void zero(const char*, T* address, std::int64_t count, std::uintptr_t) {
  std::memset(address, 0, sizeof(T) * count);
}

#endif

}  // namespace touchnet::cuda

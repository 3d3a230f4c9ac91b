// Loops on std::thread, and the choice of instruction set at run time.
//
// No OpenMP: a second OpenMP runtime beside torch's costs threads, and one that ran before a fork hangs in the child.
// The threads here live for one call, so a forked DataLoader worker has nothing to inherit. Callers divide work so that
// every output element is accumulated by one thread in one order: results do not depend on the number of threads.
#pragma once

#include <cstdint>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#if defined(__x86_64__) && defined(__GNUC__)
#define TN_X86_DISPATCH 1
#endif

namespace touchnet {

// Starting and joining a thread takes tens of microseconds; below about this much work each it does not pay.
constexpr double kMicrosecondsPerThread = 60.0;

// How many of at most `threads` are worth starting for work that takes `microseconds` on one.
inline int worth_threads(double microseconds, int threads) {
  const double useful = microseconds / kMicrosecondsPerThread;
  if (useful < 2.0 || threads < 2) return 1;
  return useful < threads ? static_cast<int>(useful) : threads;
}

// Calls fn(first, last) on `threads` contiguous pieces of [begin, end), one of them on the calling thread.
template <typename Fn>
void parallel_for(std::int64_t begin, std::int64_t end, int threads, const Fn& fn) {
  const std::int64_t count = end - begin;
  if (count <= 0) return;
  if (threads > count) threads = static_cast<int>(count);
  if (threads <= 1) {
    fn(begin, end);
    return;
  }
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto piece = [&](std::int64_t t) {
    try {
      fn(begin + count * t / threads, begin + count * (t + 1) / threads);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(error_mutex);
      if (!error) error = std::current_exception();
    }
  };
  std::vector<std::thread> workers;
  workers.reserve(threads - 1);
  std::int64_t next = 1;
  try {
    for (; next < threads; ++next) workers.emplace_back(piece, next);
  } catch (const std::system_error&) {
    // The system refused another thread: the caller does the remaining pieces itself.
  }
  piece(0);
  for (; next < threads; ++next) piece(next);
  for (std::thread& worker : workers) worker.join();
  if (error) std::rethrow_exception(error);
}

// Runs body() compiled for the widest vectors of this processor. Everything in it must inline (TN_INLINE, lambdas
// marked always_inline). Without fused multiply-add and with sums written in a fixed order, every version gives the
// same bits.
#ifdef TN_X86_DISPATCH
template <typename Body>
__attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,prefer-vector-width=512"),
               noinline)) void run_avx512(const Body& body) {
  body();
}
template <typename Body>
__attribute__((target("avx2"), noinline)) void run_avx2(const Body& body) {
  body();
}
inline int vector_level() {
  static const int level = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                                   __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")
                               ? 2
                               : (__builtin_cpu_supports("avx2") ? 1 : 0);
  return level;
}
#endif

template <typename Body>
void run_vectorised(const Body& body) {
#ifdef TN_X86_DISPATCH
  if (vector_level() == 2) return run_avx512(body);
  if (vector_level() == 1) return run_avx2(body);
#endif
  body();
}

}  // namespace touchnet

#if defined(__GNUC__)
#define TN_LAMBDA_INLINE __attribute__((always_inline))
#define TN_PREFETCH(address) __builtin_prefetch(address)
#else
#define TN_LAMBDA_INLINE
#define TN_PREFETCH(address) ((void)(address))
#endif

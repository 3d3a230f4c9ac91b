// Loops on several threads, and the choice of instruction set at run time.
//
// The threads are those that torch runs already: its OpenMP pool, entered through the GOMP_parallel that torch brought
// into the process. Nothing is linked, no second pool competes for the processors, and the pool is awake where torch
// has just worked. Without it, or in a forked child, where that pool would hang, std::threads live for one call.
// Callers divide work so that every output element is accumulated by one thread in one order: results do not depend on
// the number of threads.
#pragma once

#include <atomic>
#include <cstdint>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#if defined(__linux__)
#include <dlfcn.h>
#include <pthread.h>
#endif

#if defined(__x86_64__) && defined(__GNUC__)
#define TN_X86_DISPATCH 1
#endif

namespace touchnet {

// Work that takes this long on one thread is worth dividing: waking the others costs a few microseconds while they
// still spin, tens when they sleep.
constexpr double kWorthDividing = 60.0;

inline int worth_threads(double microseconds, int threads) { return microseconds < kWorthDividing ? 1 : threads; }

// Runs body(data) on `threads` threads at once, the calling one among them, and returns when all are done.
using Team = void (*)(void (*body)(void*), void* data, unsigned threads, unsigned flags);

#if defined(__linux__)
inline bool& is_forked() {
  static bool forked = false;
  return forked;
}
inline const int watch_forks = pthread_atfork(nullptr, nullptr, [] { is_forked() = true; });

inline Team torch_team() {
  static const Team team = reinterpret_cast<Team>(dlsym(RTLD_DEFAULT, "GOMP_parallel"));
  return watch_forks != 0 || is_forked() ? nullptr : team;
}
#else
inline Team torch_team() { return nullptr; }
#endif

// Calls fn(first, last) on `threads` contiguous pieces of [begin, end), one of them on the calling thread.
template <typename Fn>
void parallel_for(std::int64_t begin, std::int64_t end, int threads, const Fn& fn) {
  const std::int64_t count = end - begin;
  if (count <= 0) return;
  const std::int64_t pieces = threads > count ? count : threads;
  if (pieces <= 1) {
    fn(begin, end);
    return;
  }
  struct Work {
    const Fn& fn;
    const std::int64_t begin, count, pieces;
    std::atomic<std::int64_t> next{0};
    std::exception_ptr error{};
    std::mutex error_mutex{};

    void run() {  // a team may have fewer threads than asked for: each takes pieces while there are any
      try {
        for (std::int64_t t; (t = next.fetch_add(1)) < pieces;)
          fn(begin + count * t / pieces, begin + count * (t + 1) / pieces);
      } catch (...) {
        const std::lock_guard<std::mutex> lock(error_mutex);
        if (!error) error = std::current_exception();
      }
    }
  } work{fn, begin, count, pieces};
  if (const Team team = torch_team()) {
    // The size of the team stays torch's, so that the pool is never torn down and built again.
    team([](void* data) { static_cast<Work*>(data)->run(); }, &work, static_cast<unsigned>(threads), 0);
  } else {
    std::vector<std::thread> workers;
    workers.reserve(pieces - 1);
    try {
      for (std::int64_t t = 1; t < pieces; ++t) workers.emplace_back([&work] { work.run(); });
    } catch (const std::system_error&) {
      // The system refused another thread: those that run take all pieces.
    }
    work.run();
    for (std::thread& worker : workers) worker.join();
  }
  if (work.error) std::rethrow_exception(work.error);
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

// Writing past the caches. A store into a line that is not in the cache reads the line first; a store that streams does
// not, which halves the traffic of outputs that no cache would keep until they are read.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__SSE2__) || defined(_M_X64)
#include <emmintrin.h>
#define TN_STREAM 1
#endif

namespace touchnet {

// Outputs from this size on are streamed: a core's share of the last cache is smaller on most processors.
constexpr std::size_t kStreamBytes = 24u << 20;

inline bool worth_streaming(std::size_t bytes) { return bytes >= kStreamBytes; }

// To be called by a thread that streamed, before another one reads.
inline void stream_fence() {
#ifdef TN_STREAM
  _mm_sfence();
#endif
}

inline void stream_zero(void* target, std::size_t bytes) {
  char* to = static_cast<char*>(target);
#ifdef TN_STREAM
  const std::size_t head = (64 - reinterpret_cast<std::uintptr_t>(to) % 64) % 64;
  if (bytes >= head + 64) {
    std::memset(to, 0, head);
    to += head;
    bytes -= head;
    const __m128i zero = _mm_setzero_si128();
    for (; bytes >= 64; to += 64, bytes -= 64)
      for (int part = 0; part < 4; ++part) _mm_stream_si128(reinterpret_cast<__m128i*>(to) + part, zero);
  }
#endif
  std::memset(to, 0, bytes);
}

inline void stream_copy(void* target, const void* source, std::size_t bytes) {
#ifdef TN_STREAM
  if (reinterpret_cast<std::uintptr_t>(target) % 16 == 0) {
    __m128i* to = static_cast<__m128i*>(target);
    const __m128i* from = static_cast<const __m128i*>(source);
    for (; bytes >= 16; bytes -= 16) _mm_stream_si128(to++, _mm_loadu_si128(from++));
    target = to;
    source = from;
  }
#endif
  std::memcpy(target, source, bytes);
}

}  // namespace touchnet

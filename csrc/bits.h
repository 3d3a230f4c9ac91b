// Bit scans of 64-bit words.
#pragma once

#include <cstdint>

#ifdef _MSC_VER
#include <intrin.h>
#endif

namespace touchnet {

// Position of the lowest set bit of a word that is not zero.
inline int lowest_bit(uint64_t word) {
#ifdef _MSC_VER
  unsigned long index;
  _BitScanForward64(&index, word);
  return static_cast<int>(index);
#else
  return __builtin_ctzll(word);
#endif
}

// Number of set bits. In code compiled for a processor with the instruction (run_vectorised) this is one instruction.
inline int count_bits(uint64_t word) {
#ifdef _MSC_VER
  return static_cast<int>(__popcnt64(word));
#else
  return __builtin_popcountll(word);
#endif
}

}  // namespace touchnet

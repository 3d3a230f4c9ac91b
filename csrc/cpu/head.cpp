#include "head.h"

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <memory>
#include <utility>

#include "parallel.h"

#ifdef TN_X86_DISPATCH
#include <immintrin.h>
#endif

namespace touchnet {
namespace {

// Weights are packed for kOutputs outputs at a time.
constexpr int kOutputs = 4;
// Points of a tile, a whole number of register blocks of either instruction set: the activations of the widest layer
// (128 rows) and its inputs (64) take 36 KB, the weights are read once a tile.
constexpr int kTile = 48;
// Rows of activations start at a cache line: a load that straddles two takes twice the time.
constexpr std::size_t kAligned = 16;
// Tiles that a thread takes at a time: long enough (some 0.3 ms) not to notice, short enough that the threads end
// together on a machine that does other things too.
constexpr std::int64_t kTilesAtOnce = 16;

std::int64_t padded(std::int64_t outputs) { return (outputs + kOutputs - 1) / kOutputs * kOutputs; }

// What a tile goes through.
struct Kernels {
  // out[o][p] = max(0, bias[o] + sum over k of weight[o][k] in[k][p]) for the points of a tile; NaN stays NaN.
  void (*hidden_layer)(const float* in, const float* weights, const float* bias, std::int64_t inputs,
                       std::int64_t outputs, float* out);
  // out[p] = bias + sum over k of weight[k] in[k][p]; weights as packed, kOutputs a row.
  void (*last_layer)(const float* in, const float* weights, float bias, std::int64_t inputs, float* out);
};

#ifdef TN_X86_DISPATCH
namespace avx2 {
#define TN_TARGET __attribute__((target("avx2,fma")))
#define TN_FLOATS __m256
#define TN_MM(name) _mm256_##name
#include "head_layers.h"
#undef TN_TARGET
#undef TN_FLOATS
#undef TN_MM
}  // namespace avx2

namespace avx512 {
#if !defined(__clang__)  // gcc's own max_ps starts from a register that is not set
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#define TN_TARGET __attribute__((target("avx512f")))
#define TN_FLOATS __m512
#define TN_MM(name) _mm512_##name
#include "head_layers.h"
#undef TN_TARGET
#undef TN_FLOATS
#undef TN_MM
#if !defined(__clang__)
#pragma GCC diagnostic pop
#endif
}  // namespace avx512

Kernels kernels(bool wide) {
  if (wide && __builtin_cpu_supports("avx512f")) return {avx512::hidden_layer, avx512::last_layer};
  return {avx2::hidden_layer, avx2::last_layer};
}

#define TN_AVX2 __attribute__((target("avx2,fma")))
// out[c][p] = rows[p][c] for the points of a tile.
TN_AVX2 void transpose(const float* rows, std::int64_t channels, float* out) {
  std::int64_t c = 0;
  for (; c + 4 <= channels; c += 4) {
    for (int p = 0; p < kTile; p += 4) {
      const float* row = rows + p * channels + c;
      __m128 a = _mm_loadu_ps(row), b = _mm_loadu_ps(row + channels), d = _mm_loadu_ps(row + 2 * channels),
             e = _mm_loadu_ps(row + 3 * channels);
      _MM_TRANSPOSE4_PS(a, b, d, e);
      float* column = out + c * kTile + p;
      _mm_storeu_ps(column, a);
      _mm_storeu_ps(column + kTile, b);
      _mm_storeu_ps(column + 2 * kTile, d);
      _mm_storeu_ps(column + 3 * kTile, e);
    }
  }
  for (; c < channels; ++c)
    for (int p = 0; p < kTile; ++p) out[c * kTile + p] = rows[p * channels + c];
}
#undef TN_AVX2
#else
// Never called: is_supported() is false.
Kernels kernels(bool) { return {}; }
void transpose(const float*, std::int64_t, float*) {}
#endif

}  // namespace

bool Head::is_supported() {
#ifdef TN_X86_DISPATCH
  static const bool supported = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  return supported;
#else
  return false;
#endif
}

Head::Head(std::vector<HeadVolume> volumes, Sampler sampler) : volumes_(std::move(volumes)), sampler_(sampler) {
  for (const HeadVolume& volume : volumes_) features_ += volume.shape.channels;
  widest_ = features_;
}

void Head::add_layer(const float* weight, const float* bias, std::int64_t inputs, std::int64_t outputs) {
  Layer layer;
  layer.inputs = inputs;
  layer.outputs = padded(outputs);
  layer.weights.assign(static_cast<std::size_t>(layer.outputs * inputs), 0.0f);
  layer.bias.assign(static_cast<std::size_t>(layer.outputs), 0.0f);
  std::copy(bias, bias + outputs, layer.bias.begin());
  for (std::int64_t o = 0; o < outputs; ++o)
    for (std::int64_t k = 0; k < inputs; ++k)
      layer.weights[(o / kOutputs * inputs + k) * kOutputs + o % kOutputs] = weight[o * inputs + k];
  widest_ = std::max(widest_, layer.outputs);
  layers_.push_back(std::move(layer));
}

void Head::query(const float* points, std::int64_t m, float* values, int threads, bool wide) const {
  const Kernels kernels = touchnet::kernels(wide);
  const std::int64_t tiles = (m + kTile - 1) / kTile;
  std::atomic<std::int64_t> next{0};
  const double microseconds = 15.0 * tiles;
  parallel_for(0, tiles, worth_threads(microseconds, threads), [&](std::int64_t, std::int64_t) {
    const std::size_t size = kTile * widest_;
    std::size_t room = (2 * size + kAligned) * sizeof(float);
    std::vector<float> memory(room / sizeof(float));
    void* aligned = memory.data();
    float* const one =
        static_cast<float*>(std::align(kAligned * sizeof(float), 2 * size * sizeof(float), aligned, room));
    float* const other = one + size;
    float place[3 * kTile] = {}, result[kTile];
    for (std::int64_t first; (first = next.fetch_add(kTilesAtOnce)) < tiles;) {
      for (std::int64_t tile = first; tile < std::min(first + kTilesAtOnce, tiles); ++tile) {
        const std::int64_t start = tile * kTile;
        const int count = static_cast<int>(std::min<std::int64_t>(kTile, m - start));
        const float* at = points + 3 * start;
        if (count < kTile) {  // the last tile: the rest of it are points that nobody asks for
          std::copy(at, at + 3 * count, place);
          at = place;
        }
        float* column = one;
        for (const HeadVolume& volume : volumes_) {
          sampler_(volume.values, volume.shape, at, kTile, other, 1);
          transpose(other, volume.shape.channels, column);
          column += volume.shape.channels * kTile;
        }
        float *in = one, *out = other;
        for (std::size_t n = 0; n + 1 < layers_.size(); ++n) {
          const Layer& layer = layers_[n];
          kernels.hidden_layer(in, layer.weights.data(), layer.bias.data(), layer.inputs, layer.outputs, out);
          std::swap(in, out);
        }
        const Layer& final = layers_.back();
        kernels.last_layer(in, final.weights.data(), final.bias[0], final.inputs, result);
        std::copy(result, result + count, values + start);
      }
    }
  });
}

}  // namespace touchnet

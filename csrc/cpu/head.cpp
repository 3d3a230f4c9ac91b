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

// A register block is kOutputs rows by kVectors vectors of points: 12 accumulators, which hide the latency of the
// multiply-adds, 3 inputs and 1 weight fill the 16 registers. For 12 multiply-adds it loads 7 times, fewer than the
// 2 loads beside 2 multiply-adds that a cycle has room for.
constexpr int kOutputs = 4, kVectors = 3, kWidth = 8;
constexpr int kBlock = kVectors * kWidth;
// Points of a tile: the activations of the widest layer (128 rows) and its inputs (64) take 36 KB, the weights are read
// once a tile.
constexpr int kTile = 2 * kBlock;
// Rows of activations start at a cache line: a load that straddles two takes twice the time.
constexpr std::size_t kAligned = 16;
// Tiles that a thread takes at a time: long enough (some 0.3 ms) not to notice, short enough that the threads end
// together on a machine that does other things too.
constexpr std::int64_t kTilesAtOnce = 16;

std::int64_t padded(std::int64_t outputs) { return (outputs + kOutputs - 1) / kOutputs * kOutputs; }

#ifdef TN_X86_DISPATCH
#define TN_AVX2 __attribute__((target("avx2,fma")))

TN_AVX2 inline void multiply_add(__m256 w, __m256 x0, __m256 x1, __m256 x2, __m256& s0, __m256& s1, __m256& s2) {
  s0 = _mm256_fmadd_ps(w, x0, s0);
  s1 = _mm256_fmadd_ps(w, x1, s1);
  s2 = _mm256_fmadd_ps(w, x2, s2);
}

TN_AVX2 inline void store_rectified(__m256 s0, __m256 s1, __m256 s2, float* out) {  // max(0, NaN) is NaN
  const __m256 zero = _mm256_setzero_ps();
  _mm256_storeu_ps(out, _mm256_max_ps(zero, s0));
  _mm256_storeu_ps(out + kWidth, _mm256_max_ps(zero, s1));
  _mm256_storeu_ps(out + 2 * kWidth, _mm256_max_ps(zero, s2));
}

// out[o][p] = max(0, bias[o] + sum over k of weight[o][k] in[k][p]) for the points of a tile; NaN stays NaN.
TN_AVX2 void hidden_layer(const float* in, const float* weights, const float* bias, std::int64_t inputs,
                          std::int64_t outputs, float* out) {
  for (std::int64_t o = 0; o < outputs; o += kOutputs, weights += kOutputs * inputs) {
    for (int block = 0; block < kTile; block += kBlock) {
      // Twelve variables, not an array: compilers keep an array in memory.
      __m256 a0 = _mm256_set1_ps(bias[o]), a1 = a0, a2 = a0;
      __m256 b0 = _mm256_set1_ps(bias[o + 1]), b1 = b0, b2 = b0;
      __m256 c0 = _mm256_set1_ps(bias[o + 2]), c1 = c0, c2 = c0;
      __m256 d0 = _mm256_set1_ps(bias[o + 3]), d1 = d0, d2 = d0;
      const float* column = in + block;
      const float* weight = weights;
      for (std::int64_t k = 0; k < inputs; ++k, column += kTile, weight += kOutputs) {
        const __m256 x0 = _mm256_loadu_ps(column), x1 = _mm256_loadu_ps(column + kWidth),
                     x2 = _mm256_loadu_ps(column + 2 * kWidth);
        multiply_add(_mm256_broadcast_ss(weight), x0, x1, x2, a0, a1, a2);
        multiply_add(_mm256_broadcast_ss(weight + 1), x0, x1, x2, b0, b1, b2);
        multiply_add(_mm256_broadcast_ss(weight + 2), x0, x1, x2, c0, c1, c2);
        multiply_add(_mm256_broadcast_ss(weight + 3), x0, x1, x2, d0, d1, d2);
      }
      float* row = out + o * kTile + block;
      store_rectified(a0, a1, a2, row);
      store_rectified(b0, b1, b2, row + kTile);
      store_rectified(c0, c1, c2, row + 2 * kTile);
      store_rectified(d0, d1, d2, row + 3 * kTile);
    }
  }
}

// out[p] = bias + sum over k of weight[k] in[k][p]; weights as packed, kOutputs a row.
TN_AVX2 void last_layer(const float* in, const float* weights, float bias, std::int64_t inputs, float* out) {
  for (int block = 0; block < kTile; block += kBlock) {
    __m256 s0 = _mm256_set1_ps(bias), s1 = s0, s2 = s0;
    const float* column = in + block;
    for (std::int64_t k = 0; k < inputs; ++k, column += kTile)
      multiply_add(_mm256_broadcast_ss(weights + kOutputs * k), _mm256_loadu_ps(column),
                   _mm256_loadu_ps(column + kWidth), _mm256_loadu_ps(column + 2 * kWidth), s0, s1, s2);
    _mm256_storeu_ps(out + block, s0);
    _mm256_storeu_ps(out + block + kWidth, s1);
    _mm256_storeu_ps(out + block + 2 * kWidth, s2);
  }
}

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
void hidden_layer(const float*, const float*, const float*, std::int64_t, std::int64_t, float*) {}
void last_layer(const float*, const float*, float, std::int64_t, float*) {}
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

void Head::query(const float* points, std::int64_t m, float* values, int threads) const {
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
          hidden_layer(in, layer.weights.data(), layer.bias.data(), layer.inputs, layer.outputs, out);
          std::swap(in, out);
        }
        const Layer& final = layers_.back();
        last_layer(in, final.weights.data(), final.bias[0], final.inputs, result);
        std::copy(result, result + count, values + start);
      }
    }
  });
}

}  // namespace touchnet

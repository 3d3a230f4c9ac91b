// The occupancy head at many points: features read from volumes, then an MLP of fully connected layers with ReLU
// between them and one output. The points of a tile stay in the cache from the volumes to the output, and a point's
// sums run in one order: the value at a point depends neither on the other points nor on the number of threads.
#pragma once

#include <cstdint>
#include <vector>

#include "sampling.h"

namespace touchnet {

struct HeadVolume {
  const float* values;  // [1, C, X, Y, Z] of any strides; must outlive the head
  VolumeShape shape;
};

class Head {
 public:
  // Reads volumes with `sampler` (trilinear_forward or addition_forward); add the layers next, input first.
  using Sampler = void (*)(const float*, VolumeShape, const float*, std::int64_t, float*, int);
  Head(std::vector<HeadVolume> volumes, Sampler sampler);

  // weight (outputs, inputs) and bias (outputs) are copied. Inputs must be what comes before: the volumes' channels,
  // then the outputs of the layer added last; the last layer has one output.
  void add_layer(const float* weight, const float* bias, std::int64_t inputs, std::int64_t outputs);

  // values (m) at points (m, 3), contiguous; by AVX-512 where `wide` and the processor has it, to the same bits.
  void query(const float* points, std::int64_t m, float* values, int threads, bool wide = true) const;

  // Whether this processor has the instructions that the kernel needs (AVX2 and fused multiply-add).
  static bool is_supported();

 private:
  struct Layer {
    std::vector<float> weights, bias;  // weights [output / kOutputs][input][output % kOutputs], outputs padded by zeros
    std::int64_t inputs, outputs;      // outputs as padded
  };

  std::vector<HeadVolume> volumes_;
  Sampler sampler_;
  std::vector<Layer> layers_;
  std::int64_t features_ = 0, widest_ = 0;
};

}  // namespace touchnet

// The layers of the head on a tile, written once for two instruction sets: head.cpp includes this twice, with
//   TN_TARGET   the attribute that allows the instructions,
//   TN_FLOATS   a vector of floats,
//   TN_MM(name) the intrinsic of that name for it.
// Every lane does the same operations in the same order whatever the width, so that both give the same bits.

// A register block is kOutputs rows by 3 vectors of points: 12 accumulators, which hide the latency of the
// multiply-adds; with 3 inputs and 1 weight they fill the 16 registers of AVX2. For 12 multiply-adds it loads 7 times,
// fewer than the 2 loads beside 2 multiply-adds that a cycle has room for.
constexpr int kWidth = sizeof(TN_FLOATS) / sizeof(float), kBlock = 3 * kWidth;
static_assert(kTile % kBlock == 0);

TN_TARGET inline void multiply_add(TN_FLOATS w, TN_FLOATS x0, TN_FLOATS x1, TN_FLOATS x2, TN_FLOATS& s0, TN_FLOATS& s1,
                                   TN_FLOATS& s2) {
  s0 = TN_MM(fmadd_ps)(w, x0, s0);
  s1 = TN_MM(fmadd_ps)(w, x1, s1);
  s2 = TN_MM(fmadd_ps)(w, x2, s2);
}

TN_TARGET inline void store_rectified(TN_FLOATS s0, TN_FLOATS s1, TN_FLOATS s2, float* out) {  // max(0, NaN) is NaN
  const TN_FLOATS zero = TN_MM(setzero_ps)();
  TN_MM(storeu_ps)(out, TN_MM(max_ps)(zero, s0));
  TN_MM(storeu_ps)(out + kWidth, TN_MM(max_ps)(zero, s1));
  TN_MM(storeu_ps)(out + 2 * kWidth, TN_MM(max_ps)(zero, s2));
}

TN_TARGET void hidden_layer(const float* in, const float* weights, const float* bias, std::int64_t inputs,
                            std::int64_t outputs, float* out) {
  for (std::int64_t o = 0; o < outputs; o += kOutputs, weights += kOutputs * inputs) {
    for (int block = 0; block < kTile; block += kBlock) {
      // Twelve variables, not an array: compilers keep an array in memory.
      TN_FLOATS a0 = TN_MM(set1_ps)(bias[o]), a1 = a0, a2 = a0;
      TN_FLOATS b0 = TN_MM(set1_ps)(bias[o + 1]), b1 = b0, b2 = b0;
      TN_FLOATS c0 = TN_MM(set1_ps)(bias[o + 2]), c1 = c0, c2 = c0;
      TN_FLOATS d0 = TN_MM(set1_ps)(bias[o + 3]), d1 = d0, d2 = d0;
      const float* column = in + block;
      const float* weight = weights;
      for (std::int64_t k = 0; k < inputs; ++k, column += kTile, weight += kOutputs) {
        const TN_FLOATS x0 = TN_MM(loadu_ps)(column), x1 = TN_MM(loadu_ps)(column + kWidth),
                        x2 = TN_MM(loadu_ps)(column + 2 * kWidth);
        multiply_add(TN_MM(set1_ps)(weight[0]), x0, x1, x2, a0, a1, a2);
        multiply_add(TN_MM(set1_ps)(weight[1]), x0, x1, x2, b0, b1, b2);
        multiply_add(TN_MM(set1_ps)(weight[2]), x0, x1, x2, c0, c1, c2);
        multiply_add(TN_MM(set1_ps)(weight[3]), x0, x1, x2, d0, d1, d2);
      }
      float* row = out + o * kTile + block;
      store_rectified(a0, a1, a2, row);
      store_rectified(b0, b1, b2, row + kTile);
      store_rectified(c0, c1, c2, row + 2 * kTile);
      store_rectified(d0, d1, d2, row + 3 * kTile);
    }
  }
}

TN_TARGET void last_layer(const float* in, const float* weights, float bias, std::int64_t inputs, float* out) {
  for (int block = 0; block < kTile; block += kBlock) {
    TN_FLOATS s0 = TN_MM(set1_ps)(bias), s1 = s0, s2 = s0;
    const float* column = in + block;
    for (std::int64_t k = 0; k < inputs; ++k, column += kTile)
      multiply_add(TN_MM(set1_ps)(weights[kOutputs * k]), TN_MM(loadu_ps)(column), TN_MM(loadu_ps)(column + kWidth),
                   TN_MM(loadu_ps)(column + 2 * kWidth), s0, s1, s2);
    TN_MM(storeu_ps)(out + block, s0);
    TN_MM(storeu_ps)(out + block + kWidth, s1);
    TN_MM(storeu_ps)(out + block + 2 * kWidth, s2);
  }
}

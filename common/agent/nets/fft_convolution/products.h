// Products of complex matrices at every frequency, with 64 columns: the middle of a convolution by FFT. A complex
// product takes three real ones (Gauss): with A = a + i b and G = g + i h,
//     T = (a + b) g,   im = T + a (h - g),   re = T - b (h + g).

#pragma once

#include <cstdint>

#include "common/agent/nets/fft_convolution/kernels.h"
#include "common/agent/nets/simd.h"
#include "common/agent/nets/simd_block.h"

namespace craftfleet::CRAFTFLEET_SIMD {

constexpr int kChannels = 64;                   // of every matrix
constexpr int kPanel = kChannels * kChannels;   // floats of a square matrix
constexpr int kSpectrumFloats = 2 * kChannels;  // of one tile at one frequency: [re, im][64]
constexpr int64_t kFilterStep = FftKernels::kFilterStep;

enum class Target { kCached, kStreamed };

// Memory that the next product will read: its lines are prefetched while this one computes.
class Ahead {
 public:
  static constexpr int kLinesIn8 = kWidth == 16 ? 4 : 1;      // prefetched in 8 steps of a kernel
  static constexpr int kStretch = kChannels / 8 * kLinesIn8;  // and in 64

  Ahead(const float* first, int first_lines, const float* second, int second_lines)
      : first_(first), first_lines_(first_lines), second_(second), second_lines_(second_lines) {}

  // The next stretch of lines; null: all have been prefetched.
  const float* Next() {
    if (const float* const stretch = Take(&first_, &first_lines_); stretch != nullptr) return stretch;
    return Take(&second_, &second_lines_);
  }

 private:
  static constexpr int kLine = 16;  // floats

  static const float* Take(const float** from, int* lines) {
    if (*lines <= 0) return nullptr;
    const float* const stretch = *from;
    *lines -= kStretch;
    *from += kStretch * kLine;
    return stretch;
  }

  const float* first_;
  int first_lines_;
  const float* second_;
  int second_lines_;
};

// A matrix in memory: element (row, column) at data[row * row_step + column * column_step].
struct Factor {
  const float* data;
  int64_t row_step;
  int64_t column_step;
};

// c[Rows][kStrip] = init +- a[Rows][depth] b[depth][kStrip], added in the order of depth; no init: zeros. `ahead`:
// prefetched meanwhile, if it is not null. Loops are of 8 steps, since the end of a loop of 64 is not predicted.
template <int Rows, typename Op, Target T>
CRAFTFLEET_SIMD_INLINE void MultiplyBlock(int depth, Factor a, const float* b, int64_t b_step, const float* init,
                                          int64_t init_step, float* c, int64_t c_step, const float* ahead) {
  Block<Rows> sums;
  if (init != nullptr) sums.Begin([&](int m) { return init + m * init_step; });
  const auto step = [&] {
    sums.template Add<Op>([&](int m) { return a.data[m * a.row_step]; }, b);
    a.data += a.column_step;
    b += b_step;
  };
  int left = depth;
  if (ahead != nullptr) {
    for (; left >= 8; left -= 8) {
      CRAFTFLEET_UNROLL
      for (int k = 0; k < 8; ++k) {
        if (k < Ahead::kLinesIn8) _mm_prefetch(reinterpret_cast<const char*>(ahead + 16 * k), _MM_HINT_T1);
        step();
      }
      ahead += 16 * Ahead::kLinesIn8;
    }
  } else {
    for (; left >= 8; left -= 8) {
      CRAFTFLEET_UNROLL
      for (int k = 0; k < 8; ++k) step();
    }
  }
  for (; left > 0; --left) step();
  sums.End([&](int m) { return c + m * c_step; },
           [](float* to, Vector v) { T == Target::kStreamed ? Stream(to, v) : Store(to, v); });
}

// The same for any number of rows and 64 columns. Out of line, so that each variant is compiled once.
template <typename Op, Target T>
__attribute__((noinline)) void MultiplyPanel(int rows, int depth, Factor a, const float* b, int64_t b_step,
                                             const float* init, int64_t init_step, float* c, int64_t c_step,
                                             Ahead* ahead) {
  for (int column = 0; column < kChannels; column += kStrip) {
    ForBlocks(rows, [&](auto count, int64_t row) {
      MultiplyBlock<decltype(count)::kRows, Op, T>(depth, {a.data + row * a.row_step, a.row_step, a.column_step},
                                                   b + column, b_step,
                                                   init != nullptr ? init + row * init_step + column : nullptr,
                                                   init_step, c + row * c_step + column, c_step, ahead->Next());
    });
  }
}

// C = A G at every frequency: spectra of tiles times a filter.
//   a: [frequencies][tiles][re, im][64]
//   filter: frequency f at f * kFilterStep, [re, im][64][64]
//   c: [tiles][frequencies][re, im][64], written by non-temporal stores
inline void MultiplySpectra(int frequencies, int tiles, const float* a, const float* filter, float* c) {
  constexpr int kBlock = 64;  // tiles
  alignas(64) float difference[kPanel], total[kPanel], sums[kBlock * kChannels], products[kBlock * kChannels];
  const int blocks = (tiles + kBlock - 1) / kBlock;
  const int filter_lines = (2 * kPanel / 16 + blocks - 1) / blocks;  // of the next frequency, for each block
  const int64_t c_step = int64_t{frequencies} * kSpectrumFloats;
  for (int f = 0; f < frequencies; ++f) {
    const float* const re = filter + f * kFilterStep;
    const float* const im = re + kPanel;
    for (int i = 0; i < kPanel; i += kWidth) {
      Store(difference + i, Load(im + i) - Load(re + i));
      Store(total + i, Load(im + i) + Load(re + i));
    }
    for (int block = 0; block < blocks; ++block) {
      const int first = block * kBlock;
      const int rows = tiles - first < kBlock ? tiles - first : kBlock;
      const float* const a_re = a + (int64_t{f} * tiles + first) * kSpectrumFloats;
      const float* const a_im = a_re + kChannels;
      float* const c_re = c + first * c_step + int64_t{f} * kSpectrumFloats;
      const bool is_last = f + 1 == frequencies;
      // The tiles of the next block follow, and behind the last ones those of the next frequency.
      Ahead ahead(a_re + rows * kSpectrumFloats, is_last && block + 1 == blocks ? 0 : rows * kSpectrumFloats / 16,
                  re + kFilterStep + block * filter_lines * 16, is_last ? 0 : filter_lines);
      for (int i = 0; i < rows; ++i) {
        for (int k = 0; k < kChannels; k += kWidth) {
          const float* const at = a_re + i * kSpectrumFloats + k;
          Store(sums + i * kChannels + k, Load(at) + Load(at + kChannels));
        }
      }
      MultiplyPanel<Plus, Target::kCached>(rows, kChannels, {sums, kChannels, 1}, re, kChannels, nullptr, 0, products,
                                           kChannels, &ahead);
      MultiplyPanel<Plus, Target::kStreamed>(rows, kChannels, {a_re, kSpectrumFloats, 1}, difference, kChannels,
                                             products, kChannels, c_re + kChannels, c_step, &ahead);
      MultiplyPanel<Minus, Target::kStreamed>(rows, kChannels, {a_im, kSpectrumFloats, 1}, total, kChannels, products,
                                              kChannels, c_re, c_step, &ahead);
    }
  }
  _mm_sfence();
}

// out = X^T conj(D) at every frequency, summed over all tiles: the gradient of a filter.
//   x, d: chunks of at most `chunk_tiles` tiles, one after the other, each [frequencies][its tiles][re, im][64]
//   out: frequency f at f * kFilterStep, [re, im][64][64]
// With X = a + i b and D = g + i h: P = a^T g, R = b^T h, S = (a + b)^T (g - h) give re = P + R, im = S - P + R.
inline void CorrelateSpectra(int frequencies, int tiles, int chunk_tiles, const float* x, const float* d, float* out) {
  constexpr int kBlock = 64;  // tiles
  alignas(64) float x_sums[kBlock * kChannels], d_differences[kBlock * kChannels];
  alignas(64) float p[kPanel], r[kPanel], s[kPanel];
  struct Block {
    int64_t at;  // floats before it
    int tiles;
  };
  // Block `number` of chunk `chunk` at frequency f; no tiles: there is none.
  const auto find = [&](int f, int chunk, int number) {
    const int first = chunk * chunk_tiles;
    const int in_chunk = tiles - first < chunk_tiles ? tiles - first : chunk_tiles;
    const int left = in_chunk - number * kBlock;
    return Block{(int64_t{first} * frequencies + int64_t{f} * in_chunk + number * kBlock) * kSpectrumFloats,
                 left < kBlock ? left : kBlock};
  };
  const int chunks = (tiles + chunk_tiles - 1) / chunk_tiles;
  for (int f = 0; f < frequencies; ++f) {
    bool is_first = true;
    for (int chunk = 0; chunk < chunks; ++chunk) {
      Block next = find(f, chunk, 0);
      for (int number = 0; next.tiles > 0; ++number) {
        const Block block = next;
        next = find(f, chunk, number + 1);
        Block read_next = next;  // in this chunk, in the next one, or at the next frequency
        if (read_next.tiles <= 0) read_next = chunk + 1 < chunks ? find(f, chunk + 1, 0) : find(f + 1, 0, 0);
        const int lines =
            f + 1 == frequencies && chunk + 1 == chunks && next.tiles <= 0 ? 0 : read_next.tiles * kSpectrumFloats / 16;
        Ahead ahead(x + read_next.at, lines, d + read_next.at, lines);
        const float* const x_re = x + block.at;
        const float* const d_re = d + block.at;
        for (int i = 0; i < block.tiles; ++i) {
          for (int k = 0; k < kChannels; k += kWidth) {
            const int64_t at = int64_t{i} * kSpectrumFloats + k;
            Store(x_sums + i * kChannels + k, Load(x_re + at) + Load(x_re + at + kChannels));
            Store(d_differences + i * kChannels + k, Load(d_re + at) - Load(d_re + at + kChannels));
          }
        }
        const auto add = [&](const float* left, int64_t left_step, const float* right, int64_t right_step, float* sum) {
          MultiplyPanel<Plus, Target::kCached>(kChannels, block.tiles, {left, 1, left_step}, right, right_step,
                                               is_first ? nullptr : sum, kChannels, sum, kChannels, &ahead);
        };
        add(x_re, kSpectrumFloats, d_re, kSpectrumFloats, p);
        add(x_re + kChannels, kSpectrumFloats, d_re + kChannels, kSpectrumFloats, r);
        add(x_sums, kChannels, d_differences, kChannels, s);
        is_first = false;
      }
    }
    float* const re = out + f * kFilterStep;
    for (int i = 0; i < kPanel; i += kWidth) {
      Store(re + i, Load(p + i) + Load(r + i));
      Store(re + kPanel + i, (Load(s + i) - Load(p + i)) + Load(r + i));
    }
  }
}

}  // namespace craftfleet::CRAFTFLEET_SIMD

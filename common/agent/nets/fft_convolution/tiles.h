// From maps to spectra of their tiles and back: the outer parts of a convolution by FFT, 5x5 with a border of two
// zeros, 64 to 64 channels. A map is float[size][size][64]; `size` is a multiple of kOutputs, the outputs of a tile.
//
// The spectrum of a tile is [frequencies][re, im][64]; a chunk of tiles has theirs as [frequencies][tiles][re, im][64]
// before the product (MultiplySpectra) and one after the other behind it. All large arrays are read in the order of
// their addresses and written by non-temporal stores of whole cache lines: that matters as much as the arithmetic.

#pragma once

#include <cstdint>
#include <cstring>

#include "common/agent/nets/fft_convolution/products.h"
#include "common/agent/nets/fft_convolution/tile_fft.h"
#include "common/agent/nets/simd.h"

namespace craftfleet::CRAFTFLEET_SIMD {

constexpr int kKernel = 5;
constexpr int kBorder = 2;
constexpr int kOverlap = kKernel - 1;  // of neighbouring tiles

template <int Q>
struct Tiles {
  using Fft = TileFft<Q>;
  static constexpr int kPoints = Fft::kPoints;
  static constexpr int kOutputs = kPoints - kOverlap;
  static constexpr int kGroups = kChannels / kWidth;  // vectors of a pixel
  static constexpr int kTileRowsFloats = kGroups * Fft::kRowsFloats;
  static constexpr int64_t kTileFloats = int64_t{Fft::kFrequencies} * kSpectrumFloats;

  // Floats of scratch memory that the functions below need for maps of this size: a band of tiles between rows and
  // columns, and what overlaps the band below.
  static constexpr int64_t ScratchFloats(int size) {
    return int64_t{size / kOutputs} * kTileRowsFloats + int64_t{kOverlap} * size * kChannels;
  }

  // Tile (i, j) covers the rows from i kOutputs - 2 on and the columns from j kOutputs - 2 on. Its spectrum goes to
  // tile number `first` + i tiles + j of a chunk of `chunk_tiles`.
  static void TransformInput(int size, const float* map, float* spectra, int64_t chunk_tiles, float* scratch) {
    const int side = size / kOutputs;
    for (int i = 0; i < side; ++i) {
      for (int r = 0; r < kPoints; ++r) {
        const int y = i * kOutputs - kBorder + r;
        const bool is_inside = y >= 0 && y < size;
        const float* const line = map + int64_t{y} * size * kChannels;
        for (int j = 0; j < side; ++j) {
          const int x = j * kOutputs - kBorder;
          const int begin = x < 0 ? kBorder : 0;
          const int end = size - x < kPoints ? size - x : kPoints;
          if (is_inside) Touch(line + (x + begin) * kChannels, int64_t{end - begin} * kChannels);
          for (int g = 0; g < kGroups; ++g) {
            float* const row = RowOf(scratch, j, g, r);
            is_inside ? InputRow(line + int64_t{x} * kChannels + g * kWidth, begin, end, row) : ClearRow(row);
          }
        }
      }
      TransformColumns(side, scratch, spectra + int64_t{i} * side * kSpectrumFloats, chunk_tiles);
    }
  }

  // Of the gradient of an output: tiles of kOutputs that do not overlap, zeros behind. Where `mask`, 64 bits a pixel,
  // is 0, the gradient counts as 0. The rest as TransformInput.
  static void TransformGradient(int size, const float* gradient, const uint8_t* mask, float* spectra,
                                int64_t chunk_tiles, float* scratch) {
    const int side = size / kOutputs;
    for (int i = 0; i < side; ++i) {
      for (int r = 0; r < kPoints; ++r) {
        const int64_t line = int64_t{i * kOutputs + r} * size * kChannels;
        for (int j = 0; j < side; ++j) {
          const int64_t from = line + int64_t{j} * kOutputs * kChannels;
          if (r < kOutputs) Touch(gradient + from, int64_t{kOutputs} * kChannels);
          for (int g = 0; g < kGroups; ++g) {
            float* const row = RowOf(scratch, j, g, r);
            const int64_t at = from + g * kWidth;
            r < kOutputs ? GradientRow(gradient + at, mask + at / 8, row) : ClearRow(row);
          }
        }
      }
      TransformColumns(side, scratch, spectra + int64_t{i} * side * kSpectrumFloats, chunk_tiles);
    }
  }

  // The tiles of one map, one after the other -> output = max(inverse + bias, 0) and its mask, 64 bits a pixel. A value
  // up to `threshold` counts as 0: where the exact output is 0 the FFT leaves noise.
  static void InverseOutput(int size, const float* spectra, const float* bias, float threshold, float* output,
                            uint8_t* mask, float* scratch) {
    alignas(64) float line[kOutputs * kChannels], aligned_bias[kChannels];
    std::memcpy(aligned_bias, bias, sizeof(aligned_bias));
    const int side = size / kOutputs;
    for (int i = 0; i < side; ++i) {
      for (int j = 0; j < side; ++j) InverseColumns(spectra + (i * side + j) * kTileFloats, RowOf(scratch, j, 0, 0));
      for (int r = 0; r < kOutputs; ++r) {
        for (int j = 0; j < side; ++j) {
          for (int g = 0; g < kGroups; ++g) InverseRow<kOutputs>(RowOf(scratch, j, g, r), line + g * kWidth);
          const int64_t at = (int64_t{i * kOutputs + r} * size + j * kOutputs) * kChannels;
          WriteOutput(line, aligned_bias, threshold, output + at, mask + at / 8);
        }
      }
    }
  }

  // The tiles of one map -> the gradient of an input: the inverse tiles overlap and are added.
  static void InverseGradient(int size, const float* spectra, float* gradient, float* scratch) {
    alignas(64) float line[kPoints * kChannels];
    alignas(64) float from_left[kOverlap * kChannels];  // the last columns of the tile on the left
    const int side = size / kOutputs;
    // The last rows of the band above: [kOverlap][size][64].
    float* const from_above = scratch + int64_t{side} * kTileRowsFloats;
    for (int i = 0; i < side; ++i) {
      for (int j = 0; j < side; ++j) InverseColumns(spectra + (i * side + j) * kTileFloats, RowOf(scratch, j, 0, 0));
      for (int r = 0; r < kPoints; ++r) {
        const int y = i * kOutputs - kBorder + r;
        if (y < 0 || y >= size) continue;
        const bool is_kept = r >= kOutputs && i + 1 < side;
        float* const kept = from_above + int64_t{r % kOutputs} * size * kChannels;
        float* const to = is_kept ? kept : gradient + int64_t{y} * size * kChannels;
        for (int j = 0; j < side; ++j) {
          for (int g = 0; g < kGroups; ++g) InverseRow<kPoints>(RowOf(scratch, j, g, r), line + g * kWidth);
          if (j > 0) AddTo(line, from_left, kOverlap);
          const int x = j * kOutputs - kBorder;
          const int begin = j == 0 ? kBorder : 0;
          const int end = j + 1 == side ? kPoints - kBorder : kOutputs;
          if (j + 1 < side) std::memcpy(from_left, line + kOutputs * kChannels, sizeof(from_left));
          const int64_t at = int64_t{x + begin} * kChannels;
          const float* const values = line + begin * kChannels;
          if (is_kept) {
            std::memcpy(to + at, values, sizeof(float) * (end - begin) * kChannels);
          } else {
            StreamSum(values, r < kOverlap && i > 0 ? kept + at : nullptr, end - begin, to + at);
          }
        }
      }
    }
  }

  // weight[64 out][64 in][5][5] -> a filter for MultiplySpectra, divided by kPoints^2. For the output the matrices are
  // [in][out] and conjugate, since the layer correlates: Y[m] = sum over k of X[m + k] W[k]. For the gradient of the
  // input they are [out][in]: X'[m + k] = sum of Y'[m] W[k].   taps: scratch, [64][5][5][64].
  static void TransformFilter(const float* weight, bool for_output, float* filter, float* taps, float* scratch) {
    constexpr float kScale = 1.0F / (kPoints * kPoints);
    for (int out = 0; out < kChannels; ++out) {
      for (int in = 0; in < kChannels; ++in) {
        for (int k = 0; k < kKernel * kKernel; ++k) {
          const int row = for_output ? in : out;
          const int column = for_output ? out : in;
          taps[(row * kKernel * kKernel + k) * kChannels + column] =
              weight[(out * kChannels + in) * kKernel * kKernel + k] * kScale;
        }
      }
    }
    std::memset(scratch, 0, sizeof(float) * Fft::kRowsFloats);
    for (int row = 0; row < kChannels; ++row) {
      for (int column = 0; column < kChannels; column += kWidth) {
        const float* const from = taps + row * kKernel * kKernel * kChannels + column;
        for (int y = 0; y < kKernel; ++y) {
          InputRow(from + y * kKernel * kChannels, 0, kKernel, scratch + y * Fft::kRowFloats);
        }
        FilterColumns(scratch, for_output, filter + row * kChannels + column);
      }
    }
  }

  // The result of CorrelateSpectra -> the gradient of the weight, [64 out][64 in][5][5].
  static void InverseFilter(const float* filter, float* gradient, float* taps, float* scratch) {
    for (int in = 0; in < kChannels; ++in) {
      for (int out = 0; out < kChannels; out += kWidth) {
        InverseFilterColumns(filter + in * kChannels + out, scratch);
        for (int y = 0; y < kKernel; ++y) {
          InverseRow<kKernel>(scratch + y * Fft::kRowFloats, taps + (in * kKernel + y) * kKernel * kChannels + out);
        }
      }
    }
    constexpr float kScale = 1.0F / (kPoints * kPoints);
    for (int out = 0; out < kChannels; ++out) {
      for (int in = 0; in < kChannels; ++in) {
        for (int k = 0; k < kKernel * kKernel; ++k) {
          gradient[(out * kChannels + in) * kKernel * kKernel + k] =
              taps[(in * kKernel * kKernel + k) * kChannels + out] * kScale;
        }
      }
    }
  }

 private:
  // Row r of group g of the band's tile j, between the transforms of rows and of columns.
  static float* RowOf(float* scratch, int j, int g, int r) {
    return scratch + int64_t{j} * kTileRowsFloats + g * Fft::kRowsFloats + r * Fft::kRowFloats;
  }

  static void ClearRow(float* row) { std::memset(row, 0, sizeof(float) * Fft::kRowFloats); }

  // Pixels [begin, end) of a row; the others are 0. `from` is where pixel 0 would be.
  static void InputRow(const float* from, int begin, int end, float* row) {
    if (begin == 0 && end == kPoints) return InputRowOf<0, kPoints>(from, row);
    if (begin == 0 && end == kKernel) return InputRowOf<0, kKernel>(from, row);
    if (begin == 0) return InputRowOf<0, kPoints - kBorder>(from, row);
    if (end == kPoints) return InputRowOf<kBorder, kPoints>(from, row);
    return InputRowOf<kBorder, kPoints - kBorder>(from, row);
  }

  template <int Begin, int End>
  __attribute__((noinline)) static void InputRowOf(const float* from, float* row) {
    Fft::Row([&](int n) { return n >= Begin && n < End ? Load(from + n * kChannels) : Zero(); }, row);
  }

  __attribute__((noinline)) static void GradientRow(const float* from, const uint8_t* mask, float* row) {
    Fft::Row(
        [&](int n) { return n < kOutputs ? KeepWhere(Load(from + n * kChannels), mask + n * kChannels / 8) : Zero(); },
        row);
  }

  // The first Count points of a row -> line[n][64].
  template <int Count>
  __attribute__((noinline)) static void InverseRow(const float* row, float* line) {
    Fft::RowInverse(row, [&](int n, Vector v) {
      if (n < Count) Store(line + n * kChannels, v);
    });
  }

  // The columns of a band's tiles; frequency f of tile j goes to spectra + (f chunk_tiles + j) kSpectrumFloats.
  static void TransformColumns(int side, const float* scratch, float* spectra, int64_t chunk_tiles) {
    const int64_t step = chunk_tiles * kSpectrumFloats;
    for (int j = 0; j < side; ++j) {
      const float* const rows = scratch + int64_t{j} * kTileRowsFloats;
      float* const to = spectra + int64_t{j} * kSpectrumFloats;
      RealColumn(rows, step, to);
      for (int c = 1; c < Fft::kColumns; ++c) {
        ComplexColumn(rows, c, step, to + (2 * Fft::kHalfColumn + (c - 1) * kPoints) * step);
      }
    }
  }

  __attribute__((noinline)) static void ComplexColumn(const float* rows, int c, int64_t step, float* to) {
    alignas(64) float spectra[kGroups][Fft::kColumnFloats];
    for (int g = 0; g < kGroups; ++g) Fft::Column(rows + g * Fft::kRowsFloats, c, spectra[g]);
    for (int k = 0; k < kPoints; ++k) {
      for (int part = 0; part < 2; ++part) {
        CRAFTFLEET_UNROLL
        for (int g = 0; g < kGroups; ++g) {
          Stream(to + k * step + part * kChannels + g * kWidth, Load(spectra[g] + (2 * k + part) * kWidth));
        }
      }
    }
  }

  // Column 0 and what it holds of the middle frequency.
  __attribute__((noinline)) static void RealColumn(const float* rows, int64_t step, float* to) {
    constexpr int kNumbers = 2 * Fft::kHalfColumn;  // of both columns: frequencies
    alignas(64) float line[kNumbers * kSpectrumFloats];
    for (int g = 0; g < kGroups; ++g) {
      alignas(64) float spectrum[Fft::kColumnFloats];
      Fft::Column(rows + g * Fft::kRowsFloats, 0, spectrum);
      Fft::SplitReal(spectrum, [&](int u, Vector a_re, Vector a_im, Vector b_re, Vector b_im) {
        float* const a = line + u * kSpectrumFloats + g * kWidth;
        float* const b = a + Fft::kHalfColumn * kSpectrumFloats;
        Store(a, a_re), Store(a + kChannels, a_im), Store(b, b_re), Store(b + kChannels, b_im);
      });
    }
    for (int u = 0; u < kNumbers; ++u) {
      CRAFTFLEET_UNROLL
      for (int i = 0; i < kSpectrumFloats; i += kWidth) Stream(to + u * step + i, Load(line + u * kSpectrumFloats + i));
    }
  }

  // The inverse for a tile's spectrum; `rows` is RowOf(scratch, tile, 0, 0).
  static void InverseColumns(const float* spectrum, float* rows) {
    Touch(spectrum, 2 * Fft::kHalfColumn * kSpectrumFloats);
    for (int g = 0; g < kGroups; ++g) {
      InverseRealColumn(spectrum + g * kWidth, kSpectrumFloats, kChannels, rows + g * Fft::kRowsFloats);
    }
    for (int c = 1; c < Fft::kColumns; ++c) {
      const float* const column = spectrum + (2 * Fft::kHalfColumn + (c - 1) * kPoints) * kSpectrumFloats;
      Touch(column, kPoints * kSpectrumFloats);
      for (int g = 0; g < kGroups; ++g) {
        InverseComplexColumn(column + g * kWidth, kSpectrumFloats, kChannels, c, rows + g * Fft::kRowsFloats);
      }
    }
  }

  // The columns' frequencies are `step` floats apart, imaginary parts `im_step` behind the real ones.
  __attribute__((noinline)) static void InverseComplexColumn(const float* column, int64_t step, int64_t im_step, int c,
                                                             float* rows) {
    alignas(64) float spectrum[Fft::kColumnFloats];
    for (int k = 0; k < kPoints; ++k) {
      Fft::StorePair(spectrum, k, Load(column + k * step), Load(column + k * step + im_step));
    }
    Fft::ColumnInverse(spectrum, c, rows);
  }

  __attribute__((noinline)) static void InverseRealColumn(const float* columns, int64_t step, int64_t im_step,
                                                          float* rows) {
    alignas(64) float spectrum[Fft::kColumnFloats];
    Fft::JoinReal(
        [&](int u, Vector* a_re, Vector* a_im, Vector* b_re, Vector* b_im) {
          const float* const a = columns + u * step;
          const float* const b = a + Fft::kHalfColumn * step;
          *a_re = Load(a), *a_im = Load(a + im_step), *b_re = Load(b), *b_im = Load(b + im_step);
        },
        spectrum);
    Fft::ColumnInverse(spectrum, 0, rows);
  }

  // One vector of channels of a filter.
  static void FilterColumns(const float* rows, bool conjugate, float* filter) {
    const auto put = [&](int f, Vector re, Vector im) {
      Store(filter + f * kFilterStep, re);
      Store(filter + f * kFilterStep + kPanel, conjugate ? -im : im);
    };
    alignas(64) float spectrum[Fft::kColumnFloats];
    Fft::Column(rows, 0, spectrum);
    Fft::SplitReal(spectrum, [&](int u, Vector a_re, Vector a_im, Vector b_re, Vector b_im) {
      put(u, a_re, a_im);
      put(Fft::kHalfColumn + u, b_re, b_im);
    });
    for (int c = 1; c < Fft::kColumns; ++c) {
      Fft::Column(rows, c, spectrum);
      for (int k = 0; k < kPoints; ++k) {
        Vector re, im;
        Fft::LoadPair(spectrum, k, &re, &im);
        put(2 * Fft::kHalfColumn + (c - 1) * kPoints + k, re, im);
      }
    }
  }

  static void InverseFilterColumns(const float* filter, float* rows) {
    InverseRealColumn(filter, kFilterStep, kPanel, rows);
    for (int c = 1; c < Fft::kColumns; ++c) {
      InverseComplexColumn(filter + (2 * Fft::kHalfColumn + (c - 1) * kPoints) * kFilterStep, kFilterStep, kPanel, c,
                           rows);
    }
  }

  // line[kOutputs][64] -> outputs and mask.
  static void WriteOutput(const float* line, const float* bias, float threshold, float* output, uint8_t* mask) {
    const Vector bound = Broadcast(threshold);
    for (int n = 0; n < kOutputs; ++n) {
      CRAFTFLEET_UNROLL
      for (int g = 0; g < kGroups; ++g) {
        const int at = n * kChannels + g * kWidth;
        Stream(output + at, CutBelow(Load(line + at) + Load(bias + g * kWidth), bound, mask + at / 8));
      }
    }
  }

  static void AddTo(float* to, const float* from, int pixels) {
    for (int i = 0; i < pixels * kChannels; i += kWidth) Store(to + i, Load(to + i) + Load(from + i));
  }

  // `above`: added, if it is not null.
  static void StreamSum(const float* values, const float* above, int pixels, float* to) {
    for (int i = 0; i < pixels * kChannels; i += kWidth) {
      Stream(to + i, above != nullptr ? Load(values + i) + Load(above + i) : Load(values + i));
    }
  }
};

}  // namespace craftfleet::CRAFTFLEET_SIMD

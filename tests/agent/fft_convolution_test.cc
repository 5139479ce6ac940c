// The convolution by FFT: its transform, its products and the whole, each against its definition in float64.

#include "common/agent/nets/fft_convolution/fft_convolution.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <cstring>
#include <tuple>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/nets/fft_convolution/kernels.h"
#include "common/agent/pooled_buffer.h"
#include "common/base/cpu_path.h"
#include "tests/agent/kernel_numbers.h"

namespace craftfleet {
namespace {

using testing::KernelPaths;
using testing::kMaxError;
using testing::RelativeError;

constexpr int kChannels = FftConvolution::kChannels;
constexpr int kKernel = FftConvolution::kKernel;
constexpr int64_t kFilterStep = FftKernels::kFilterStep;

// Aligned floats.
class Floats {
 public:
  explicit Floats(int64_t size) : size_(size), buffer_(size) { std::fill_n(data(), size, 0.0F); }
  // Numbers in [-scale / 2, scale / 2) that depend on `stream`.
  Floats(int64_t size, uint64_t stream, double scale = 1) : Floats(size) {
    testing::FillNumbers(size, stream, scale, data());
  }
  float* data() const { return buffer_.get(); }
  float operator[](int64_t i) const { return data()[i]; }
  int64_t size() const { return size_; }
  std::vector<float> values() const { return {data(), data() + size_}; }

 private:
  int64_t size_;
  PooledBuffer buffer_;
};

double RelativeError(const std::vector<double>& want, const Floats& got) {
  double error = 0;
  double norm = 0;
  for (size_t i = 0; i < want.size(); ++i) {
    error += (want[i] - got[i]) * (want[i] - got[i]);
    norm += want[i] * want[i];
  }
  return std::sqrt(error / norm);
}

// The frequency k of a spectrum of 4 Q points at the place k0 Q + k1, where k0 = k mod 4 and k1 = k mod Q.
int FrequencyAt(int place, int q) {
  int k = 0;
  while (k % 4 != place / q || k % q != place % q) ++k;
  return k;
}

// (ky, kx) of each frequency of a tile's spectrum, in the order of tile_fft.h.
std::vector<std::pair<int, int>> Frequencies(int q) {
  const int half = (q - 1) / 2;
  const auto column_of = [&](int c) {
    if (c <= half) return FrequencyAt(c, q);
    return c <= 2 * half ? FrequencyAt(2 * q + c - half, q) : FrequencyAt(q + c - 2 * half - 1, q);
  };
  std::vector<int> half_column = {0, 2 * q};  // places
  for (int k = 1; k <= half; ++k) half_column.push_back(k);
  for (int k = 1; k <= half; ++k) half_column.push_back(2 * q + k);
  for (int k = 0; k < q; ++k) half_column.push_back(q + k);
  std::vector<std::pair<int, int>> frequencies;
  for (const int kx : {0, 2 * q}) {
    for (const int place : half_column) frequencies.emplace_back(FrequencyAt(place, q), kx);
  }
  for (int c = 1; c < 2 * q; ++c) {
    for (int place = 0; place < 4 * q; ++place) frequencies.emplace_back(FrequencyAt(place, q), column_of(c));
  }
  return frequencies;
}

class FftKernelsTest : public ::testing::TestWithParam<int> {
 protected:
  void SetUp() override {
    if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  }
};

// X[ky, kx] = sum over y and x of x[y, x] exp(-2 pi i (y ky + x kx) / N), of a tile with its border of zeros.
TEST_P(FftKernelsTest, TheTransformOfATileIsItsDefinition) {
  const int size = GetParam();
  for (const CpuPath path : KernelPaths()) {
    const FftKernels& kernels = *FindFftKernels(path, size);
    const int points = kernels.outputs + 4;
    const Floats map(int64_t{size} * size * kChannels, 1);
    const Floats spectrum(int64_t{kernels.frequencies} * 2 * kChannels);
    const Floats scratch(kernels.scratch_floats(size));
    kernels.transform_input(size, map.data(), spectrum.data(), /*chunk_tiles=*/1, scratch.data());
    const std::vector<std::pair<int, int>> frequencies = Frequencies(points / 4);
    ASSERT_EQ(frequencies.size(), static_cast<size_t>(kernels.frequencies));
    for (const int channel : {0, 37, 63}) {
      double error = 0;
      double norm = 0;
      for (size_t f = 0; f < frequencies.size(); f += 7) {
        std::complex<double> want = 0;
        for (int y = 0; y < size; ++y) {
          for (int x = 0; x < size; ++x) {
            const double turns = ((y + 2.0) * frequencies[f].first + (x + 2.0) * frequencies[f].second) / points;
            want += double{map[(y * size + x) * kChannels + channel]} * std::polar(1.0, -2 * M_PI * turns);
          }
        }
        const int64_t at = f * 2 * kChannels + channel;
        error += std::norm(want - std::complex<double>(spectrum[at], spectrum[at + kChannels]));
        norm += std::norm(want);
      }
      EXPECT_LT(std::sqrt(error / norm), kMaxError) << CpuPathName(path) << ", channel " << channel;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, FftKernelsTest, ::testing::Values(32, 24));

std::complex<double> Complex(const Floats& values, int64_t at, int64_t im_step) {
  return {values[at], values[at + im_step]};
}

TEST(FftProducts, AreComplexMatrixProductsAtEachFrequency) {
  constexpr int kFrequencies = 3;
  for (const CpuPath path : KernelPaths()) {
    const FftKernels& kernels = *FindFftKernels(path, 32);
    for (const int tiles : {1, 4, 5, 8, 63, 64, 71}) {
      const Floats a(int64_t{kFrequencies} * tiles * 2 * kChannels, 2);
      const Floats filter(kFrequencies * kFilterStep, 3);
      const Floats c(a.size());
      kernels.multiply(kFrequencies, tiles, a.data(), filter.data(), c.data());
      std::vector<double> want(c.size());
      for (int f = 0; f < kFrequencies; ++f) {
        for (int tile = 0; tile < tiles; ++tile) {
          for (int column = 0; column < kChannels; ++column) {
            std::complex<double> sum = 0;
            for (int k = 0; k < kChannels; ++k) {
              sum += Complex(a, (int64_t{f} * tiles + tile) * 2 * kChannels + k, kChannels) *
                     Complex(filter, f * kFilterStep + k * kChannels + column, kChannels * kChannels);
            }
            const int64_t at = (int64_t{tile} * kFrequencies + f) * 2 * kChannels + column;
            want[at] = sum.real(), want[at + kChannels] = sum.imag();
          }
        }
      }
      EXPECT_LT(RelativeError(want, c), kMaxError) << CpuPathName(path) << ", " << tiles << " tiles";
    }
  }
}

TEST(FftProducts, CorrelateAllTilesOfAllCalls) {
  constexpr int kFrequencies = 3;
  for (const CpuPath path : KernelPaths()) {
    const FftKernels& kernels = *FindFftKernels(path, 32);
    const Floats sums(kFrequencies * FftKernels::kSumsStep);
    const Floats filter(kFrequencies * kFilterStep);
    std::vector<double> want(filter.size());
    for (const int tiles : {9, 70, 150}) {
      const Floats x(int64_t{kFrequencies} * tiles * 2 * kChannels, 4);
      const Floats d(x.size(), 5);
      kernels.correlate(kFrequencies, tiles, x.data(), d.data(), /*adds=*/tiles > 9, sums.data());
      for (int f = 0; f < kFrequencies; ++f) {
        for (int tile = 0; tile < tiles; ++tile) {
          const int64_t at = (int64_t{f} * tiles + tile) * 2 * kChannels;
          for (int i = 0; i < kChannels; ++i) {
            for (int j = 0; j < kChannels; ++j) {
              const std::complex<double> product =
                  Complex(x, at + i, kChannels) * std::conj(Complex(d, at + j, kChannels));
              const int64_t to = f * kFilterStep + i * kChannels + j;
              want[to] += product.real(), want[to + kChannels * kChannels] += product.imag();
            }
          }
        }
      }
      kernels.combine_sums(kFrequencies, sums.data(), filter.data());
      EXPECT_LT(RelativeError(want, filter), kMaxError) << CpuPathName(path) << ", " << tiles << " tiles";
    }
  }
}

// A layer on `n` maps, with what it computes.
struct Layer {
  Layer(int size, int n)
      : size(size),
        n(n),
        input(int64_t{n} * size * size * kChannels, 6),
        output_gradient(input.size(), 7),
        weight(FftConvolution::kWeights, 8, 0.2),
        bias(kChannels, 9, 0.2),
        output(input.size()),
        input_gradient(input.size()),
        weight_gradient(FftConvolution::kWeights),
        bias_gradient(kChannels) {}

  void Compute() {
    const FftConvolution convolution(size);
    mask.resize(convolution.mask_bytes(n));
    const Floats spectra(convolution.spectra_floats(n));
    const Floats filter(convolution.filter_floats());
    convolution.TransformFilter(weight.data(), FftConvolution::Use::kOutput, filter.data());
    convolution.Forward(n, input.data(), filter.data(), bias.data(), output.data(), mask.data(), spectra.data());
    convolution.TransformFilter(weight.data(), FftConvolution::Use::kInputGradient, filter.data());
    convolution.Backward(n, output_gradient.data(), mask.data(), spectra.data(), filter.data(),
                         {input_gradient.data(), weight_gradient.data(), bias_gradient.data()});
  }

  bool IsPositive(int64_t at) const { return (mask[at / 8] >> (at % 8) & 1) != 0; }

  int size;
  int n;
  Floats input, output_gradient, weight, bias;
  Floats output, input_gradient, weight_gradient, bias_gradient;
  std::vector<uint8_t> mask;
};

// [n,S,S,64] as LibTorch's [n,64,S,S], in float64.
at::Tensor Map(const Floats& pixels, int n, int size) {
  return at::from_blob(pixels.data(), {n, size, size, kChannels}).permute({0, 3, 1, 2}).to(at::kDouble);
}

// Y = max(X * W + b, 0) and its gradients in float64, with the layer's own mask: where the exact value is next to 0,
// either side is right.
void ExpectDefinition(const Layer& layer) {
  const auto leaf = [](at::Tensor tensor) { return tensor.contiguous().set_requires_grad(true); };
  const at::Tensor input = leaf(Map(layer.input, layer.n, layer.size));
  const at::Tensor weight =
      leaf(at::from_blob(layer.weight.data(), {kChannels, kChannels, kKernel, kKernel}).to(at::kDouble));
  const at::Tensor bias = leaf(at::from_blob(layer.bias.data(), {kChannels}).to(at::kDouble));
  const Floats kept(layer.output.size());
  for (int64_t i = 0; i < kept.size(); ++i) kept.data()[i] = layer.IsPositive(i) ? 1 : 0;
  const at::Tensor sums = at::conv2d(input, weight, bias, /*stride=*/1, /*padding=*/2);
  const at::Tensor output = sums * Map(kept, layer.n, layer.size);
  EXPECT_LT((sums - output).max().item<double>(), 1e-5) << "counts as 0";
  torch::autograd::backward({output}, {Map(layer.output_gradient, layer.n, layer.size)});
  EXPECT_LT(RelativeError(output.detach(), Map(layer.output, layer.n, layer.size)), kMaxError);
  EXPECT_LT(RelativeError(input.grad(), Map(layer.input_gradient, layer.n, layer.size)), kMaxError);
  EXPECT_LT(RelativeError(weight.grad(), at::from_blob(layer.weight_gradient.data(), weight.sizes())), kMaxError);
  EXPECT_LT(RelativeError(bias.grad(), at::from_blob(layer.bias_gradient.data(), bias.sizes())), kMaxError);
}

class FftConvolutionTest : public ::testing::TestWithParam<std::tuple<int, int>> {};

TEST_P(FftConvolutionTest, OutputsAndGradientsAreTheirDefinition) {
  const auto [size, n] = GetParam();
  for (const CpuPath path : KernelPaths()) {
    const ScopedCpuPath scoped(path);
    SCOPED_TRACE(CpuPathName(path));
    Layer layer(size, n);
    layer.Compute();
    ExpectDefinition(layer);
  }
}

// One, two and three tiles a side, both transforms; more maps than are transformed at once.
INSTANTIATE_TEST_SUITE_P(SizesAndMaps, FftConvolutionTest,
                         ::testing::Values(std::tuple(24, 1), std::tuple(24, 35), std::tuple(32, 3), std::tuple(48, 2),
                                           std::tuple(64, 3), std::tuple(72, 1), std::tuple(96, 1)));

TEST(FftConvolution, BothInstructionSetsComputeTheSameBits) {
  if (KernelPaths().size() < 2) GTEST_SKIP() << "a CPU without AVX-512";
  for (const int size : {64, 72}) {
    std::vector<std::vector<float>> results;
    for (const CpuPath path : KernelPaths()) {
      const ScopedCpuPath scoped(path);
      Layer layer(size, 5);
      layer.Compute();
      results.push_back({});
      for (const Floats* part : {&layer.output, &layer.input_gradient, &layer.weight_gradient, &layer.bias_gradient}) {
        const std::vector<float> values = part->values();
        results.back().insert(results.back().end(), values.begin(), values.end());
      }
    }
    EXPECT_EQ(std::memcmp(results[0].data(), results[1].data(), results[0].size() * sizeof(float)), 0) << size;
  }
}

TEST(FftConvolution, AMapDoesNotDependOnTheOthers) {
  if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  constexpr int kSize = 24;
  constexpr int kMaps = 37;
  Layer all(kSize, kMaps);
  all.Compute();
  const int64_t map = int64_t{kSize} * kSize * kChannels;
  for (const int which : {0, 17, 36}) {
    Layer one(kSize, 1);
    std::copy_n(all.input.data() + which * map, map, one.input.data());
    std::copy_n(all.output_gradient.data() + which * map, map, one.output_gradient.data());
    one.Compute();
    EXPECT_EQ(std::memcmp(one.output.data(), all.output.data() + which * map, map * sizeof(float)), 0) << which;
    EXPECT_EQ(std::memcmp(one.input_gradient.data(), all.input_gradient.data() + which * map, map * sizeof(float)), 0)
        << which;
  }
}

// As in the black parts of a frame before the biases have been trained.
TEST(FftConvolution, ZerosStayZeros) {
  if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  Layer layer(32, 1);
  std::fill_n(layer.bias.data(), kChannels, 0.0F);
  constexpr int kLit = 8;  // rows of the map that are not black
  std::fill(layer.input.data() + kLit * 32 * kChannels, layer.input.data() + layer.input.size(), 0.0F);
  layer.Compute();
  for (int64_t i = (kLit + 2) * 32 * kChannels; i < layer.output.size(); ++i) {
    ASSERT_EQ(layer.output[i], 0);
    ASSERT_FALSE(layer.IsPositive(i));
  }
}

TEST(FftConvolution, FitsMultiplesOf32And24) {
  if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  for (const int size : {24, 32, 64, 72, 96, 120}) EXPECT_TRUE(FftConvolution::Fits(size)) << size;
  for (const int size : {0, 16, 36, 65}) EXPECT_FALSE(FftConvolution::Fits(size)) << size;
  const ScopedCpuPath base(CpuPath::kBase);
  EXPECT_FALSE(FftConvolution::Fits(64));
}

}  // namespace
}  // namespace craftfleet

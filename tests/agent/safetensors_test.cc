#include "common/agent/safetensors.h"

#include <cstring>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/weights.h"
#include "common/config/agent_presets.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

std::string Floats(const std::vector<float>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)};
}

// A file with the given header and data.
std::string File(const std::string& header, const std::string& data) {
  std::string bytes(8, '\0');
  const uint64_t length = header.size();
  std::memcpy(bytes.data(), &length, 8);
  return bytes + header + data;
}

std::string ErrorOf(absl::string_view bytes) {
  const absl::Status status = ReadSafetensors(bytes).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
  return status.ToString();
}

TEST(Safetensors, WritesTheDocumentedFormat) {
  const std::string data = Floats({1, 2, 3});
  const std::string bytes = WriteSafetensors(
      {{{"a", {2, 1}, absl::string_view(data).substr(0, 8)}, {"b", {}, absl::string_view(data).substr(8)}},
       {{"k", "v"}}});
  std::string header = R"({"__metadata__":{"k":"v"},"a":{"dtype":"F32","shape":[2,1],"data_offsets":[0,8]},)"
                       R"("b":{"dtype":"F32","shape":[],"data_offsets":[8,12]}})";
  header.resize((header.size() + 7) / 8 * 8, ' ');
  EXPECT_EQ(bytes, File(header, data));
}

TEST(Safetensors, ReadsBackWhatItWrote) {
  const std::string data = Floats({1, 2, 3, 4});
  const std::string bytes = WriteSafetensors({{{"z", {3}, absl::string_view(data).substr(0, 12)},
                                               {"empty", {0, 4}, ""},
                                               {"a\"\\\n", {1}, absl::string_view(data).substr(12)}},
                                              {{"steps", "12"}}});
  const absl::StatusOr<SafeTensors> file = ReadSafetensors(bytes);
  ASSERT_TRUE(file.ok()) << file.status();
  ASSERT_EQ(file->tensors.size(), 3);
  EXPECT_EQ(file->tensors[0].name, "z");
  EXPECT_EQ(file->tensors[0].data, data.substr(0, 12));
  EXPECT_EQ(file->tensors[1].name, "empty");
  EXPECT_EQ(file->tensors[1].shape, (std::vector<int64_t>{0, 4}));
  EXPECT_EQ(file->tensors[2].name, "a\"\\\n");
  EXPECT_EQ(file->metadata.at("steps"), "12");
}

TEST(Safetensors, RefusesHostileBytesWithAReason) {
  const std::string data = Floats({1, 2});
  const auto entry = [](const std::string& rest) { return R"({"a":{"dtype":"F32",)" + rest + "}}"; };
  EXPECT_THAT(ErrorOf(""), HasSubstr("at least 8"));
  EXPECT_THAT(ErrorOf(std::string(8, '\xff')), HasSubstr("header of 18446744073709551615 bytes"));
  EXPECT_THAT(ErrorOf(File("[]", "")), HasSubstr("not a JSON object"));
  EXPECT_THAT(ErrorOf(File("{", "")), HasSubstr("not a JSON object"));
  EXPECT_THAT(ErrorOf(File(std::string(100000, '['), "")), HasSubstr("not a JSON object"));
  EXPECT_THAT(ErrorOf(File("{\"a\xff\":1}", "")), HasSubstr("not a JSON object"));
  EXPECT_THAT(ErrorOf(File(R"({"a":3})", "")), HasSubstr("tensor \"a\" lacks"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F16","shape":[2],"data_offsets":[0,4]}})", "1234")), HasSubstr("F16"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[-2],"data_offsets":[0,8])"), data)), HasSubstr("-2"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[1.5],"data_offsets":[0,8])"), data)), HasSubstr("1.5"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":"2","data_offsets":[0,8])"), data)), HasSubstr("not an array"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[2],"data_offsets":[0,8,8])"), data)), HasSubstr("do not lie"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[2],"data_offsets":[8,0])"), data)), HasSubstr("do not lie"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[3],"data_offsets":[0,12])"), data)), HasSubstr("do not lie"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[2],"data_offsets":[0,18446744073709551615])"), data)),
              HasSubstr("18446744073709551615"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[3],"data_offsets":[0,8])"), data)), HasSubstr("8 bytes of data"));
  // 2^62 * 4 * 4 bytes wrap around to 0.
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[4611686018427387904,4],"data_offsets":[0,0])"), "")),
              HasSubstr("not what its shape needs"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[1],"data_offsets":[4,8])"), data)), HasSubstr("gap"));
  EXPECT_THAT(ErrorOf(File(entry(R"("shape":[1],"data_offsets":[0,4])"), data)), HasSubstr("follow the last"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},)"
                           R"("b":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}})",
                           data)),
              HasSubstr("\"b\" overlap"));
  EXPECT_THAT(ErrorOf(File(R"({"__metadata__":{"k":1}})", "")), HasSubstr("not a string"));
  EXPECT_THAT(ErrorOf(File(R"({"__metadata__":[]})", "")), HasSubstr("not an object"));
}

// An error that shows such a value recursed into it until the stack was full.
TEST(Safetensors, NestedValuesAreNotShown) {
  const std::string nested = std::string(1'000'000, '[') + std::string(1'000'000, ']');
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":)" + nested + R"(,"shape":[2],"data_offsets":[0,4]}})", "1234")),
              HasSubstr("has dtype an array, want"));
  EXPECT_THAT(ErrorOf(File(R"({"a":{"dtype":"F32","shape":[)" + nested + R"(],"data_offsets":[0,4]}})", "1234")),
              HasSubstr("has an array, want whole numbers"));
}

TEST(Safetensors, EveryTruncationIsRefused) {
  const std::string data = Floats({1, 2});
  const std::string bytes = WriteSafetensors({{{"a", {2}, data}}, {}});
  for (size_t size = 0; size < bytes.size(); ++size) ErrorOf(absl::string_view(bytes).substr(0, size));
}

TEST(Weights, SurviveARoundTripBitForBit) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  std::vector<float> weights(spec.param_count);
  for (size_t i = 0; i < weights.size(); ++i) weights[i] = 1.0F / static_cast<float>(i + 1);
  const absl::StatusOr<std::vector<float>> loaded = LoadWeights(spec, SaveWeights(spec, weights));
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(*loaded, weights);
}

TEST(Weights, OfEachAgentFitTheirBoundWhichIsClose) {
  for (const absl::string_view name : AgentNames()) {
    const AgentSpec spec = *FindAgent(name);
    if (spec.param_count > 20'000'000) continue;  // hundreds of megabytes; its header is like those of the others
    const auto bytes = static_cast<int64_t>(SaveWeights(spec, std::vector<float>(spec.param_count)).size());
    EXPECT_LE(bytes, MaxWeightsBytes(spec)) << name;
    EXPECT_LT(MaxWeightsBytes(spec) - bytes, 64 << 10) << name;
  }
}

TEST(Weights, RefusesMissingUnknownAndMisshapenTensorsByName) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const std::vector<float> weights(spec.param_count);
  const auto error_of = [&](const std::vector<SafeTensor>& tensors) {
    const absl::Status status = LoadWeights(spec, WriteSafetensors({tensors, {}})).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
    return status.ToString();
  };
  std::vector<SafeTensor> tensors = AsTensors(spec, "", weights);
  tensors.pop_back();
  EXPECT_THAT(error_of(tensors), HasSubstr("\"value_net.bias\" is missing"));
  tensors = AsTensors(spec, "", weights);
  tensors.push_back({"lstm.weight", {1}, tensors[0].data.substr(0, 4)});
  EXPECT_THAT(error_of(tensors), HasSubstr("no tensor \"lstm.weight\""));
  tensors = AsTensors(spec, "", weights);
  tensors[8].shape = {512, 17};
  EXPECT_THAT(error_of(tensors), HasSubstr("\"action_net.weight\" has shape [512,17], want [17,512]"));
}

}  // namespace
}  // namespace craftfleet

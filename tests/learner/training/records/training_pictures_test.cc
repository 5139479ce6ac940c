#include "learner/training/records/training_pictures.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::SizeIs;

// Two steps; all pixels of the last observation have the value 200, its first one 90.
Fragment TwoFrames(const AgentSpec& spec) {
  Fragment fragment;
  fragment.frames = std::string(spec.frame_bytes(), '\x05') + std::string(spec.frame_bytes(), '\xc8');
  for (int64_t i = 0; i < 3; ++i) fragment.frames[spec.frame_bytes() + i] = 90;
  return fragment;
}

cv::Mat Decode(const EventPicture& picture) {
  return cv::imdecode(std::vector<uint8_t>(picture.png.begin(), picture.png.end()), cv::IMREAD_COLOR);
}

TEST(TrainingPictures, ShowTheLastObservationEnlarged) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const auto pictures = TrainingPictures(spec, std::make_shared<const std::string>(SampleWeights(1)), TwoFrames(spec));
  ASSERT_THAT(pictures, IsOk());
  ASSERT_THAT(*pictures, SizeIs(1));
  EXPECT_EQ((*pictures)[0].tag, "rollout/frame");
  EXPECT_EQ((*pictures)[0].width, 256);
  const cv::Mat pixels = Decode((*pictures)[0]);
  ASSERT_EQ(pixels.rows, 256);
  EXPECT_EQ(pixels.at<cv::Vec3b>(3, 3)[0], 90);
  EXPECT_EQ(pixels.at<cv::Vec3b>(4, 4)[0], 200);
}

TEST(TrainingPictures, ShowWhereAnAgentWithAttentionLooks) {
  const AgentSpec spec = *FindAgent("oc_ca");
  const auto pictures =
      TrainingPictures(spec, std::make_shared<const std::string>(SampleWeights(1, "oc_ca")), TwoFrames(spec));
  ASSERT_THAT(pictures, IsOk());
  ASSERT_THAT(*pictures, SizeIs(2));
  EXPECT_EQ((*pictures)[1].tag, "rollout/attention");
  const cv::Mat pixels = Decode((*pictures)[1]);
  double darkest = 0, brightest = 0;
  cv::minMaxLoc(pixels.reshape(1), &darkest, &brightest);
  EXPECT_EQ(brightest, 200) << "the place with the most attention keeps its colour";
  EXPECT_EQ(darkest, 30) << "without attention: no patch covers the right border";
}

TEST(TrainingPictures, RefuseOtherWeights) {
  const AgentSpec spec = *FindAgent("oc_ca");
  EXPECT_FALSE(TrainingPictures(spec, std::make_shared<const std::string>(SampleWeights(1)), TwoFrames(spec)).ok());
}

}  // namespace
}  // namespace craftfleet

#include "envserver/world/options.h"

#include <functional>
#include <string>

#include <gmock/gmock.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

TEST(WorldOptions, DefaultsAreValid) {
  const WorldOptions options;
  EXPECT_THAT(options.Validate(), IsOk());
  EXPECT_EQ(options.update_distance(), 18);
  EXPECT_EQ(options.inventory_rows(), 2);
}

TEST(WorldOptions, FromEnvNameSetsAppearanceAndNumbers) {
  const auto name = EnvName::Parse("crafter:appearance=0/33/33/34,numbers=qhsdf");
  ASSERT_THAT(name, IsOk());
  const WorldOptions options = WorldOptions::FromEnvName(*name);
  EXPECT_THAT(options.Validate(), IsOk());
  EXPECT_EQ(options.appearance, "tczsuk");
  EXPECT_EQ(options.percentages[3], 34);
  EXPECT_EQ(options.numbers.tree, 0.945);
  EXPECT_EQ(options.numbers.coal, 0.92);
  EXPECT_EQ(options.numbers.cow, 0.985);
  EXPECT_EQ(options.numbers.zombie, 0.985);
  EXPECT_EQ(options.numbers.skeleton, 0.8);
}

TEST(WorldOptions, ErrorsNameFieldValueAndRange) {
  struct Case {
    std::function<void(WorldOptions*)> edit;
    std::string message;
  };
  const Case cases[] = {
      {[](WorldOptions* o) { o->width = 3; }, "width 3, want 4..250"},
      {[](WorldOptions* o) { o->height = 251; }, "height 251, want 4..250"},
      {[](WorldOptions* o) { o->view_width = 0; }, "view_width 0, want 1..63"},
      {[](WorldOptions* o) { o->view_height = 2; }, "view_height 2, want 3..63"},
      {[](WorldOptions* o) { o->view_width = 1; }, "view_height 9, want 17..63"},
      {[](WorldOptions* o) { o->length = -1; }, "length -1, want 0.."},
      {[](WorldOptions* o) { o->length = 1'000'000'001; }, "length 1000000001, want 0..1000000000"},
      {[](WorldOptions* o) { o->numbers.cow = 1.5; }, "cow threshold 1.5, want 0..1"},
      {[](WorldOptions* o) {
         o->percentages = {25, 25, 25, 26};
       },
       "percentages 25/25/25/26, want sum 100"},
      {[](WorldOptions* o) {
         o->percentages = {-1, 1, 50, 50};
       },
       "percentage -1, want 0..100"},
      {[](WorldOptions* o) { o->appearance = "tx"; }, "appearance \"tx\", want letters of \"twczsukip\""},
      {[](WorldOptions* o) { o->appearance = "tt"; }, "each at most once"},
      {[](WorldOptions* o) {
         o->appearance = "tw";
         o->percentages = {97, 1, 1, 1};
       },
       "'w' has one variant only, want 100/0/0/0"},
  };
  for (const Case& refused : cases) {
    WorldOptions options;
    refused.edit(&options);
    EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(refused.message)));
  }
}

}  // namespace
}  // namespace craftfleet

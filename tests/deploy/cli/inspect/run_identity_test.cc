#include "deploy/cli/inspect/run_identity.h"

#include <set>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/config/known_canary.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

v1::RunConfig Resolved(v1::RunConfig config) { return *ResolveRunConfig(std::move(config)); }

TEST(RunIdentity, IgnoresSettingsThatDoNotAffectLearning) {
  const v1::RunConfig config = Resolved(DefaultRunConfig());
  v1::RunConfig other = config;
  other.set_seed(7);
  other.set_tile(4);
  other.set_gradient_shards(1);
  other.set_cpu(v1::RunConfig::AVX2);
  other.mutable_checkpoint()->set_keep(9);
  other.mutable_env()->set_frame_size(64);
  other.mutable_env()->set_name("crafter:numbers=default");
  other.mutable_eval()->set_env("crafter:inventory=on");
  other.mutable_eval()->set_every_steps(1000);
  EXPECT_EQ(RunIdentity(other), RunIdentity(config));
}

TEST(RunIdentity, AnExplicitDefaultOfTheAgentMakesNoDifference) {
  const v1::RunConfig config = Resolved(DefaultRunConfig("oc_ca").value());
  v1::RunConfig other = config;
  other.mutable_network()->set_heads(8);
  EXPECT_EQ(RunIdentity(other), RunIdentity(config));
  other.mutable_network()->set_heads(4);
  EXPECT_NE(RunIdentity(other), RunIdentity(config));
}

TEST(RunIdentity, DistinguishesSettingsThatAffectLearning) {
  const v1::RunConfig config = Resolved(DefaultRunConfig());
  std::set<std::string> identities = {RunIdentity(config)};
  const auto add = [&](auto change) {
    v1::RunConfig other = config;
    change(&other);
    EXPECT_TRUE(identities.insert(RunIdentity(other)).second) << other.DebugString();
  };
  add([](v1::RunConfig* c) { c->set_agent("lstm_cnn"); });
  add([](v1::RunConfig* c) { c->set_steps(2'000'000); });
  add([](v1::RunConfig* c) { c->set_lanes(1); });
  add([](v1::RunConfig* c) { c->mutable_ppo()->set_gamma(0.9); });
  add([](v1::RunConfig* c) { c->mutable_network()->set_recurrent(true); });
  add([](v1::RunConfig* c) { c->mutable_env()->set_name("crafter:inventory=off"); });
  add([](v1::RunConfig* c) { c->mutable_eval()->set_env("crafter:numbers=easy-x2"); });
  add([](v1::RunConfig* c) { c->mutable_distillation()->set_every_iterations(8); });
}

TEST(RunIdentity, DistinguishesTextures) {
  const v1::RunConfig config = Resolved(DefaultRunConfig());
  EXPECT_EQ(RunIdentity(config, kBuiltInTextures), RunIdentity(config));
  EXPECT_NE(RunIdentity(config, "8140aa54698876d7"), RunIdentity(config));
  EXPECT_NE(RunIdentity(config, "8140aa54698876d7"), RunIdentity(config, "8140aa54698876d8"));
}

}  // namespace
}  // namespace craftfleet

// One misbehaving peer of a fleet, until it is killed. Started by hostile.py.
//   bad_peer --role=actor --misdeed=lying --learner=HOST:PORT --seed=7
//   bad_peer --role=envserver --misdeed=slow --learner=HOST:PORT --behind=HOST:PORT
//   bad_peer --role=learner --misdeed=silent --listen=HOST:PORT

#include <memory>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/process/program.h"
#include "common/process/worker_name.h"
#include "common/telemetry/log.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "common/wire/wire_flags.h"
#include "craftfleet/v1/status.pb.h"
#include "envserver/announcer.h"
#include "envserver/canary.h"
#include "envserver/render/textures.h"
#include "tests/hostile/bad_actor.h"
#include "tests/hostile/bad_env_server.h"
#include "tests/hostile/bad_learner.h"

ABSL_FLAG(std::string, role, "", "actor, envserver or learner");
ABSL_FLAG(std::string, misdeed, "",
          "silent, lying, flooding; for an environment server also slow, sluggish and endless (games)");
ABSL_FLAG(std::string, learner, "", "address of the learner, for actors and environment servers");
ABSL_FLAG(std::string, behind, "", "address of the environment server that a bad one passes sessions on to");
ABSL_FLAG(std::string, listen, "127.0.0.1:0", "address to listen on, for environment servers and learners");
ABSL_FLAG(uint64_t, seed, 1, "of what it does when");

namespace craftfleet {
namespace {

absl::Status NoSuch(const std::string& flag, const std::string& value) {
  return absl::InvalidArgumentError(absl::StrCat("--", flag, " is '", value, "': see --help"));
}

absl::Status RunActor(const std::string& misdeed, const wire::Endpoint& learner) {
  BadActor actor(learner, absl::GetFlag(FLAGS_seed));
  if (misdeed == "silent") {
    actor.StaySilent();
  } else if (misdeed == "lying") {
    actor.Lie();
  } else if (misdeed == "flooding") {
    actor.Flood();
  } else {
    return NoSuch("misdeed", misdeed);
  }
  return absl::OkStatus();
}

absl::Status RunEnvServer(const std::string& misdeed, const wire::Endpoint& learner,
                          const wire::ChannelSecurity& security) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, DefaultTextureDir());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string digest, TextureDigest(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const Textures> loaded, Textures::Load(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string canary, GameCanary(*loaded));
  Misdeed kind = Misdeed::kSilent;
  if (misdeed == "slow") {
    kind = Misdeed::kSlow;
  } else if (misdeed == "sluggish") {
    kind = Misdeed::kSluggish;
  } else if (misdeed == "endless") {
    kind = Misdeed::kEndless;
  } else if (misdeed == "lying") {
    kind = Misdeed::kLying;
  } else if (misdeed == "flooding") {
    kind = Misdeed::kFlooding;
  } else if (misdeed != "silent") {
    return NoSuch("misdeed", misdeed);
  }
  BadEnvService service(kind, wire::Connect(absl::GetFlag(FLAGS_behind), security), absl::GetFlag(FLAGS_seed));
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::unique_ptr<wire::Server> server,
      wire::Server::Create(wire::ServerOptionsFromFlags(absl::GetFlag(FLAGS_listen)), {&service}));
  Announcer announcer(learner, UniqueWorkerName(), server->address(), digest, canary,
                      [] { return v1::ProcessSummary(); });
  server->Wait();
  return absl::OkStatus();
}

absl::Status RunLearner(const std::string& misdeed) {
  LearnerMisdeed kind = LearnerMisdeed::kSilent;
  if (misdeed == "lying") {
    kind = LearnerMisdeed::kLying;
  } else if (misdeed == "flooding") {
    kind = LearnerMisdeed::kFlooding;
  } else if (misdeed != "silent") {
    return NoSuch("misdeed", misdeed);
  }
  BadLearnerService service(kind);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::unique_ptr<wire::Server> server,
      wire::Server::Create(wire::ServerOptionsFromFlags(absl::GetFlag(FLAGS_listen)), {&service}));
  LogInfo("listening on %s", server->address());
  server->Wait();
  return absl::OkStatus();
}

absl::Status Run() {
  const std::string role = absl::GetFlag(FLAGS_role);
  const std::string misdeed = absl::GetFlag(FLAGS_misdeed);
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  const wire::Endpoint learner = wire::Connect(absl::GetFlag(FLAGS_learner), security);
  if (role == "actor") return RunActor(misdeed, learner);
  if (role == "envserver") return RunEnvServer(misdeed, learner, security);
  if (role == "learner") return RunLearner(misdeed);
  return NoSuch("role", role);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({"bad_peer", "One misbehaving peer of a fleet; see tests/hostile/README.md."}, argc, argv);
  return craftfleet::ExitCode("bad_peer", craftfleet::Run());
}

// Real programs with wrong flags, configuration files and textures: errors name the place and what was expected.

#include <algorithm>
#include <filesystem>
#include <ostream>
#include <string>
#include <vector>

#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/process/version.h"
#include "tests/fakes/test_paths.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::StartsWith;

// A command line of each program and kind of error (values and ranges of single flags: flag_values_test, config_test),
// and texts that standard error must contain. "@" is replaced by the test's folder, which has config.txt.
struct BadCommand {
  std::string what;
  std::string program;
  std::vector<std::string> arguments;
  std::vector<std::string> error;
  friend void PrintTo(const BadCommand& command, std::ostream* out) { *out << command.what; }
};

class BadCommandTest : public SmallRunTest, public testing::WithParamInterface<BadCommand> {};

TEST_P(BadCommandTest, IsRefusedWithOneLineThatNamesTheError) {
  std::vector<std::string> arguments = GetParam().arguments;
  for (std::string& argument : arguments) {
    if (const size_t at = argument.find('@'); at != std::string::npos) argument.replace(at, 1, folder_.path());
  }
  const Ended ended = Run(GetParam().program, arguments);
  EXPECT_EQ(ended.exit_code, 1);
  for (const std::string& part : GetParam().error) EXPECT_THAT(ended.err, HasSubstr(part));
  EXPECT_EQ(std::vector<std::string>(absl::StrSplit(ended.err, '\n', absl::SkipEmpty())).size(), 1) << ended.err;
  EXPECT_THAT(ended.out, IsEmpty());
  EXPECT_FALSE(PathExists(Logdir("run"))) << "no run was started";
}

const std::vector<BadCommand>& BadCommands() {
  static const std::string train = "craftfleet train";
  static const std::string learner = "craftfleet-learner";
  static const std::string actor = "craftfleet-actor";
  static const std::string server = "craftfleet-envserver";
  static const auto* const commands = new std::vector<BadCommand>{
      {"UnknownFlag", train, {"--logdir=@/run", "--lnes=3"}, {"'lnes' (did you mean --lanes?)", "--help"}},
      {"NoFlag",
       train,
       {"--logdir=@/run", "lanes=3"},
       {"\"lanes=3\" is not a flag (did you mean --lanes=3?)", "--help"}},
      {"NoLanes", train, {"--logdir=@/run", "--lanes=0"}, {"lanes is 0, want 1..4096"}},
      {"LanesThatAreNoNumber",
       train,
       {"--logdir=@/run", "--lanes=abc"},
       {"craftfleet train: --lanes=abc, want a whole number; see"}},
      {"NegativeSeed", train, {"--logdir=@/run", "--seed=-1"}, {"--seed=-1, want a whole number, at least 0;"}},
      {"FlagWithoutAValue", train, {"--logdir"}, {"craftfleet train: --logdir needs a value: --logdir=VALUE;"}},
      {"StepsThatAreNoNumber",
       train,
       {"--logdir=@/run", "--steps=abc"},
       {"craftfleet train: --steps=abc, want a whole number, such as 1000000"}},
      {"NoUnitOfTime",
       "craftfleet status",
       {"--interval=5sec"},
       {"--interval=5sec, want a length of time", "a number without a unit is in seconds"}},
      {"LanesThatDoNotDivide", train, {"--logdir=@/run", "--lanes=7"}, {"ppo.rollout_steps", "lanes (7)"}},
      {"UnknownAgent", train, {"--logdir=@/run", "--agent=nope"}, {"\"nope\"", "known agents: ppo_cnn"}},
      {"UnknownDevice", train, {"--logdir=@/run", "--device=gpu"}, {"--device=gpu, want auto, cpu, cuda or cuda:N"}},
      {"NoSuchGpu", train, {"--logdir=@/run", "--device=cuda:99"}, {"--device=cuda:99: "}},
      {"NoLogdir", train, {}, {"--logdir is missing"}},
      {"LogdirThatCannotBe", train, {"--logdir=/proc/no/such"}, {"/proc/no"}},
      {"NoConfigFile", train, {"--logdir=@/run", "--config=@/none.txt"}, {"--config: ", "/none.txt", "No such file"}},
      {"ResumeWithoutRun",
       train,
       {"--logdir=@/run", "--resume"},
       {"--resume: no run in --logdir=", "/run", "start it without --resume"}},
      {"StalenessAndOverlap",
       train,
       {"--logdir=@/run", "--max_staleness=1", "--overlap=1"},
       {"overlap and max_staleness are both given"}},
      {"ResumeFromWithoutResume", train, {"--logdir=@/run", "--resume_from=x"}, {"--resume_from requires --resume"}},
      {"NoTextureFolder", train, {"--logdir=@/run", "--textures=@/none"}, {"/none", "No such file"}},
      {"LearnerBeyondLoopback",
       learner,
       {"--logdir=@/run", "--listen=0.0.0.0:0"},
       {"--listen=0.0.0.0:0 reaches beyond this host", "--insecure"}},
      {"ServerBeyondLoopback", server, {"--listen=0.0.0.0:0"}, {"--listen=0.0.0.0:0", "--insecure"}},
      {"RankBeyondTheWorld", learner, {"--logdir=@/run", "--world_size=2", "--rank=2"}, {"--rank=2, want 0..1"}},
      {"RanksOnAGpu", learner, {"--world_size=2", "--rank=1", "--device=cuda"}, {"--device=cuda", "CPUs"}},
      {"ListenWithoutPort",
       server,
       {"--listen=127.0.0.1"},
       {"--listen: \"127.0.0.1\" is not an address, want HOST:PORT"}},
      {"OneServerThatIsNoAddress", actor, {"--envservers=127.0.0.1:1,x"}, {"--envservers: \"x\" is not an address"}},
      {"NoServers", actor, {"--envservers="}, {"--envservers is empty"}},
      {"UnknownFrames", actor, {"--frames=png"}, {"--frames=png, want raw or scene"}},
      {"NoCheckpoint", "craftfleet eval", {}, {"--checkpoint is missing"}},
      {"CheckpointThatIsNone", "craftfleet eval", {"--checkpoint=@"}, {"no checkpoint at /", "want a run's folder"}},
      {"StatusOfNobody",
       "craftfleet status",
       {"--address=127.0.0.1:1"},
       {"127.0.0.1:1: cannot connect: nothing listens there"}},
      {"UnknownFlagBeforeTheCommand", "craftfleet", {"--nope"}, {"unknown flag \"--nope\"; see craftfleet --help"}},
      {"EvaluationOnNoEnvironment",
       "craftfleet eval",
       {"--checkpoint=@", "--env=pong"},
       {"craftfleet eval: --env: ", "unknown game \"pong\", want \"crafter\""}},
      {"FlagOfAnotherCommand", "craftfleet envs", {"--address=127.0.0.1:1"}, {"unknown flag 'address'; see"}},
      {"AVideoCannotFollow",
       "craftfleet watch",
       {"run", "--video=a.mp4", "--follow"},
       {"--follow and --video: want one of them"}},
      {"AStripIsNoTerminal", "craftfleet watch", {"run", "--strip=a.png", "--terminal"}, {"--terminal and --strip"}},
      {"ReportWithoutRuns",
       "craftfleet report",
       {"@", "--out=@/report"},
       {"no run in or below ", "want a folder with config.txt and stats.jsonl"}},
      {"CurveOfNoFolder", "craftfleet curve", {"@/none"}, {"/none: no such run folder or file"}},
      {"NoAdminCommand", "craftfleet admin", {}, {"name a command: checkpoint, pause, resume, drain NAME"}},
      {"MistypedCommand",
       "craftfleet",
       {"trian"},
       {"there is no command \"trian\" (did you mean \"train\"?)", "--help"}},
  };
  return *commands;
}

INSTANTIATE_TEST_SUITE_P(BadInput, BadCommandTest, testing::ValuesIn(BadCommands()),
                         [](const auto& info) { return info.param.what; });

class BadInputTest : public SmallRunTest {};

TEST_F(BadInputTest, ErrorsInAConfigFileHaveFileLineAndField) {
  ASSERT_THAT(WriteFileSynced(config(), "lanes: 4\nppo {\n  rollout_stps: 64\n}\n"), IsOk());
  Ended ended = Run("craftfleet train", Flags("run"));
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(config() + ":3:"));
  EXPECT_THAT(ended.err, HasSubstr("\"rollout_stps\""));
  EXPECT_THAT(ended.err, HasSubstr("known fields of PpoConfig: rollout_steps, "));

  ASSERT_THAT(WriteFileSynced(config(), "lanes: 4\nsteps: many\n"), IsOk());
  ended = Run("craftfleet train", Flags("run"));
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(config() + ":2:"));
  EXPECT_THAT(ended.err, HasSubstr("steps: "));
  EXPECT_FALSE(PathExists(Logdir("run")));
}

TEST_F(BadInputTest, EvalRefusesAnInvalidEnvironment) {
  Train("run");
  const Ended ended = Run("craftfleet eval", {"--checkpoint=" + Logdir("run"), "--env=crafter:bogus"});
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("unknown option \"bogus\", want one of"));
}

// Its programs were not copied with it.
TEST_F(BadInputTest, ACommandWithoutItsProgramIsNotCalledUnknown) {
  const std::string alone = folder_ / "craftfleet";
  std::filesystem::copy_file(BuiltProgram("craftfleet"), alone);
  const Ended ended = Run(alone, {"train"});
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("cannot run " + alone + "-torch: No such file"));
}

// Every installed program.
class EveryProgram : public SmallRunTest, public testing::WithParamInterface<std::string> {};

TEST_P(EveryProgram, HelpDescribesTheProgramAndItsFlags) {
  const Ended ended = Run(GetParam(), {"--help"});
  EXPECT_EQ(ended.exit_code, 0);
  EXPECT_THAT(ended.err, IsEmpty());
  EXPECT_THAT(ended.out, Not(IsEmpty()));
  EXPECT_THAT(ended.out, HasSubstr(GetParam().substr(0, GetParam().find('-'))));
}

TEST_P(EveryProgram, EveryFlagIsExplainedInFullOnRequest) {
  const Ended ended = Run(GetParam(), {"--helpfull"});
  EXPECT_EQ(ended.exit_code, 0);
  EXPECT_THAT(ended.err, IsEmpty());
  if (GetParam() == "craftfleet curve") {  // in Python, without a log
    EXPECT_THAT(ended.out, HasSubstr("  --reference\n"));
  } else if (GetParam() != "craftfleet") {
    EXPECT_THAT(ended.out, HasSubstr("  --log_level (default info)\n"));
  }
}

TEST_P(EveryProgram, JsonHelpNamesProgramAndSummary) {
  const Ended ended = Run(GetParam(), {"--help_json"});
  EXPECT_EQ(ended.exit_code, 0);
  const nlohmann::json json = nlohmann::json::parse(ended.out);
  EXPECT_EQ(json["program"], GetParam());
  EXPECT_GT(json["summary"].get<std::string>().size(), 10);
}

TEST_P(EveryProgram, VersionIsOneLine) {
  const Ended ended = Run(GetParam(), {"--version"});
  EXPECT_EQ(ended.exit_code, 0);
  EXPECT_THAT(ended.out, HasSubstr(std::string(ProgramVersion())));
  EXPECT_EQ(ended.out.find('\n'), ended.out.size() - 1);
  EXPECT_THAT(ended.err, IsEmpty());
}

TEST_P(EveryProgram, AnUnknownFlagIsNamed) {
  const Ended ended = Run(GetParam(), {"--no_such_flag=1"});
  EXPECT_EQ(ended.exit_code, 1);
  if (GetParam() != "craftfleet") {
    EXPECT_THAT(ended.err, HasSubstr("no_such_flag"));
  }
}

INSTANTIATE_TEST_SUITE_P(BadInput, EveryProgram,
                         testing::Values("craftfleet", "craftfleet train", "craftfleet eval", "craftfleet status",
                                         "craftfleet-learner", "craftfleet-actor", "craftfleet-envserver",
                                         "craftfleet curve"),
                         [](const auto& info) {
                           std::string name;
                           for (const char c : info.param) name += c == '-' || c == ' ' ? '_' : c;
                           return name;
                         });

TEST_F(BadInputTest, HelpForACommandIsThatOfItsProgram) {
  const Ended help = Run("craftfleet", {"help", "train"});
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_EQ(help.out, Run("craftfleet train", {"--help"}).out);
  EXPECT_LE(std::count(help.out.begin(), help.out.end(), '\n'), 40) << "it fits a screen";
}

TEST_F(BadInputTest, TheCommandFindsItsPrograms) {
  const Ended ended = Run("craftfleet", {"train", "--help"});
  EXPECT_EQ(ended.exit_code, 0);
  EXPECT_THAT(ended.out, StartsWith("craftfleet train trains an agent"));
  EXPECT_THAT(ended.out, HasSubstr("--logdir"));
}

}  // namespace
}  // namespace craftfleet

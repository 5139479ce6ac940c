// Every number and text of every message that processes exchange or store, at its extremes: it is refused by name, or
// listed below with the reason why any value is harmless. A new field or message fails until it is in one or the other.

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/learner_replies.h"
#include "actor/play_reply.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"
#include "common/wire/request_check.h"
#include "craftfleet/v1/admin.pb.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "craftfleet/v1/types.pb.h"
#include "learner/run/checkpoint.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/field_walk.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

constexpr int kLanes = 4;
constexpr int kFrameSize = 64;
constexpr int kFrameBytes = 12;    // of made-up replies
constexpr int kPictureBytes = 27;  // the same
constexpr int kEpisodeSteps = 20;

const FieldExpectations& Expectations() {
  static const auto* const expectations = new FieldExpectations{
      /*harmless=*/{
          {"JoinRequest.protocol_version", "compared in the handshake (protocol_test)"},
          {"JoinRequest.run_id", "compared in the handshake (protocol_test)"},
          {"PermitRequest.epoch", "compared with the learner's own: ABORTED (learner_service_test)"},
          {"PermitRequest.env_servers[]", "the learner reads the first 64"},
          {"PermitRequest.env_servers.name", "not read: the address names a server"},
          {"PermitRequest.env_servers.role", "not read"},
          {"PermitRequest.env_servers.address", "an invalid one is left out (learner_service_test)"},
          {"PermitRequest.env_servers.state", "not read"},
          {"PermitRequest.env_servers.last_seen_s", "not read"},
          {"PermitRequest.env_servers.summary", "one out of range is left out (learner_service_test)"},
          {"PermitRequest.env_servers.step_ms", "one out of range is left out (learner_service_test)"},
          {"Announcement.protocol_version", "compared in the handshake (protocol_test)"},
          {"Announcement.texture_digest", "compared in the handshake (protocol_test)"},
          {"FragmentMessage.actor", "checked by name before the fragment is read (learner_service_test)"},
          {"EvaluationResult.episodes[]", "compared with the task's number of episodes (learner_service_test)"},
          {"EvaluationResult.actor", "checked by name before the result is read (learner_service_test)"},
          {"EvaluationResult.epoch", "compared with the learner's own: ABORTED (learner_service_test)"},
          {"EvaluationResult.id", "compared with the tasks that exist (evaluation_table_test)"},
          {"JoinReply.frame_formats[]", "the actor looks for one that it knows"},
          {"PermitReply.env_servers_generation", "only sent back"},
          {"SessionHello.frame_formats[]", "the server looks for one that it knows (env_service_test)"},
          {"OpenLanes.lanes.lane", "any number from 0; a negative one is refused (env_batch_test)"},
          {"OpenLanes.lanes.seed", "any number"},
          {"CloseLanes.lanes", "lanes that are not open are ignored"},
          {"PlayReply.refused.reason", "cut when it is read (CutReason)"},
          {"PlayReply.moments.achievements", "any number from 0; a negative one is refused (convert_test)"},
          {"CheckpointState.format", "the manifest's counts (checkpoint_store_test)"},
          {"CheckpointState.program_version", "not read: the manifest's is shown (checkpoint_store_test)"},
          {"CheckpointState.texture_digest", "compared with the textures (learner.cc)"},
          {"CheckpointState.lanes.snapshot", "an invalid one resets its lane (lane_loading_test)"},
          {"CheckpointState.lanes.previous_snapshot", "the same"},
          {"CheckpointState.lanes.state[]", "the same"},
          {"CheckpointState.lanes.state", "the same"},
          {"CheckpointState.lanes.previous_state[]", "the same"},
          {"CheckpointState.lanes.previous_state", "the same"},
          {"CheckpointState.logs[]", "found by name: files that are no logs are not touched (run_folder_test)"},
          {"CheckpointState.logs.file", "the same"},
          {"CheckpointState.best_score", "-inf: no score yet; inf and nan are refused (below)"},
      },
      /*other_words=*/
      {
          {"SessionHello.protocol_version", "protocol version"},
          {"SessionHello.texture_digest", "textures"},
          {"SessionHello.recording.picture_size", "picture width"},
          {"SessionHello.game_canary", "canary"},
          {"OpenLanes.lanes[]", "named twice"},
          {"StepLanes.lanes[]", "lanes in one request"},
          {"CloseLanes.lanes[]", "lanes in one request"},
          {"PlayReply.snapshots", "snapshot"},
          {"PlayReply.moments.player_x", "moment.player"},
          {"PlayReply.moments.player_y", "moment.player"},
      },
      /*elsewhere=*/
      {
          {"RunConfig", "config_test, extreme_configs_test"},
          {"EnvConfig", "config_test, env_service_test"},
          {"ActorMessage", "what it has in it is walked by itself; empty: refused (learner_streams_test)"},
          {"LearnerMessage", "the same; empty or not asked for: the stream ends (learner_stream_test)"},
          {"FragmentVerdict", "of a fragment that the actor sent, else the stream ends (learner_stream_test)"},
          {"WeightsRequest", "any version and any task may be requested (learner_service_test)"},
          {"SnapshotRequest", "compared with the lane's next fragment: ABORTED (learner_service_test)"},
          {"AnnounceReply", "not read"},
          {"LeaveRequest", "checked as the actor's name (learner_service_test)"},
          {"EvaluationReply", "empty"},
          {"LeaveReply", "empty"},
          {"PlayRequest", "its requests are walked one by one"},
          {"StatusRequest", "empty"},
          {"StatusReply", "for people: clients accept any value (fuzz target status_reply)"},
          {"Metric", "the same"},
          {"FleetSummary", "the same"},
          {"WorkerCount", "the same"},
          {"CheckpointRequest", "empty"},
          {"CheckpointReply", "for people"},
          {"PauseRequest", "empty"},
          {"PauseReply", "empty"},
          {"ResumeRequest", "empty"},
          {"ResumeReply", "has no numbers and no texts"},
          {"DrainRequest", "any text: NOT_FOUND (admin_service_test)"},
          {"DrainReply", "for people"},
          {"UndrainRequest", "as DrainRequest"},
          {"UndrainReply", "for people"},
          {"StopRequest", "empty"},
          {"StopReply", "empty"},
      }};
  return *expectations;
}

// Formats that only one program reads; their tests walk or fuzz all fields:
//   access.proto  access_test, fuzz target access
//   config.proto  config_test, fuzz target config
//   event.proto   never read
//   ranks.proto   rank_store_test

void FillSummary(v1::ProcessSummary* summary) {
  summary->set_last_error("an error");
  summary->add_times()->set_activity("play");
}

CheckedMessage JoinRequestCase() {
  v1::JoinRequest request;
  request.set_actor("host-1-a");
  return Case<v1::JoinRequest>(request, [](v1::JoinRequest* r) { return wire::CheckJoin(*r); });
}

CheckedMessage PermitRequestCase() {
  v1::PermitRequest request;
  request.set_actor("host-1-a");
  request.set_capacity(kLanes);
  request.add_active();
  FillSummary(request.mutable_summary());
  request.add_env_servers();
  request.add_failures()->set_reason("damaged");
  return Case<v1::PermitRequest>(request, [](v1::PermitRequest* r) { return wire::CheckPermitRequest(*r, kLanes); });
}

CheckedMessage AnnouncementCase() {
  v1::Announcement announcement;
  announcement.set_name("host-2-b");
  announcement.set_address("10.0.0.1:50061");
  FillSummary(announcement.mutable_summary());
  return Case<v1::Announcement>(announcement, [](v1::Announcement* a) { return wire::CheckAnnouncement(*a); });
}

CheckedMessage FragmentCase() {
  return Case<v1::FragmentMessage>(wire::ToProto(SampleFragment(2, 7, 40)),
                                   [](v1::FragmentMessage* m) { return wire::FromProto(m, kSampleShape).status(); });
}

CheckedMessage EvaluationResultCase() {
  return Case<v1::EvaluationResult>(wire::ToProto(std::vector<Episode>{EndedEpisode(0, 9)}),
                                    [](v1::EvaluationResult* r) { return wire::FromProto(*r).status(); });
}

CheckedMessage JoinReplyCase() {
  v1::JoinReply reply;
  reply.set_run_id("run-a");
  reply.set_lease_ms(5000);
  *reply.mutable_config() = DefaultRunConfig();
  reply.add_frame_formats(v1::FRAMES_SCENE);
  return Case<v1::JoinReply>(reply, CheckJoinReply);
}

CheckedMessage PermitReplyCase() {
  v1::PermitReply reply;
  reply.add_granted()->set_lane(1);
  reply.add_lost();
  reply.add_env_servers("10.0.0.1:50061");
  v1::EvaluationTask* task = reply.mutable_evaluation();
  task->set_id(1);
  task->set_first_episode(1);
  task->set_episodes(2);
  task->mutable_env()->set_frame_size(kFrameSize);
  return Case<v1::PermitReply>(reply, [](v1::PermitReply* r) {
    v1::PermitRequest request;
    request.set_capacity(kLanes);
    request.add_active();
    return CheckPermitReply(request, kLanes, kFrameSize, *r);
  });
}

CheckedMessage WeightsChunkCase() {
  v1::WeightsChunk chunk;
  chunk.set_policy_version(3);
  chunk.set_total_bytes(10);
  chunk.set_data("12345");
  return Case<v1::WeightsChunk>(chunk, [](v1::WeightsChunk* c) { return CheckWeightsChunk(*c, 10, 3, 10, 0); });
}

CheckedMessage SnapshotReplyCase() {
  v1::SnapshotReply reply;
  reply.set_snapshot(SampleSnapshot("a game"));
  reply.add_state(0.5F);
  return Case<v1::SnapshotReply>(reply, [](v1::SnapshotReply* r) { return ReadSnapshot(r, 1).status(); });
}

// A session with a real environment server, from hello to the last of `requests`. A lane that is refused is an error.
absl::Status Play(const std::vector<v1::PlayRequest>& requests) {
  static auto* const service = EnvServiceImpl::Create(*DefaultTextureDir()).value().release();
  static auto* const server = wire::Server::Create({}, {service}).value().release();
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(60));
  const auto stream = v1::EnvironmentService::NewStub(server->InProcess().channel)->Play(&context);
  v1::PlayReply reply;
  for (const v1::PlayRequest& request : requests) {
    if (!stream->Write(request) || !stream->Read(&reply)) return wire::FromGrpc(stream->Finish(), "server");
    if (reply.refused_size() > 0) return absl::InvalidArgumentError(reply.refused(0).reason());
  }
  stream->WritesDone();
  return wire::FromGrpc(stream->Finish(), "server");
}

v1::PlayRequest HelloRequest() {
  v1::PlayRequest request;
  *request.mutable_hello() = SampleHello(kEpisodeSteps);
  return request;
}

v1::PlayRequest OpenRequest() {
  v1::PlayRequest request;
  request.mutable_open()->add_lanes()->set_seed(1);
  return request;
}

CheckedMessage HelloCase() {
  v1::SessionHello hello = SampleHello(kEpisodeSteps);
  hello.mutable_recording();
  hello.add_frame_formats(v1::FRAMES_SCENE);
  return Case<v1::SessionHello>(hello, [](v1::SessionHello* h) {
    v1::PlayRequest request;
    *request.mutable_hello() = *h;
    return Play({request});
  });
}

CheckedMessage OpenCase() {
  return Case<v1::OpenLanes>(OpenRequest().open(), [](v1::OpenLanes* open) {
    v1::PlayRequest request;
    *request.mutable_open() = *open;
    return Play({HelloRequest(), request});
  });
}

CheckedMessage StepCase() {
  v1::StepLanes step;
  step.add_lanes(0);
  step.set_actions(std::string(1, '\1'));
  return Case<v1::StepLanes>(step, [](v1::StepLanes* s) {
    v1::PlayRequest request;
    *request.mutable_step() = *s;
    return Play({HelloRequest(), OpenRequest(), request});
  });
}

CheckedMessage CloseCase() {
  v1::CloseLanes close;
  close.add_lanes(0);
  return Case<v1::CloseLanes>(close, [](v1::CloseLanes* c) {
    v1::PlayRequest request;
    *request.mutable_close() = *c;
    return Play({HelloRequest(), OpenRequest(), request});
  });
}

// Checks the fields of the replies to hello, open and step, which the sample has all at once.
absl::Status CheckReplies(v1::PlayReply* all) {
  v1::SessionHello session = SampleHello(kEpisodeSteps);
  session.mutable_recording();
  const PlayReplyCheck check(session, kFrameBytes);
  v1::PlayReply hello;
  hello.set_program_version(all->program_version());
  hello.set_canary(all->canary());
  CRAFTFLEET_RETURN_IF_ERROR(check.Hello(hello));
  v1::OpenLanes opening;
  opening.add_lanes()->set_snapshot("any");
  v1::PlayReply open;
  open.mutable_refused()->Swap(all->mutable_refused());
  CRAFTFLEET_RETURN_IF_ERROR(check.Open(opening, open));
  all->clear_program_version();
  all->clear_canary();
  v1::StepLanes step;
  step.add_lanes(0);
  step.set_snapshot(true);
  CRAFTFLEET_RETURN_IF_ERROR(check.Step(step, *all));
  StepBatch batch;
  CRAFTFLEET_RETURN_IF_ERROR(wire::FromProto(all, 1, kFrameBytes, kEpisodeSteps, &batch));
  return wire::MomentsFromProto(all, 1, kFrameBytes, kPictureBytes).status();
}

CheckedMessage PlayReplyCase() {
  v1::PlayReply reply;
  StepBatch batch;
  batch.rewards = {1};
  batch.ends = {StepEnd::kTruncated};
  batch.frames = std::string(kFrameBytes, 'f');
  batch.last_frames = std::string(kFrameBytes, 'l');
  batch.episodes = {EndedEpisode(0, kEpisodeSteps)};
  batch.snapshots = {SealSnapshot(EnvDigest("crafter", kEpisodeSteps), "a game")};
  wire::ToProto(&batch, &reply);
  wire::ToProto(std::vector<Moment>{SampleMoment(1)}, &reply);
  reply.set_program_version("0.2.0");
  reply.set_canary("0123456789abcdef");
  reply.add_episode_steps(0);
  reply.add_refused()->set_reason("damaged");
  FillSummary(reply.mutable_server());
  return Case<v1::PlayReply>(reply, CheckReplies);
}

CheckedMessage CheckpointStateCase() {
  v1::CheckpointState state = SampleCheckpoint(1).state;
  state.set_next_eval_episode(1);
  v1::LaneState* lane = state.mutable_lanes(0);
  lane->add_state(1);
  lane->add_previous_state(1);
  lane->set_previous_snapshot("before");
  state.add_logs()->set_file("stats.jsonl");
  v1::PendingEvaluation* pending = state.add_pending();
  pending->set_number(1);
  pending->set_first_episode(1);
  pending->set_episodes(1);
  state.mutable_play()->set_value_deviation(1);
  return Case<v1::CheckpointState>(state, [](v1::CheckpointState* s) { return CheckCheckpointState(*s); });
}

TEST(FieldEdges, ExtremesAreRefusedByNameOrListedAsHarmless) {
  std::vector<CheckedMessage> cases;
  for (const auto make : {JoinRequestCase, PermitRequestCase, AnnouncementCase, FragmentCase, EvaluationResultCase,
                          JoinReplyCase, PermitReplyCase, WeightsChunkCase, SnapshotReplyCase, HelloCase, OpenCase,
                          StepCase, CloseCase, PlayReplyCase, CheckpointStateCase}) {
    cases.push_back(make());
  }
  FieldWalk walk(&Expectations());
  for (const CheckedMessage& checked : cases) walk.Run(checked);
  walk.ExpectListsAreUsed();
  for (const auto* message :
       {v1::JoinRequest::descriptor(), v1::PlayRequest::descriptor(), v1::StatusReply::descriptor(),
        v1::DrainRequest::descriptor(), v1::EpisodeMessage::descriptor(), v1::CheckpointState::descriptor()}) {
    walk.ExpectComplete(*message->file());
  }
}

TEST(FieldEdges, TheBestScoreIsANumberOrNoneYet) {
  v1::CheckpointState state = SampleCheckpoint(1).state;
  for (const double score : {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    state.set_best_score(score);
    EXPECT_THAT(CheckCheckpointState(state),
                StatusIs(absl::StatusCode::kInvalidArgument, testing::HasSubstr("best_score")));
  }
}

}  // namespace
}  // namespace craftfleet

#include "learner/learner_service.h"

#include <algorithm>
#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/process/version.h"
#include "common/wire/fragment_digest.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "common/wire/status_service.h"
#include "learner/worker_page.h"

namespace craftfleet {
namespace {

constexpr int kMaxWaitMs = 2000;  // of a long poll
// Of weights. Each download that waits for its client holds two chunks, and there may be thousands of downloads.
constexpr size_t kChunkBytes = 128u << 10;
constexpr size_t kLinesPerClient = 16;   // about workers, in the period of LimitedLog, whatever their names
constexpr int kMaxServersReported = 64;  // environment servers in one request of an actor

absl::Duration WaitTime(int wait_ms) { return absl::Milliseconds(std::clamp(wait_ms, 0, kMaxWaitMs)); }

Permit FromProto(const v1::Permit& message) { return {message.lane(), message.fragment(), message.policy_version()}; }

void AddPermits(const std::vector<Permit>& permits, google::protobuf::RepeatedPtrField<v1::Permit>* out) {
  for (const Permit& permit : permits) {
    v1::Permit* message = out->Add();
    message->set_lane(permit.lane);
    message->set_fragment(permit.fragment);
    message->set_policy_version(permit.policy_version);
    message->set_reload(permit.reload);
  }
}

// Whether the registry refused a client because of its name, or of its number of names.
bool IsAboutNames(const absl::Status& status) {
  return status.code() == absl::StatusCode::kPermissionDenied || status.code() == absl::StatusCode::kResourceExhausted;
}

v1::FragmentVerdict::Verdict VerdictToProto(LaneScheduler::Verdict verdict) {
  switch (verdict) {
    case LaneScheduler::Verdict::kAccepted:
      return v1::FragmentVerdict::ACCEPTED;
    case LaneScheduler::Verdict::kDuplicate:
      return v1::FragmentVerdict::DUPLICATE;
    case LaneScheduler::Verdict::kExpired:
    case LaneScheduler::Verdict::kStale:
      return v1::FragmentVerdict::EXPIRED;
  }
  return v1::FragmentVerdict::VERDICT_UNSPECIFIED;
}

}  // namespace

LearnerServiceImpl::LearnerServiceImpl(const Options& options, WorkerRegistry* registry, WeightStore* weights,
                                       FragmentQueue* fragments)
    : options_(options),
      registry_(registry),
      weights_(weights),
      fragments_(fragments),
      refusals_(&clock_),
      polls_(options.max_polls_per_client) {}

WorkerClient LearnerServiceImpl::ClientOf(const grpc::ServerContext& context) const {
  return {options_.access != nullptr ? options_.access->Identify(context) : wire::IdentifyByCertificate(context),
          wire::ClientOfPeer(context.peer())};
}

absl::Status LearnerServiceImpl::NameActor(const grpc::ServerContext& context, absl::string_view name) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckName("actor", name));
  return LogRefusal(context, registry_->UseName(WorkerRole::kActor, name, ClientOf(context)));
}

absl::Status LearnerServiceImpl::LogRefusal(const grpc::ServerContext& context, absl::Status status) {
  if (IsAboutNames(status)) {
    const std::string client = ClientOf(context).Name();
    refusals_.Warn(client, absl::StrFormat("refused %s: %s", client, status.message()));
  }
  return status;
}

void LearnerServiceImpl::WarnRefused(const grpc::ServerContext& context, absl::string_view worker,
                                     absl::string_view text) {
  const size_t key = std::hash<std::string>()(std::string(worker)) % kLinesPerClient;
  refusals_.Warn(absl::StrCat("worker ", key, " of ", ClientOf(context).Name()), text);
}

grpc::Status LearnerServiceImpl::Join(grpc::ServerContext* context, const v1::JoinRequest* request,
                                      v1::JoinReply* reply) {
  const wire::Handshake ours = {wire::kProtocolVersion, options_.run_id, ""};
  const wire::Handshake theirs = {request->protocol_version(), request->run_id(), ""};
  if (absl::Status status = wire::CheckHandshake("learner", ours, "actor", theirs); !status.ok()) {
    WarnRefused(*context, request->actor(),
                absl::StrFormat("actor %s refused: %s", request->actor(), status.message()));
    return wire::ToGrpc(status);
  }
  absl::Status status = wire::CheckJoin(*request);
  if (status.ok() && request->only_ask()) status = NameActor(*context, request->actor());
  if (status.ok() && !request->only_ask()) {
    status = LogRefusal(*context, registry_->Join(ClientOf(*context), request->actor(), request->address(),
                                                  {request->build(), request->canary(), request->cpu()}));
    if (status.code() == absl::StatusCode::kFailedPrecondition) {
      WarnRefused(*context, request->actor(), absl::StrFormat("refused %s", status.message()));
    }
  }
  if (!status.ok()) return wire::ToGrpc(status);
  reply->set_run_id(options_.run_id);
  reply->set_epoch(options_.epoch);
  *reply->mutable_config() = options_.config;
  reply->set_texture_digest(options_.texture_digest);
  reply->set_lease_ms(static_cast<int>(absl::ToInt64Milliseconds(options_.lease)));
  reply->set_program_version(std::string(ProgramVersion()));
  reply->set_game_canary(registry_->GameCanary());
  return grpc::Status::OK;
}

grpc::Status LearnerServiceImpl::GetPermits(grpc::ServerContext* context, const v1::PermitRequest* request,
                                            v1::PermitReply* reply) {
  const wire::StreamWatch::Stream poll(&polls_, context);
  if (!poll.admitted().ok()) return wire::ToGrpc(poll.admitted());
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return wire::ToGrpc(status);
  if (absl::Status status = wire::CheckPermitRequest(*request, options_.shape.lanes, options_.shape.steps);
      !status.ok()) {
    WarnRefused(*context, request->actor(),
                absl::StrFormat("request of actor %s refused: %s",
                                Printable(request->actor().substr(0, wire::kMaxTextBytes)), status.message()));
    return wire::ToGrpc(status);
  }
  if (absl::Status status = wire::CheckName("actor", request->actor()); !status.ok()) return wire::ToGrpc(status);
  const absl::StatusOr<WorkerRegistry::PermitReply> given = registry_->GetPermits(ToRequest(context, *request));
  if (!given.ok()) return wire::ToGrpc(LogRefusal(*context, given.status()));
  AddPermits(given->granted, reply->mutable_granted());
  AddPermits(given->lost, reply->mutable_lost());
  reply->set_finished(given->finished);
  if (given->evaluation.has_value()) *reply->mutable_evaluation() = ToProto(*given->evaluation);
  reply->set_env_servers_generation(given->servers_generation);
  for (const std::string& address : given->servers) reply->add_env_servers(address);
  return grpc::Status::OK;
}

WorkerRegistry::PermitRequest LearnerServiceImpl::ToRequest(grpc::ServerContext* context,
                                                            const v1::PermitRequest& request) const {
  WorkerRegistry::PermitRequest asked;
  asked.client = ClientOf(*context);
  asked.actor = request.actor();
  for (const v1::Permit& permit : request.active()) asked.active.push_back(FromProto(permit));
  asked.steps.assign(request.active_steps().begin(), request.active_steps().end());
  for (const v1::LaneFailure& failure : request.failures()) {
    asked.failures.push_back({failure.lane(), failure.fragment(), failure.reason()});
  }
  asked.capacity = request.capacity();
  asked.wait = WaitTime(request.wait_ms());
  asked.evaluates = request.evaluates();
  asked.evaluation = request.evaluation();
  asked.wants_servers = request.wants_env_servers();
  asked.servers_generation = request.env_servers_generation();
  asked.summary = KeepSummary(request.summary());
  for (int i = 0; i < std::min(request.env_servers_size(), kMaxServersReported); ++i) {
    const v1::Peer& server = request.env_servers(i);
    const bool valid = wire::CheckText("address", server.address()).ok() && wire::CheckSummary(server.summary()).ok();
    if (valid) asked.servers.push_back(ToServerReport(server));
  }
  asked.is_cancelled = [context] { return context->IsCancelled(); };
  return asked;
}

v1::EvaluationTask LearnerServiceImpl::ToProto(const EvaluationScheduler::Task& task) const {
  v1::EvaluationTask message;
  message.set_id(task.id);
  *message.mutable_env() = options_.config.env();
  message.mutable_env()->set_name(options_.config.eval().env());
  message.set_seed(options_.config.eval().seed());
  message.set_first_episode(task.first_episode);
  message.set_episodes(task.episodes);
  message.set_greedy(task.greedy);
  return message;
}

grpc::Status LearnerServiceImpl::PushFragments(
    grpc::ServerContext* context, grpc::ServerReaderWriter<v1::FragmentVerdict, v1::FragmentMessage>* stream) {
  wire::StreamWatch::Stream watched(&streams_, context);
  if (!watched.admitted().ok()) return wire::ToGrpc(watched.admitted());
  v1::FragmentMessage message;
  v1::FragmentVerdict reply;
  while (true) {
    watched.Await("a fragment", options_.fragment_timeout);
    if (!stream->Read(&message)) break;
    watched.Work();
    if (absl::Status status = NameActor(*context, message.actor()); !status.ok()) return wire::ToGrpc(status);
    absl::StatusOr<v1::FragmentVerdict::Verdict> verdict = Intake(&message);
    if (!verdict.ok()) {
      if (verdict.status().code() == absl::StatusCode::kInvalidArgument) {
        ++rejected_;
        const absl::Status status = absl::InvalidArgumentError(
            absl::StrFormat("fragment %d of lane %d of actor %s: %s", message.number(), message.lane(),
                            Printable(message.actor().substr(0, wire::kMaxTextBytes)), verdict.status().message()));
        WarnRefused(*context, message.actor(), absl::StrFormat("fragment refused: %s", status.message()));
        return wire::ToGrpc(status);
      }
      return wire::ToGrpc(verdict.status());
    }
    reply.set_lane(message.lane());
    reply.set_number(message.number());
    reply.set_verdict(*verdict);
    message = v1::FragmentMessage();  // a stream that waits must not keep megabytes of its last fragment
    watched.Await("a verdict to be taken", options_.reply_timeout);
    if (!stream->Write(reply)) break;
  }
  return wire::ToGrpc(watched.late());
}

absl::StatusOr<v1::FragmentVerdict::Verdict> LearnerServiceImpl::Intake(v1::FragmentMessage* message) {
  if (message->epoch() != options_.epoch) {
    ++expired_;
    return v1::FragmentVerdict::EXPIRED;
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(Fragment fragment, wire::FromProto(message, options_.shape));
  fragment.sender = message->actor();
  fragment.digest = wire::FragmentDigest(fragment);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const LaneScheduler::Verdict verdict,
      registry_->Accept(fragment.sender, {fragment.lane, fragment.number, fragment.policy_version}, fragment.snapshot,
                        fragment.digest));
  if (verdict == LaneScheduler::Verdict::kAccepted) {
    ++accepted_;
    CRAFTFLEET_RETURN_IF_ERROR(fragments_->Push(std::move(fragment)));
  } else if (verdict != LaneScheduler::Verdict::kStale) {  // which the registry counts
    ++(verdict == LaneScheduler::Verdict::kDuplicate ? duplicates_ : expired_);
  }
  return VerdictToProto(verdict);
}

grpc::Status LearnerServiceImpl::GetWeights(grpc::ServerContext* context, const v1::WeightsRequest* request,
                                            grpc::ServerWriter<v1::WeightsChunk>* writer) {
  wire::StreamWatch::Stream watched(&streams_, context);
  if (!watched.admitted().ok()) return wire::ToGrpc(watched.admitted());
  const absl::StatusOr<WeightStore::Weights> weights = FindWeights(*request);
  if (!weights.ok()) return wire::ToGrpc(weights.status());
  v1::WeightsChunk chunk;
  chunk.set_policy_version(weights->version);
  chunk.set_total_bytes(static_cast<int64_t>(weights->bytes->size()));
  for (size_t offset = 0; offset < weights->bytes->size(); offset += kChunkBytes) {
    chunk.mutable_data()->assign(*weights->bytes, offset, kChunkBytes);
    watched.Await("weights to be taken", options_.reply_timeout);
    if (!writer->Write(chunk)) break;
  }
  return wire::ToGrpc(watched.late());
}

absl::StatusOr<WeightStore::Weights> LearnerServiceImpl::FindWeights(const v1::WeightsRequest& request) const {
  if (request.evaluation() != 0) {
    std::shared_ptr<const std::string> bytes = registry_->EvaluationWeights(request.evaluation());
    if (bytes == nullptr) {
      return absl::AbortedError(absl::StrFormat("evaluation task %d is over", request.evaluation()));
    }
    return WeightStore::Weights{0, std::move(bytes)};
  }
  WeightStore::Weights weights = weights_->Wait(request.at_least(), WaitTime(request.wait_ms()));
  if (weights.bytes == nullptr || weights.version < request.at_least()) {
    return absl::DeadlineExceededError(absl::StrFormat("policy version %d is not available yet, the latest is %d",
                                                       request.at_least(), weights.version));
  }
  return weights;
}

grpc::Status LearnerServiceImpl::GetSnapshot(grpc::ServerContext* /*context*/, const v1::SnapshotRequest* request,
                                             v1::SnapshotReply* reply) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return wire::ToGrpc(status);
  absl::StatusOr<LaneSnapshot> snapshot = registry_->Snapshot(request->lane(), request->fragment());
  if (!snapshot.ok()) return wire::ToGrpc(snapshot.status());
  *reply = wire::ToProto(*std::move(snapshot));
  return grpc::Status::OK;
}

grpc::Status LearnerServiceImpl::FinishEvaluation(grpc::ServerContext* context, const v1::EvaluationResult* request,
                                                  v1::EvaluationReply* /*reply*/) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return wire::ToGrpc(status);
  if (absl::Status status = NameActor(*context, request->actor()); !status.ok()) return wire::ToGrpc(status);
  const absl::StatusOr<std::vector<Episode>> episodes = wire::FromProto(*request, options_.shape.max_length);
  const absl::Status status = episodes.ok() ? registry_->FinishEvaluation(request->id(), *episodes) : episodes.status();
  if (!status.ok()) {
    WarnRefused(*context, request->actor(),
                absl::StrFormat("evaluation by actor %s refused: %s", request->actor(), status.message()));
  }
  return wire::ToGrpc(status);
}

grpc::Status LearnerServiceImpl::Announce(grpc::ServerContext* context, const v1::Announcement* request,
                                          v1::AnnounceReply* reply) {
  const wire::Handshake ours = {wire::kProtocolVersion, "", options_.texture_digest};
  const wire::Handshake theirs = {request->protocol_version(), "", request->texture_digest()};
  absl::Status status = wire::CheckHandshake("learner", ours, "environment server", theirs);
  if (status.ok()) status = wire::CheckAnnouncement(*request);
  if (status.ok() && request->leaving()) {
    status = LogRefusal(
        *context, registry_->Leave(ClientOf(*context), WorkerRole::kEnvServer, request->name(), request->address()));
  } else if (status.ok()) {
    status = LogRefusal(*context, registry_->Announce(ClientOf(*context), request->name(), request->address(),
                                                      request->summary().lanes(), {request->build(), request->canary()},
                                                      KeepSummary(request->summary())));
  }
  if (!status.ok() && !IsAboutNames(status)) {
    WarnRefused(*context, request->name(),
                absl::StrFormat("environment server %s refused: %s", request->name(), status.message()));
  }
  if (!status.ok()) return wire::ToGrpc(status);
  reply->set_run_id(options_.run_id);
  reply->set_lease_ms(static_cast<int>(absl::ToInt64Milliseconds(registry_->server_lease())));
  return grpc::Status::OK;
}

grpc::Status LearnerServiceImpl::Leave(grpc::ServerContext* context, const v1::LeaveRequest* request,
                                       v1::LeaveReply* /*reply*/) {
  absl::Status status = wire::CheckName("actor", request->actor());
  if (status.ok()) {
    status = LogRefusal(*context, registry_->Leave(ClientOf(*context), WorkerRole::kActor, request->actor()));
  }
  return wire::ToGrpc(status);
}

void LearnerServiceImpl::FillStatus(v1::StatusReply* reply) const {
  reply->set_run_id(options_.run_id);
  wire::AddMetric("epoch", static_cast<double>(options_.epoch), reply);
  wire::AddMetric("fragments_accepted", static_cast<double>(accepted_.load()), reply);
  wire::AddMetric("fragments_duplicate", static_cast<double>(duplicates_.load()), reply);
  wire::AddMetric("fragments_expired", static_cast<double>(expired_.load()), reply);
  wire::AddMetric("fragments_rejected", static_cast<double>(rejected_.load()), reply);
  wire::AddMetric("fragments_queued", static_cast<double>(fragments_->size()), reply);
  wire::AddMetric("fragments_differing", static_cast<double>(registry_->differing()), reply);
  wire::AddMetric("fragments_dropped", static_cast<double>(registry_->dropped()), reply);
  wire::AddMetric("lanes_reset", static_cast<double>(registry_->resets()), reply);
  wire::AddMetric("permits_lapsed", static_cast<double>(registry_->lapsed()), reply);
  AddWorkers(*registry_, reply);
}

absl::Status LearnerServiceImpl::CheckEpoch(int64_t epoch) const {
  if (epoch == options_.epoch) return absl::OkStatus();
  return absl::AbortedError(absl::StrFormat("epoch %d, but the learner is in epoch %d since its last start: join again",
                                            epoch, options_.epoch));
}

}  // namespace craftfleet

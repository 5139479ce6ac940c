#include "learner/learner_service.h"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include <absl/strings/str_format.h>

#include "common/log.h"
#include "common/printable.h"
#include "common/status_macros.h"
#include "common/version.h"
#include "common/wire/fragment_digest.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

constexpr int kMaxWaitMs = 2000;          // of a long poll
constexpr size_t kChunkBytes = 2u << 20;  // of weights
constexpr int kMaxServersTold = 64;       // environment servers of which an actor speaks at once

absl::Duration WaitTime(int wait_ms) { return absl::Milliseconds(std::clamp(wait_ms, 0, kMaxWaitMs)); }

Permit FromProto(const v1::Permit& message) { return {message.lane(), message.fragment(), message.policy_version()}; }

void AddPermits(const std::vector<Permit>& permits, google::protobuf::RepeatedPtrField<v1::Permit>* out) {
  for (const Permit& permit : permits) {
    v1::Permit* message = out->Add();
    message->set_lane(permit.lane);
    message->set_fragment(permit.fragment);
    message->set_policy_version(permit.policy_version);
  }
}

constexpr absl::string_view kActor = "actor";
constexpr absl::string_view kEnvServer = "environment server";
// Twice the longest lease: what was given to a name has lapsed before another can have it.
constexpr absl::Duration kNameLapse = absl::Seconds(16);

v1::FragmentVerdict::Verdict ToProto(LaneLedger::Verdict verdict) {
  switch (verdict) {
    case LaneLedger::Verdict::kAccepted:
      return v1::FragmentVerdict::ACCEPTED;
    case LaneLedger::Verdict::kDuplicate:
      return v1::FragmentVerdict::DUPLICATE;
    case LaneLedger::Verdict::kExpired:
      return v1::FragmentVerdict::EXPIRED;
  }
  return v1::FragmentVerdict::VERDICT_UNSPECIFIED;
}

}  // namespace

LearnerServiceImpl::LearnerServiceImpl(const Options& options, LaneLedger* ledger, WeightStore* weights,
                                       FragmentQueue* fragments, EvaluationBook* evaluations,
                                       ServerRegistry* env_servers, FleetBook* fleet)
    : options_(options),
      ledger_(ledger),
      weights_(weights),
      fragments_(fragments),
      evaluations_(evaluations),
      env_servers_(env_servers),
      fleet_(fleet),
      names_(kNameLapse, &clock_),
      builds_(options.build, &clock_),
      refusals_(&clock_) {}

absl::Status LearnerServiceImpl::Name(const grpc::ServerContext& context, absl::string_view kind,
                                      absl::string_view name) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckName(kind, name));
  const std::string identity =
      options_.access != nullptr ? options_.access->Identify(context) : wire::IdentifyByCertificate(context);
  absl::Status status = names_.Use(kind, name, identity);
  if (!status.ok()) refusals_.Warn(identity, absl::StrFormat("refused %s: %s", identity, status.message()));
  return status;
}

grpc::Status LearnerServiceImpl::Join(grpc::ServerContext* context, const v1::JoinRequest* request,
                                      v1::JoinReply* reply) {
  const wire::Handshake ours = {wire::kProtocolVersion, options_.run_id, ""};
  const wire::Handshake theirs = {request->protocol_version(), request->run_id(), ""};
  if (absl::Status status = wire::CheckHandshake("learner", ours, "actor", theirs); !status.ok()) {
    LogWarning("actor %s refused: %s", request->actor(), status.message());
    return wire::ToGrpc(status);
  }
  absl::Status status = wire::CheckJoin(*request);
  if (status.ok()) status = Name(*context, kActor, request->actor());
  if (!status.ok()) return wire::ToGrpc(status);
  if (!request->only_ask()) {
    if (status = builds_.CheckActor(*request); !status.ok()) {
      LogWarning("refused %s", status.message());
      return wire::ToGrpc(status);
    }
    ledger_->Join(request->actor(), request->address());
    fleet_->Heard("actor", request->actor(), request->address(), {});
  }
  reply->set_run_id(options_.run_id);
  reply->set_epoch(options_.epoch);
  *reply->mutable_config() = options_.config;
  reply->set_texture_digest(options_.texture_digest);
  reply->set_lease_ms(static_cast<int>(absl::ToInt64Milliseconds(options_.lease)));
  reply->set_program_version(std::string(ProgramVersion()));
  reply->set_game_canary(builds_.GameCanary());
  return grpc::Status::OK;
}

grpc::Status LearnerServiceImpl::GetPermits(grpc::ServerContext* context, const v1::PermitRequest* request,
                                            v1::PermitReply* reply) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return wire::ToGrpc(status);
  if (absl::Status status = wire::CheckPermitRequest(*request, options_.shape.lanes, options_.shape.steps);
      !status.ok()) {
    LogWarning("request of actor %s refused: %s", Printable(request->actor().substr(0, wire::kMaxTextBytes)),
               status.message());
    return wire::ToGrpc(status);
  }
  if (absl::Status status = Name(*context, kActor, request->actor()); !status.ok()) return wire::ToGrpc(status);
  for (const v1::LaneFailure& failure : request->failures()) {
    ledger_->Refuse(request->actor(), failure.lane(), failure.fragment(), failure.reason());
  }
  evaluations_->Renew(request->actor(), request->evaluation());
  std::vector<Permit> active;
  for (const v1::Permit& permit : request->active()) active.push_back(FromProto(permit));
  absl::StatusOr<LaneLedger::Grant> grant =
      ledger_->GetPermits(request->actor(), active, request->capacity(), WaitTime(request->wait_ms()),
                          absl::MakeConstSpan(request->active_steps().data(), request->active_steps_size()));
  if (!grant.ok()) return wire::ToGrpc(grant.status());
  if (context->IsCancelled()) {
    ledger_->LoseTouch(request->actor());
    return grpc::Status::CANCELLED;
  }
  fleet_->Heard("actor", request->actor(), "", request->summary());
  for (int i = 0; i < std::min(request->env_servers_size(), kMaxServersTold); ++i) {
    const v1::Peer& server = request->env_servers(i);
    if (wire::CheckText("address", server.address()).ok()) fleet_->HeardOf(server);
  }
  AddPermits(grant->granted, reply->mutable_granted());
  AddPermits(grant->lost, reply->mutable_lost());
  reply->set_finished(grant->finished);
  if (!grant->resting) OfferEvaluation(*request, reply);
  TellEnvServers(*request, reply);
  return grpc::Status::OK;
}

void LearnerServiceImpl::TellEnvServers(const v1::PermitRequest& request, v1::PermitReply* reply) {
  if (!request.wants_env_servers()) return;
  int64_t generation = request.env_servers_generation();
  reply->set_env_servers_generation(generation);
  if (env_servers_->Generation() == generation || env_servers_->ShouldKeep(generation)) return;
  const std::vector<ServerRegistry::Server> servers = env_servers_->Servers(&generation);
  reply->set_env_servers_generation(generation);
  for (const ServerRegistry::Server& server : servers) reply->add_env_servers(server.address);
}

void LearnerServiceImpl::OfferEvaluation(const v1::PermitRequest& request, v1::PermitReply* reply) {
  if (!request.evaluates() || request.evaluation() != 0) return;
  const std::optional<EvaluationBook::Task> task = evaluations_->Take(request.actor());
  if (!task.has_value()) return;
  v1::EvaluationTask* message = reply->mutable_evaluation();
  message->set_id(task->id);
  *message->mutable_env() = options_.config.env();
  message->mutable_env()->set_name(options_.config.eval().env());
  message->set_seed(options_.config.eval().seed());
  message->set_first_episode(task->first_episode);
  message->set_episodes(task->episodes);
  message->set_greedy(task->greedy);
}

grpc::Status LearnerServiceImpl::PushFragments(
    grpc::ServerContext* context, grpc::ServerReaderWriter<v1::FragmentVerdict, v1::FragmentMessage>* stream) {
  wire::StreamWatch::Stream watched(&streams_, context);
  if (!watched.admitted().ok()) return wire::ToGrpc(watched.admitted());
  v1::FragmentMessage message;
  v1::FragmentVerdict reply;
  while (true) {
    watched.Await("a fragment", wire::StreamWatch::kRequest);
    if (!stream->Read(&message)) break;
    watched.Work();
    if (absl::Status status = Name(*context, kActor, message.actor()); !status.ok()) return wire::ToGrpc(status);
    absl::StatusOr<v1::FragmentVerdict::Verdict> verdict = TakeIn(&message);
    if (!verdict.ok()) {
      if (verdict.status().code() == absl::StatusCode::kInvalidArgument) {
        ++rejected_;
        const absl::Status status = absl::InvalidArgumentError(
            absl::StrFormat("fragment %d of lane %d of actor %s: %s", message.number(), message.lane(),
                            Printable(message.actor().substr(0, wire::kMaxTextBytes)), verdict.status().message()));
        LogWarning("refused: %s", status.message());
        return wire::ToGrpc(status);
      }
      return wire::ToGrpc(verdict.status());
    }
    reply.set_lane(message.lane());
    reply.set_number(message.number());
    reply.set_verdict(*verdict);
    watched.Await("a verdict to be taken", wire::StreamWatch::kTakesReply);
    if (!stream->Write(reply)) break;
  }
  return grpc::Status::OK;
}

absl::StatusOr<v1::FragmentVerdict::Verdict> LearnerServiceImpl::TakeIn(v1::FragmentMessage* message) {
  if (message->epoch() != options_.epoch) {
    ++expired_;
    return v1::FragmentVerdict::EXPIRED;
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(Fragment fragment, wire::FromProto(message, options_.shape));
  fragment.sender = message->actor();
  fragment.digest = wire::FragmentDigest(fragment);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const LaneLedger::Verdict verdict,
      ledger_->Accept(fragment.sender, {fragment.lane, fragment.number, fragment.policy_version}, fragment.snapshot,
                      fragment.digest));
  if (verdict == LaneLedger::Verdict::kAccepted) {
    ++accepted_;
    CRAFTFLEET_RETURN_IF_ERROR(fragments_->Push(std::move(fragment)));
  } else {
    ++(verdict == LaneLedger::Verdict::kDuplicate ? duplicates_ : expired_);
  }
  return ToProto(verdict);
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
    watched.Await("weights to be taken", wire::StreamWatch::kTakesReply);
    if (!writer->Write(chunk)) break;
  }
  return grpc::Status::OK;
}

absl::StatusOr<WeightStore::Weights> LearnerServiceImpl::FindWeights(const v1::WeightsRequest& request) const {
  if (request.evaluation() != 0) {
    std::shared_ptr<const std::string> bytes = evaluations_->Weights(request.evaluation());
    if (bytes == nullptr) {
      return absl::AbortedError(absl::StrFormat("evaluation task %d is over", request.evaluation()));
    }
    return WeightStore::Weights{0, std::move(bytes)};
  }
  WeightStore::Weights weights = weights_->Wait(request.at_least(), WaitTime(request.wait_ms()));
  if (weights.bytes == nullptr || weights.version < request.at_least()) {
    return absl::DeadlineExceededError(
        absl::StrFormat("policy version %d is not there yet, the last is %d", request.at_least(), weights.version));
  }
  return weights;
}

grpc::Status LearnerServiceImpl::GetSnapshot(grpc::ServerContext* /*context*/, const v1::SnapshotRequest* request,
                                             v1::SnapshotReply* reply) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return wire::ToGrpc(status);
  absl::StatusOr<LaneSnapshot> snapshot = ledger_->Snapshot(request->lane(), request->fragment());
  if (!snapshot.ok()) return wire::ToGrpc(snapshot.status());
  *reply = wire::ToProto(*std::move(snapshot));
  return grpc::Status::OK;
}

grpc::Status LearnerServiceImpl::FinishEvaluation(grpc::ServerContext* context, const v1::EvaluationResult* request,
                                                  v1::EvaluationReply* /*reply*/) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return wire::ToGrpc(status);
  if (absl::Status status = Name(*context, kActor, request->actor()); !status.ok()) return wire::ToGrpc(status);
  const absl::StatusOr<std::vector<Episode>> episodes = wire::FromProto(*request, options_.shape.max_length);
  const absl::Status status = episodes.ok() ? evaluations_->Finish(request->id(), *episodes) : episodes.status();
  if (!status.ok()) LogWarning("evaluation by actor %s refused: %s", request->actor(), status.message());
  return wire::ToGrpc(status);
}

grpc::Status LearnerServiceImpl::Announce(grpc::ServerContext* context, const v1::Announcement* request,
                                          v1::AnnounceReply* reply) {
  const wire::Handshake ours = {wire::kProtocolVersion, "", options_.texture_digest};
  const wire::Handshake theirs = {request->protocol_version(), "", request->texture_digest()};
  absl::Status status = wire::CheckHandshake("learner", ours, "environment server", theirs);
  if (status.ok()) status = wire::CheckAnnouncement(*request);
  if (status.ok()) status = Name(*context, kEnvServer, request->name());
  // Nor may one be announced where another's games are.
  if (status.ok()) status = Name(*context, "environment server at", request->address());
  if (status.ok() && !request->leaving()) status = builds_.CheckServer(*request);
  if (!status.ok()) {
    refusals_.Warn(request->name(),
                   absl::StrFormat("environment server %s refused: %s", request->name(), status.message()));
    return wire::ToGrpc(status);
  }
  if (request->leaving()) {
    names_.Leave(kEnvServer, request->name());
    names_.Leave("environment server at", request->address());
    env_servers_->Leave(request->name());
    fleet_->Left("envserver", request->name());
  } else {
    env_servers_->Announce(request->name(), request->address(), request->summary().lanes());
    fleet_->Heard("envserver", request->name(), request->address(), request->summary());
  }
  reply->set_run_id(options_.run_id);
  reply->set_lease_ms(static_cast<int>(absl::ToInt64Milliseconds(env_servers_->lease())));
  return grpc::Status::OK;
}

grpc::Status LearnerServiceImpl::Leave(grpc::ServerContext* context, const v1::LeaveRequest* request,
                                       v1::LeaveReply* /*reply*/) {
  if (absl::Status status = Name(*context, kActor, request->actor()); !status.ok()) return wire::ToGrpc(status);
  names_.Leave(kActor, request->actor());
  ledger_->Leave(request->actor());
  fleet_->Left("actor", request->actor());
  evaluations_->Renew(request->actor(), 0);
  return grpc::Status::OK;
}

void LearnerServiceImpl::FillStatus(v1::StatusReply* reply) const {
  reply->set_run_id(options_.run_id);
  wire::AddMetric("epoch", static_cast<double>(options_.epoch), reply);
  wire::AddMetric("fragments_accepted", static_cast<double>(accepted_.load()), reply);
  wire::AddMetric("fragments_duplicate", static_cast<double>(duplicates_.load()), reply);
  wire::AddMetric("fragments_expired", static_cast<double>(expired_.load()), reply);
  wire::AddMetric("fragments_rejected", static_cast<double>(rejected_.load()), reply);
  wire::AddMetric("fragments_queued", static_cast<double>(fragments_->size()), reply);
  wire::AddMetric("fragments_differing", static_cast<double>(ledger_->differing()), reply);
  wire::AddMetric("lanes_reset", static_cast<double>(ledger_->resets()), reply);
  wire::AddMetric("permits_lapsed", static_cast<double>(ledger_->lapsed()), reply);
  const std::vector<LaneLedger::ActorInfo> actors = ledger_->Actors();
  for (v1::Peer& worker : fleet_->Workers()) {
    const auto actor =
        std::find_if(actors.begin(), actors.end(), [&](const auto& a) { return a.name == worker.name(); });
    if (actor != actors.end()) {
      worker.set_state(absl::StrFormat("%d permits, %d fragments accepted%s%s", actor->permits, actor->fragments,
                                       actor->stalled ? ", makes no progress" : "",
                                       !actor->draining      ? ""
                                       : actor->permits == 0 ? ", drained"
                                                             : ", draining"));
    }
    reply->add_peers()->Swap(&worker);
  }
  builds_.FillStatus(reply);
}

absl::Status LearnerServiceImpl::CheckEpoch(int64_t epoch) const {
  if (epoch == options_.epoch) return absl::OkStatus();
  return absl::AbortedError(absl::StrFormat("epoch %d, but the learner is in epoch %d since its last start: join again",
                                            epoch, options_.epoch));
}

}  // namespace craftfleet

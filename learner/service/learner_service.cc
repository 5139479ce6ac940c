#include "learner/service/learner_service.h"

#include <algorithm>
#include <functional>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/process/version.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "common/wire/status_service.h"
#include "learner/service/worker_page.h"

namespace craftfleet {
namespace {

constexpr char kPlay[] = "/craftfleet.v1.LearnerService/Play";
constexpr int kLinesPerClient = 16;  // about workers, in the period of LimitedLog, whatever their names
constexpr absl::Duration kLongestWait = absl::Seconds(5);
constexpr int kMaxServersReported = 64;  // environment servers in one request of an actor

Permit ToPermit(const v1::Permit& message) { return {message.lane(), message.fragment(), message.policy_version()}; }

void AddPermits(const std::vector<Permit>& permits, google::protobuf::RepeatedPtrField<v1::Permit>* out) {
  for (const Permit& permit : permits) {
    v1::Permit* message = out->Add();
    message->set_lane(permit.lane);
    message->set_fragment(permit.fragment);
    message->set_policy_version(permit.policy_version);
    message->set_reload(permit.reload);
  }
}

// Answers a short call at once.
grpc::ServerUnaryReactor* Finish(grpc::CallbackServerContext* context, const absl::Status& status) {
  grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
  reactor->Finish(wire::ToGrpc(status));
  return reactor;
}

// Whether the registry refused a client because of its name, or of its number of names.
bool IsAboutNames(const absl::Status& status) {
  return status.code() == absl::StatusCode::kPermissionDenied || status.code() == absl::StatusCode::kResourceExhausted;
}

}  // namespace

LearnerServiceImpl::LearnerServiceImpl(const Options& options, WorkerRegistry* registry, WeightStore* weights,
                                       FragmentQueue* fragments)
    : options_(options),
      frames_(options.config, options.texture_digest),
      registry_(registry),
      weights_(weights),
      intake_(options.epoch, options.shape, {&frames_, registry, weights, fragments}),
      refusals_(&clock_),
      worker_refusals_(&clock_, kLinesPerClient),
      streams_(options.max_streams_per_client) {
  registry_->SetObserver([this](absl::string_view actor) {
    if (actor.empty()) {
      waiting_for_permits_.Retry();
    } else {
      waiting_for_permits_.Retry(actor);
    }
  });
}

LearnerServiceImpl::~LearnerServiceImpl() { registry_->SetObserver(nullptr); }

WorkerClient LearnerServiceImpl::ClientOf(const grpc::ServerContextBase& context) const {
  return {wire::Identify(context), wire::ClientOfPeer(context.peer())};
}

absl::Status LearnerServiceImpl::NameActor(const grpc::ServerContextBase& context, absl::string_view name) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckName("actor", name));
  const WorkerClient client = ClientOf(context);
  return LogRefusal(client, registry_->UseName(WorkerRole::kActor, name, client));
}

absl::Status LearnerServiceImpl::LogRefusal(const WorkerClient& client, absl::Status status) {
  if (IsAboutNames(status)) {
    refusals_.Warn(client.Name(), absl::StrFormat("refused %s: %s", client.Name(), status.message()));
  }
  return status;
}

void LearnerServiceImpl::WarnRefused(const grpc::ServerContextBase& context, absl::string_view text) {
  worker_refusals_.Warn(ClientOf(context).Name(), text);
}

grpc::ServerUnaryReactor* LearnerServiceImpl::Join(grpc::CallbackServerContext* context, const v1::JoinRequest* request,
                                                   v1::JoinReply* reply) {
  const wire::Handshake ours = {wire::kProtocolVersion, options_.run_id, ""};
  const wire::Handshake theirs = {request->protocol_version(), request->run_id(), ""};
  if (absl::Status status = wire::CheckHandshake("learner", ours, "actor", theirs); !status.ok()) {
    WarnRefused(*context, absl::StrFormat("actor %s refused: %s", request->actor(), status.message()));
    return Finish(context, status);
  }
  absl::Status status = wire::CheckJoin(*request);
  if (status.ok() && request->only_ask()) status = NameActor(*context, request->actor());
  if (status.ok() && !request->only_ask()) {
    const WorkerClient client = ClientOf(*context);
    status = LogRefusal(client, registry_->Join(client, request->actor(), request->address(),
                                                {request->build(), request->canary(), request->cpu()}));
    if (status.code() == absl::StatusCode::kFailedPrecondition) {
      WarnRefused(*context, absl::StrFormat("refused %s", status.message()));
    }
  }
  if (!status.ok()) return Finish(context, status);
  reply->set_run_id(options_.run_id);
  reply->set_epoch(options_.epoch);
  *reply->mutable_config() = options_.config;
  reply->set_texture_digest(options_.texture_digest);
  reply->set_lease_ms(static_cast<int>(absl::ToInt64Milliseconds(options_.lease)));
  reply->set_program_version(std::string(ProgramVersion()));
  reply->set_game_canary(registry_->builds()->GameCanary());
  frames_.AddFormats(reply);
  return Finish(context, absl::OkStatus());
}

absl::Status LearnerServiceImpl::CheckAllowed(const grpc::ServerContextBase& context) const {
  return options_.access != nullptr ? options_.access->Check(context, kPlay) : absl::OkStatus();
}

absl::StatusOr<v1::FragmentVerdict> LearnerServiceImpl::Receive(const grpc::ServerContextBase& context,
                                                                v1::FragmentMessage* message) {
  const WorkerClient client = ClientOf(context);
  absl::StatusOr<v1::FragmentVerdict> verdict = intake_.Receive(client, message);
  if (!verdict.ok()) return LogRefusal(client, verdict.status());
  if (verdict->verdict() == v1::FragmentVerdict::REFUSED) {
    WarnRefused(context, absl::StrFormat("fragment refused: %s", verdict->reason()));
  }
  return verdict;
}

absl::Status LearnerServiceImpl::CheckPermits(const grpc::ServerContextBase& context,
                                              const v1::PermitRequest& request) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckEpoch(request.epoch()));
  if (absl::Status status = wire::CheckPermitRequest(request, options_.shape.lanes); !status.ok()) {
    WarnRefused(context, absl::StrFormat("request of actor %s refused: %s",
                                         Printable(request.actor().substr(0, wire::kMaxTextBytes)), status.message()));
    return status;
  }
  return absl::OkStatus();
}

void LearnerServiceImpl::FillPermits(const WorkerRegistry::PermitReply& given, v1::PermitReply* reply) const {
  AddPermits(given.granted, reply->mutable_granted());
  AddPermits(given.lost, reply->mutable_lost());
  reply->set_finished(given.finished);
  if (given.evaluation.has_value()) *reply->mutable_evaluation() = ToProto(*given.evaluation);
  reply->set_env_servers_generation(given.servers_generation);
  for (const std::string& address : given.servers) reply->add_env_servers(address);
}

WorkerRegistry::PermitRequest LearnerServiceImpl::ToRequest(WorkerClient client,
                                                            const v1::PermitRequest& request) const {
  WorkerRegistry::PermitRequest asked;
  asked.client = std::move(client);
  asked.actor = request.actor();
  for (const v1::Permit& permit : request.active()) asked.active.push_back(ToPermit(permit));
  for (const v1::LaneFailure& failure : request.failures()) {
    asked.failures.push_back({failure.lane(), failure.fragment(), failure.reason()});
  }
  asked.capacity = request.capacity();
  asked.wait = std::min(absl::Milliseconds(request.wait_ms()), kLongestWait);
  asked.evaluates = request.evaluates();
  asked.evaluation = request.evaluation();
  asked.wants_servers = request.wants_env_servers();
  asked.servers_generation = request.env_servers_generation();
  asked.summary = KeepSummary(request.summary());
  for (int i = 0; i < std::min(request.env_servers_size(), kMaxServersReported); ++i) {
    const v1::Peer& server = request.env_servers(i);
    if (wire::CheckServerReport(server).ok()) asked.servers.push_back(ToServerReport(server));
  }
  return asked;
}

v1::EvaluationTask LearnerServiceImpl::ToProto(const EvaluationTable::Task& task) const {
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

grpc::ServerUnaryReactor* LearnerServiceImpl::GetSnapshot(grpc::CallbackServerContext* context,
                                                          const v1::SnapshotRequest* request,
                                                          v1::SnapshotReply* reply) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return Finish(context, status);
  absl::StatusOr<LaneSnapshot> snapshot = registry_->lanes()->table().Snapshot(request->lane(), request->fragment());
  if (!snapshot.ok()) return Finish(context, snapshot.status());
  *reply = wire::ToProto(*std::move(snapshot));
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* LearnerServiceImpl::FinishEvaluation(grpc::CallbackServerContext* context,
                                                               const v1::EvaluationResult* request,
                                                               v1::EvaluationReply* /*reply*/) {
  if (absl::Status status = CheckEpoch(request->epoch()); !status.ok()) return Finish(context, status);
  if (absl::Status status = NameActor(*context, request->actor()); !status.ok()) return Finish(context, status);
  const absl::StatusOr<std::vector<Episode>> episodes = wire::FromProto(*request, options_.shape.max_length);
  const absl::Status status =
      episodes.ok() ? registry_->FinishEvaluation(request->actor(), request->id(), *episodes) : episodes.status();
  if (!status.ok()) {
    WarnRefused(*context, absl::StrFormat("evaluation by actor %s refused: %s", request->actor(), status.message()));
  }
  return Finish(context, status);
}

grpc::ServerUnaryReactor* LearnerServiceImpl::Announce(grpc::CallbackServerContext* context,
                                                       const v1::Announcement* request, v1::AnnounceReply* reply) {
  const wire::Handshake ours = {wire::kProtocolVersion, "", options_.texture_digest};
  const wire::Handshake theirs = {request->protocol_version(), "", request->texture_digest()};
  const WorkerClient client = ClientOf(*context);
  absl::Status status = wire::CheckHandshake("learner", ours, "environment server", theirs);
  if (status.ok()) status = wire::CheckAnnouncement(*request);
  if (status.ok() && request->leaving()) {
    status = LogRefusal(client, registry_->Leave(client, WorkerRole::kEnvServer, request->name(), request->address()));
  } else if (status.ok()) {
    status =
        LogRefusal(client, registry_->Announce(client, request->name(), request->address(), request->summary().lanes(),
                                               {request->build(), request->canary(), /*cpu=*/""},
                                               KeepSummary(request->summary())));
  }
  if (!status.ok() && !IsAboutNames(status)) {
    WarnRefused(*context, absl::StrFormat("environment server %s refused: %s", request->name(), status.message()));
  }
  if (!status.ok()) return Finish(context, status);
  reply->set_run_id(options_.run_id);
  reply->set_lease_ms(static_cast<int>(absl::ToInt64Milliseconds(registry_->server_lease())));
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* LearnerServiceImpl::Leave(grpc::CallbackServerContext* context,
                                                    const v1::LeaveRequest* request, v1::LeaveReply* /*reply*/) {
  absl::Status status = wire::CheckName("actor", request->actor());
  if (status.ok()) {
    const WorkerClient client = ClientOf(*context);
    status = LogRefusal(client, registry_->Leave(client, WorkerRole::kActor, request->actor()));
  }
  return Finish(context, status);
}

std::vector<WorkerRegistry::WorkerInfo> LearnerServiceImpl::FillStatus(v1::StatusReply* reply) const {
  reply->set_run_id(options_.run_id);
  wire::AddMetric("epoch", static_cast<double>(options_.epoch), reply);
  intake_.AddMetrics(reply);
  const LaneCounters counters = registry_->lanes()->table().counters;
  wire::AddMetric("fragments_differing", static_cast<double>(counters.differing), reply);
  wire::AddMetric("fragments_dropped", static_cast<double>(counters.dropped), reply);
  wire::AddMetric("lanes_reset", static_cast<double>(counters.resets), reply);
  wire::AddMetric("permits_lapsed", static_cast<double>(counters.lapsed), reply);
  return AddWorkers(*registry_, reply);
}

absl::Status LearnerServiceImpl::CheckEpoch(int64_t epoch) const {
  if (epoch == options_.epoch) return absl::OkStatus();
  return absl::AbortedError(absl::StrFormat("epoch %d, but the learner is in epoch %d since its last start: join again",
                                            epoch, options_.epoch));
}

}  // namespace craftfleet

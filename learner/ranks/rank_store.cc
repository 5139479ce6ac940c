#include "learner/ranks/rank_store.h"

#include <algorithm>
#include <map>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>
#include <absl/time/clock.h>
#include <grpcpp/client_context.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/wire/server.h"
#include "craftfleet/v1/ranks.grpc.pb.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxBytes = size_t{64} << 20;  // of all keys and values; 256 ranks need half of it
constexpr absl::Duration kCall = absl::Seconds(10);
// Between two attempts to connect.
constexpr absl::Duration kTryAgain = absl::Milliseconds(200);
// Between two looks at a key: at first, and at most.
constexpr absl::Duration kLookAgain = absl::Milliseconds(5);
constexpr absl::Duration kLookSeldom = absl::Milliseconds(250);

}  // namespace

class RankStore::Table : public v1::RankService::Service {
 public:
  // `server` is started with this service, and stopped before it goes.
  absl::Status Listen(const std::string& address) {
    CRAFTFLEET_ASSIGN_OR_RETURN(server_, wire::Server::Create({address, /*insecure=*/true}, {this}));
    return absl::OkStatus();
  }
  wire::Endpoint InProcess() { return server_->InProcess(); }

  grpc::Status Put(grpc::ServerContext* /*context*/, const v1::PutRequest* request, v1::PutReply* /*reply*/) override {
    const MutexLock lock(&mutex_);
    const size_t bytes = request->key().size() + request->value().size();
    if (values_.count(request->key()) > 0) return {grpc::StatusCode::ALREADY_EXISTS, request->key()};
    if (bytes > kMaxBytes - bytes_) return {grpc::StatusCode::RESOURCE_EXHAUSTED, "the table of the ranks is full"};
    bytes_ += bytes;
    values_.emplace(request->key(), request->value());
    return grpc::Status::OK;
  }

  grpc::Status Get(grpc::ServerContext* /*context*/, const v1::GetRequest* request, v1::GetReply* reply) override {
    const MutexLock lock(&mutex_);
    const auto found = values_.find(request->key());
    if (found == values_.end()) return {grpc::StatusCode::NOT_FOUND, request->key()};
    reply->set_value(found->second);
    return grpc::Status::OK;
  }

 private:
  Mutex mutex_;
  std::map<std::string, std::string> values_ ABSL_GUARDED_BY(mutex_);
  size_t bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  std::unique_ptr<wire::Server> server_;
};

RankStore::RankStore(std::unique_ptr<Table> table, wire::Endpoint rank0)
    : table_(std::move(table)), rank0_(std::move(rank0)) {}

RankStore::~RankStore() = default;

absl::StatusOr<std::shared_ptr<RankStore>> RankStore::Serve(const std::string& address) {
  auto table = std::make_unique<Table>();
  const absl::Status listening = table->Listen(address);
  if (!listening.ok()) {
    return absl::Status(listening.code(), absl::StripPrefix(listening.message(), "--listen: "));
  }
  wire::Endpoint rank0 = table->InProcess();
  return std::shared_ptr<RankStore>(new RankStore(std::move(table), std::move(rank0)));
}

absl::StatusOr<std::shared_ptr<RankStore>> RankStore::Join(const std::string& address, absl::Duration timeout) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("master_addr", address));
  const absl::Time deadline = SteadyNow() + timeout;
  while (true) {
    // A new one each time: gRPC polls a channel that failed only every 5 s.
    const wire::Endpoint rank0 = wire::Connect(address);
    const absl::Status connected = wire::WaitUntilConnected("rank 0", rank0, deadline - SteadyNow());
    if (connected.ok()) return std::shared_ptr<RankStore>(new RankStore(nullptr, rank0));
    if (SteadyNow() + kTryAgain >= deadline) return connected;
    absl::SleepFor(kTryAgain);
  }
}

absl::Status RankStore::Put(const std::string& key, const std::string& value) {
  v1::PutRequest request;
  request.set_key(key);
  request.set_value(value);
  v1::PutReply reply;
  grpc::ClientContext context;
  wire::SetDeadline(&context, kCall);
  return wire::FromCall(v1::RankService::NewStub(rank0_.channel)->Put(&context, request, &reply), "rank 0", rank0_);
}

absl::StatusOr<std::string> RankStore::Get(const std::string& key) {
  v1::GetRequest request;
  request.set_key(key);
  v1::GetReply reply;
  grpc::ClientContext context;
  wire::SetDeadline(&context, kCall);
  CRAFTFLEET_RETURN_IF_ERROR(
      wire::FromCall(v1::RankService::NewStub(rank0_.channel)->Get(&context, request, &reply), "rank 0", rank0_));
  return std::move(*reply.mutable_value());
}

absl::StatusOr<std::string> RankStore::Await(const std::string& key, absl::Duration timeout) {
  const absl::Time deadline = SteadyNow() + timeout;
  absl::Duration pause = kLookAgain;
  while (true) {
    absl::StatusOr<std::string> value = Get(key);
    if (!absl::IsNotFound(value.status()) || SteadyNow() >= deadline) return value;
    absl::SleepFor(pause);
    pause = std::min(2 * pause, kLookSeldom);
  }
}

}  // namespace craftfleet

#include "learner/ranks/rank_links.h"

#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <functional>
#include <stdexcept>
#include <utility>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <torch/csrc/distributed/c10d/PrefixStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/Store.hpp>

#include "common/base/clock.h"
#include "common/base/numeric_host.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kBeat = absl::Seconds(1);
constexpr absl::Duration kSilence = absl::Seconds(7);
// For the connections between ranks that are all there.
constexpr absl::Duration kConnect = absl::Seconds(30);
constexpr absl::Duration kForever = absl::Hours(24 * 365);
constexpr int kTag = 0;

std::chrono::milliseconds Milliseconds(absl::Duration duration) {
  return absl::ToChronoMilliseconds(std::max(duration, absl::Milliseconds(1)));
}

// The first line: LibTorch adds its stack, Gloo its sources.
std::string MessageOf(const std::exception& error) {
  const auto* const torch_error = dynamic_cast<const c10::Error*>(&error);
  const std::string all = torch_error != nullptr ? torch_error->what_without_backtrace() : error.what();
  const std::string line = all.substr(0, all.find('\n'));
  // "[../gloo/transport/tcp/pair.cc:598] Connection closed by peer"
  const size_t source = line[0] == '[' ? line.find("] ") : std::string::npos;
  return source == std::string::npos ? line : line.substr(source + 2);
}

// OK, or what `f` threw.
absl::Status Try(const std::function<void()>& f) {
  try {
    f();
    return absl::OkStatus();
  } catch (const std::exception& error) {
    return absl::UnavailableError(MessageOf(error));
  }
}

// The address of this host that others reach it by: the one from which it reaches rank 0. The name of a host often
// means its loopback address.
std::string OwnAddress(const RankOptions& options) {
  std::string own = "127.0.0.1";
  addrinfo hints = {};
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const std::string master = WithoutBrackets(options.master_addr);
  if (getaddrinfo(master.c_str(), absl::StrCat(options.master_port).c_str(), &hints, &found) != 0) {
    return own;
  }
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next) {
    const int udp = socket(each->ai_family, SOCK_DGRAM | SOCK_CLOEXEC, 0);  // connecting it sends nothing
    sockaddr_storage local = {};
    socklen_t size = sizeof(local);
    auto* const address = reinterpret_cast<sockaddr*>(&local);
    const bool is_known =
        udp >= 0 && connect(udp, each->ai_addr, each->ai_addrlen) == 0 && getsockname(udp, address, &size) == 0;
    if (udp >= 0) close(udp);
    const std::string numeric = is_known ? NumericHost(address) : "";
    if (numeric.empty()) continue;
    own = numeric;
    break;
  }
  freeaddrinfo(found);
  return own;
}

// Throws if `status` is an error, as Gloo expects of a store.
void OrThrow(const absl::Status& status) {
  if (!status.ok()) throw std::runtime_error(std::string(status.message()));
}

// The ranks' store for Gloo, which writes each key once.
class GlooStore : public c10d::Store {
 public:
  explicit GlooStore(std::shared_ptr<RankStore> store)
      : c10d::Store(Milliseconds(kConnect)), store_(std::move(store)) {}

  void set(const std::string& key, const std::vector<uint8_t>& value) override {
    OrThrow(store_->Put(key, std::string(value.begin(), value.end())));
  }
  std::vector<uint8_t> get(const std::string& key) override {
    const absl::StatusOr<std::string> value = store_->Await(key, absl::FromChrono(timeout_));
    OrThrow(value.status());
    return {value->begin(), value->end()};
  }
  bool check(const std::vector<std::string>& keys) override {
    return std::all_of(keys.begin(), keys.end(), [this](const std::string& key) { return store_->Get(key).ok(); });
  }
  void wait(const std::vector<std::string>& keys) override { wait(keys, timeout_); }
  void wait(const std::vector<std::string>& keys, const std::chrono::milliseconds& timeout) override {
    for (const std::string& key : keys) OrThrow(store_->Await(key, absl::FromChrono(timeout)).status());
  }

  // Gloo needs none of these.
  int64_t add(const std::string& /*key*/, int64_t /*value*/) override { return Unused(); }
  bool deleteKey(const std::string& /*key*/) override { return Unused() != 0; }
  int64_t getNumKeys() override { return Unused(); }
  c10::intrusive_ptr<c10d::Store> clone() { return c10::make_intrusive<GlooStore>(store_); }  // from LibTorch 2.8 on

 private:
  static int64_t Unused() {
    OrThrow(absl::UnimplementedError("not a function of the ranks' store"));
    return 0;
  }

  const std::shared_ptr<RankStore> store_;
};

c10::intrusive_ptr<c10d::ProcessGroupGloo> MakeGroup(const char* name, const RankOptions& options,
                                                     const std::shared_ptr<RankStore>& store) {
  auto gloo = c10d::ProcessGroupGloo::Options::create(Milliseconds(kConnect));
  gloo->devices.push_back(c10d::ProcessGroupGloo::createDeviceForHostname(OwnAddress(options)));
  const auto prefixed = c10::make_intrusive<c10d::PrefixStore>(name, c10::make_intrusive<GlooStore>(store));
  return c10::make_intrusive<c10d::ProcessGroupGloo>(prefixed, options.rank, options.world_size, gloo);
}

}  // namespace

struct RankLinks::Operation {
  int neighbour;
  c10::intrusive_ptr<c10d::Work> work = {};  // null: it could not begin
  std::string error = {};                    // why not
};

struct RankLinks::Groups {
  enum class Way { kSend, kReceive };

  static Transfer Begin(c10d::ProcessGroupGloo* group, Way way, int rank, void* data, size_t size) {
    const auto operation = std::make_shared<Operation>(Operation{rank});
    const absl::Status begun = Try([&] {
      std::vector<at::Tensor> bytes = {at::from_blob(data, {static_cast<int64_t>(size)}, at::kByte)};
      operation->work = way == Way::kSend ? group->send(bytes, rank, kTag) : group->recv(bytes, rank, kTag);
    });
    operation->error = std::string(begun.message());
    return operation;
  }

  // Data has a connection for each direction: on a single one, Gloo's thread spins on what arrives while the caller
  // sends.
  c10::intrusive_ptr<c10d::ProcessGroupGloo> to_higher;
  c10::intrusive_ptr<c10d::ProcessGroupGloo> to_lower;
  c10::intrusive_ptr<c10d::ProcessGroupGloo> beats;  // apart, so that beats don't wait behind data
};

absl::Status RankLinks::Available() { return absl::OkStatus(); }

absl::StatusOr<std::unique_ptr<RankLinks>> RankLinks::Connect(const RankOptions& options,
                                                              const std::shared_ptr<RankStore>& store) {
  auto groups = std::make_unique<Groups>();
  const absl::Status connected = Try([&] {
    groups->to_higher = MakeGroup("to_higher", options, store);
    groups->to_lower = MakeGroup("to_lower", options, store);
    groups->beats = MakeGroup("beats", options, store);
  });
  if (!connected.ok()) {
    return absl::UnavailableError(absl::StrCat("the ranks have come, but can't connect: ", connected.message()));
  }
  return std::unique_ptr<RankLinks>(new RankLinks(options.rank, options.world_size, std::move(groups)));
}

RankLinks::RankLinks(int rank, int size, std::unique_ptr<Groups> groups)
    : rank_(rank), size_(size), groups_(std::move(groups)), beats_([this] { Beat(); }) {}

RankLinks::~RankLinks() {
  Leave(absl::CancelledError("the group has ended"));
  beats_.join();
}

RankLinks::Transfer RankLinks::StartSend(int rank, absl::Span<const char> bytes) {
  c10d::ProcessGroupGloo* const group = rank > rank_ ? groups_->to_higher.get() : groups_->to_lower.get();
  return Groups::Begin(group, Groups::Way::kSend, rank, const_cast<char*>(bytes.data()), bytes.size());
}

RankLinks::Transfer RankLinks::StartReceive(int rank, absl::Span<char> bytes) {
  c10d::ProcessGroupGloo* const group = rank > rank_ ? groups_->to_lower.get() : groups_->to_higher.get();
  return Groups::Begin(group, Groups::Way::kReceive, rank, bytes.data(), bytes.size());
}

absl::Status RankLinks::Wait(const Transfer& transfer) { return Finish(transfer, kForever); }

absl::Status RankLinks::Finish(const Transfer& transfer, absl::Duration limit) {
  const int neighbour = transfer->neighbour;
  if (transfer->work == nullptr) return Lose(neighbour, transfer->error);
  {
    const MutexLock lock(&mutex_);
    if (!ended_.ok()) return ended_;
    running_.push_back(transfer.get());
  }
  const absl::Time begin = SteadyNow();
  bool is_done = false;
  const absl::Status waited = Try([&] { is_done = transfer->work->wait(Milliseconds(limit)); });
  {
    const MutexLock lock(&mutex_);
    running_.erase(std::find(running_.begin(), running_.end(), transfer.get()));
    changed_.NotifyAll();
    if (waited.ok() && is_done) return absl::OkStatus();
  }
  if (SteadyNow() - begin >= limit) return Lose(neighbour, absl::StrCat("silent for ", absl::FormatDuration(limit)));
  return Lose(neighbour, std::string(waited.message()));
}

absl::Status RankLinks::Lose(int neighbour, const std::string& why) {
  Leave(absl::UnavailableError(absl::StrFormat("rank %d is lost: %s", neighbour, why)));
  return ended();
}

void RankLinks::Leave(const absl::Status& reason) {
  const MutexLock lock(&mutex_);
  if (!ended_.ok()) return;
  ended_ = reason;
  changed_.NotifyAll();
  // Again and again, since Gloo forgets an abort that comes before the wait.
  do {
    for (Operation* const operation : running_) (void)Try([&] { operation->work->abort(); });
  } while (!changed_.WaitFor(&mutex_, absl::Milliseconds(10),
                             [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return running_.empty(); }));
}

absl::Status RankLinks::ended() const {
  const MutexLock lock(&mutex_);
  return ended_;
}

void RankLinks::Beat() {
  std::vector<int> neighbours;
  if (rank_ > 0) neighbours.push_back(rank_ - 1);
  if (rank_ + 1 < size_) neighbours.push_back(rank_ + 1);
  while (BeatOnce(neighbours)) {
    const MutexLock lock(&mutex_);
    changed_.WaitFor(&mutex_, kBeat, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return !ended_.ok(); });
  }
}

bool RankLinks::BeatOnce(const std::vector<int>& neighbours) {
  char beat = 0;
  std::vector<char> heard(neighbours.size());
  std::vector<Transfer> transfers;
  for (size_t i = 0; i < neighbours.size(); ++i) {
    transfers.push_back(Groups::Begin(groups_->beats.get(), Groups::Way::kSend, neighbours[i], &beat, 1));
    transfers.push_back(Groups::Begin(groups_->beats.get(), Groups::Way::kReceive, neighbours[i], &heard[i], 1));
  }
  return std::all_of(transfers.begin(), transfers.end(),
                     [this](const Transfer& each) { return Finish(each, kSilence).ok(); });
}

}  // namespace craftfleet

#include "learner/ranks/rank_links.h"

#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <functional>
#include <utility>

#include <ATen/ATen.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>
#include <torch/csrc/distributed/c10d/PrefixStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>

#include "common/base/clock.h"
#include "common/base/numeric_host.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kBeat = absl::Seconds(1);
constexpr absl::Duration kSilence = absl::Seconds(7);
// For the connections between ranks that are all there.
constexpr absl::Duration kConnect = absl::Seconds(30);
// How long rank 0 waits for the others to hear why they can't be a group.
constexpr absl::Duration kFarewell = absl::Seconds(3);
// Between two looks of rank 0 at what the others have stored.
constexpr absl::Duration kLookAgain = absl::Milliseconds(50);
constexpr absl::Duration kForever = absl::Hours(24 * 365);
constexpr int kTag = 0;

// Keys of the store.
constexpr char kOffer[] = "offer";
constexpr char kWorldSize[] = "world_size";
constexpr char kVerdict[] = "verdict";
std::string KeyOf(absl::string_view what, int rank) { return absl::StrCat(what, "/", rank); }

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

// Whether the store has `key`. Asked again and again where a wait may end early: LibTorch 1.13 takes what the store
// answers just after the end of a wait for the answer to the next question, and then waits for ever.
bool Has(const std::string& key, c10d::TCPStore* store) {
  bool has = false;
  return Try([&] { has = store->check({key}); }).ok() && has;
}

std::vector<uint8_t> Bytes(absl::string_view text) { return {text.begin(), text.end()}; }

// The address of this host that others reach it by: the one from which it reaches rank 0. The name of a host often
// means its loopback address.
std::string OwnAddress(const RankOptions& options) {
  std::string own = "127.0.0.1";
  addrinfo hints = {};
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(options.master_addr.c_str(), absl::StrCat(options.master_port).c_str(), &hints, &found) != 0) {
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

// Debian's LibTorch 2.6 asks for libuv by default, but is built without it. Older ones don't have the field.
template <typename Options>
auto LeaveOutLibuv(Options* tcp, int /*preferred*/) -> decltype(tcp->useLibUV = false, void()) {
  tcp->useLibUV = false;
}
template <typename Options>
void LeaveOutLibuv(Options* /*tcp*/, char /*otherwise*/) {}

// Verdicts as text: a code, then the message.
std::string ToText(const absl::Status& status) {
  return status.ok() ? "" : absl::StrCat(status.raw_code(), " ", status.message());
}

absl::Status FromText(const std::string& text) {
  const std::pair<std::string, std::string> parts = absl::StrSplit(text, absl::MaxSplits(' ', 1));
  int code = 0;
  if (!absl::SimpleAtoi(parts.first, &code)) return absl::OkStatus();
  return absl::Status(static_cast<absl::StatusCode>(code), parts.second);
}

c10::intrusive_ptr<c10d::ProcessGroupGloo> MakeGroup(const char* name, const RankOptions& options,
                                                     const c10::intrusive_ptr<c10d::Store>& store) {
  auto gloo = c10d::ProcessGroupGloo::Options::create(Milliseconds(kConnect));
  gloo->devices.push_back(c10d::ProcessGroupGloo::createDeviceForHostname(OwnAddress(options)));
  return c10::make_intrusive<c10d::ProcessGroupGloo>(c10::make_intrusive<c10d::PrefixStore>(name, store), options.rank,
                                                     options.world_size, gloo);
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

struct RankMeeting::Store {
  c10::intrusive_ptr<c10d::TCPStore> tcp;
};

RankMeeting::RankMeeting(const RankOptions& options, std::unique_ptr<Store> store)
    : options_(options), deadline_(SteadyNow() + options.timeout), store_(std::move(store)) {}

RankMeeting::~RankMeeting() = default;

std::string RankMeeting::address() const { return absl::StrCat(options_.master_addr, ":", options_.master_port); }

absl::StatusOr<std::unique_ptr<RankMeeting>> RankMeeting::Open(const RankOptions& options, const std::string& offer) {
  std::unique_ptr<RankMeeting> meeting(new RankMeeting(options, std::make_unique<Store>()));
  const bool is_first = options.rank == 0;
  int world_size = options.world_size;
  const absl::Status opened = Try([&] {
    c10d::TCPStoreOptions tcp;
    tcp.port = static_cast<uint16_t>(options.master_port);
    tcp.isServer = is_first;
    tcp.waitWorkers = false;
    LeaveOutLibuv(&tcp, 0);
    tcp.timeout = Milliseconds(options.timeout);
    auto& store = meeting->store_->tcp;
    store = c10::make_intrusive<c10d::TCPStore>(is_first ? "127.0.0.1" : options.master_addr, tcp);
    if (is_first) {
      store->set(kWorldSize, Bytes(absl::StrCat(options.world_size)));
      store->set(kOffer, Bytes(offer));
      meeting->offer_ = offer;
      return;
    }
    const std::vector<uint8_t> size = store->get(kWorldSize);
    (void)absl::SimpleAtoi(std::string(size.begin(), size.end()), &world_size);
    const std::vector<uint8_t> offered = store->get(kOffer);
    meeting->offer_.assign(offered.begin(), offered.end());
  });
  if (!opened.ok() && is_first) {
    return absl::UnavailableError(absl::StrFormat("--master_port=%d: can't listen for the other ranks: %s",
                                                  options.master_port, opened.message()));
  }
  if (!opened.ok()) {
    return absl::UnavailableError(absl::StrFormat("rank 0 has not come to %s within %s (--rank_timeout): %s",
                                                  meeting->address(), absl::FormatDuration(options.timeout),
                                                  opened.message()));
  }
  if (world_size != options.world_size) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--world_size=%d, but rank 0 at %s has %d: start all ranks with "
                        "the same",
                        options.world_size, meeting->address(), world_size));
  }
  return meeting;
}

absl::Status RankMeeting::CheckOthers(const RankBuild& build) {
  c10d::TCPStore& store = *store_->tcp;
  std::vector<int> missing;
  for (int rank = 1; rank < options_.world_size; ++rank) {
    while (!Has(KeyOf("build", rank), &store) && SteadyNow() < deadline_) {
      if (options_.should_stop()) return absl::CancelledError("rank 0 was stopped before all ranks had come");
      absl::SleepFor(kLookAgain);
    }
    if (!Has(KeyOf("build", rank), &store)) missing.push_back(rank);
  }
  if (!missing.empty()) {
    return absl::UnavailableError(absl::StrFormat("%s %s of %d %s not come to %s within %s (--rank_timeout)",
                                                  missing.size() == 1 ? "rank" : "ranks", absl::StrJoin(missing, ", "),
                                                  options_.world_size, missing.size() == 1 ? "has" : "have", address(),
                                                  absl::FormatDuration(options_.timeout)));
  }
  absl::Status found;
  for (int rank = 1; rank < options_.world_size && found.ok(); ++rank) {
    std::vector<uint8_t> bytes;
    CRAFTFLEET_RETURN_IF_ERROR(Try([&] { bytes = store.get(KeyOf("build", rank)); }));
    const std::vector<std::string> other =
        absl::StrSplit(std::string(bytes.begin(), bytes.end()), absl::MaxSplits('\n', 2));
    if (other.size() != 3) {
      found = absl::DataLossError(absl::StrFormat("rank %d: its report has %d lines, want 3", rank, other.size()));
    } else if (!other[2].empty()) {
      found = absl::FailedPreconditionError(absl::StrFormat("rank %d: %s", rank, other[2]));
    } else if (other[0] != build.canary) {
      found = absl::FailedPreconditionError(absl::StrFormat(
          "rank %d computes other numbers than rank 0 (canary %s of build %s, want %s of build %s): use "
          "the same build for all ranks and, if their CPUs are of different kinds, --cpu=avx2",
          rank, other[0], other[1], build.canary, build.build));
    }
  }
  return found;
}

absl::Status RankMeeting::Report(const RankBuild& build) {
  c10d::TCPStore& store = *store_->tcp;
  int64_t processes = 0;
  std::vector<uint8_t> verdict;
  const absl::Status reported = Try([&] {
    processes = store.add(KeyOf("process", options_.rank), 1);
    if (processes > 1) return;
    store.set(KeyOf("build", options_.rank),
              Bytes(absl::StrCat(build.canary, "\n", build.build, "\n", build.objection.message())));
    store.wait({kVerdict}, Milliseconds(options_.timeout + kFarewell));
    verdict = store.get(kVerdict);
    store.set(KeyOf("heard", options_.rank), Bytes("1"));
  });
  if (!reported.ok()) {
    return absl::UnavailableError(
        absl::StrFormat("rank 0 at %s has left before all ranks had come: %s", address(), reported.message()));
  }
  if (processes > 1) {
    return absl::AlreadyExistsError(
        absl::StrFormat("rank %d is already in the group at %s: another process has it, or the group has yet to end",
                        options_.rank, address()));
  }
  return FromText(std::string(verdict.begin(), verdict.end()));
}

absl::StatusOr<std::unique_ptr<RankLinks>> RankMeeting::Connect(const RankBuild& build) {
  c10d::TCPStore& store = *store_->tcp;
  if (options_.rank > 0) {
    CRAFTFLEET_RETURN_IF_ERROR(Report(build));
  } else {
    const absl::Status found = CheckOthers(build);
    CRAFTFLEET_RETURN_IF_ERROR(Try([&] { store.set(kVerdict, Bytes(ToText(found))); }));
    if (!found.ok()) {
      // The store ends with this process.
      const absl::Time deadline = SteadyNow() + kFarewell;
      for (int rank = 1; rank < options_.world_size; ++rank) {
        if (!Has(KeyOf("build", rank), &store)) continue;
        while (!Has(KeyOf("heard", rank), &store) && SteadyNow() < deadline) absl::SleepFor(kLookAgain);
      }
      return found;
    }
  }
  auto groups = std::make_unique<RankLinks::Groups>();
  const absl::Status connected = Try([&] {
    groups->to_higher = MakeGroup("to_higher", options_, store_->tcp);
    groups->to_lower = MakeGroup("to_lower", options_, store_->tcp);
    groups->beats = MakeGroup("beats", options_, store_->tcp);
  });
  if (!connected.ok()) {
    return absl::UnavailableError(absl::StrCat("the ranks have come, but can't connect: ", connected.message()));
  }
  return std::unique_ptr<RankLinks>(new RankLinks(options_.rank, options_.world_size, std::move(groups)));
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

#include "learner/ranks/rank_meeting.h"

#include <utility>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>
#include <absl/time/clock.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// How long rank 0 waits for the others to hear why they can't be a group.
constexpr absl::Duration kFarewell = absl::Seconds(3);
// Between two looks of rank 0 at what the others have stored.
constexpr absl::Duration kLookAgain = absl::Milliseconds(50);

// Keys of the store. Rank 0 writes the verdict once all builds are there; then each rank writes that it heard it.
constexpr char kWorldSize[] = "world_size";
constexpr char kOffer[] = "offer";
constexpr char kVerdict[] = "verdict";
std::string BuildOf(int rank) { return absl::StrCat("build/", rank); }
std::string HeardOf(int rank) { return absl::StrCat("heard/", rank); }

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

absl::Status NotCome(const std::vector<int>& missing, const RankOptions& options) {
  const bool is_one = missing.size() == 1;
  return absl::UnavailableError(absl::StrFormat("%s %s of %d %s not come to %s within %s (--rank_timeout)",
                                                is_one ? "rank" : "ranks", absl::StrJoin(missing, ", "),
                                                options.world_size, is_one ? "has" : "have", options.address(),
                                                absl::FormatDuration(options.timeout)));
}

// What is wrong with a rank whose build reads `report`. OK: nothing.
absl::Status CheckReport(int rank, const std::string& report, const RankBuild& build) {
  const std::vector<std::string> other = absl::StrSplit(report, absl::MaxSplits('\n', 2));
  if (other.size() != 3) {
    return absl::DataLossError(absl::StrFormat("rank %d: its report has %d lines, want 3", rank, other.size()));
  }
  if (!other[2].empty()) return absl::FailedPreconditionError(absl::StrFormat("rank %d: %s", rank, other[2]));
  if (other[0] == build.canary) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrFormat("rank %d computes other numbers than rank 0 (canary %s of build %s, want %s of build %s): use "
                      "the same build for all ranks and, if their CPUs are of different kinds, --cpu=avx2",
                      rank, other[0], other[1], build.canary, build.build));
}

absl::StatusOr<std::shared_ptr<RankStore>> Offer(const RankOptions& options, const std::string& offer) {
  absl::StatusOr<std::shared_ptr<RankStore>> store = RankStore::Serve(options.address());
  if (!store.ok()) {
    return absl::Status(store.status().code(),
                        absl::StrFormat("--master_addr=%s --master_port=%d: can't listen for the other ranks: %s",
                                        options.master_addr, options.master_port, store.status().message()));
  }
  CRAFTFLEET_RETURN_IF_ERROR((*store)->Put(kWorldSize, absl::StrCat(options.world_size)));
  CRAFTFLEET_RETURN_IF_ERROR((*store)->Put(kOffer, offer));
  return store;
}

}  // namespace

RankMeeting::RankMeeting(const RankOptions& options, std::shared_ptr<RankStore> store, std::string offer)
    : options_(options), deadline_(SteadyNow() + options.timeout), store_(std::move(store)), offer_(std::move(offer)) {}

absl::StatusOr<std::unique_ptr<RankMeeting>> RankMeeting::Open(const RankOptions& options, const std::string& offer) {
  CRAFTFLEET_RETURN_IF_ERROR(RankLinks::Available());
  if (options.rank == 0) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<RankStore> store, Offer(options, offer));
    return std::unique_ptr<RankMeeting>(new RankMeeting(options, std::move(store), offer));
  }
  const absl::StatusOr<std::shared_ptr<RankStore>> store = RankStore::Join(options.address(), options.timeout);
  if (!store.ok()) {
    return absl::Status(store.status().code(),
                        absl::StrFormat("rank 0 has not come to %s within %s (--rank_timeout): %s", options.address(),
                                        absl::FormatDuration(options.timeout), store.status().message()));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string world_size, (*store)->Await(kWorldSize, options.timeout));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string offered, (*store)->Await(kOffer, options.timeout));
  if (world_size != absl::StrCat(options.world_size)) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--world_size=%d, but rank 0 at %s has %s: start all ranks with the same", options.world_size,
                        options.address(), world_size));
  }
  return std::unique_ptr<RankMeeting>(new RankMeeting(options, *store, std::move(offered)));
}

absl::Status RankMeeting::CheckOthers(const RankBuild& build) {
  std::vector<int> missing;
  absl::Status found;
  for (int rank = 1; rank < options_.world_size; ++rank) {
    absl::StatusOr<std::string> report = store_->Get(BuildOf(rank));
    while (absl::IsNotFound(report.status()) && SteadyNow() < deadline_) {
      if (options_.should_stop()) return absl::CancelledError("rank 0 was stopped before all ranks had come");
      absl::SleepFor(kLookAgain);
      report = store_->Get(BuildOf(rank));
    }
    if (!report.ok()) {
      missing.push_back(rank);
    } else if (found.ok()) {
      found = CheckReport(rank, *report, build);
    }
  }
  return missing.empty() ? found : NotCome(missing, options_);
}

void RankMeeting::WaitUntilHeard() {
  const absl::Time deadline = SteadyNow() + kFarewell;
  for (int rank = 1; rank < options_.world_size; ++rank) {
    if (store_->Get(BuildOf(rank)).ok()) (void)store_->Await(HeardOf(rank), deadline - SteadyNow());
  }
}

absl::Status RankMeeting::Report(const RankBuild& build) {
  const absl::Status stored = store_->Put(
      BuildOf(options_.rank), absl::StrCat(build.canary, "\n", build.build, "\n", build.objection.message()));
  if (absl::IsAlreadyExists(stored)) {
    return absl::AlreadyExistsError(
        absl::StrFormat("rank %d is already in the group at %s: another process has it, or the group has yet to end",
                        options_.rank, options_.address()));
  }
  const absl::StatusOr<std::string> verdict =
      stored.ok() ? store_->Await(kVerdict, options_.timeout + kFarewell) : absl::StatusOr<std::string>(stored);
  if (!verdict.ok()) {
    return absl::UnavailableError(absl::StrFormat("rank 0 at %s has left before all ranks had come: %s",
                                                  options_.address(), verdict.status().message()));
  }
  (void)store_->Put(HeardOf(options_.rank), "");  // rank 0 waits for that only if it is about to leave
  return FromText(*verdict);
}

absl::StatusOr<std::unique_ptr<RankLinks>> RankMeeting::Connect(const RankBuild& build) {
  if (options_.rank > 0) {
    CRAFTFLEET_RETURN_IF_ERROR(Report(build));
  } else {
    const absl::Status found = CheckOthers(build);
    CRAFTFLEET_RETURN_IF_ERROR(store_->Put(kVerdict, ToText(found)));
    if (!found.ok()) {
      WaitUntilHeard();
      return found;
    }
  }
  return RankLinks::Connect(options_, store_);
}

}  // namespace craftfleet

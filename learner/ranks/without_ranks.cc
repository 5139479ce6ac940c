// RankLinks of builds without the headers of Gloo.

#include "learner/ranks/rank_links.h"

namespace craftfleet {
namespace {

absl::Status NoRanks() {
  return absl::UnimplementedError(
      "this build has one learner only: it was built without the headers of Gloo (Debian's package libgloo-dev)");
}

}  // namespace

struct RankLinks::Groups {};
struct RankLinks::Operation {};

absl::Status RankLinks::Available() { return NoRanks(); }
absl::StatusOr<std::unique_ptr<RankLinks>> RankLinks::Connect(const RankOptions&, const std::shared_ptr<RankStore>&) {
  return NoRanks();
}
RankLinks::~RankLinks() = default;
RankLinks::Transfer RankLinks::StartSend(int, absl::Span<const char>) { return nullptr; }
RankLinks::Transfer RankLinks::StartReceive(int, absl::Span<char>) { return nullptr; }
absl::Status RankLinks::Wait(const Transfer&) { return NoRanks(); }
void RankLinks::Leave(const absl::Status&) {}
absl::Status RankLinks::ended() const { return NoRanks(); }

}  // namespace craftfleet

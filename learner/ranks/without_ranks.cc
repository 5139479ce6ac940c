// RankMeeting and RankLinks of builds without the headers of Gloo.

#include "learner/ranks/rank_links.h"

namespace craftfleet {

struct RankLinks::Groups {};
struct RankLinks::Operation {};
struct RankMeeting::Store {};

absl::StatusOr<std::unique_ptr<RankMeeting>> RankMeeting::Open(const RankOptions&, const std::string&) {
  return absl::UnimplementedError(
      "this build has one learner only: it was built without the headers of Gloo (Debian's package libgloo-dev)");
}

RankMeeting::~RankMeeting() = default;

absl::StatusOr<std::unique_ptr<RankLinks>> RankMeeting::Connect(const RankBuild&) {
  return absl::UnimplementedError("no ranks");
}

RankLinks::~RankLinks() = default;
RankLinks::Transfer RankLinks::StartSend(int, absl::Span<const char>) { return nullptr; }
RankLinks::Transfer RankLinks::StartReceive(int, absl::Span<char>) { return nullptr; }
absl::Status RankLinks::Wait(const Transfer&) { return absl::UnimplementedError("no ranks"); }
void RankLinks::Leave(const absl::Status&) {}
absl::Status RankLinks::ended() const { return absl::UnimplementedError("no ranks"); }

}  // namespace craftfleet

#include "envserver/announcer.h"

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/mutex.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

// A learner that takes every announcement.
class AnyServerService : public v1::LearnerService::Service {
 public:
  grpc::Status Announce(grpc::ServerContext* /*context*/, const v1::Announcement* announcement,
                        v1::AnnounceReply* reply) override {
    reply->set_run_id("run-a");
    const MutexLock lock(&mu_);
    names_.push_back(announcement->name());
    return grpc::Status::OK;
  }
  std::vector<std::string> names() const {
    const MutexLock lock(&mu_);
    return names_;
  }

 private:
  mutable Mutex mu_;
  std::vector<std::string> names_ ABSL_GUARDED_BY(mu_);
};

absl::Duration IntervalOf(int lease_ms) {
  v1::AnnounceReply reply;
  reply.set_lease_ms(lease_ms);
  return AnnouncementInterval(reply);
}

TEST(Announcer, AnnouncesEightTimesWithinTheLearnersLease) {
  EXPECT_EQ(IntervalOf(8000), absl::Seconds(1));
  EXPECT_EQ(IntervalOf(2000), absl::Milliseconds(250));
}

TEST(Announcer, NeitherFloodsTheLearnerNorFallsSilentWhateverTheLease) {
  EXPECT_EQ(IntervalOf(800), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(799), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(0), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(std::numeric_limits<int>::min()), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(80'000), absl::Seconds(10));
  EXPECT_EQ(IntervalOf(80'001), absl::Seconds(10));
  EXPECT_EQ(IntervalOf(std::numeric_limits<int>::max()), absl::Seconds(10));
}

// The two differed, and nobody could drain a server by the name that its status shows.
TEST(Announcer, RegistersUnderTheNameOfTheServersStatus) {
  AnyServerService service;
  const std::unique_ptr<wire::Server> learner = *wire::Server::Create({}, {&service});
  const wire::StatusServiceImpl status("envserver", [](v1::StatusReply* /*reply*/) {});
  Announcer announcer(learner->InProcess(), status.name(), "10.0.0.1:50061", "", "",
                      [] { return v1::ProcessSummary(); });
  EXPECT_TRUE(WaitUntil([&] { return !service.names().empty(); }));
  announcer.Leave();
  EXPECT_THAT(service.names(), testing::Each(status.Snapshot().name()));
}

}  // namespace
}  // namespace craftfleet

// An access file: if it is accepted, a client without credentials may only check health.

#include "common/base/check.h"
#include "common/wire/access.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

void TryInput(absl::string_view input) {
  const auto access = wire::ParseAccess(input, "input");
  if (!access.ok()) return;
  wire::Caller anonymous;
  wire::Caller authenticated;
  authenticated.certificate_names = {"actor", "host.example.com"};
  authenticated.token = "a token";
  for (const char* path : {"/craftfleet.v1.StatusService/GetStatus", "/craftfleet.v1.LearnerService/Join",
                           "/craftfleet.v1.AdminService/Stop", "/something.else/Call"}) {
    CRAFTFLEET_CHECK(!wire::CheckAccess(*access, anonymous, path).ok());
    wire::CheckAccess(*access, authenticated, path).IgnoreError();
  }
  CRAFTFLEET_CHECK(wire::CheckAccess(*access, anonymous, "/grpc.health.v1.Health/Check").ok());
}

std::vector<std::string> SoundInputs() {
  return {R"(client { name: "workers" certificate: "actor" right: PLAY }
client { name: "ops" certificate: "*.example.com" right: WATCH right: STEER })",
          R"(client { name: "monitor" right: WATCH
  token_sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855" })"};
}

}  // namespace craftfleet

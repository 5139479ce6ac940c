// The head of an HTTP request for metrics: whatever it is, there is one whole answer.

#include <absl/strings/match.h>

#include "common/check.h"
#include "common/wire/http_server.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

void TryInput(absl::string_view input) {
  const std::string answer = wire::AnswerHttp(input, [](absl::string_view path) -> wire::HttpServer::Response {
    CRAFTFLEET_CHECK(!absl::StrContains(path, ' ') && !absl::StrContains(path, '?'));
    if (path == "/metrics") return {200, "text/plain", "craftfleet_iteration 3\n"};
    return {404, "text/plain", "want /metrics\n"};
  });
  CRAFTFLEET_CHECK(absl::StartsWith(answer, "HTTP/1.1 ") && absl::StrContains(answer, "\r\n\r\n"));
  const bool found = absl::StartsWith(answer, "HTTP/1.1 200 ");
  CRAFTFLEET_CHECK(!found || absl::StrContains(input, "/metrics"));
}

std::vector<std::string> SoundInputs() {
  return {"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:9090\r\nUser-Agent: Prometheus/2.42\r\n\r\n",
          "HEAD /metrics?x=1 HTTP/1.0\r\n\r\n", "POST / HTTP/1.1\r\n\r\n"};
}

}  // namespace craftfleet

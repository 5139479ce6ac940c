// An environment server within the test's process.

#pragma once

#include <memory>
#include <string>

#include "common/io/paths.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "craftfleet/v1/environment.pb.h"
#include "envserver/env_service.h"

namespace craftfleet {

// The real service with the project's textures, on a free port on loopback.
struct EnvServer {
  wire::Endpoint Connect() const { return wire::Connect(server->address()); }

  std::unique_ptr<EnvServiceImpl> service = *EnvServiceImpl::Create(*DefaultTextureDir());
  std::unique_ptr<wire::Server> server = *wire::Server::Create({"127.0.0.1:0"}, {service.get()});
};

// The first request of a session: Crafter for ppo_cnn, in episodes of `length` steps.
inline v1::SessionHello SampleHello(int length) {
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.set_run_id("run-a");
  hello.mutable_env()->set_name("crafter");
  hello.mutable_env()->set_frame_size(64);
  hello.mutable_env()->set_length(length);
  return hello;
}

}  // namespace craftfleet

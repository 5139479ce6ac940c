// An actor that misbehaves.

#pragma once

#include <cstdint>
#include <memory>
#include <random>
#include <string>

#include <absl/status/status.h>

#include "actor/learner_client.h"
#include "common/agent/agent_spec.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// One actor. Each function runs until the learner has finished, or forever; the process is killed in the end. Not
// thread-safe.
class BadActor {
 public:
  BadActor(const wire::Endpoint& learner, uint64_t seed);

  // Takes as many permits as it gets, renews them, and plays none.
  void StaySilent();

  // Answers each permit with an invalid fragment, and sends other false messages: permits that it does not have,
  // evaluations that were not assigned to it, goodbyes in the name of another worker. It sends nothing that the learner
  // could not recognise as false, because that would change the bytes of the run.
  void Lie();

  // Downloads weights that it never reads, sends large messages, joins under ever new names. Eight threads, each with
  // its own connection.
  void Flood();

 private:
  absl::Status Join();
  absl::StatusOr<v1::PermitReply> AskForPermits(int capacity);
  void SendLie(const v1::Permit& permit);
  void SayNonsense();
  void FloodOnce();
  // A fragment with black frames that is valid apart from its content.
  v1::FragmentMessage Fragment(const v1::Permit& permit) const;
  void Spoil(v1::FragmentMessage* message);
  int Draw(int n) { return std::uniform_int_distribution<int>(0, n - 1)(random_); }

  const wire::Endpoint endpoint_;
  const LearnerClient learner_;
  const std::unique_ptr<v1::LearnerService::Stub> stub_;
  std::mt19937_64 random_;
  std::string name_;
  v1::JoinReply joined_;
  AgentSpec spec_;
};

}  // namespace craftfleet

// An actor that misbehaves.

#ifndef CRAFTFLEET_TESTS_HOSTILE_BAD_ACTOR_H_
#define CRAFTFLEET_TESTS_HOSTILE_BAD_ACTOR_H_

#include <cstdint>
#include <random>
#include <string>

#include <absl/status/status.h>

#include "actor/learner_client.h"
#include "common/agent/agent_spec.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet {

// One actor. Each function goes on until the learner has finished, or for good; the process is killed in the end. Not
// thread-safe.
class BadActor {
 public:
  BadActor(const wire::Endpoint& learner, uint64_t seed);

  // Takes as many permits as it gets, says that it has them, and plays none.
  void StaySilent();

  // Answers each permit with a fragment that can't be, and says other things that aren't so: permits it does not have,
  // evaluations nobody gave it, goodbyes in another's name. What a learner could not tell from the truth it does not
  // say, or the run would have other bytes.
  void Lie();

  // Downloads weights that it never reads, sends large messages, joins under ever new names: eight threads, each with a
  // connection of its own.
  void Flood();

 private:
  absl::Status Join();
  absl::StatusOr<v1::PermitReply> AskForPermits();
  void SendLie(const v1::Permit& permit);
  void SayNonsense();
  void FloodOnce();
  // A fragment of black frames, as it should be but for what it holds.
  v1::FragmentMessage Fragment(const v1::Permit& permit) const;
  void Spoil(v1::FragmentMessage* message);
  int Draw(int n) { return std::uniform_int_distribution<int>(0, n - 1)(random_); }

  const wire::Endpoint endpoint_;
  const LearnerClient learner_;
  std::mt19937_64 random_;
  std::string name_;
  v1::JoinReply joined_;
  AgentSpec spec_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_HOSTILE_BAD_ACTOR_H_

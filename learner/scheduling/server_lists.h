// Which actor plays on which environment servers.

#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>

#include <absl/strings/string_view.h>

#include "learner/scheduling/worker.h"

namespace craftfleet {

// Gives each actor a handful of the registered environment servers: sessions on all of hundreds would be slow to start,
// and each server that comes or goes would be news for every actor. Results don't depend on the choice.
//
// Size: at least kFewest, as far as there are so many, at most kMost; in between so many that on average each server is
// in two lists.
//
// Which servers: those with the smallest hash of actor and address, so that a server that comes or goes changes few
// lists. Those on the actor's host come first, and there are no others if the host has at least half of the servers
// that the fleet has for so many actors. After Avoid, servers of the clients with the fewest avoided servers come
// before all others: one client with thousands of bad servers does not keep actors from the good ones. Not thread-safe.
class ServerLists {
 public:
  static constexpr size_t kFewest = 8;
  static constexpr size_t kMost = 64;

  struct List {
    int64_t generation = 0;  // changes with the addresses; unique among all lists
    std::set<std::string> addresses;
  };

  // Generations are greater than `generation`.
  explicit ServerLists(int64_t generation) : generation_(generation) {}

  // Adds a server, or moves it to another client.
  void PutServer(const std::string& address, const WorkerClient& client);
  // Removes a server; ignored if there is no such server.
  void RemoveServer(absl::string_view address);
  // Forgets an actor; ignored if it never asked.
  void RemoveActor(absl::string_view actor);

  // None of its list's servers answers this actor: its next list has others, near or far. Those that it had come back
  // once all have been tried, or after they were removed. Ignored if it never asked.
  void Avoid(absl::string_view actor);

  // The list of `actor`, which is on `host`. The reference is valid until the next call.
  const List& ListOf(const std::string& actor, const std::string& host);

  int64_t last_generation() const { return generation_; }
  size_t servers() const { return servers_.size(); }
  // The number of servers in the actor's list, as it last got it; 0: it never asked.
  size_t SizeOf(absl::string_view actor) const;

 private:
  struct Actor {
    std::string host;
    List list;
    std::set<std::string> avoided;  // servers that did not answer it
    int64_t seen = -1;              // `changes_` when the list was made
  };

  std::set<std::string> Choose(const std::string& name, const Actor& actor) const;

  int64_t generation_;                                        // of the last list that changed
  int64_t changes_ = 0;                                       // of servers and actors
  std::map<std::string, WorkerClient, std::less<>> servers_;  // by address
  std::map<std::string, Actor, std::less<>> actors_;
};

}  // namespace craftfleet

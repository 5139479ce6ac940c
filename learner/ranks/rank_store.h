// What the ranks of a run tell each other before they are connected.

#pragma once

#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/wire/channel.h"

namespace craftfleet {

// Values by key, each written once. Rank 0 keeps them, for as long as its RankStore lives. Thread-safe.
//
// Errors of every call:
//   Unavailable: rank 0 has left.   DeadlineExceeded: it is silent.
class RankStore {
 public:
  // Creates rank 0's store, which listens on `address`, HOST:PORT, and nowhere else.
  //   Unavailable: it can't; the message says why.   InvalidArgument: not an address.
  static absl::StatusOr<std::shared_ptr<RankStore>> Serve(const std::string& address);
  // Connects another rank to rank 0's store, as soon as that listens.
  //   Unavailable: it has not come in time.   InvalidArgument: not an address.
  static absl::StatusOr<std::shared_ptr<RankStore>> Join(const std::string& address, absl::Duration timeout);
  ~RankStore();
  RankStore(const RankStore&) = delete;
  RankStore& operator=(const RankStore&) = delete;

  //   AlreadyExists: the key has a value.   ResourceExhausted: the store is full, or key and value beyond 64 KiB.
  absl::Status Put(const std::string& key, const std::string& value);
  //   NotFound: it has no value yet.
  absl::StatusOr<std::string> Get(const std::string& key);
  // Waits for a value.
  //   NotFound: it has none after `timeout`.
  absl::StatusOr<std::string> Await(const std::string& key, absl::Duration timeout);

 private:
  class Table;  // rank 0's

  RankStore(std::unique_ptr<Table> table, wire::Endpoint rank0);

  const std::unique_ptr<Table> table_;  // null: another rank's
  const wire::Endpoint rank0_;
};

}  // namespace craftfleet

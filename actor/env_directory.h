// Which environment servers there are at the moment.

#ifndef CRAFTFLEET_ACTOR_ENV_DIRECTORY_H_
#define CRAFTFLEET_ACTOR_ENV_DIRECTORY_H_

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/mutex.h"
#include "common/wire/channel.h"

namespace craftfleet {

// Thread-safe.
class EnvDirectory {
 public:
  // These, for good.
  explicit EnvDirectory(std::vector<wire::Endpoint> servers);

  // `list`, the value of flag `flag`, has entries joined by commas:
  //   HOST:PORT, unix:PATH   a server
  //   dns:HOST:PORT          one at each address behind the name, which is looked up again every few seconds
  //   learner                those that registered with the learner
  //   InvalidArgument: an entry is none of these; names it.
  // Certificates must carry the name of a dns: entry, where there is TLS.
  static absl::StatusOr<std::shared_ptr<EnvDirectory>> Parse(absl::string_view flag, absl::string_view list,
                                                             const wire::ChannelSecurity& security = {});
  ~EnvDirectory();

  // Whether the learner's registry is asked for, and what it says.
  bool uses_registry() const { return uses_registry_; }
  // Whether there will never be others.
  bool fixed() const { return !uses_registry_ && names_.empty(); }
  void SetRegistered(std::vector<std::string> addresses) ABSL_LOCKS_EXCLUDED(mu_);

  // The channels are null but for those given to the constructor: EnvClient connects.
  std::vector<wire::Endpoint> Servers() const ABSL_LOCKS_EXCLUDED(mu_);
  // Another number whenever Servers() has changed.
  int64_t generation() const { return generation_; }

 private:
  struct Name {
    std::string host;
    std::string port;
  };

  explicit EnvDirectory(const wire::ChannelSecurity& security) : security_(security) {}
  // Looks names up until the end.
  void KeepLookingUp() ABSL_LOCKS_EXCLUDED(mu_);
  // Makes `addresses` all that `source` has to offer.
  void Replace(const std::string& source, std::vector<std::string> addresses) ABSL_LOCKS_EXCLUDED(mu_);

  const wire::ChannelSecurity security_;
  bool uses_registry_ = false;
  std::vector<Name> names_;

  mutable Mutex mu_;
  CondVar changed_;
  std::map<std::string, std::vector<std::string>> addresses_ ABSL_GUARDED_BY(mu_);  // by source
  std::map<std::string, wire::Endpoint> servers_ ABSL_GUARDED_BY(mu_);              // by address
  std::atomic<int64_t> generation_{1};
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread resolver_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ENV_DIRECTORY_H_

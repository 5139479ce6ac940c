// Which lane is played on which environment server.

#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <absl/types/span.h>

namespace craftfleet {

// Spreads lanes evenly over the available servers. Servers are numbered 0..n-1 in the order of SetServers; new ones are
// not available at first. Makes no calls and never waits. Not thread-safe.
class LanePlacement {
 public:
  // `first`: the preferred one of equally loaded servers, modulo their number, so that several placements don't
  // all begin with the same server.
  explicit LanePlacement(size_t first) : first_(first) {}

  // Replaces the list of servers. Servers that are still listed keep their lanes and availability. Returns the lanes of
  // the others, in ascending order, which are now unplaced. `addresses` must be distinct.
  std::vector<int> SetServers(const std::vector<std::string>& addresses);

  // Sets whether lanes may be placed on `server`. Lanes placed there stay.
  void SetAvailable(size_t server, bool available) { servers_[server].available = available; }

  // Places an unplaced lane on the available server with the fewest lanes, other than `except`. Returns nothing, and
  // leaves the lane unplaced, if there is no such server.
  std::optional<size_t> Place(int lane, std::optional<size_t> except = std::nullopt);
  // Removes a lane; ignored if it is unplaced.
  void Remove(int lane);
  // Makes a server unavailable and removes its lanes. Returns them in ascending order.
  std::vector<int> Lose(size_t server);
  // Removes all lanes and makes all servers unavailable.
  void Clear();

  // The fewest lanes that must be moved so that no available server has two more than another.
  std::vector<int> Excess() const;

  // The server of a lane; nothing: unplaced.
  std::optional<size_t> ServerOf(int lane) const;
  int LanesOn(size_t server) const { return servers_[server].lanes; }
  // Orders `lanes`, all of them placed, by server; the order within a server is kept.
  std::vector<int> Arrange(std::vector<int> lanes) const;
  // The placed ones of `lanes`, by server.
  std::vector<std::vector<int>> ByServer(absl::Span<const int> lanes) const;

 private:
  struct Server {
    std::string address;
    bool available = false;
    int lanes = 0;
  };

  const size_t first_;
  std::vector<Server> servers_;
  std::map<int, size_t> server_of_;  // by lane
};

}  // namespace craftfleet

#include "deploy/top/top_view.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>

#include "common/crafter.h"
#include "common/printable.h"
#include "learner/run/progress.h"

namespace craftfleet {
namespace {

using Style = TopLine::Style;

constexpr int kHeadLines = 9;  // above the workers, with an advice of one line
constexpr int kFootLines = 2;

constexpr char kHelp[] = R"(
 role     learner, actor or server (environment server)
 state    ok; LOST: not heard of for its lease; left: said goodbye
 steps/s  environment steps: of the last iterations (learner), the last 20 s (others)
 lanes    games: of the run, with a permit at the actor, open at the server
 lag      versions of the weights that an actor is behind
 mem      memory in RAM         err  errors in its log      seen  since its last word
 time     where its working threads' time goes, in percent, the largest first:
          env   games are stepped         wire  messages under way
          inf   the policy acts           perm  waiting for leave to play
          intk  waiting for fragments     upd   PPO
          oth   logs, checkpoints, ...    idle  waiting for actors

 q quit   p pause   s S sort by the next, previous column   r reverse
 arrows, j, k, page up, page down: scroll                   h leave this page)";

// A row of the table: the process and what it is sorted by.
struct Row {
  std::string role;
  std::string name;
  std::string state;
  v1::ProcessSummary summary;
  int64_t lag = -1;  // -1: has none
  double seen = -1;  // seconds; -1: it is the learner itself
  bool bad = false;
};

const char* ShortName(absl::string_view activity) {
  static const auto* const names = new std::map<absl::string_view, const char*>{
      {"environment", "env"}, {"wire", "wire"},  {"inference", "inf"}, {"permits", "perm"},
      {"intake", "intk"},     {"update", "upd"}, {"other", "oth"},     {"idle", "idle"}};
  const auto found = names->find(activity);
  return found == names->end() ? "?" : found->second;
}

// The beginning of a text that may come from a stranger.
std::string Cut(absl::string_view text, int width) {
  return Printable(text.substr(0, static_cast<size_t>(std::max(0, width))));
}

std::string Bytes(int64_t bytes) {
  const double mib = static_cast<double>(bytes) / (1 << 20);
  return mib < 1000 ? absl::StrFormat("%.0fM", mib) : absl::StrFormat("%.1fG", mib / 1024);
}

// The largest shares, as many as `width` has room for: "inf 61 env 30".
std::string Shares(const v1::ProcessSummary& summary, int width) {
  std::vector<v1::ActivityTime> times(summary.times().begin(), summary.times().end());
  std::stable_sort(times.begin(), times.end(), [](const auto& a, const auto& b) { return a.share() > b.share(); });
  std::string text;
  for (const v1::ActivityTime& time : times) {
    const int64_t percent = std::lround(100 * time.share());
    const std::string part = absl::StrFormat("%s%s %d", text.empty() ? "" : " ", ShortName(time.activity()), percent);
    if (percent == 0 || static_cast<int>(text.size() + part.size()) > width) break;
    text += part;
  }
  return text;
}

std::map<std::string, double> MetricsOf(const v1::StatusReply& status) {
  std::map<std::string, double> metrics;
  for (const v1::Metric& metric : status.metrics()) metrics[metric.name()] = metric.value();
  return metrics;
}

const char* StateOf(v1::Peer::Health health) {
  if (health == v1::Peer::LOST) return "LOST";
  if (health == v1::Peer::NOT_ANSWERING) return "HANGS";  // no room for more
  return health == v1::Peer::LEFT ? "left" : "ok";
}

std::vector<Row> RowsOf(const v1::StatusReply& status) {
  std::vector<Row> rows;
  for (const v1::Peer& peer : status.peers()) {
    Row row;
    row.role = peer.role() == "envserver" ? "server" : peer.role();
    row.name = peer.name();
    row.bad = peer.health() == v1::Peer::LOST || peer.health() == v1::Peer::NOT_ANSWERING;
    row.state = StateOf(peer.health());
    row.summary = peer.summary();
    if (peer.role() == "actor" && peer.health() == v1::Peer::OK && peer.summary().policy_version() >= 0) {
      row.lag = std::max<int64_t>(0, status.summary().policy_version() - peer.summary().policy_version());
    }
    row.seen = peer.last_seen_s();
    rows.push_back(std::move(row));
  }
  return rows;
}

// Sorts stably; numbers begin with the largest.
void Sort(const TopState& state, std::vector<Row>* rows) {
  const auto by_number = [&](const std::function<double(const Row&)>& number) {
    std::stable_sort(rows->begin(), rows->end(), [&](const Row& a, const Row& b) { return number(a) > number(b); });
  };
  const auto by_text = [&](std::string Row::*text) {
    std::stable_sort(rows->begin(), rows->end(), [&](const Row& a, const Row& b) { return a.*text < b.*text; });
  };
  by_text(&Row::name);
  switch (state.sort) {
    case TopColumn::kRole:
      by_text(&Row::role);
      break;
    case TopColumn::kName:
      break;
    case TopColumn::kState:
      by_text(&Row::state);  // capitals, which are bad, come first
      break;
    case TopColumn::kSteps:
      by_number([](const Row& row) { return row.summary.steps_per_second(); });
      break;
    case TopColumn::kLanes:
      by_number([](const Row& row) { return row.summary.lanes(); });
      break;
    case TopColumn::kLag:
      by_number([](const Row& row) { return static_cast<double>(row.lag); });
      break;
    case TopColumn::kMemory:
      by_number([](const Row& row) { return static_cast<double>(row.summary.memory_bytes()); });
      break;
    case TopColumn::kErrors:
      by_number([](const Row& row) { return static_cast<double>(row.summary.errors()); });
      break;
    case TopColumn::kSeen:
      by_number([](const Row& row) { return row.seen; });
      break;
  }
  if (state.reverse) std::reverse(rows->begin(), rows->end());
}

// What is over 80 columns goes to names first, up to 32 of them, then to times.
int NameWidth(int width) { return std::clamp(width - 65, 10, 32); }

std::string FormatRow(const Row& row, int width) {
  const int name = NameWidth(width);
  const int times = width - name - 50;
  return absl::StrFormat("%-7s %-*s %-5s %7.0f %5d %3s %6s %3d %5s %s", Cut(row.role, 7), name, Cut(row.name, name),
                         row.state, row.summary.steps_per_second(), row.summary.lanes(),
                         row.lag < 0 ? "-" : absl::StrCat(row.lag), Bytes(row.summary.memory_bytes()),
                         std::min<int64_t>(row.summary.errors(), 999), row.seen < 0 ? "-" : FormatTimeLeft(row.seen),
                         Shares(row.summary, times));
}

std::string HeaderRow(int width) {
  return absl::StrFormat("%-7s %-*s %-5s %7s %5s %3s %6s %3s %5s %s", "ROLE", NameWidth(width), "NAME", "STATE",
                         "STEPS/S", "LANES", "LAG", "MEM", "ERR", "SEEN", "TIME %");
}

std::string StepsLine(const v1::StatusReply& status, std::map<std::string, double> metrics) {
  const double steps = metrics["env_steps"];
  const double goal = metrics["env_steps_goal"];
  const double rate = status.summary().steps_per_second();
  std::string line = absl::StrFormat("%s/%s steps %.1f%%  %.0f steps/s", WithCommas(std::llround(steps)),
                                     WithCommas(std::llround(goal)), goal > 0 ? 100 * steps / goal : 0, rate);
  if (rate > 0 && steps < goal) absl::StrAppend(&line, "  ", FormatTimeLeft((goal - steps) / rate), " left");
  return line;
}

std::string ScoreLine(std::map<std::string, double> metrics) {
  return absl::StrFormat("iteration %.0f  reward %.2f  length %.0f  score %.2f  unlocked %.0f/%d", metrics["iteration"],
                         metrics["reward"], metrics["episode_length"], metrics["crafter_score"],
                         metrics["achievements_unlocked"], kNumAchievements);
}

std::string TimesLine(const v1::FleetSummary& fleet) {
  std::vector<std::string> parts;
  for (const v1::ActivityTime& time : fleet.times()) {
    parts.push_back(absl::StrFormat("%s %.0f%%", time.activity(), 100 * time.share()));
  }
  return absl::StrCat("time: ", parts.empty() ? "not known yet" : absl::StrJoin(parts, "  "));
}

std::string CountsLine(const v1::StatusReply& status) {
  std::map<std::pair<std::string, v1::Peer::Health>, int> count;
  int64_t errors = status.summary().errors();
  for (const v1::Peer& peer : status.peers()) {
    ++count[{peer.role(), peer.health()}];
    errors += peer.summary().errors();
  }
  const auto lost = [&](const char* role) {
    std::vector<std::string> bad;
    if (const int number = count[{role, v1::Peer::LOST}]; number > 0) bad.push_back(absl::StrFormat("%d lost", number));
    if (const int number = count[{role, v1::Peer::NOT_ANSWERING}]; number > 0) {
      bad.push_back(absl::StrFormat("%d not answering", number));
    }
    return bad.empty() ? "" : absl::StrCat(" (", absl::StrJoin(bad, ", "), ")");
  };
  return absl::StrFormat("%d actors%s  %d servers%s  %d errors  checkpoint %s ago", count[{"actor", v1::Peer::OK}],
                         lost("actor"), count[{"envserver", v1::Peer::OK}], lost("envserver"), errors,
                         FormatTimeLeft(MetricsOf(status)["checkpoint_age"]));
}

// The text of an error in some log, with whose it is; empty: there is none.
std::string LastError(const v1::StatusReply& status) {
  if (!status.summary().last_error().empty()) return "learner: " + status.summary().last_error();
  for (const v1::Peer& peer : status.peers()) {
    if (!peer.summary().last_error().empty()) return peer.name() + ": " + peer.summary().last_error();
  }
  return "";
}

// `text` in lines of at most `width`.
std::vector<std::string> Wrap(absl::string_view text, int width) {
  std::vector<std::string> lines = {""};
  for (const absl::string_view word : absl::StrSplit(text, ' ')) {
    std::string& line = lines.back();
    if (!line.empty() && static_cast<int>(line.size() + 1 + word.size()) > width) {
      lines.emplace_back(word);
    } else {
      absl::StrAppend(&line, line.empty() ? "" : " ", word);
    }
  }
  return lines;
}

// The page, which may be longer than `page.height`.
std::vector<TopLine> DrawAll(const v1::StatusReply& status, const TopState& state, const TopPage& page) {
  const int width = std::max(40, page.width);
  std::vector<TopLine> lines;
  const auto add = [&](absl::string_view text, Style style = Style::kPlain) {
    lines.push_back({Cut(text, width), style});
  };
  add(absl::StrFormat("craftfleet top%s  learner %s  run %s  up %s", state.paused ? " PAUSED" : "", page.address,
                      status.run_id(), FormatTimeLeft(status.uptime_s())),
      Style::kTitle);
  if (state.help) {
    for (const absl::string_view line : absl::StrSplit(kHelp, '\n')) add(line);
    return lines;
  }
  if (!page.trouble.empty()) add(page.trouble, Style::kBad);
  add(StepsLine(status, MetricsOf(status)));
  add(ScoreLine(MetricsOf(status)));
  add(CountsLine(status));
  add(TimesLine(status.fleet()));
  const bool good = status.fleet().bottleneck() != "actors" && status.fleet().bottleneck() != "environment servers";
  for (const std::string& line : Wrap(status.fleet().advice(), width)) add(line, good ? Style::kGood : Style::kBad);
  if (const std::string error = LastError(status); !error.empty()) add("last error of " + error, Style::kBad);
  add("");
  add(HeaderRow(width), Style::kHeader);
  Row learner;
  learner.role = "learner";
  learner.name = status.name();
  learner.state = page.trouble.empty() ? "ok" : "LOST";
  learner.summary = status.summary();
  add(FormatRow(learner, width), page.trouble.empty() ? Style::kPlain : Style::kBad);

  std::vector<Row> rows = RowsOf(status);
  Sort(state, &rows);
  const size_t room = page.height == 0
                          ? rows.size()
                          : static_cast<size_t>(std::max(1, page.height - kFootLines - static_cast<int>(lines.size())));
  const size_t first = std::min(static_cast<size_t>(state.scroll), rows.size() > room ? rows.size() - room : 0);
  for (size_t i = first; i < std::min(rows.size(), first + room); ++i) {
    add(FormatRow(rows[i], width), rows[i].bad ? Style::kBad : Style::kPlain);
  }
  if (page.height == 0) return lines;
  const size_t below = rows.size() - std::min(rows.size(), first + room);
  add(first + below == 0 ? "" : absl::StrFormat("... %d above, %d below", first, below));
  add(absl::StrFormat("q quit  p pause  s sort (%s%s)  r reverse  arrows scroll  h help", TopColumnName(state.sort),
                      state.reverse ? ", reversed" : ""));
  return lines;
}

}  // namespace

int WorkersOnPage(int height) { return std::max(1, height - kHeadLines - kFootLines); }

std::vector<TopLine> DrawTop(const v1::StatusReply& status, const TopState& state, const TopPage& page) {
  std::vector<TopLine> lines = DrawAll(status, state, page);
  // With a line more a terminal would scroll.
  if (page.height > 0 && lines.size() > static_cast<size_t>(page.height)) lines.resize(page.height);
  return lines;
}

}  // namespace craftfleet

#include "deploy/cli/top/top_view.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>

#include "common/base/crafter.h"
#include "common/base/numbers.h"
#include "common/base/printable.h"
#include "common/wire/status_service.h"
#include "learner/run/progress.h"

namespace craftfleet {
namespace {

using Style = TextLine::Style;

constexpr int kHeadLines = 9;  // above the workers, if the advice is one line
constexpr int kFootLines = 2;

constexpr char kHelp[] = R"(
 role     learner, actor or server (environment server)
 state    ok; LOST: no heartbeat within its lease; HANGS: does not answer;
          SLOW: steps take several times as long as elsewhere;
          left: has left the fleet; draining: gets no new work; drained: idle
 steps/s  environment steps: of the last iterations (learner), of 20 s (others)
 lanes    games: of the run, with a permit at the actor, open at the server
 lag      how many versions of the weights an actor is behind
 mem      resident memory     err  errors in its log     seen  last heartbeat
 time     shares of the working threads' time, in percent, largest first:
          env   stepping games            wire  messages in transit
          inf   inference of the policy   perm  waiting for permits
          intk  waiting for fragments     upd   PPO update
          oth   logs, checkpoints, ...    idle  waiting for actors

 q quit   p pause   s S sort by the next, previous column   r reverse
 arrows, j, k, page up, page down: scroll                  h back to the fleet)";

// A row of the table: a process and the values by which it is sorted.
struct Row {
  std::string role;
  std::string name;
  std::string state;
  v1::ProcessSummary summary;
  int64_t lag = -1;  // -1: none
  double seen = -1;  // seconds; -1: the learner itself
  bool bad = false;
};

const char* ShortName(absl::string_view activity) {
  static const auto* const names = new std::map<absl::string_view, const char*>{
      {"environment", "env"}, {"wire", "wire"},  {"inference", "inf"}, {"permits", "perm"},
      {"intake", "intk"},     {"update", "upd"}, {"other", "oth"},     {"idle", "idle"}};
  const auto found = names->find(activity);
  return found == names->end() ? "?" : found->second;
}

// The beginning of a text that may come from an untrusted process.
std::string Cut(absl::string_view text, int width) {
  return Printable(text.substr(0, static_cast<size_t>(std::max(0, width))));
}

std::string Bytes(int64_t bytes) {
  if (bytes == 0) return "-";  // not reported yet
  const double mib = static_cast<double>(bytes) / (1 << 20);
  return mib < 1000 ? absl::StrFormat("%.0fM", mib) : absl::StrFormat("%.1fG", mib / 1024);
}

// The largest shares, as many as fit into `width`: "inf 61 env 30".
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

const char* StateOf(const v1::Peer& peer) {
  if (peer.health() == v1::Peer::LOST) return "LOST";
  if (peer.health() == v1::Peer::NOT_ANSWERING) return "HANGS";
  if (peer.health() == v1::Peer::SLOW) return "SLOW";
  if (peer.health() == v1::Peer::LEFT) return "left";
  if (peer.drain() == v1::Peer::DRAINING) return "draining";
  return peer.drain() == v1::Peer::DRAINED ? "drained" : "ok";
}

std::vector<Row> RowsOf(const v1::StatusReply& status) {
  std::vector<Row> rows;
  for (const v1::Peer& peer : status.peers()) {
    Row row;
    row.role = peer.role() == "envserver" ? "server" : peer.role();
    row.name = peer.name();
    row.bad =
        peer.health() == v1::Peer::LOST || peer.health() == v1::Peer::NOT_ANSWERING || peer.health() == v1::Peer::SLOW;
    row.state = StateOf(peer);
    row.summary = peer.summary();
    if (peer.role() == "actor" && peer.health() == v1::Peer::OK && peer.summary().policy_version() >= 0) {
      row.lag = std::max<int64_t>(0, status.summary().policy_version() - peer.summary().policy_version());
    }
    row.seen = peer.last_seen_s();
    rows.push_back(std::move(row));
  }
  return rows;
}

// Sorts stably; the largest numbers come first.
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
      by_text(&Row::state);  // LOST, HANGS and SLOW, in capitals, come first
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

// The variable column widths. Space beyond 80 columns goes to the names, up to 32 columns, and then to the times. Long
// states take space from the names.
struct Widths {
  Widths(int page, const std::vector<Row>& rows) {
    for (const Row& row : rows) state = std::max(state, static_cast<int>(row.state.size()));
    name = std::max(10, std::clamp(page - 65, 10, 32) - (state - 5));
    times = page - name - state - 45;
  }

  int name = 0;
  int state = 5;
  int times = 0;
};

std::string FormatRow(const Row& row, const Widths& widths) {
  return absl::StrFormat("%-7s %-*s %-*s %7.0f %5d %3s %6s %3d %5s %s", Cut(row.role, 7), widths.name,
                         Cut(row.name, widths.name), widths.state, row.state, row.summary.steps_per_second(),
                         row.summary.lanes(), row.lag < 0 ? "-" : absl::StrCat(row.lag),
                         Bytes(row.summary.memory_bytes()), std::min<int64_t>(row.summary.errors(), 999),
                         row.seen < 0 ? "-" : FormatTimeLeft(row.seen), Shares(row.summary, widths.times));
}

std::string HeaderRow(const Widths& widths) {
  return absl::StrFormat("%-7s %-*s %-*s %7s %5s %3s %6s %3s %5s %s", "ROLE", widths.name, "NAME", widths.state,
                         "STATE", "STEPS/S", "LANES", "LAG", "MEM", "ERR", "SEEN", "TIME %");
}

std::string StepsLine(const v1::StatusReply& status, std::map<std::string, double> metrics) {
  const double steps = metrics["env_steps"];
  const double goal = metrics["env_steps_goal"];
  const double rate = status.summary().steps_per_second();
  std::string line = absl::StrFormat("%s/%s steps %.1f%%  %.0f steps/s", WithCommas(std::llround(steps)),
                                     WithCommas(std::llround(goal)), goal > 0 ? 100 * steps / goal : 0, rate);
  switch (status.fleet().run_state()) {
    case v1::FleetSummary::EVALUATING:
      return line + "  evaluating";
    case v1::FleetSummary::COMPLETE:
      return line + "  complete";
    case v1::FleetSummary::PAUSED:
      return line + "  paused";
    default:
      break;
  }
  if (rate > 0 && steps < goal) absl::StrAppend(&line, "  ", FormatTimeLeft((goal - steps) / rate), " left");
  return line;
}

std::string ScoreLine(std::map<std::string, double> metrics) {
  if (metrics["episodes"] == 0) {
    return absl::StrFormat("iteration %.0f  reward -  length -  score -  unlocked 0/%d", metrics["iteration"],
                           kNumAchievements);
  }
  return absl::StrFormat("iteration %.0f  reward %.2f  length %.0f  score %.2f  unlocked %.0f/%d", metrics["iteration"],
                         metrics["reward"], metrics["episode_length"], metrics["crafter_score"],
                         metrics["achievements_unlocked"], kNumAchievements);
}

// Empty while every update learns from the newest weights.
std::string StalenessLine(std::map<std::string, double> metrics) {
  if (metrics["staleness_max"] == 0 && metrics["fragments_dropped"] == 0) return "";
  return absl::StrFormat("staleness %.0f to %.0f updates, mean %.2f  %.0f fragments dropped", metrics["staleness_min"],
                         metrics["staleness_max"], metrics["staleness_mean"], metrics["fragments_dropped"]);
}

std::string TimesLine(const v1::FleetSummary& fleet) {
  std::vector<std::string> parts;
  for (const v1::ActivityTime& time : fleet.times()) {
    parts.push_back(absl::StrFormat("%s %.0f%%", time.activity(), 100 * time.share()));
  }
  return absl::StrCat("time: ", parts.empty() ? "not known yet" : absl::StrJoin(parts, "  "));
}

std::string GpuLine(const v1::ProcessSummary& summary) {
  return absl::StrFormat("gpu: %s  %.0f%% busy  %s of %s", summary.gpu(), 100 * summary.gpu_utilization(),
                         Bytes(summary.gpu_memory_bytes()), Bytes(summary.gpu_memory_size_bytes()));
}

std::string CountsLine(const v1::StatusReply& status) {
  std::map<std::pair<std::string, v1::Peer::Health>, int> count = wire::WorkersOf(status);
  int64_t errors = status.summary().errors();
  for (const v1::Peer& peer : status.peers()) errors += peer.summary().errors();
  const auto lost = [&](const char* role) {
    std::vector<std::string> bad;
    if (const int number = count[{role, v1::Peer::LOST}]; number > 0) bad.push_back(absl::StrFormat("%d lost", number));
    if (const int number = count[{role, v1::Peer::NOT_ANSWERING}]; number > 0) {
      bad.push_back(absl::StrFormat("%d not answering", number));
    }
    if (const int number = count[{role, v1::Peer::SLOW}]; number > 0) bad.push_back(absl::StrFormat("%d slow", number));
    return bad.empty() ? "" : absl::StrCat(" (", absl::StrJoin(bad, ", "), ")");
  };
  return absl::StrFormat(
      "%s%s  %s%s  %s  checkpoint %s ago", Counted(count[{"actor", v1::Peer::OK}], "actor"), lost("actor"),
      Counted(count[{"envserver", v1::Peer::OK}] + count[{"envserver", v1::Peer::SLOW}], "server"), lost("envserver"),
      Counted(errors, "error"), FormatTimeLeft(MetricsOf(status)["checkpoint_age"]));
}

// Names the drained workers and the command that undoes it; empty if there are none.
std::string DrainedLine(const v1::StatusReply& status, absl::string_view address) {
  std::vector<std::string> drained;
  for (const v1::Peer& peer : status.peers()) {
    if (peer.health() == v1::Peer::OK && peer.drain() != v1::Peer::NO_DRAIN) drained.push_back(peer.name());
  }
  if (drained.empty()) return "";
  return absl::StrCat("To use ", drained.size() == 1 ? drained[0] : absl::StrCat(drained.size(), " drained workers"),
                      " again: craftfleet admin --address=", address, " undrain ",
                      drained.size() == 1 ? drained[0] : "NAME");
}

// The last error of a process, with its name; empty if there is none.
std::string LastError(const v1::StatusReply& status) {
  if (!status.summary().last_error().empty()) return "learner: " + status.summary().last_error();
  for (const v1::Peer& peer : status.peers()) {
    if (!peer.summary().last_error().empty()) return peer.name() + ": " + peer.summary().last_error();
  }
  return "";
}

// Splits `text` into lines of at most `width`.
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
std::vector<TextLine> DrawAll(const v1::StatusReply& status, const TopState& state, const TopPage& page) {
  const int width = std::max(40, page.width);
  std::vector<TextLine> lines;
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
  // The learner of a complete run ends: then it is no problem that it no longer answers.
  const bool ended = !page.problem.empty() && status.fleet().run_state() == v1::FleetSummary::COMPLETE;
  const bool lost = !page.problem.empty() && !ended;
  if (lost) add(page.problem, Style::kBad);
  add(StepsLine(status, MetricsOf(status)));
  add(ScoreLine(MetricsOf(status)));
  if (const std::string staleness = StalenessLine(MetricsOf(status)); !staleness.empty()) add(staleness);
  add(CountsLine(status));
  add(TimesLine(status.fleet()));
  if (!status.summary().gpu().empty()) add(GpuLine(status.summary()));
  const bool good = status.fleet().bottleneck() != "actors" && status.fleet().bottleneck() != "environment servers";
  for (const std::string& line : Wrap(status.fleet().advice(), width)) add(line, good ? Style::kGood : Style::kBad);
  if (const std::string error = LastError(status); !error.empty()) add("last error of " + error, Style::kBad);
  const std::string drained = DrainedLine(status, page.address);
  if (!drained.empty()) {
    for (const std::string& line : Wrap(drained, width)) add(line);
  }
  add("");
  Row learner;
  learner.role = "learner";
  learner.name = status.name();
  learner.state = ended ? "ended" : lost ? "LOST" : "ok";
  learner.summary = status.summary();
  std::vector<Row> rows = RowsOf(status);
  Sort(state, &rows);
  const Widths widths(width, rows);
  add(HeaderRow(widths), Style::kHeader);
  add(FormatRow(learner, widths), lost ? Style::kBad : Style::kPlain);
  const size_t room = page.height == 0
                          ? rows.size()
                          : static_cast<size_t>(std::max(1, page.height - kFootLines - static_cast<int>(lines.size())));
  const size_t first = std::min(static_cast<size_t>(state.scroll), rows.size() > room ? rows.size() - room : 0);
  for (size_t i = first; i < std::min(rows.size(), first + room); ++i) {
    add(FormatRow(rows[i], widths), rows[i].bad ? Style::kBad : Style::kPlain);
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

std::vector<TextLine> DrawTop(const v1::StatusReply& status, const TopState& state, const TopPage& page) {
  std::vector<TextLine> lines = DrawAll(status, state, page);
  // One more line would scroll the terminal.
  if (page.height > 0 && lines.size() > static_cast<size_t>(page.height)) lines.resize(page.height);
  return lines;
}

std::string RenderAnsi(const std::vector<TextLine>& lines) {
  std::string text = "\x1b[H";  // home
  for (size_t i = 0; i < lines.size(); ++i) {
    // Clear the rest of an older, longer line.
    absl::StrAppend(&text, i == 0 ? "" : "\r\n", WithAnsiStyle(lines[i].text, lines[i].style), "\x1b[K");
  }
  return text + "\x1b[J";
}

}  // namespace craftfleet

"""craftfleet top: shows a fleet live in a terminal."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time

from . import _cli, programs
from ._cli import Flag, Refusal, in_range

PROGRAM = "craftfleet top"
USAGE = """craftfleet top shows a whole fleet: what each process does, which ones are lost, and what limits the speed of the run. It
connects only to the learner. In a terminal the page is live; keys sort, pause and scroll (h lists them). Without a terminal
it prints plain-text pages.

  craftfleet top --address=127.0.0.1:50051
  craftfleet top --address=127.0.0.1:50051 --once > page.txt"""
HELP = """
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
 arrows, j, k, page up, page down: scroll                  h back to the fleet"""
ACTIVITIES = {"environment": "env", "wire": "wire", "inference": "inf", "permits": "perm", "intake": "intk", "update": "upd",
              "other": "oth", "idle": "idle"}
COLUMNS = ("role", "name", "state", "steps", "lanes", "lag", "mem", "err", "seen")


@dataclasses.dataclass
class View:
  """What the user has chosen."""
  sort: str = "role"
  reverse: bool = False
  paused: bool = False
  help: bool = False
  scroll: int = 0  # workers above the first one on the page

  def press(self, key: str, page: int) -> None:
    """A key, or its name in curses; `page`: the workers on a page."""
    if key in ("s", "S"):
      self.sort = COLUMNS[(COLUMNS.index(self.sort) + (1 if key == "s" else -1)) % len(COLUMNS)]
      self.scroll = 0
    elif key in ("p", " "):
      self.paused = not self.paused
    elif key == "r":
      self.reverse = not self.reverse
    elif key in ("h", "?"):
      self.help = not self.help
    step = {"j": 1, "KEY_DOWN": 1, "k": -1, "KEY_UP": -1, "KEY_NPAGE": page, "KEY_PPAGE": -page}.get(key, 0)
    self.scroll = max(0, self.scroll + step)


def duration(seconds: float) -> str:
  """1h2m, 13m48s, 40s"""
  if not 0 <= seconds < 1e9:
    return "-"
  minutes, seconds = divmod(round(seconds), 60)
  if minutes >= 1440:
    return f"{minutes // 1440}d{minutes % 1440 // 60}h"
  if minutes >= 60:
    return f"{minutes // 60}h{minutes % 60}m"
  return f"{minutes}m{seconds}s" if minutes else f"{seconds}s"


def _bytes(number: float) -> str:
  mib = number / 2**20
  return "-" if number == 0 else f"{mib:.0f}M" if mib < 1000 else f"{mib / 1024:.1f}G"


def _counted(number: int, thing: str) -> str:
  return f"{number:,} {thing}{'' if number == 1 else 's'}"


def _shares(summary: dict, width: int) -> str:
  """The largest shares, as many as fit: inf 61 env 30"""
  text = ""
  for part in sorted(summary.get("times", []), key=lambda part: -float(part["share"])):
    percent = f"{100 * float(part['share']):.0f}"
    longer = f"{text} {ACTIVITIES.get(part['activity'], '?')} {percent}".lstrip()
    if percent == "0" or len(longer) > width:
      break
    text = longer
  return text


def _row(role: str, name: str, state: str, summary: dict, lag: int = -1, seen: float = -1) -> dict:
  number = lambda field: float(summary.get(field, 0))
  return {"role": role, "name": name, "state": state, "steps": number("steps_per_second"), "lanes": number("lanes"), "lag": lag,
          "mem": number("memory_bytes"), "err": number("errors"), "seen": seen, "summary": summary}


def _is_complete(status: dict) -> bool:
  """The learner of a complete run ends: then it is no problem that it no longer answers."""
  return status.get("fleet", {}).get("run_state") == "COMPLETE"


def _state(peer: dict) -> str:
  health = {"LOST": "LOST", "NOT_ANSWERING": "HANGS", "SLOW": "SLOW", "LEFT": "left"}.get(peer["health"])
  return health or {"DRAINING": "draining", "DRAINED": "drained"}.get(peer["drain"], "ok")


def _worker(peer: dict, newest: int) -> dict:
  summary = peer.get("summary", {})
  version = int(summary.get("policy_version", -1))
  lag = max(0, newest - version) if peer["role"] == "actor" and peer["health"] == "OK" and version >= 0 else -1
  role = "server" if peer["role"] == "envserver" else peer["role"]
  return _row(role, peer["name"], _state(peer), summary, lag, float(peer["last_seen_s"]))


class Table:
  """The widths of a page. Columns beyond 80 go to the names, up to 32, then to the times; long states take some of the names'."""

  def __init__(self, width: int, rows: list[dict]):
    self.state = max([5, *(len(row["state"]) for row in rows)])
    self.name = max(10, min(max(width - 65, 10), 32) - (self.state - 5))
    self.times = width - self.name - self.state - 45

  def head(self) -> str:
    return f"{'ROLE':7} {'NAME':{self.name}} {'STATE':{self.state}} STEPS/S LANES LAG    MEM ERR  SEEN TIME %"

  def line(self, row: dict) -> str:
    lag = "-" if row["lag"] < 0 else row["lag"]
    seen = "-" if row["seen"] < 0 else duration(row["seen"])
    return (f"{row['role'][:7]:7} {row['name'][:self.name]:{self.name}} {row['state']:{self.state}} {row['steps']:7.0f} "
            f"{row['lanes']:5.0f} {lag:>3} {_bytes(row['mem']):>6} {min(row['err'], 999):3.0f} {seen:>5} "
            f"{_shares(row['summary'], self.times)}")


def _steps_line(status: dict, metrics: dict) -> str:
  steps, goal = metrics.get("env_steps", 0), metrics.get("env_steps_goal", 0)
  rate = float(status.get("summary", {}).get("steps_per_second", 0))
  line = f"{steps:,.0f}/{goal:,.0f} steps {100 * steps / goal if goal > 0 else 0:.1f}%  {rate:.0f} steps/s"
  state = status.get("fleet", {}).get("run_state", "")
  if state in ("EVALUATING", "COMPLETE", "PAUSED"):
    return f"{line}  {state.lower()}"
  return f"{line}  {duration((goal - steps) / rate)} left" if rate > 0 and steps < goal else line


def _score_line(metrics: dict) -> str:
  number = lambda name, form: format(metrics.get(name, 0), form) if metrics.get("episodes") else "-"
  return (f"iteration {metrics.get('iteration', 0):.0f}  reward {number('reward', '.2f')}  length {number('episode_length', '.0f')}  "
          f"score {number('crafter_score', '.2f')}  unlocked {metrics.get('achievements_unlocked', 0):.0f}/22")


def _counts_line(status: dict, metrics: dict) -> str:
  """Of all workers, also those that the status does not list."""
  fleet = status.get("fleet", {})
  known = [(count["role"], count["health"], int(count["number"])) for count in fleet.get("workers", [])]
  known = known or [(peer["role"], peer["health"], 1) for peer in status["peers"]]
  total = lambda role, *healths: sum(number for of, health, number in known if of == role and health in healths)
  def bad(role):
    words = {"LOST": "lost", "NOT_ANSWERING": "not answering", "SLOW": "slow"}
    some = [f"{total(role, health)} {word}" for health, word in words.items() if total(role, health)]
    return f" ({', '.join(some)})" if some else ""
  errors = sum(int(of.get("summary", {}).get("errors", 0)) for of in [status, *status["peers"]])
  return (f"{_counted(total('actor', 'OK'), 'actor')}{bad('actor')}  {_counted(total('envserver', 'OK', 'SLOW'), 'server')}"
          f"{bad('envserver')}  {_counted(errors, 'error')}  checkpoint {duration(metrics.get('checkpoint_age', 0))} ago")


def _head(status: dict, address: str, width: int) -> list[tuple[str, str]]:
  """The lines above the table, with their styles."""
  metrics = {metric["name"]: float(metric["value"]) for metric in status["metrics"]}
  summary, fleet = status.get("summary", {}), status.get("fleet", {})
  lines = [(_steps_line(status, metrics), ""), (_score_line(metrics), "")]
  if metrics.get("staleness_max") or metrics.get("fragments_dropped"):
    values = [metrics.get(f"staleness_{which}", 0) for which in ("min", "max", "mean")]
    lines.append(("staleness {:.0f} to {:.0f} updates, mean {:.2f}".format(*values) +
                  f"  {metrics.get('fragments_dropped', 0):.0f} fragments dropped", ""))
  lines.append((_counts_line(status, metrics), ""))
  times = "  ".join(f"{part['activity']} {100 * float(part['share']):.0f}%" for part in fleet.get("times", []))
  lines.append((f"time: {times or 'not known yet'}", ""))
  if summary.get("gpu"):
    lines.append((f"gpu: {summary['gpu']}  {100 * float(summary['gpu_utilization']):.0f}% busy  "
                  f"{_bytes(int(summary['gpu_memory_bytes']))} of {_bytes(int(summary['gpu_memory_size_bytes']))}", ""))
  style = "bad" if fleet.get("bottleneck") in ("actors", "environment servers") else "good"
  lines += [(line, style) for line in textwrap.wrap(fleet.get("advice", ""), width) or [""]]
  errors = [(of["name"], of.get("summary", {}).get("last_error")) for of in [{**status, "name": "learner"}, *status["peers"]]]
  lines += [(f"last error of {name}: {error}", "bad") for name, error in errors if error][:1]
  drained = [peer["name"] for peer in status["peers"] if peer["health"] == "OK" and peer["drain"] != "NO_DRAIN"]
  if drained:
    who, name = (drained[0], drained[0]) if len(drained) == 1 else (f"{len(drained)} drained workers", "NAME")
    text = f"To use {who} again: craftfleet admin --address={address} undrain {name}"
    lines += [(line, "") for line in textwrap.wrap(text, width, break_on_hyphens=False)]
  return lines


def draw(status: dict, view: View, width: int, height: int, address: str, problem: str = "") -> list[tuple[str, str]]:
  """The page: lines of printable ASCII, at most as wide as the page, each with its style: "", title, header, good or bad.

  `status` is what craftfleet status --json prints of the learner, `problem` why it is outdated; `height` 0: no limit.
  Takes `view.scroll` back to the last page.
  """
  width = max(40, width)
  cut = lambda lines: [(re.sub(r"[^ -~]", "?", text)[:width], style) for text, style in lines][:height or None]
  paused = " PAUSED" if view.paused else ""
  lines = [(f"craftfleet top{paused}  learner {address}  run {status['run_id']}  up {duration(float(status['uptime_s']))}", "title")]
  if view.help:
    return cut(lines + [(line, "") for line in HELP.split("\n")])
  ended = bool(problem) and _is_complete(status)
  lost = bool(problem) and not ended
  lines += [(problem, "bad")] if lost else []
  lines += _head(status, address, width) + [("", "")]
  newest = int(status.get("summary", {}).get("policy_version", 0))
  rows = sorted((_worker(peer, newest) for peer in status["peers"]), key=lambda row: row["name"])
  # The largest numbers come first, and states in capitals.
  rows.sort(key=lambda row: row[view.sort] if isinstance(row[view.sort], str) else -row[view.sort])
  rows = rows[::-1] if view.reverse else rows
  table = Table(width, rows)
  learner = _row("learner", status["name"], "ended" if ended else "LOST" if lost else "ok", status.get("summary", {}))
  lines += [(table.head(), "header"), (table.line(learner), "bad" if lost else "")]
  fit = max(1, height - 2 - len(lines)) if height else len(rows)
  first = view.scroll = min(view.scroll, max(0, len(rows) - fit))
  lines += [(table.line(row), "bad" if row["state"] in ("LOST", "HANGS", "SLOW") else "") for row in rows[first:first + fit]]
  if height:
    below = max(0, len(rows) - first - fit)
    order = view.sort + (", reversed" if view.reverse else "")
    lines += [(f"... {first} above, {below} below" if first + below else "", ""),
              (f"q quit  p pause  s sort ({order})  r reverse  arrows scroll  h help", "")]
  return cut(lines)


class Watcher:
  """Keeps the latest status of the learner up to date, with craftfleet status; starts it again when it ends."""

  def __init__(self, arguments: list[str]):
    words, self._environment = programs.find("status")
    self._command = [*words, "--watch", "--json", *arguments]
    self._changed = threading.Condition()
    self._seen = (0, {}, "")  # replies so far, the last one, and why there is no newer one
    threading.Thread(target=self._run, daemon=True).start()

  def last(self) -> tuple[int, dict, str]:
    with self._changed:
      return self._seen

  def after(self, number: int) -> tuple[int, dict, str]:
    """Waits for a later reply than that, or for a problem."""
    with self._changed:
      while self._seen[0] <= number and not self._seen[2]:
        self._changed.wait(0.2)  # signals are handled in between
      return self._seen

  def _put(self, status: dict | None, problem: str) -> None:
    with self._changed:
      number, before, _ = self._seen
      self._seen = (number, before, problem) if status is None else (number + 1, status, "")
      self._changed.notify_all()

  def _run(self) -> None:
    while True:
      with subprocess.Popen(self._command, env=self._environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True) as child:
        lines = []
        for line in child.stdout:  # an empty line ends each reply
          lines.append(line)
          if line == "\n":
            self._put(json.loads("".join(lines)), "")
            lines.clear()
        error = child.stderr.read().strip().removeprefix("craftfleet status: ")
      self._put(None, error or "craftfleet status ended")
      time.sleep(1)


def _print_page(status: dict, view: View, flags) -> None:
  print("\n".join(text for text, _ in draw(status, view, flags.width, 0, flags.address)), flush=True)


def _print_pages(watcher: Watcher, view: View, flags) -> None:
  number = 0
  while True:
    seen, status, problem = watcher.after(number)
    if seen == number:
      if _is_complete(status):
        return
      raise Refusal(problem)
    number = seen
    _print_page(status, view, flags)
    print(flush=True)


def _show(watcher: Watcher, view: View, address: str) -> None:
  import curses  # pylint: disable=import-outside-toplevel

  def live(screen):
    with contextlib.suppress(curses.error):  # some terminals cannot hide the cursor
      curses.curs_set(0)
    styles = {"": 0, "title": curses.A_BOLD, "header": curses.A_REVERSE, "good": 0, "bad": curses.A_BOLD}
    if curses.has_colors():
      curses.use_default_colors()
      for number, (style, colour) in enumerate({"good": curses.COLOR_GREEN, "bad": curses.COLOR_RED}.items(), start=1):
        curses.init_pair(number, colour, -1)
        styles[style] = curses.color_pair(number)
    screen.timeout(200)
    shown, key = watcher.last(), ""
    while key != "q":
      shown = shown if view.paused else watcher.last()
      height, width = screen.getmaxyx()
      problem = f"no status from the learner: {shown[2]}" if shown[2] else ""
      screen.erase()
      for y, (text, style) in enumerate(draw(shown[1], view, width, height, address, problem)):
        screen.insnstr(y, 0, text, width, styles[style])
      try:
        key = screen.getkey()
      except curses.error:  # none
        key = ""
      view.press(key, max(1, height - 11))

  try:
    curses.wrapper(live)
  except curses.error as error:
    raise Refusal(f"cannot use this terminal: {error}; try --once") from None


def _run(flags, arguments: list[str]) -> None:
  if arguments:
    raise Refusal(f'"{arguments[0]}" is not a flag; see {PROGRAM} --help')
  if flags.sort not in COLUMNS:
    raise Refusal(f"--sort={flags.sort}, want {', '.join(COLUMNS)}")
  in_range("width", flags.width, 40, 400)
  own = ("once", "sort", "width")
  watcher = Watcher([f"--{name}={value}" for name, value in vars(flags).items() if name not in own and value != ""])
  for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda *_: sys.exit(0))
  view = View(flags.sort)
  number, status, problem = watcher.after(0)
  if number == 0:
    raise Refusal(problem)
  if status["role"] != "learner":
    raise Refusal(f"--address={flags.address} has the role {status['role']!a:.80}, want the learner; craftfleet status shows any process")
  if flags.once:
    _print_page(status, view, flags)
  elif sys.stdin.isatty() and sys.stdout.isatty():
    _show(watcher, view, flags.address)
  else:
    _print_pages(watcher, view, flags)


def _flags() -> list[Flag]:
  """With those of craftfleet status that say how to connect."""
  words, environment = programs.find("status")
  text = subprocess.run([*words, "--help_json"], capture_output=True, check=True, env=environment).stdout
  described = {flag["name"]: flag for flag in json.loads(text)["flags"] if flag["name"] not in ("json", "watch", "log_level", "log_format")}
  address, interval = described.pop("address"), described.pop("interval")
  return [
      Flag("address", "string", address["default"], "address of the learner, HOST:PORT"),
      Flag("once", "bool", False, "print one page as plain text and exit"),
      Flag("interval", "string", interval["default"], interval["help"].removeprefix("with --watch: ")),
      Flag("sort", "string", "role", f"column to sort workers by: {', '.join(COLUMNS)}"),
      Flag("width", "integer", 100, "columns of plain-text pages, 40..400"),
      *(Flag(flag["name"], flag["type"], flag["default"], flag["help"], main=False) for flag in described.values()),
  ]


def main(arguments: list[str]) -> int:
  try:
    flags = _flags()
  except (OSError, ImportError, subprocess.CalledProcessError, ValueError) as error:
    print(f"{PROGRAM}: {_cli.reason(error)}", file=sys.stderr)
    return 1
  return _cli.run(PROGRAM, USAGE, flags, arguments, _run)

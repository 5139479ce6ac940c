"""The page of craftfleet top and its keys. tests/deploy/watch_test.py shows a real fleet."""

import contextlib
import io
import math
import os
import pty
import sys
import types

from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

os.environ["CRAFTFLEET_BIN"] = str(BIN)
sys.path.insert(0, str(SOURCE / "deploy/python/craftfleet"))

from analysis.top import COLUMNS, Refusal, View, _print_pages, _show, draw  # noqa: E402  pylint: disable=wrong-import-position

METRICS = {"env_steps": 172032, "env_steps_goal": 1e6, "iteration": 42, "episodes": 900, "reward": 4.25, "episode_length": 187,
           "crafter_score": 8.5, "achievements_unlocked": 15, "checkpoint_age": 70}


def times(**shares):
  return [{"activity": name, "share": share} for name, share in shares.items()]


def worker(role, name, rate, **fields):
  summary = {"steps_per_second": rate, "lanes": 8, "memory_bytes": str(300 << 20), "policy_version": "40", "errors": "0",
             "last_error": "", "times": times(inference=0.61, environment=0.3, wire=0.09)} | fields.pop("summary", {})
  return {"role": role, "name": name, "health": "OK", "drain": "NO_DRAIN", "last_seen_s": 0.3, "summary": summary} | fields


def fleet(*peers, metrics=None, summary=None, **of_fleet):
  """As craftfleet status --json prints it: numbers of 64 bits are strings."""
  peers = peers or (worker("actor", "host-3-cc", 600), worker("actor", "host-2-bb", 400), worker("envserver", "host-4-dd", 1000))
  return {
      "role": "learner", "name": "host-1-aa", "run_id": "run-7", "uptime_s": 3725, "peers": list(peers),
      "metrics": [{"name": name, "value": value} for name, value in (METRICS | (metrics or {})).items()],
      "summary": {"steps_per_second": 1000, "lanes": 16, "policy_version": "42", "times": times(update=0.6)} | (summary or {}),
      "fleet": {"times": times(update=0.6, inference=0.4), "bottleneck": "learner", "run_state": "TRAINING",
                "advice": "The learner takes 60% of the time: give it more."} | of_fleet,
  }


def page(status, view=None, width=100, height=0, problem=""):
  return "\n".join(text for text, _ in draw(status, view or View(), width, height, "a:1", problem))


def order(status, **view):
  lines = page(status, View(**view)).split("\nlearner ")[1].split("\n")[1:]
  return [line[8:].split()[0] for line in lines]


class Page(python_case.unittest.TestCase):

  def test_shows_the_run_and_every_process(self):
    text = page(fleet(), width=80)
    for part in ("learner a:1  run run-7  up 1h2m", "172,032/1,000,000 steps 17.2%  1000 steps/s  13m48s left",
                 "iteration 42  reward 4.25  length 187  score 8.50  unlocked 15/22",
                 "2 actors  1 server  0 errors  checkpoint 1m10s ago", "time: update 60%  inference 40%", "give it more."):
      self.assertIn(part, text)
    self.assertRegex(text, r"\nlearner host-1-aa +ok +1000 +16 +- ")
    self.assertRegex(text, r"\nactor +host-2-bb +ok +400 +8 +2 +300M +0 +0s inf 61")
    self.assertRegex(text, r"\nserver +host-4-dd +ok +1000 .*env 30")
    self.assertIn("inf 61 env 30 wire 9", page(fleet(), width=120))

  def test_no_line_is_wider_and_no_page_higher_than_the_terminal(self):
    status = fleet(*(worker("actor", f"worker-{i}" * 9, i) for i in range(100)), advice=" ".join([30 * "x", 30 * "y", 300 * "z"]))
    for width in (40, 80, 81, 200):
      for height in (12, 24, 50):
        lines = draw(status, View(), width, height, 300 * "a", "trouble")
        self.assertEqual(len(lines), height)
        self.assertLessEqual(max(len(text) for text, _ in lines), width)

  def test_before_there_are_episodes_or_workers(self):
    text = page({**fleet(metrics=dict.fromkeys(METRICS, 0)), "peers": []})
    self.assertIn("\niteration 0  reward -  length -  score -  unlocked 0/22\n0 actors  0 servers  ", text)
    empty = {"role": "learner", "name": "", "run_id": "", "uptime_s": 0, "peers": [], "metrics": []}
    self.assertIn("time: not known yet", page(empty))

  def test_the_learner_of_a_complete_run_has_ended(self):
    text = page(fleet(run_state="COMPLETE"), problem="no news: gone")
    self.assertRegex(text, "learner host-1-aa +ended ")
    self.assertNotIn("no news", text)
    text = page(fleet(run_state="EVALUATING"), problem="no news: gone")
    self.assertRegex(text, "learner host-1-aa +LOST ")
    self.assertIn("\nno news: gone\n", text)

  def test_the_state_of_a_run_that_is_not_training(self):
    for state in ("PAUSED", "EVALUATING", "COMPLETE"):
      self.assertIn(f"1000 steps/s  {state.lower()}\n", page(fleet(run_state=state)))

  def test_workers_with_a_problem_stand_out(self):
    for health, state, counted in (("LOST", "LOST", "0 servers (1 lost)"), ("SLOW", "SLOW", "1 server (1 slow)"),
                                   ("NOT_ANSWERING", "HANGS", "0 servers (1 not answering)")):
      status = fleet(worker("actor", "a", 1), worker("actor", "b", 1), worker("envserver", "c", 1, health=health, last_seen_s=75))
      self.assertIn(f"2 actors  {counted}", page(status))
      self.assertRegex(page(status), rf"\nserver +c +{state} .*1m15s")
      self.assertEqual([text[:6] for text, style in draw(status, View(), 80, 0, "", "") if style == "bad"], ["server"])

  def test_workers_beyond_those_listed_are_counted(self):
    counts = [{"role": "actor", "health": "OK", "number": 1200}, {"role": "envserver", "health": "LOST", "number": 3}]
    self.assertIn("1,200 actors  0 servers (3 lost)", page(fleet(workers=counts)))

  def test_says_how_to_undrain_workers(self):
    text = page(fleet(worker("actor", "a", 600, drain="DRAINING"), worker("actor", "b", 1)))
    self.assertRegex(text, "actor +a +draining +600")
    self.assertIn("To use a again: craftfleet admin --address=a:1 undrain a", text)
    drained = [worker("actor", "a", 600, drain="DRAINED"), worker("envserver", "b", 1, drain="DRAINED")]
    self.assertIn("To use 2 drained workers again: craftfleet admin --address=a:1 undrain NAME", page(fleet(*drained)))
    drained[1]["health"] = "LOST"
    self.assertIn("To use a again", page(fleet(*drained)))

  def test_errors_staleness_and_gpu(self):
    text = page(fleet(worker("actor", "a", 1, summary={"last_error": "disk full", "errors": "2"}), worker("actor", "b", 1, health="LEFT"),
                      worker("envserver", "c", 1)))
    self.assertIn("last error of a: disk full", text)
    self.assertIn("\n1 actor  1 server  2 errors  ", text)
    self.assertNotIn("staleness", text)
    self.assertNotIn("gpu:", text)
    stale = {"staleness_min": 0, "staleness_mean": 0.75, "staleness_max": 2, "fragments_dropped": 3}
    self.assertIn("staleness 0 to 2 updates, mean 0.75  3 fragments dropped", page(fleet(metrics=stale)))
    gpu = {"gpu": "NVIDIA H100", "gpu_memory_bytes": str(3 << 30), "gpu_memory_size_bytes": str(80 << 30), "gpu_utilization": 0.87}
    self.assertIn("gpu: NVIDIA H100  87% busy  3.0G of 80.0G", page(fleet(summary=gpu)))

  def test_untrusted_texts_and_numbers_are_harmless(self):
    status = fleet(worker("actor", "a\x1b[2J\nb\xff", math.inf, last_seen_s="NaN", summary={"last_error": "\r\x07oh"}),
                   metrics={"env_steps": "NaN", "env_steps_goal": "Infinity"}, times=times(update="NaN"))
    for text, _ in draw(status, View(), 80, 24, "", ""):
      self.assertTrue(text.isascii() and (text.isprintable()), text)
    self.assertIn("a?[2J?b?", page(status))

  def test_sorts_by_each_column(self):
    status = fleet(worker("actor", "c", 600, summary={"memory_bytes": "1"}), worker("actor", "b", 400, summary={"errors": "9"}),
                   worker("envserver", "d", 1000, summary={"lanes": 99}))
    for sort, names in {"role": "bcd", "name": "bcd", "steps": "dcb", "lanes": "dbc", "mem": "bdc", "err": "bcd"}.items():
      self.assertEqual("".join(order(status, sort=sort)), names, sort)
    self.assertEqual(order(status, sort="steps", reverse=True), ["b", "c", "d"])

  def test_scrolls_and_counts_hidden_workers(self):
    status = fleet(*(worker("actor", f"worker-{i}", i) for i in range(10, 43)))
    for scroll, counts in ((0, "... 0 above, 20 below"), (5, "... 5 above, 15 below"), (1000, "... 20 above, 0 below")):
      self.assertIn(counts, page(status, View(scroll=scroll), 80, 24))
    view = View(scroll=1000)
    page(status, view, 80, 24)
    view.press("k", 10)
    self.assertIn("... 19 above, 1 below", page(status, view, 80, 24), "the way back begins at the end")

  def test_pages_end_without_an_error_with_a_complete_run(self):
    for state, ends in (("COMPLETE", contextlib.nullcontext()), ("TRAINING", self.assertRaisesRegex(Refusal, "it has stopped"))):
      replies = iter([(1, fleet(run_state=state), ""), (1, fleet(run_state=state), "it has stopped")])
      flags = types.SimpleNamespace(width=100, address="a:1")
      with contextlib.redirect_stdout(io.StringIO()) as pages, ends:
        _print_pages(types.SimpleNamespace(after=lambda _, replies=replies: next(replies)), View(), flags)
      self.assertEqual(pages.getvalue().count("craftfleet top"), 1)


class Terminal(python_case.unittest.TestCase):

  def test_needs_no_colours_and_no_hidden_cursor(self):
    watcher = types.SimpleNamespace(last=lambda: (1, fleet(), ""))
    for terminal in ("vt100", "vt220"):
      child, screen = pty.fork()
      if child == 0:
        os.environ["TERM"] = terminal
        try:
          _show(watcher, View(), "a:1")
          os._exit(0)  # pylint: disable=protected-access
        except BaseException as error:  # pylint: disable=broad-exception-caught
          print(error, flush=True)
          os._exit(1)  # pylint: disable=protected-access
      os.write(screen, b"q")
      text = b""
      with contextlib.suppress(OSError):  # at the end of the child
        while part := os.read(screen, 4096):
          text += part
      self.assertEqual(os.waitpid(child, 0)[1], 0, text)
      self.assertIn(b"host-1-aa", text)
      os.close(screen)


class Keys(python_case.unittest.TestCase):

  def test_each_key_has_its_effect(self):
    view = View()
    for key, field, value in (("s", "sort", "name"), ("S", "sort", "role"), ("S", "sort", "seen"), ("r", "reverse", True),
                              ("p", "paused", True), (" ", "paused", False), ("h", "help", True), ("KEY_DOWN", "scroll", 1),
                              ("KEY_NPAGE", "scroll", 11), ("k", "scroll", 10), ("KEY_PPAGE", "scroll", 0), ("KEY_UP", "scroll", 0)):
      view.press(key, 10)
      self.assertEqual(getattr(view, field), value, key)
    self.assertEqual(list(COLUMNS)[0], "role")
    self.assertIn("sort by the next", page(fleet(), view))
    self.assertTrue(page(fleet(), View(paused=True)).startswith("craftfleet top PAUSED  learner a:1"))


python_case.main()

"""Watching a fleet: metrics, dashboard and alert rules, craftfleet top and status, logs."""

import json
import re
import shlex
import shutil
import signal
import subprocess
import unittest
import urllib.request

from tests.fakes import python_case
from tests.fakes.python_case import ENDLESS, SOURCE, built, wait_until
from tests.fakes.screens import Tmux

MONITORING = SOURCE / "deploy/monitoring"


def promtool(*arguments, text=""):
  """Runs promtool; skips the test without it."""
  if shutil.which("promtool") is None:
    raise unittest.SkipTest("promtool is missing: install Debian's package prometheus")
  return subprocess.run(["promtool", *arguments], input=text, capture_output=True, text=True, timeout=60)


def samples(text):
  """(name, labels, value) of each sample in Prometheus' text format."""
  for line in text.splitlines():
    if not line.startswith("#"):
      name, labels, value = re.fullmatch(r"(\w+)(?:\{(.*)\})? (\S+)", line).groups()
      yield name, dict(re.findall(r'(\w+)="([^"]*)"', labels or "")), float(value)


def families(text):
  """name -> (type, help)."""
  helps = dict(re.findall(r"^# HELP (\w+) (.*)$", text, re.M))
  return {name: (kind, helps[name]) for name, kind in re.findall(r"^# TYPE (\w+) (\w+)$", text, re.M)}


class Fleet(python_case.ProcessCase):

  def setUp(self):
    super().setUp()
    (self.folder / "config.txt").write_text(ENDLESS)

  def start_learner(self, *flags):
    process, log = self.start("craftfleet-learner", f"--config={self.folder}/config.txt",
                              f"--logdir={self.folder}/run{self.programs}", "--listen=127.0.0.1:0", "--threads=1", *flags)
    return process, log, self.word_after(log, "listening on ")

  def start_fleet(self):
    """Starts a learner, an actor and two environment servers, one of them known only to the actor. Returns logs by role."""
    _, learner_log, self.learner = self.start_learner()
    self.registered, _ = self.start("craftfleet-envserver", "--listen=127.0.0.1:0", f"--learner={self.learner}")
    _, server_log = self.start("craftfleet-envserver", "--listen=127.0.0.1:0")
    self.server = self.word_after(server_log, "listening on ")
    _, actor_log = self.start("craftfleet-actor", f"--learner={self.learner}", f"--envservers={self.server}",
                              "--threads=1")
    self.word_after(actor_log, "joined run ")
    wait_until(lambda: self.metric("iteration") >= 2, "two iterations")
    return {"learner": learner_log, "actor": actor_log, "envserver": server_log}

  def lines_of(self, process):
    """The output of `process` on a pipe, line by line."""
    self.addCleanup(process.stdout.close)
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    while True:
      line = process.stdout.readline()
      self.assertTrue(line, "it ended")
      yield line

  def status(self, address=""):
    return json.loads(self.run_program("craftfleet status", f"--address={address or self.learner}", "--json").stdout)

  def metric(self, name):
    return {metric["name"]: metric["value"] for metric in self.status()["metrics"]}[name]

  def scrape(self, log):
    return urllib.request.urlopen(self.word_after(log, "metrics on "), timeout=10).read().decode()


class Metrics(unittest.TestCase):
  """The metrics of the three kinds of processes of one fleet."""

  @classmethod
  def setUpClass(cls):
    super().setUpClass()
    cls.fleet = Fleet()
    cls.addClassCleanup(cls.fleet.doCleanups)
    cls.fleet.setUp()
    cls.logs = cls.fleet.start_fleet()
    cls.scraped = {role: cls.fleet.scrape(log) for role, log in cls.logs.items()}

  def test_promtool_accepts_the_metrics_of_each_process(self):
    promtool("--version")
    for role, text in self.scraped.items():
      checked = promtool("check", "metrics", text=text)
      self.assertEqual((checked.returncode, checked.stdout, checked.stderr), (0, "", ""), role)

  def test_dashboard_and_rules_name_metrics_that_are_served(self):
    served = {name for text in self.scraped.values() for name in families(text)}
    table = (SOURCE / "common/telemetry/metric_table.cc").read_text()
    of_gpus = re.findall(r'^ *{"(gpu_\w+)", kGauge, "(\w*)"', table, re.M)  # served only where there is one
    served.update(f"craftfleet_{name}_{unit}".rstrip("_") for name, unit in of_gpus)
    dashboard = json.loads((MONITORING / "dashboard.json").read_text())
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    queries += re.findall(r"^ +expr: (.*)$", (MONITORING / "alerts.yml").read_text(), re.M)
    self.assertGreater(len(queries), 20)
    for query in queries:
      used = set(re.findall(r"craftfleet_\w+", query))
      self.assertTrue(used, query)
      self.assertLessEqual(used, served, query)

  def test_metrics_have_the_values_of_the_status(self):
    fleet, logs = self.fleet, self.logs
    before = fleet.metric("env_steps")
    served = {name: value for name, labels, value in samples(fleet.scrape(logs["learner"]))}
    self.assertLessEqual(before, served["craftfleet_env_steps_total"])
    self.assertLessEqual(served["craftfleet_env_steps_total"], fleet.metric("env_steps"))
    shares = [value for name, labels, value in samples(fleet.scrape(logs["actor"]))
              if name == "craftfleet_time_share" and labels["role"] == "actor"]
    self.assertAlmostEqual(sum(shares), 1, places=5)
    self.assertIn("metrics_address", fleet.status())


class Watch(Fleet):

  def test_promtool_accepts_rules_and_configuration(self):
    for kind, file in [("rules", "alerts.yml"), ("config", "prometheus.yml")]:
      checked = promtool("check", kind, str(MONITORING / file))
      self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
    self.assertNotEqual(promtool("check", "rules", str(MONITORING / "README.md")).returncode, 0)

  def check_alert(self, alert, series, minutes, firing):
    """Checks how many alerts of this name fire after so many minutes of the series: metric -> a value each minute."""
    case = {
        "rule_files": [str(MONITORING / "alerts.yml")],
        "evaluation_interval": "1m",
        "tests": [{
            "interval": "1m",
            "input_series": [{"series": metric, "values": values} for metric, values in series.items()],
            "promql_expr_test": [{
                "expr": f'count(ALERTS{{alertname="{alert}",alertstate="firing"}}) or vector(0)',
                "eval_time": f"{minutes}m",
                "exp_samples": [{"labels": "{}", "value": firing}],
            }],
        }],
    }
    (self.folder / "rules_test.yml").write_text(json.dumps(case))  # JSON is YAML
    checked = promtool("test", "rules", str(self.folder / "rules_test.yml"))
    self.assertEqual(checked.returncode, 0, f"{series} {checked.stdout}{checked.stderr}")

  def test_workers_that_are_lost_or_do_not_answer_raise_an_alert(self):
    for state, firing in [("lost", 1), ("not_answering", 1), ("slow", 1), ("ok", 0)]:
      workers = f'craftfleet_workers{{role="learner",worker="envserver",state="{state}"}}'
      self.check_alert("CraftFleetWorkersLost", {workers: "0 1x10"}, 8, firing)

  def test_a_run_without_an_iteration_for_half_an_hour_raises_an_alert(self):
    for steps, minutes, firing in [("0x60", 10, 0), ("0x60", 40, 1), ("0x20 64x40", 40, 0), ("0+64x60", 60, 0), ("9000x60", 60, 0)]:
      series = {'craftfleet_env_steps_total{role="learner"}': steps, 'craftfleet_env_steps_goal{role="learner"}': "9000x60"}
      self.check_alert("CraftFleetStandsStill", series, minutes, firing)

  def test_metrics_on_other_hosts_networks_need_a_flag(self):
    _, log = self.start("craftfleet-envserver", "--listen=127.0.0.1:0", "--metrics_listen=0.0.0.0:0")
    wait_until(lambda: "--metrics_insecure" in log.read_text(), "a refusal that says how")
    _, log = self.start("craftfleet-envserver", "--listen=127.0.0.1:0", "--metrics_listen=0.0.0.0:0", "--metrics_insecure")
    self.word_after(log, "metrics on ")

  def test_top_shows_the_whole_fleet_and_lost_workers(self):
    self.start_fleet()
    # The actor's polls report the server that only the actor knows.
    page = wait_until(lambda: (lambda page: page if "1 actor  2 servers  " in page else "")(self.top()), "all of them")
    self.assertRegex(page, r"(?m)^learner \S+ +ok ")
    self.assertRegex(page, r"(?m)^actor +\S+ +ok +\d+ +\d +[-\d] +\d+M +0 ")
    self.assertEqual(len(re.findall(r"(?m)^server +\S+ +ok ", page)), 2, page)
    self.assertIn(self.server, page)
    self.assertIn("1 actor  2 servers  0 errors", page)
    self.assertRegex(page, r"time: .*(update|inference) \d+%")
    self.registered.send_signal(signal.SIGKILL)
    wait_until(lambda: re.search(r"(?m)^server +\S+ +LOST ", self.top()), "a lost server")

  def top(self):
    page = self.run_program("craftfleet top", f"--address={self.learner}", "--once", "--width=80").stdout
    self.assertLessEqual(max(map(len, page.splitlines())), 80)
    return page

  def test_pages_are_printed_without_a_terminal(self):
    _, _, self.learner = self.start_learner()
    for begin, *command in (["craftfleet top", *built("craftfleet top")], ["role ", *built("craftfleet status"), "--watch"]):
      process = subprocess.Popen([*command, f"--address={self.learner}", "--interval=100ms"], stdout=subprocess.PIPE, text=True)
      lines = self.lines_of(process)
      pages = 0
      while pages < 3:
        line = next(lines)
        self.assertNotIn("\x1b", line)
        pages += line.startswith(begin)
      process.terminate()
      self.assertEqual(process.wait(timeout=10), 0 if begin == "craftfleet top" else -signal.SIGTERM)

  def test_a_learner_that_stops_ends_its_watchers_with_a_word(self):
    learner, _, self.learner = self.start_learner()
    watcher = subprocess.Popen([*built("craftfleet status"), "--watch", f"--address={self.learner}"], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)
    self.addCleanup(watcher.kill)
    watcher.stdout.readline()
    learner.terminate()
    _, errors = watcher.communicate(timeout=60)
    self.assertEqual((watcher.returncode, errors), (1, f"craftfleet status: {self.learner}: it has stopped, or cannot be reached\n"))

  def test_top_is_live_in_a_terminal_and_survives_its_learner(self):
    process, _, self.learner = self.start_learner()
    command = shlex.join([*map(str, built("craftfleet top")), f"--address={self.learner}", "--interval=100ms"])
    with Tmux(self.folder, command) as terminal:
      terminal.wait_for(f"craftfleet top  learner {self.learner}")
      terminal.wait_for("q quit  p pause  s sort (role)")
      for key, text in (("h", "page down: scroll"), ("h", "sort (role)"), ("s", "sort (name)"), ("r", "sort (name, reversed)"),
                        ("p", "craftfleet top PAUSED"), ("Space", "craftfleet top  learner")):
        terminal.press(key)
        terminal.wait_for(text)
      terminal.resize(60, 12)
      process.kill()
      terminal.wait_for("no status from the learner: ")
      terminal.press("q")
      terminal.wait_for_exit(0)

  def test_top_refuses_a_process_that_is_not_a_learner(self):
    _, log = self.start("craftfleet-envserver", "--listen=127.0.0.1:0")
    address = self.word_after(log, "listening on ")
    ended = subprocess.run([*built("craftfleet top"), f"--address={address}", "--once"], capture_output=True, text=True,
                           timeout=60)
    self.assertEqual(ended.returncode, 1)
    self.assertIn("want the learner", ended.stderr)

  def test_logs_as_json_are_one_object_a_line(self):
    process, log, self.learner = self.start_learner("--log_format=json")
    self.start("craftfleet-envserver", "--listen=127.0.0.1:0", "--learner=" + self.learner)
    process.terminate()
    process.wait(timeout=60)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    self.assertGreaterEqual(len(lines), 2)
    for line in lines:
      self.assertEqual(set(line), {"time", "level", "program", "message"})
      self.assertEqual((line["level"], line["program"]), ("info", "craftfleet-learner"))

  def test_quiet_logs_contain_only_errors(self):
    address = f"unix:{self.folder}/socket"
    process, log = self.start("craftfleet-envserver", f"--listen={address}", "--log_level=error", "--learner=127.0.0.1:1")
    wait_until((self.folder / "socket").exists, "it serves")
    self.run_program("craftfleet status", f"--address={address}")
    with self.assertRaises(subprocess.TimeoutExpired):
      process.wait(timeout=1)
    process.terminate()
    process.wait(timeout=60)
    self.assertEqual(log.read_text(), "")


if __name__ == "__main__":
  python_case.main()

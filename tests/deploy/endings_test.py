"""How programs end and which results they keep: a closed terminal, a closed output pipe, a full standard output."""

import json
import os
import signal
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import ENDLESS, built, wait_until

EXPERIMENT = python_case.SMALL_EXPERIMENT.replace("steps = 192", "steps = 1000000000")


class Endings(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    (self.folder / "config.txt").write_text(ENDLESS)

  def start(self, name, *flags, **options):
    """Starts a process with standard error in a file."""
    self.errors = self.folder / f"{name}.err"
    with open(self.errors, "w", encoding="utf-8") as errors:
      options = {"stdout": subprocess.DEVNULL, "stderr": errors, **options}
      process = subprocess.Popen([*built(name), *flags], **options)
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    return process

  def run_flags(self):
    return [f"--config={self.folder}/config.txt", f"--logdir={self.folder}/run"]

  def wait_for_text(self, text):
    wait_until(lambda: text in self.errors.read_text(), f"'{text}' in {self.errors}")

  def finished_run(self):
    return python_case.trained_run(self.folder / "run", python_case.SMALL_RUN)

  # A closed terminal.

  def test_hangup_stops_a_run_with_a_checkpoint(self):
    train = self.start("craftfleet train", *self.run_flags(), "--checkpoint_every=1000000")
    episodes = self.folder / "run/stats.jsonl"
    wait_until(lambda: episodes.exists() and episodes.read_text().count("\n") > 50, "50 episodes")
    train.send_signal(signal.SIGHUP)
    train.send_signal(signal.SIGHUP)  # the shell and the kernel both send it
    self.assertEqual(train.wait(20), 0, self.errors.read_text())
    self.assertIn("stopped; continue with --resume", self.errors.read_text())
    self.assertNotIn("trying again", self.errors.read_text())
    last = max(int(path.name.partition("-")[2]) for path in (self.folder / "run/checkpoints").iterdir())
    self.assertGreaterEqual(last, 50 * 20 // 64)

  def test_hangup_stops_workers(self):
    server = self.start("craftfleet-envserver", "--listen=127.0.0.1:0")
    self.wait_for_text("listening on")
    server.send_signal(signal.SIGHUP)
    self.assertEqual(server.wait(20), 0)
    actor = self.start("craftfleet-actor", "--learner=127.0.0.1:1")
    self.wait_for_text("status on")
    actor.send_signal(signal.SIGHUP)
    self.assertEqual(actor.wait(20), 0)

  def test_a_server_can_be_stopped_as_soon_as_it_says_that_it_listens(self):
    for _ in range(10):
      server = self.start("craftfleet-envserver", "--listen=127.0.0.1:0", stderr=subprocess.PIPE, text=True)
      with server.stderr as log:
        self.assertTrue(any("listening on" in line for line in log))
        server.send_signal(signal.SIGHUP)
        log.read()
      self.assertEqual(server.wait(20), 0)

  def test_under_nohup_a_hangup_is_ignored(self):
    server = self.start("craftfleet-envserver", "--listen=127.0.0.1:0",
                        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    self.wait_for_text("listening on")
    server.send_signal(signal.SIGHUP)
    with self.assertRaises(subprocess.TimeoutExpired):
      server.wait(1)
    server.terminate()
    self.assertEqual(server.wait(20), 0)

  def test_hangup_stops_a_sweep_and_its_runs(self):
    (self.folder / "experiments.toml").write_text(EXPERIMENT)
    sweep = self.start("craftfleet sweep", self.folder / "experiments.toml", "--seeds=1", f"--logdir={self.folder}/runs")
    wait_until(lambda: list(self.folder.glob("runs/**/iter-00000002")), "a checkpoint")
    sweep.send_signal(signal.SIGHUP)
    self.assertEqual(sweep.wait(30), 75, self.errors.read_text())  # as for any stopped sweep
    log = next(self.folder.glob("runs/**/log.txt")).read_text()
    self.assertIn("stopped; continue with --resume", log)

  # A closed output pipe.

  def close_output(self, process):
    """Reads the first line and closes the pipe, like head -1."""
    line = process.stdout.readline()
    process.stdout.close()
    return line

  def test_a_run_without_a_reader_continues(self):
    train = self.start("craftfleet train", *self.run_flags(), "--steps=1280", stdout=subprocess.PIPE)
    wait_until((self.folder / "run/checkpoints/iter-00000002").exists, "checkpoint 2")
    train.stdout.close()
    self.assertEqual(train.wait(60), 0, self.errors.read_text())
    self.assertIn("the run is complete", self.errors.read_text())

  def test_a_fleet_without_readers_continues(self):
    learner = self.start("craftfleet-learner", *self.run_flags(), "--steps=1280", "--listen=127.0.0.1:0",
                         stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    address = ""
    while not address:
      line = learner.stderr.readline()
      address = line.partition("listening on ")[2].strip()
    self.addCleanup(learner.stderr.close)
    workers = [self.start("craftfleet-envserver", "--listen=127.0.0.1:0", f"--learner={address}",
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE),
               self.start("craftfleet-actor", f"--learner={address}", "--envservers=learner", "--threads=1",
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE)]
    for process in [learner, *workers]:
      process.stdout.close()
    for worker in workers:
      worker.stderr.close()
    # The learner's log has no reader any more either.
    learner.stderr.close()
    self.assertEqual(learner.wait(60), 0)
    self.assertEqual(workers[1].wait(20), 0)
    workers[0].terminate()
    self.assertEqual(workers[0].wait(20), 0)

  def test_an_evaluation_without_a_reader_writes_its_result(self):
    evaluation = self.start("craftfleet eval", f"--checkpoint={self.finished_run()}", "--episodes=50",
                            f"--out={self.folder}/result.json", stdout=subprocess.PIPE)
    self.close_output(evaluation)
    self.assertEqual(evaluation.wait(60), 0, self.errors.read_text())
    self.assertEqual(json.loads((self.folder / "result.json").read_text())["episodes"], 50)

  def test_a_sweep_without_a_reader_continues(self):
    (self.folder / "experiments.toml").write_text(EXPERIMENT.replace("1000000000", "640"))
    sweep = self.start("craftfleet sweep", self.folder / "experiments.toml", "--seeds=2", f"--logdir={self.folder}/runs",
                       stdout=subprocess.PIPE)
    self.close_output(sweep)
    self.assertEqual(sweep.wait(90), 0, self.errors.read_text())
    logs = list(self.folder.glob("runs/**/log.txt"))
    self.assertEqual(len(logs), 2)
    for log in logs:
      self.assertIn("the run is complete", log.read_text())

  def test_pages_end_with_their_reader(self):
    self.start("craftfleet train", *self.run_flags(), "--listen=127.0.0.1:0")
    self.wait_for_text("listening on ")
    address = self.errors.read_text().partition("listening on ")[2].split()[0]
    for program, flags in (("craftfleet top", []), ("craftfleet status", ["--watch"])):
      with self.subTest(program):
        pages = self.start(program, f"--address={address}", "--interval=0.1", *flags, stdout=subprocess.PIPE)
        self.assertTrue(self.close_output(pages))
        self.assertIn(pages.wait(20), (0, -signal.SIGPIPE), self.errors.read_text())

  # A full standard output.

  def test_a_full_standard_output_is_an_error(self):
    run = self.finished_run()
    commands = [
        ["craftfleet", "--help"], ["craftfleet", "--version"], ["craftfleet agents"], ["craftfleet agents", "--json"],
        ["craftfleet envs", "--worlds=1"], ["craftfleet curve", run], ["craftfleet curve", "--help"],
        ["craftfleet curve", run, "--out=-"], ["craftfleet curve", run, "--out=/dev/full"],
        ["craftfleet eval", f"--checkpoint={run}", "--episodes=1"],
        ["craftfleet eval", f"--checkpoint={run}", "--episodes=1", "--out=-"],
        ["craftfleet train", f"--config={self.folder}/config.txt", f"--logdir={self.folder}/other"],
        ["craftfleet-learner", f"--config={self.folder}/config.txt", f"--logdir={self.folder}/other",
         "--listen=127.0.0.1:0"],
        ["craftfleet sweep", self.folder / "experiments.toml", "--list"],
    ]
    (self.folder / "experiments.toml").write_text(EXPERIMENT)
    for program, *arguments in commands:
      with self.subTest(program, arguments=arguments), open("/dev/full", "w", encoding="utf-8") as full:
        ended = subprocess.run([*built(program), *arguments], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
        self.assertEqual(ended.returncode, 1, ended.stderr)
        self.assertRegex(ended.stderr, "cannot write (all of )?(standard output|/dev/full)")
        self.assertEqual(ended.stderr.count("cannot write"), 1, ended.stderr)
    self.assertFalse((self.folder / "other/config.txt").exists(), "nothing is begun")

  def test_pages_on_a_full_standard_output_are_an_error(self):
    self.start("craftfleet train", *self.run_flags(), "--listen=127.0.0.1:0")
    self.wait_for_text("listening on ")
    address = self.errors.read_text().partition("listening on ")[2].split()[0]
    for program, *flags in (["craftfleet top"], ["craftfleet top", "--once"], ["craftfleet status"],
                            ["craftfleet status", "--json"], ["craftfleet status", "--watch"]):
      with self.subTest(program, flags=flags), open("/dev/full", "w", encoding="utf-8") as full:
        ended = subprocess.run([*built(program), f"--address={address}", *flags], stdout=full, stderr=subprocess.PIPE,
                               text=True, timeout=60)
        self.assertEqual(ended.returncode, 1, ended.stderr)
        self.assertIn("cannot write all of standard output", ended.stderr)

  # Targets of results.

  def test_results_go_where_they_are_asked_to(self):
    run = self.finished_run()
    png = b"\x89PNG\r\n\x1a\n"
    (self.folder / "real.png").write_bytes(b"old")
    (self.folder / "link.png").symlink_to("real.png")
    self.run_program("craftfleet curve", run, f"--out={self.folder}/link.png")
    self.assertTrue((self.folder / "link.png").is_symlink())
    self.assertEqual((self.folder / "real.png").read_bytes()[:8], png)
    for out in ("-", "/dev/stdout"):
      drawn = subprocess.run([*built("craftfleet curve"), run, f"--out={out}"], capture_output=True, timeout=60)
      self.assertEqual(drawn.stdout[:8], png, "the table is elsewhere")
      self.assertIn(b"run", drawn.stderr)
    evaluated = self.run_program("craftfleet eval", f"--checkpoint={run}", "--episodes=2", "--out=-")
    self.assertEqual(json.loads(evaluated.stdout)["episodes"], 2)
    self.assertIn("Crafter score", evaluated.stderr)
    os.mkfifo(self.folder / "fifo")
    with subprocess.Popen(["cat", self.folder / "fifo"], stdout=subprocess.PIPE) as cat:
      self.run_program("craftfleet curve", run, f"--out={self.folder}/fifo")
      self.assertEqual(cat.stdout.read()[:8], png)
    self.assertTrue((self.folder / "fifo").is_fifo())

  def test_a_target_that_cannot_be_written_is_refused_before_the_work(self):
    run = self.finished_run()
    for out, error in ((f"{self.folder}/none/a.png", "--out: cannot create"), (self.folder, "is a folder, want a file"),
                       ("a.jpg", "--out=a.jpg, want a file that ends in .png")):
      refused = self.run_program("craftfleet curve", run, f"--out={out}", code=1)
      self.assertIn(error, refused.stderr)
      self.assertEqual(refused.stdout, "", "nothing is drawn or printed")
    refused = self.run_program("craftfleet eval", f"--checkpoint={run}", f"--out={self.folder}", code=1)
    self.assertIn("--out: ", refused.stderr)
    self.assertEqual(refused.stdout, "", "nothing is played")


python_case.main()

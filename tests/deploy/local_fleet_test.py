"""deploy/local-fleet.sh: runs a fleet on this machine and leaves nothing behind."""

import os
import signal
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE, command_line, processes_with, wait_until


class LocalFleet(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    (self.folder / "config.txt").write_text(python_case.SMALL_RUN)

  def start(self, *flags, actors=2, envservers=2, steps=192, programs=BIN, **variables):
    process = subprocess.Popen(
        [SOURCE / "deploy/local-fleet.sh", f"--bin={programs}", f"--actors={actors}", f"--envservers={envservers}",
         f"--config={self.folder}/config.txt", f"--logdir={self.folder}/run", "--threads=1", f"--steps={steps}", *flags],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={"TMPDIR": str(self.folder), "PATH": "/usr/bin:/bin", **variables})
    self.addCleanup(process.stderr.close)
    self.addCleanup(process.kill)
    return process

  def wait_for_checkpoint(self, iteration):
    wait_until((self.folder / f"run/checkpoints/iter-{iteration:08}").exists, f"checkpoint {iteration}")

  def processes(self, program=""):
    return [pid for pid in processes_with(f"{self.folder}/") if f"{BIN}/craftfleet-{program}" in command_line(pid)]

  def expect_nothing_left(self):
    self.assertEqual(self.processes(), [])
    self.assertEqual(list(self.folder.glob("craftfleet.*")), [])

  def finish(self, process):
    errors = process.communicate(timeout=120)[1]
    return process.returncode, errors

  def test_ends_with_the_run_and_leaves_nothing_behind(self):
    code, errors = self.finish(self.start())
    self.assertEqual(code, 0, errors)
    self.assertIn("the run is complete", errors)
    self.wait_for_checkpoint(3)
    self.expect_nothing_left()
    self.assertEqual(sorted(log.name for log in (self.folder / "run/fleet").iterdir()),
                     ["actor-1.log", "actor-2.log", "envserver-1.log", "envserver-2.log"])

  def test_several_learners_end_with_the_run_and_at_sigterm(self):
    process = self.start("--learners=2", steps=1000000)
    self.wait_for_checkpoint(2)
    self.assertEqual(len(self.processes("learner")), 2)
    process.terminate()
    code, errors = self.finish(process)
    self.assertEqual(code, 0, errors)
    self.assertIn("rank 0 has stopped", (self.folder / "run/fleet/learner-1.log").read_text())
    self.expect_nothing_left()
    code, errors = self.finish(self.start("--learners=2", "--resume", steps=192))
    self.assertEqual(code, 0, errors)
    self.expect_nothing_left()

  def test_sigterm_stops_all_and_the_run_can_be_resumed(self):
    process = self.start(steps=1000000)
    self.wait_for_checkpoint(2)
    self.assertEqual(len(self.processes()), 5)
    process.terminate()
    code, errors = self.finish(process)
    self.assertEqual(code, 0, errors)
    self.assertIn("stopped; continue with --resume", errors)
    self.expect_nothing_left()
    code, errors = self.finish(self.start("--resume", steps=192))
    self.assertEqual(code, 0, errors)

  def test_ctrl_c_reaches_each_process_once(self):
    process = self.start(steps=1000000)
    self.wait_for_checkpoint(1)
    os.killpg(process.pid, signal.SIGINT)  # like a terminal, to the whole foreground group
    code, errors = self.finish(process)
    self.assertEqual(code, 0, errors)
    self.assertIn("stopped; continue with --resume", errors)
    self.expect_nothing_left()

  def test_the_fleet_ends_when_the_script_is_killed(self):
    process = self.start(steps=1000000)
    self.wait_for_checkpoint(1)
    process.kill()
    process.wait()
    wait_until(lambda: not self.processes(), "no process left")

  def test_a_lost_worker_is_named_and_the_others_continue(self):
    process = self.start(steps=1000000)
    self.wait_for_checkpoint(1)
    subprocess.run(["kill", "-KILL", str(self.processes("actor")[0])], check=True)
    line = wait_until(process.stderr.readline, "a line")
    while "ended with exit code 137" not in line:
      line = wait_until(process.stderr.readline, "the worker's end")
    self.assertRegex(line, r"actor-[12] ended with exit code 137")
    self.assertIsNone(process.poll())
    subprocess.run(["kill", "-KILL", str(self.processes("actor")[0])], check=True)
    code, errors = self.finish(process)
    self.assertEqual(code, 1, errors)
    self.assertIn("no actor or no environment server is left", errors)
    self.expect_nothing_left()

  def test_a_fleet_without_actors_ends_also_if_they_left_on_their_own(self):
    process = self.start(actors=1, steps=1000000, CRAFTFLEET_FLEET_PATIENCE="1")
    self.wait_for_checkpoint(1)
    actor, = self.processes("actor")
    os.kill(actor, signal.SIGTERM)
    code, errors = self.finish(process)
    self.assertEqual(code, 1, errors)
    self.assertIn("no actor or no environment server is left", errors)
    self.assertNotIn("ended with exit code", errors)
    self.expect_nothing_left()

  def stand_ins(self, **programs):
    """A folder of programs: their shell scripts by name."""
    folder = self.folder / "programs"
    folder.mkdir()
    for name, script in programs.items():
      (folder / f"craftfleet-{name}").write_text(f"#!/bin/sh\n{script}\n")
      (folder / f"craftfleet-{name}").chmod(0o755)
    return folder

  def test_actors_that_are_killed_together_are_all_named(self):
    waiting = "exec sleep 600"
    programs = self.stand_ins(learner=waiting, envserver=waiting, actor=f"echo $$ >>{self.folder}/actors\n{waiting}")
    process = self.start(actors=4, programs=programs)
    actors = self.folder / "actors"
    wait_until(lambda: actors.exists() and len(actors.read_text().split()) == 4, "four actors")
    subprocess.run(["kill", "-KILL", *actors.read_text().split()], check=True)
    code, errors = self.finish(process)
    self.assertEqual(code, 1, errors)
    self.assertEqual(errors.count("ended with exit code 137"), 4, errors)

  def test_a_learner_has_minutes_for_its_last_checkpoint(self):
    programs = self.stand_ins(learner=f"until [ -e {self.folder}/written ]; do sleep 0.1; done", envserver="exec sleep 600",
                              actor="exit 0")
    process = self.start(programs=programs)
    line = process.stderr.readline()
    while line and "workers have left" not in line:
      line = process.stderr.readline()
    self.assertIn("the learner has 300 s to write its last checkpoint", line)
    (self.folder / "written").touch()
    code, errors = self.finish(process)
    self.assertEqual(code, 0, errors)

  def test_flags_of_tls_reach_every_process(self):
    certs = self.folder / "certs"
    subprocess.run([SOURCE / "deploy/make-certs.sh", certs, "fleet"], check=True, capture_output=True)
    code, errors = self.finish(self.start(f"--tls_cert={certs}/fleet.pem", f"--tls_key={certs}/fleet.key", f"--tls_ca={certs}/ca.pem",
                                          "--tls_server_name=fleet", actors=1, envservers=1))
    self.assertEqual(code, 0, errors)
    self.assertIn("the run is complete", errors)
    self.expect_nothing_left()

  def test_bad_flags_are_refused_by_name(self):
    for flag, message in (("--actors=0", "--actors=0, want 1..999"), ("--listen=0.0.0.0:1", "its own Unix sockets"),
                          ("--learners=0", "--learners=0, want 1..999"), ("--rank=1", "give --learners=L"),
                          ("steps", "'steps' is not a flag"), ("--bin=/nowhere", "/nowhere/craftfleet-learner does not exist")):
      code, errors = self.finish(self.start(flag))
      self.assertEqual(code, 2, errors)
      self.assertIn(message, errors)
    code, errors = self.finish(self.start("--lanse=3"))
    self.assertEqual(code, 1, errors)
    self.assertIn("lanse", errors)
    self.expect_nothing_left()


python_case.main()

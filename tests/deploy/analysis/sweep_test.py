"""Plans of craftfleet sweep, its child processes, and its array job."""

import contextlib
import errno
import fcntl
import io
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import types
import unittest
import unittest.mock

from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE, built, wait_until

os.environ["CRAFTFLEET_BIN"] = str(BIN)
sys.path.insert(0, str(SOURCE / "deploy/python/craftfleet"))

from analysis import experiments, programs, slurm, sweep_jobs, sweep_plan  # noqa: E402  pylint: disable=wrong-import-position
from analysis import sweep as sweep_command  # noqa: E402  pylint: disable=wrong-import-position
from analysis._cli import Refusal  # noqa: E402  pylint: disable=wrong-import-position

# Two cells of 128 steps.
FILE = python_case.SMALL_EXPERIMENT.replace("steps = 192", "steps = 128").replace(
    'name = "small"', 'name = "t"\naxes = [{ axis = "gamma" }]') + """
[[axes]]
name = "gamma"
choices = [{ name = "a" }, { name = "b", config = { ppo.gamma = %s } }]
"""
TEXTURES = "9e107d9d372bb682"  # that every job is to have
# Stands in for craftfleet train: appends its arguments to LOGDIR/starts, then makes the files that a sweep reads, with the checkpoints
# of TRAINED. FAKE_TRAIN: "half": those of half of the steps; "wait": the same, then waits for SIGHUP; "fail2": seed 2 fails.
FAKE_TRAIN = """#!/usr/bin/env python3
import os, pathlib, shutil, signal, sys
mode = os.environ.get("FAKE_TRAIN", "")
flags = dict(word.lstrip("-").partition("=")[::2] for word in sys.argv[1:])
run = pathlib.Path(flags["logdir"])
with open(run / "starts", "a") as file:
  file.write(" ".join(sys.argv[1:]) + "\\n")
if mode == "fail2" and flags.get("seed") == "2":
  print("the last line says why\\n")
  sys.exit(3)
signal.signal(signal.SIGHUP, lambda *_: sys.exit(0))
if "resume" not in flags:
  (run / "config.txt").write_text(pathlib.Path(flags["config"]).read_text() + f"seed: {flags['seed']}\\n")
steps = int(flags["steps"]) // (2 if mode in ("half", "wait") else 1)
(run / "checkpoints").mkdir(exist_ok=True)
for checkpoint in [f"iter-{number:08}" for number in range(1, steps // 64 + 1)]:
  if not (run / "checkpoints" / checkpoint).exists():  # at once, as the sweep may look any time
    shutil.copytree(pathlib.Path(os.environ["TRAINED"]) / "checkpoints" / checkpoint, run / "copy")
    (run / "copy").rename(run / "checkpoints" / checkpoint)
if mode == "wait":
  signal.pause()
"""


class Lines:
  """Collects what a sweep prints."""

  def __init__(self):
    self.text = ""

  def write(self, text):
    self.text += text

  def flush(self):
    pass


class Sweep(python_case.FolderCase):

  @classmethod
  def setUpClass(cls):
    super().setUpClass()
    temp = tempfile.TemporaryDirectory(prefix="craftfleet-")
    cls.addClassCleanup(temp.cleanup)
    os.environ["TRAINED"] = f"{temp.name}/run"
    python_case.trained_run(os.environ["TRAINED"], python_case.SMALL_RUN, "--steps=128")

  def setUp(self):
    super().setUp()
    self.program = self.folder / "fake_train"
    self.program.write_text(FAKE_TRAIN)
    self.program.chmod(0o755)
    self.out = Lines()
    self.set_mode("")

  def set_mode(self, mode):
    os.environ["FAKE_TRAIN"] = mode

  def jobs(self, seeds, gamma=0.5):
    cells = sweep_plan.select_cells(experiments.parse(FILE % gamma, "file.toml"), [], [])
    return sweep_plan.plan(cells, str(self.folder / "runs"), seeds, TEXTURES)

  def make(self, seeds=1, gamma=0.5, program=None):
    return sweep_jobs.Sweep(self.jobs(seeds, gamma), [str(program or self.program)], dict(os.environ), 2, self.out,
                            look_again=0.05)

  def fails(self, made):
    with self.assertRaises(Refusal) as caught:
      made.run()
    return str(caught.exception)

  def starts(self, run):
    path = self.folder / "runs/t" / run / "starts"
    return path.read_text().splitlines() if path.exists() else []

  def state(self, run):
    return sweep_plan.states([job for job in self.jobs(3) if job.name == f"t/{run}"])[0]

  def test_runs_every_cell_with_every_seed_and_none_again(self):
    self.make(2).run()
    for run in ("a/seed1", "a/seed2", "b/seed1", "b/seed2"):
      self.assertEqual(len(self.starts(run)), 1, run)
      self.assertNotIn("--resume", self.starts(run)[0])
      self.assertTrue((self.folder / "runs/t" / run / "log.txt").exists())
      self.assertTrue(self.state(run).finished)
    self.assertIn("4 done, 0 running, 0 left, 0 failed | 512/512 steps", self.out.text)
    self.make(3).run()
    self.assertEqual((len(self.starts("a/seed1")), len(self.starts("a/seed3"))), (1, 1))
    self.assertIn("6 runs, of which 4 are done already; 2 at a time", self.out.text)

  def test_resumes_unfinished_runs(self):
    self.set_mode("half")
    self.assertEqual(self.fails(self.make()), "2 of 2 runs failed")
    self.assertIn("FAILED: t/a/seed1: it ended at 64 of 128 steps; see ", self.out.text)
    self.set_mode("")
    self.make().run()
    self.assertEqual(len(self.starts("b/seed1")), 2)
    self.assertIn("--resume --steps=128", self.starts("b/seed1")[1])

  def test_a_failed_run_is_reported_with_its_last_line_and_stops_no_other(self):
    self.set_mode("fail2")
    self.assertEqual(self.fails(self.make(3)), "2 of 6 runs failed")
    self.assertIn("FAILED: t/a/seed2: exit code 3: the last line says why (", self.out.text)
    self.assertEqual(len(self.starts("b/seed3")), 1)
    self.assertIn("4 done, 0 running, 0 left, 2 failed", self.out.text)

  def test_an_error_of_the_system_fails_one_run(self):
    def check(job):
      if job.name == "t/a/seed1":
        raise OSError(errno.ENOMEM, "Cannot allocate memory")
    made = self.make()
    with unittest.mock.patch.object(sweep_jobs, "check_configuration", check):
      self.assertEqual(self.fails(made), "1 of 2 runs failed")
    self.assertIn("FAILED: t/a/seed1: Cannot allocate memory\n", self.out.text)
    made._stages["t/a/seed1"] = "running"  # pylint: disable=protected-access
    with unittest.mock.patch.object(programs, "ask", side_effect=OSError(errno.ENOMEM, "Cannot allocate memory")):
      self.assertIn("1 done, 1 running", made._progress(0))  # pylint: disable=protected-access

  def test_stop_ends_its_runs_and_waits(self):
    self.set_mode("wait")
    made, ended = self.make(2), []
    def run():
      try:
        made.run()
      except sweep_jobs.Stopped as stopped:
        ended.append(str(stopped))
    thread = threading.Thread(target=run)
    thread.start()
    wait_until(lambda: self.state("a/seed1").begun and self.state("b/seed1").begun, "two runs")
    made.stop()
    thread.join()
    self.assertEqual(ended, ["stopped with 0 of 4 runs done; the same command resumes the sweep"])
    self.assertEqual(self.starts("a/seed2"), [])
    self.assertEqual(sweep_jobs.folder_user(str(self.folder / "runs/t/a/seed1")), "")

  def test_waits_for_a_folder_that_another_process_uses(self):
    folder = self.folder / "runs/t/a/seed1"
    folder.mkdir(parents=True)
    with open(folder / "lock", "w", encoding="utf-8") as lock:
      lock.write("process 1 on here\n")
      lock.flush()
      fcntl.flock(lock, fcntl.LOCK_EX)
      thread = threading.Thread(target=self.make().run)
      thread.start()
      wait_until(lambda: self.state("b/seed1").finished, "the other run")
      self.assertEqual(self.starts("a/seed1"), [])
      self.assertIn(f"waits: run folder {folder} is in use by process 1 on here", self.out.text)
    thread.join()
    self.assertEqual(len(self.starts("a/seed1")), 1)

  def test_refuses_a_folder_with_another_configuration(self):
    self.set_mode("half")
    self.fails(self.make())
    self.set_mode("")
    self.fails(self.make(gamma=0.6))
    self.assertIn("FAILED: t/b/seed1: ", self.out.text)
    self.assertIn("is not this cell's configuration", self.out.text)
    self.assertEqual(len(self.starts("b/seed1")), 1)

  def test_a_finished_run_of_another_configuration_is_not_done(self):
    self.make().run()
    self.fails(self.make(gamma=0.6))
    self.assertIn("2 runs, of which 1 is done already", self.out.text)
    self.assertIn("FAILED: t/b/seed1: ", self.out.text)
    self.assertIn("t/b/seed1/config.txt is not this cell's configuration", self.out.text)
    with contextlib.redirect_stderr(io.StringIO()) as warnings:
      self.assertEqual([state.finished for state in sweep_plan.states_or_none(self.jobs(1, 0.6))], [True, False])
    self.assertIn("warning: t/b/seed1: ", warnings.getvalue())
    self.assertEqual(len(self.starts("b/seed1")), 1)

  def test_a_finished_run_with_other_textures_is_not_done(self):
    self.make().run()
    for cell, digest in (("a", TEXTURES), ("b", "8140aa54698876d7")):
      (self.folder / f"runs/t/{cell}/seed1/run.json").write_text(f'{{"texture_digest": "{digest}"}}')
    self.assertEqual(self.fails(self.make()), "1 of 2 runs failed")
    self.assertIn("2 runs, of which 1 is done already", self.out.text)
    self.assertIn(f"t/b/seed1/run.json: the run has textures 8140aa54698876d7, want {TEXTURES}: use another", self.out.text)
    self.assertEqual(len(self.starts("b/seed1")), 1)

  def test_a_log_that_cannot_be_opened_is_named(self):
    (self.folder / "runs/t/a/seed1/log.txt").mkdir(parents=True)
    self.assertEqual(self.fails(self.make()), "1 of 2 runs failed")
    self.assertIn(f"FAILED: t/a/seed1: cannot open {self.folder}/runs/t/a/seed1/log.txt: Is a directory\n", self.out.text)

  def test_a_missing_program_fails_every_run(self):
    self.fails(self.make(program="/nowhere/craftfleet"))
    self.assertIn("cannot start /nowhere/craftfleet: No such file or directory", self.out.text)


class Plan(python_case.FolderCase):
  TWO = """
axes = [{ name = "x", choices = [{ name = "a" }, { name = "ab", config = { ppo.gamma = 0.5 } }] },
        { name = "y", choices = [{ name = "c" }, { name = "d", config = { ppo.clip = 0.1 } }] }]
experiments = [{ name = "t", axes = [{ axis = "x" }, { axis = "y" }] }, { name = "u", axes = [{ axis = "x" }] }]
"""

  def setUp(self):
    super().setUp()
    self.file = experiments.parse(self.TWO, "f")

  def select(self, names, cells):
    return [f"{cell.experiment}/{cell.name}" for cell in sweep_plan.select_cells(self.file, names, cells)]

  def test_selects_cells_by_experiment_name_and_first_parts(self):
    self.assertEqual(self.select([], []), ["t/a/c", "t/a/d", "t/ab/c", "t/ab/d", "u/a", "u/ab"])
    self.assertEqual(self.select(["u"], []), ["u/a", "u/ab"])
    self.assertEqual(self.select([], ["a"]), ["t/a/c", "t/a/d", "u/a"])
    self.assertEqual(self.select(["t"], ["ab/d", "a/c"]), ["t/a/c", "t/ab/d"])
    for names, cells, message in ((["v"], [], "--experiment=v, want one of t, u"), (["u"], ["a/c"], "--cell=a/c, want a cell that --list names")):
      with self.assertRaises(Refusal) as caught:
        self.select(names, cells)
      self.assertEqual(str(caught.exception), message)

  def test_a_list_looks_at_all_runs_at_once(self):
    with (unittest.mock.patch.object(programs, "ask", wraps=programs.ask) as ask,
          contextlib.redirect_stdout(io.StringIO()) as shown):
      for steps in (0, 5000):
        sweep_command._list(sweep_plan.select_cells(self.file, ["u"], ["a"]),  # pylint: disable=protected-access
                            types.SimpleNamespace(logdir=str(self.folder), seeds=2, steps=steps), TEXTURES)
        self.assertEqual(ask.call_count, 1)
        ask.reset_mock()
    self.assertRegex(shown.getvalue(), r"^u/a +1000000 steps   0 of 2 done .*\n1 cells\nu/a +5000 steps ")

  def test_every_cell_is_run_once_with_each_seed(self):
    jobs = sweep_plan.plan(sweep_plan.select_cells(self.file, [], []), "/runs", 2, TEXTURES, 5000, ["--threads=3"])
    self.assertEqual([job.name for job in jobs], [f"t/{cell}/seed{seed}" for seed in (1, 2) for cell in ("a/c", "a/d", "ab/c", "ab/d")])
    job = jobs[6]
    self.assertEqual((job.folder, job.config_path, job.steps), ("/runs/t/ab/c/seed2", "/runs/t/ab/c/cell.txt", 5000))
    shared = ["--steps=5000", "--logdir=/runs/t/ab/c/seed2", "--threads=3"]
    self.assertEqual(job.start, ["--config=/runs/t/ab/c/cell.txt", "--seed=2", *shared])
    self.assertEqual(job.resume, ["--resume", *shared])
    self.assertEqual(job.config_text, "# t, ab/c; values that are not given have their defaults.\nppo {\n  gamma: 0.5\n}\n")
    self.assertEqual(job.texture_digest, TEXTURES)
    self.assertEqual(sweep_plan.plan(sweep_plan.select_cells(self.file, [], []), "/runs", 1, TEXTURES)[0].steps, 1000000)

  def test_a_run_that_is_named_twice_is_run_once(self):
    jobs = sweep_plan.plan(sweep_plan.select_cells(self.file, [], []), "/runs", 1, TEXTURES)
    named = sweep_command._named_runs(jobs, ["t/ab/c/seed1", "t/a/c/seed1", "t/ab/c/seed1"])  # pylint: disable=protected-access
    self.assertEqual([job.name for job in named], ["t/ab/c/seed1", "t/a/c/seed1"])

  def test_the_folder_has_the_cells_file(self):
    job = sweep_plan.plan(sweep_plan.select_cells(self.file, [], []), str(self.folder), 1, TEXTURES)[0]
    for text in (None, "other"):
      if text:
        pathlib.Path(job.config_path).write_text(text)
      sweep_plan.prepare_folder(job)
      self.assertEqual(pathlib.Path(job.config_path).read_text(), job.config_text)

  def test_cells_want_their_textures(self):
    file = experiments.parse('axes = [{ name = "x", choices = [{ name = "a" }, { name = "b", texture_digest = "8140aa54698876d7" }] }]\n'
                             'experiments = [{ name = "t", axes = [{ axis = "x" }] }]', "f")
    cells = sweep_plan.select_cells(file, [], [])
    self.assertEqual([cell.name for cell in sweep_plan.cells_with_textures(cells, "8140aa54698876d7")], ["a", "b"])
    self.assertEqual([cell.name for cell in sweep_plan.cells_with_textures(cells, "0")], ["a"])
    self.assertEqual([job.texture_digest for job in sweep_plan.plan(cells, "/runs", 1, "0")], ["0", "8140aa54698876d7"])
    with self.assertRaises(Refusal) as caught:
      sweep_plan.cells_with_textures(cells[1:], "0")
    self.assertIn("cell t/b wants textures 8140aa54698876d7, not 0: give their folder with --textures", str(caught.exception))

  def test_written_configurations_are_complete_ones_again(self):
    self.run_program("craftfleet sweep", str(SOURCE / "deploy/experiments/paper.toml"), f"--write_configs={self.folder}", "--experiment=ablation")
    cells = next(experiment for experiment in experiments.load(str(SOURCE / "deploy/experiments/paper.toml")) if experiment.name == "ablation").cells
    self.assertEqual(len(list(self.folder.rglob("*.txt"))), len(cells))
    for cell in cells:
      path = self.folder / f"ablation/{cell.name}.txt"
      answer, = programs.ask([{"config": path.read_text()}])
      self.assertEqual(answer["config"], cell.config)


class SlurmArray(python_case.FolderCase):

  def run_task(self, task, srun_exit=0, state="RUNNING"):
    """Task of the script with stand-ins for Slurm's commands: srun and scontrol print their arguments, squeue prints `state`."""
    programs = (f"srun() {{ printf '[%s]' \"$@\"; return {srun_exit}; }}\nsqueue() {{ echo {state}; }}\n"
                "scontrol() { echo scontrol \"$@\"; }\nexec() { \"$@\"; exit; }\n")
    command = ["/bin/craftfleet", "sweep", "/it's here/paper.toml", "--logdir=/runs"]
    (self.folder / "script").write_text(programs + slurm.script("/runs/slurm", 5, 2, command, ["t/a/seed1", "t/b c/seed1"]))
    ended = subprocess.run(["bash", self.folder / "script"], capture_output=True, text=True, check=False, env=os.environ | {
        "SLURM_ARRAY_JOB_ID": "7", "SLURM_CPUS_PER_TASK": "2", "SLURM_ARRAY_TASK_ID": str(task)})
    return ended.stdout, ended.returncode

  def test_each_task_runs_its_own_run(self):
    self.assertEqual(self.run_task(0), ("[--cpu-bind=none][/bin/craftfleet][sweep][/it's here/paper.toml][--logdir=/runs]"
                                        "[--run=t/a/seed1][--threads=2]", 0))
    self.assertIn("[--run=t/b c/seed1]", self.run_task(1)[0])

  def test_only_a_task_that_slurm_stops_is_requeued(self):
    self.assertTrue(self.run_task(1, slurm.STOPPED)[0].endswith("scontrol requeue 7_1\n"))
    self.assertEqual(self.run_task(1, 1)[1], 1)
    self.assertEqual(self.run_task(1, slurm.STOPPED, "COMPLETING")[1], 75)


class Commands(unittest.TestCase):

  def test_help_errors_and_start_up(self):
    for name in ("curve", "report", "sweep"):
      program = built(f"craftfleet {name}")
      shown = subprocess.run([*program, "--help"], capture_output=True, text=True, check=True).stdout
      self.assertTrue(shown.startswith(f"craftfleet {name} "), shown)
      self.assertLessEqual(shown.count("\n"), 40, "it fits a screen")
      refused = subprocess.run([*program, "--ou=x"], capture_output=True, text=True, check=False)
      self.assertEqual(refused.returncode, 1)
      self.assertIn(f"craftfleet {name}: unknown flag 'ou'", refused.stderr)
    for words, message in ((["report", "--html=x"], "--html=x, want true or false"), (["sweep", "--seeds=x"], "--seeds=x, want a whole number"),
                           (["report", "--out"], "--out needs a value"), (["report", "--outt=a"], "(did you mean --out?)")):
      refused = subprocess.run([BIN / "craftfleet", *words], capture_output=True, text=True, check=False)
      self.assertIn(message, refused.stderr)


class Program(python_case.FolderCase):
  """craftfleet sweep and what craftfleet report makes of its runs."""

  def setUp(self):
    super().setUp()
    self.file = self.folder / "t.toml"
    self.file.write_text(FILE % 0.5)

  def arguments(self, *more):
    return [self.file, "--seeds=2", "--jobs=2", f"--logdir={self.folder}/runs", *more]

  def sweep(self, *more, code=0):
    return self.run_program("craftfleet sweep", *self.arguments(*more), code=code)

  def start(self, *more, before=()):
    process = subprocess.Popen([*before, *built("craftfleet sweep"), *self.arguments(*more)], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)
    self.addCleanup(process.communicate)
    self.addCleanup(process.kill)
    wait_until(lambda: list(self.folder.glob("runs/**/log.txt")), "the first run")
    return process

  def test_a_killed_sweep_is_finished_once_and_reported(self):
    self.start().kill()  # its children continue, or are resumed
    self.assertIn("4 done, 0 running, 0 left, 0 failed | 512/512 steps", self.sweep().stdout)
    folders = [self.folder / "runs/t" / cell / seed for cell in "ab" for seed in ("seed1", "seed2")]
    logs = [(folder / "log.txt").read_text() for folder in folders]
    self.assertEqual(self.sweep("--list").stdout.count("2 of 2 done"), 2)
    again = self.sweep()
    self.assertIn("4 runs, of which 4 are done already", again.stdout)
    self.assertNotIn("begins", again.stdout)
    self.assertEqual([(folder / "log.txt").read_text() for folder in folders], logs)

    runs, experiments = f"{self.folder}/runs", f"--experiments={self.file}"
    report = self.run_program("craftfleet report", runs, experiments, f"--out={self.folder}/report")
    self.assertIn("4 runs, 4 complete", report.stdout)
    text = (self.folder / "report/report.md").read_text()
    self.assertIn("2 of 2 configurations have a complete run (2 cells", text)
    page = self.run_program("craftfleet report", runs, experiments, "--out=-")
    self.assertEqual(page.stdout, text)
    self.assertIn("4 runs, 4 complete; report.md written to standard output", page.stderr)
    damaged = folders[0] / "config.txt"
    damaged.write_text("no configuration")
    rest = self.run_program("craftfleet report", runs, "--out=-").stderr
    self.assertIn(f"warning: left out: {damaged}", rest)
    self.assertIn("3 runs, 3 complete; 1 more", rest)
    self.assertIn(str(damaged), self.run_program("craftfleet report", folders[0], "--out=-", code=1).stderr)

  def test_sigterm_stops_its_runs_and_the_same_command_resumes(self):
    sweep = self.start("--steps=100000")
    sweep.terminate()
    self.assertEqual(sweep.wait(60), 75)
    self.assertIn("stopped with 0 of 4 runs done; the same command resumes the sweep", sweep.stderr.read())
    self.assertIn("0 of 2 done", self.sweep("--list", "--steps=100000").stdout)
    self.sweep()

  # As from Slurm and systemd; under nohup a run would inherit that SIGHUP, which stops it, is ignored.
  def test_sigterm_to_the_sweep_and_its_run_stops_the_run_with_a_checkpoint(self):
    self.file.write_text((FILE % 0.5).replace("every_iterations = 1", "every_iterations = 10000"))
    sweep = self.start("--steps=1000000000", "--cell=a", "--jobs=1", before=["nohup"])
    run = self.folder / "runs/t/a/seed1"
    wait_until(lambda: (run / "stats.jsonl").exists() and (run / "stats.jsonl").stat().st_size, "an iteration")
    (train,) = python_case.processes_with(f"--logdir={run}")
    for process in (train, sweep.pid):
      os.kill(process, signal.SIGTERM)
    self.assertEqual(sweep.wait(60), 75)
    self.assertGreater(max(path.name for path in (run / "checkpoints").iterdir()), "iter-00000000")

  def test_a_dry_run_only_prints_the_commands(self):
    textures = self.folder / "two words"
    textures.symlink_to(SOURCE / "envserver/textures")
    out = self.sweep("--dry_run", "--cell=b", "--threads=1", f"--textures={textures}").stdout
    self.assertIn(f"craftfleet train --config={self.folder}/runs/t/b/cell.txt --seed=2 --steps=128 "
                  f"--logdir={self.folder}/runs/t/b/seed2 --threads=1 '--textures={textures}'\n", out)
    self.assertNotIn("/t/a/", out)
    self.assertFalse((self.folder / "runs").exists())

  def test_sbatch_gets_its_flags_and_nothing_of_this_python(self):
    (self.folder / "sbatch").write_text("#!/bin/sh\nprintf '[%s]' \"$@\"\nenv\n")
    (self.folder / "sbatch").chmod(0o755)
    ended = subprocess.run(
        [*built("craftfleet sweep"), *self.arguments("--executor=slurm", "--slurm_flags=--comment='two words' --mem=8G")], capture_output=True,
        text=True, check=False, env=os.environ | {"PATH": f"{self.folder}:{os.environ['PATH']}", "CRAFTFLEET_SECOND_PYTHON": "1"})
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertIn("[--comment=two words][--mem=8G][", ended.stdout)
    self.assertNotIn("CRAFTFLEET_SECOND_PYTHON", ended.stdout)

  def test_bad_arguments_are_named(self):
    for program, arguments, error in (
        ("sweep", [], "name one file with experiments"), ("sweep", ["/nowhere.toml"], "/nowhere.toml"),
        ("sweep", [self.file], "--logdir is missing"), ("sweep", self.arguments("--jobs=0"), "--jobs=0, want 1..1000"),
        ("sweep", self.arguments("--slurm_flags='"), "--slurm_flags=': No closing quotation"),
        ("sweep", self.arguments("--experiment=x"), "--experiment=x, want one of t"),
        ("report", ["--out=r"], "name at least one folder with runs"), ("report", ["/nowhere", "--out=r"], "/nowhere: no such folder"),
        ("report", [self.folder], "--out is missing"),
        ("report", ["/nowhere", f"--out={self.file}"], "is not a folder; want a folder")):
      refused = self.run_program(f"craftfleet {program}", *arguments, code=1)
      self.assertIn(error, refused.stderr)
      if "is not a folder" in error:
        self.assertNotIn("no such folder", refused.stderr)


python_case.main()

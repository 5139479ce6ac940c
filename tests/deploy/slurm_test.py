"""deploy/slurm and `craftfleet sweep --executor=slurm` on a real Slurm that the test starts and stops."""

import subprocess

from tests.deploy.slurm_cluster import SlurmCluster, why_not
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE, built, wait_until

SCRIPT = SOURCE / "deploy/slurm/fleet.sbatch"
# 2 actors and 2 environment servers, small enough for three nodes on one machine.
PARTS = ["--cpus-per-task=1", "--mem-per-cpu=500", ":", "--ntasks=2", "--mem-per-cpu=500", ":", "--ntasks=2", "--mem-per-cpu=500"]
TWO_LEARNERS = ["--ntasks=2", "--cpus-per-task=1", "--mem-per-cpu=500", ":", "--ntasks=1", "--mem-per-cpu=500", ":", "--ntasks=1", "--mem-per-cpu=500"]
ENDS = ("COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY")
ODD = 'größe 50% b, 9%j "q"'  # of a folder
EXPERIMENTS = python_case.SMALL_EXPERIMENT.replace('name = "small"', 'name = "small"\naxes = [{ axis = "gamma" }]') + """
[[axes]]
name = "gamma"
choices = [{ name = "gamma=0.9", config = { ppo.gamma = 0.9 } }, { name = "gamma=0.5", config = { ppo.gamma = 0.5 } }]
"""


class Slurm(python_case.FolderCase):

  def setUp(self):
    reason = why_not()
    if reason:
      self.skipTest(reason)
    super().setUp()
    self.logdir = self.folder / "run"
    (self.folder / "config.txt").write_text(python_case.SMALL_RUN)
    # A checkout's layout around the programs of this build.
    self.root = self.folder / "root"
    (self.root / "build").mkdir(parents=True)
    (self.root / "build/bin").symlink_to(BIN)
    (self.root / "deploy").symlink_to(SOURCE / "deploy")
    self.cluster = SlurmCluster()
    self.cluster.env["CRAFTFLEET_ROOT"] = str(self.root)
    self.cluster.__enter__()
    self.addCleanup(self.cluster.__exit__)

  def sbatch(self, *arguments):
    out = self.cluster.run("sbatch", "--parsable", f"--output={self.folder}/job-%j.log", *arguments).stdout
    return out.strip().split(";")[0]

  def submit_fleet(self, steps, *flags, parts=tuple(PARTS)):
    return self.sbatch(*parts, SCRIPT, f"--config={self.folder}/config.txt", f"--logdir={self.logdir}", f"--steps={steps}",
                       "--threads=1", *flags)

  def job_log(self):
    return "\n".join(file.read_text(errors="replace") for file in
                     [*self.folder.glob("job-*.log"), *sorted((self.logdir / "fleet").glob("*.log"))])

  def wait_for_checkpoint(self, iteration, logdir=None):
    path = (logdir or self.logdir) / f"checkpoints/iter-{iteration:08}"
    try:
      wait_until(path.exists, f"checkpoint {iteration}", seconds=120)
    except AssertionError as error:
      raise AssertionError(f"{error}\n{self.job_log()}\n{self.cluster.logs()}") from None

  def expect_state(self, job, state):
    try:
      ended = self.cluster.wait_for_state(job, state, *ENDS)
      if ended != state:
        raise AssertionError(f"job {job} is {ended}, want {state}")
    except AssertionError as error:
      raise AssertionError(f"{error}\n{self.job_log()}\n{self.cluster.logs()}") from None

  def expect_bytes_of_one_process(self, steps):
    alone = self.folder / "alone"
    subprocess.run([*built("craftfleet train"), f"--config={self.folder}/config.txt", f"--logdir={alone}", f"--steps={steps}",
                    "--threads=1"], check=True, capture_output=True, timeout=200)
    self.assertEqual((self.logdir / "stats.jsonl").read_bytes(), (alone / "stats.jsonl").read_bytes())

  def test_a_fleet_of_three_components_gives_the_bytes_of_one_process(self):
    self.logdir = self.folder / ODD / "fleet 9%A"  # which is in options of Slurm
    job = self.submit_fleet(steps=192)
    self.expect_state(job, "COMPLETED")
    self.assertIn("2 actors, 2 environment servers", self.job_log())
    self.assertIn("the run is complete", self.job_log())
    self.assertNotIn("--insecure", self.job_log())
    self.assertTrue(list(self.logdir.glob("fleet/*.learner.log")))
    self.assertFalse((self.logdir / "fleet/tls/ca.key").exists())
    self.expect_bytes_of_one_process(steps=192)

  def test_a_fleet_with_two_learners_gives_the_bytes_of_one_process(self):
    job = self.submit_fleet(192, "--log_format=json", parts=TWO_LEARNERS)  # the script reads the learner's address in its log
    self.expect_state(job, "COMPLETED")
    self.assertIn("2 ranks share the updates out", self.job_log())
    self.expect_bytes_of_one_process(steps=192)

  def use_a_wheel(self):
    """Replaces the checkout by the layout of a Python environment with the wheel."""
    root = self.folder / "venv"
    share = root / "share/craftfleet"
    share.mkdir(parents=True)
    (root / "bin").symlink_to(BIN)
    for name in ("make-certs.sh", "slurm"):
      (share / name).symlink_to(SOURCE / "deploy" / name)
    self.cluster.env["CRAFTFLEET_ROOT"] = str(root)

  def test_a_preempted_fleet_is_requeued_and_resumes_as_if_never_stopped(self):
    self.use_a_wheel()
    job = self.submit_fleet(steps=10240)  # long enough to be going on still when the urgent job comes
    self.wait_for_checkpoint(2)
    urgent = self.sbatch("--partition=high", "--nodes=3", "--exclusive", "--wrap=sleep 1")
    self.expect_state(urgent, "COMPLETED")
    self.assertIn("stopped; continue with --resume", self.job_log())
    self.assertIn("requeueing the job", self.job_log())
    self.expect_state(job, "COMPLETED")
    self.assertEqual(self.cluster.job(job)["Restarts"], "1")
    self.assertIn("resumes after iteration", self.job_log())
    self.expect_bytes_of_one_process(steps=10240)

  def command_lines(self, program):
    lines = [python_case.command_line(pid).split() for pid in python_case.processes_with(str(self.logdir))]
    return [line for line in lines if line and line[0].endswith(program)]

  def test_scancel_ends_a_fleet_for_good(self):
    job = self.submit_fleet(steps=1000000)
    self.wait_for_checkpoint(1)
    for program in ("craftfleet-actor", "craftfleet-envserver"):
      workers = self.command_lines(program)
      self.assertEqual(len(workers), 2)
    self.cluster.run("scancel", job)
    self.expect_state(job, "CANCELLED")
    wait_until(lambda: self.cluster.run("squeue", "-h").stdout == "", "an empty queue")
    self.assertNotIn("requeueing the job", self.job_log())
    self.assertEqual(python_case.processes_with(str(self.logdir)), [])

  def test_a_job_names_what_is_missing(self):
    self.expect_state(self.sbatch(*PARTS, SCRIPT), "FAILED")
    self.assertIn("--logdir is missing", self.job_log())
    self.expect_state(self.sbatch(*PARTS, SCRIPT, "--logdir=x", "--log_level=error"), "FAILED")
    self.assertIn("--log_level=error: want --log_level=info", self.job_log())
    self.cluster.env["CRAFTFLEET_ROOT"] = str(self.folder)
    self.expect_state(self.sbatch(*PARTS, SCRIPT, "--logdir=x"), "FAILED")
    self.assertIn(f"{self.folder}/build/bin/craftfleet-learner does not exist", self.job_log())
    self.assertIn("submit this script with sbatch", self.cluster.run("bash", SCRIPT, "--logdir=x", check=False).stderr)

  def sweep(self, *flags, runs="runs", check=True):
    return self.cluster.run(*built("craftfleet sweep"), self.folder / "experiments.toml", "--seeds=2", "--executor=slurm",
                            f"--logdir={self.folder}/{runs}", "--jobs=10", "--slurm_flags=--mem-per-cpu=400 --parsable", *flags,
                            check=check)

  def test_the_folder_of_a_sweep_may_have_an_odd_name(self):
    """It is in directives of Slurm."""
    (self.folder / "experiments.toml").write_text(EXPERIMENTS)
    job = self.sweep("--run=small/gamma=0.9/seed1", runs=ODD).stdout.split()[-1]
    wait_until(lambda: self.cluster.run("squeue", "-h").stdout == "", "an empty queue", seconds=200)
    log = self.folder / ODD / f"slurm/{job}_0.log"
    self.assertTrue(log.exists(), [str(path) for path in self.folder.rglob("*.log")] + [self.cluster.logs()])
    self.assertIn("done: small/gamma=0.9/seed1", log.read_text())
    refused = self.sweep(runs="9%A", check=False)
    self.assertEqual(refused.returncode, 1)
    self.assertIn("want a folder without %A and %a", refused.stderr)
    self.assertFalse((self.folder / "9%A").exists())

  def test_a_sweep_runs_as_an_array_and_a_stopped_task_is_requeued(self):
    (self.folder / "experiments.toml").write_text(EXPERIMENTS.replace("steps = 192", "steps = 1280"))
    submitted = self.sweep()
    self.assertIn("unfinished runs: 4", submitted.stdout)
    job = submitted.stdout.split()[-1]
    self.wait_for_checkpoint(1, self.folder / "runs/small/gamma=0.9/seed1")
    self.cluster.run("scancel", "--signal=TERM", f"{job}_0")
    log = self.folder / f"runs/slurm/{job}_0.log"
    wait_until(lambda: "requeueing the task" in log.read_text(), "a task that is requeued")
    wait_until(lambda: self.cluster.run("squeue", "-h").stdout == "", "an empty queue", seconds=200)
    self.assertIn("resumes: small/gamma=0.9/seed1", log.read_text())
    listed = subprocess.run([*built("craftfleet sweep"), self.folder / "experiments.toml", "--list", "--seeds=2",
                             f"--logdir={self.folder}/runs"], capture_output=True, text=True, check=True).stdout
    self.assertEqual(listed.count("2 of 2 done"), 2, listed + "".join(
        f"== {file}\n{file.read_text(errors='replace')}" for file in (self.folder / "runs").rglob("*.log")))
    self.assertIn("all runs are done: ", self.sweep().stdout)


python_case.main()

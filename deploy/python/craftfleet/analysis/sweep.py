"""craftfleet sweep: runs experiments."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence

from . import _cli, experiments, programs, slurm
from ._cli import Flag, Refusal, in_range, reason
from .experiments import Cell, Experiment

PROGRAM = "craftfleet sweep"
USAGE = """craftfleet sweep FILE runs the experiments of a file: every cell with several seeds, each with `craftfleet train`. After a
stop or a crash, the same command continues: it skips complete runs and resumes the others. A run that fails is reported and
does not stop the others. The folder of each run has its output in log.txt.

  craftfleet sweep deploy/experiments/paper.toml --list
  craftfleet sweep deploy/experiments/paper.toml --experiment=table1 --cell=ppo_cnn --seeds=3 --jobs=2 --logdir=runs/paper
  craftfleet sweep deploy/experiments/paper.toml --executor=slurm --jobs=100 --logdir=/shared/runs/paper
  craftfleet report runs/paper --out=report

Ctrl-C, SIGTERM or closing the terminal stops it and its runs, each with a checkpoint. If its output is closed
(craftfleet sweep ... | head), it continues silently."""
FLAGS = [
    Flag("logdir", "string", "", "folder of the runs: LOGDIR/EXPERIMENT/CELL/seed1, ... (required to run)"),
    Flag("experiment", "list", [], "experiments of the file to run, joined by commas [all]"),
    Flag("cell", "list", [], "cells to run, joined by commas\nsuch as ppo_cnn, 94-2-2-2/ppo_cnn, or 94-2-2-2 for all cells below it\n[all]"),
    Flag("seeds", "integer", 10, "runs of each cell, with the seeds 1, 2, ...; 1..1000"),
    Flag("jobs", "integer", 1, "runs at a time, 1..1000"),
    Flag("steps", "integer", 0, "environment steps of each run, for a trial: 100000 or 100k; 0: those of the experiment"),
    Flag("list", "bool", False, "only list the cells; with --logdir also the number of their finished runs"),
    Flag("dry_run", "bool", False, "only print the commands that would be run, or with --executor=slurm the script"),
    Flag("executor", "string", "local", "where to run: local (processes on this machine) or slurm (one array job)\n"
         "tasks that Slurm preempts are requeued and resume"),
    Flag("threads", "integer", 0, "threads of each run; 0: the CPU quota divided among --jobs\nwith --executor=slurm 0 means 1"),
    Flag("run", "list", [], "only these runs, joined by commas: table1/ppo_cnn/seed1 [all]", main=False),
    Flag("slurm_flags", "string", "", 'with --executor=slurm: flags for sbatch, such as "--partition=gpu --mem=8G --time=2-0"', main=False),
    Flag("textures", "string", "", "textures of all runs, as for craftfleet train [the ones that come with this program]", main=False),
    Flag("write_configs", "string", "", "only write each cell's configuration to DIR/EXPERIMENT/CELL.txt", main=False),
]
_REPORT_EVERY = 30.0  # seconds between lines of progress
_LOOK_AGAIN = 2.0  # seconds between looks at a folder that another process uses


# The plan.


def select_cells(all_experiments: Sequence[Experiment], names: list[str], cells: list[str]) -> list[Cell]:
  """Cells of these experiments (empty: all) and of these names or first parts of names, in the file's order."""
  known = [experiment.name for experiment in all_experiments]
  for name in names:
    if name not in known:
      raise Refusal(f"--experiment={name}, want one of {', '.join(known)}")
  def fits(cell, wanted):
    return cell.name == wanted or cell.name.startswith(wanted + "/")
  among = [cell for experiment in all_experiments if not names or experiment.name in names for cell in experiment.cells]
  for name in cells:
    if not any(fits(cell, name) for cell in among):
      raise Refusal(f"--cell={name}, want a cell that --list names")
  return [cell for cell in among if not cells or any(fits(cell, name) for name in cells)]


def cells_with_textures(cells: list[Cell], digest: str) -> list[Cell]:
  """Those whose runs are drawn with these textures: cells without a digest of their own take any."""
  drawn = [cell for cell in cells if cell.texture_digest in ("", digest)]
  if cells and not drawn:
    raise Refusal(f"cell {cells[0].experiment}/{cells[0].name} wants textures {cells[0].texture_digest}, not {digest}: give their "
                  "folder with --textures")
  return drawn


@dataclasses.dataclass(frozen=True)
class Job:
  """A run of the sweep."""

  name: str  # "table1/ppo_cnn/seed1"
  folder: str
  config_path: str  # the file that the run is started with
  config_text: str  # its contents
  steps: int  # to train
  start: list[str]  # arguments of `craftfleet train` for a new run
  resume: list[str]


@dataclasses.dataclass(frozen=True)
class State:
  begun: bool = False  # has a checkpoint to resume from
  steps: int = 0  # of the newest one
  finished: bool = False


def cell_file(cell: Cell) -> str:
  return f"# {cell.experiment}, {cell.name}; values that are not given have their defaults.\n{cell.config_text}"


def plan(cells: Sequence[Cell], logdir: str, seeds: int, steps: int = 0, train_flags: Sequence[str] = ()) -> list[Job]:
  """Seed 1 of every cell, then seed 2, ...; cells that share a folder are run once."""
  distinct = {}
  for cell in cells:
    distinct.setdefault(cell.folder, cell)
  jobs = []
  for seed in range(1, seeds + 1):
    for cell in distinct.values():
      above = os.path.join(logdir, cell.folder)
      folder, config = os.path.join(above, f"seed{seed}"), os.path.join(above, "cell.txt")
      wanted = steps or cell.steps
      shared = [f"--steps={wanted}", f"--logdir={folder}", *train_flags]
      jobs.append(Job(f"{cell.folder}/seed{seed}", folder, config, cell_file(cell), wanted,
                      [f"--config={config}", f"--seed={seed}", *shared], ["--resume", *shared]))
  return jobs


def _make_folders(flag: str, folder: str) -> None:
  try:
    os.makedirs(folder, exist_ok=True)
  except OSError as error:
    raise Refusal(f"{flag}: cannot create {reason(error)}") from None


def prepare_folder(job: Job) -> None:
  """Creates the run's folder and its cell's file, which the jobs of the cell share."""
  _make_folders("--logdir", job.folder)
  try:
    with open(job.config_path, encoding="utf-8") as file:
      if file.read() == job.config_text:
        return
  except (OSError, UnicodeDecodeError):
    pass
  try:
    _cli.replace_file(job.config_path, job.config_text.encode())
  except OSError as error:
    raise Refusal(f"cannot write {job.config_path}: {error.strerror}") from None


def states(jobs: Sequence[Job]) -> list[State | Refusal]:
  """What each run has; a Refusal if that cannot be read."""
  answers = programs.ask([{"folder": job.folder, "steps": job.steps} for job in jobs])
  return [Refusal(answer["error"]) if "error" in answer else State(**answer) for answer in answers]


def _states_or_none(jobs: Sequence[Job]) -> list[State]:
  """Names runs that cannot be read in warnings, and takes them for ones that have not begun."""
  known = []
  for job, state in zip(jobs, states(jobs)):
    if isinstance(state, Refusal):
      _cli.warn(f"{job.name} cannot be read: {state}")
      state = State()
    known.append(state)
  return known


# Running.


def _with_steps(config: str, steps: int) -> str:
  return re.sub(r"(?m)^steps: .*\n", "", config) + f"\nsteps: {steps}\n"


def check_configuration(job: Job) -> None:
  """Refusal: the folder has a run of another configuration."""
  path = os.path.join(job.folder, "config.txt")
  if not os.path.exists(path):
    return
  try:
    with open(path, encoding="utf-8") as file:
      text = file.read()
  except (OSError, UnicodeDecodeError) as error:
    raise Refusal(f"{path}: {getattr(error, 'strerror', 'not a text file')}") from None
  # The steps may change when the run is resumed.
  answers = programs.ask([{"config": _with_steps(text, job.steps), "path": path},
                          {"config": _with_steps(job.config_text, job.steps), "path": job.config_path}])
  for answer in answers:
    if "error" in answer:
      raise Refusal(answer["error"])
  if answers[0]["identity"] != answers[1]["identity"]:
    raise Refusal(f"{path} is not this cell's configuration ({job.config_path}): use another --logdir")


def folder_user(folder: str) -> str:
  """Which process uses the run's folder; "" if none does."""
  path = os.path.join(folder, "lock")
  try:
    with open(path, "a+", encoding="utf-8") as file:
      try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return ""
      except OSError as error:
        if error.errno in (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL):
          return ""  # the file system has no locks
        if error.errno != errno.EWOULDBLOCK:
          raise
        file.seek(0)
        return file.read().strip() or "another process"
  except OSError as error:
    raise Refusal(f"cannot lock {path}: {error.strerror}") from None


def _last_line(path: str) -> str:
  """The last line that is not empty."""
  try:
    with open(path, encoding="utf-8", errors="replace") as file:
      return next((line.strip() for line in reversed(file.read().split("\n")) if line.strip()), "")
  except OSError:
    return ""


def time_left_text(seconds: float) -> str:
  s = round(seconds)
  if s >= 86400:
    return f"{s // 86400}d{s % 86400 // 3600}h"
  if s >= 3600:
    return f"{s // 3600}h{s % 3600 // 60}m"
  return f"{s // 60}m{s % 60}s" if s >= 60 else f"{s}s"


@dataclasses.dataclass
class _Entry:
  job: Job
  stage: str = "waiting"  # running, done, failed
  first_steps: int = 0  # done when the sweep began
  child: subprocess.Popen | None = None
  state: State = State()  # when the child was started
  look_at: float = 0  # when to look at the folder again
  told: bool = False  # that another process uses the folder


class Stopped(Exception):
  """A signal ended the sweep before all was done; the message says how much was."""


class Sweep:
  """Runs jobs as child processes, several at a time.

  Finished runs are skipped, unfinished ones are resumed, and the others are started. If another process uses the folder of a
  run (such as a child that outlived its sweep), the job waits for it. The output of each run is appended to log.txt in its
  folder.
  """

  def __init__(self, jobs: Sequence[Job], program: str, at_a_time: int, out=sys.stdout, look_again: float = _LOOK_AGAIN):
    self._entries = [_Entry(job) for job in jobs]
    self._program, self._at_a_time, self._out, self._look_again = program, at_a_time, out, look_again
    self._stopping = False
    self._begun = 0.0
    self._output_error = ""
    self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

  def run(self) -> None:
    """Returns when every job is done.   Refusal: some failed, says how many.   Stopped: stop() was called before."""
    self._look_at_folders()
    self._begun = time.monotonic()
    next_report = self._begun + _REPORT_EVERY
    while self._take_steps():
      self._wait(next_report)
      if time.monotonic() >= next_report:
        self._print(self._progress())
        next_report += _REPORT_EVERY
    self._print(self._progress())
    failed, done = self._count("failed"), self._count("done")
    if failed:
      raise Refusal(f"{failed} of {len(self._entries)} runs failed")
    if done < len(self._entries):
      raise Stopped(f"stopped with {done} of {len(self._entries)} runs done; the same command resumes the sweep")
    if self._output_error:
      raise Refusal(f"cannot write all of standard output: {self._output_error}")

  def stop(self) -> None:
    """Ends the children and starts no more. May be called by a signal handler and by other threads."""
    self._stopping = True
    for entry in self._entries:
      if entry.child:
        entry.child.terminate()
    self.wake()

  def wake(self) -> None:
    """Looks at the children now."""
    try:
      os.write(self._wake_write, b"w")
    except BlockingIOError:
      pass

  def _look_at_folders(self) -> None:
    for entry in self._entries:
      try:
        prepare_folder(entry.job)
      except Refusal:
        pass  # reported when the job starts
    for entry, state in zip(self._entries, states([entry.job for entry in self._entries])):
      state = State() if isinstance(state, Refusal) else state
      entry.first_steps = min(state.steps, entry.job.steps)
      entry.stage = "done" if state.finished else "waiting"
    count = len(self._entries)
    self._print(f"{count:,} run{'' if count == 1 else 's'}, of which {self._count('done')} are done already; "
                f"{self._at_a_time} at a time")

  def _take_steps(self) -> bool:
    """Starts jobs and goes on with those that run. False: nothing is left to do."""
    for entry in self._entries:
      if entry.stage == "running":
        self._go_on(entry)
    for entry in self._entries:
      if self._stopping or self._count("running") == self._at_a_time:
        break
      if entry.stage == "waiting":
        entry.stage = "running"
        self._go_on(entry)
    waiting = self._count("waiting") if not self._stopping else 0
    return self._count("running") + waiting > 0

  def _go_on(self, entry: _Entry) -> None:
    try:
      if entry.child is None:
        self._try_to_start(entry)
      elif entry.child.poll() is not None:
        self._finish(entry)
    except Refusal as error:
      entry.child = None
      entry.stage = "failed"
      self._print(f"FAILED: {entry.job.name}: {error}")

  def _done(self, entry: _Entry) -> None:
    entry.stage = "done"
    self._print(f"done: {entry.job.name}")

  def _try_to_start(self, entry: _Entry) -> None:
    if self._stopping:
      entry.stage = "waiting"
      return
    if time.monotonic() < entry.look_at:
      return
    job = entry.job
    prepare_folder(job)
    user = folder_user(job.folder)
    if user:
      if not entry.told:
        self._print(f"waits: run folder {job.folder} is in use by {user}: stop that process or use another --logdir")
      entry.told, entry.look_at = True, time.monotonic() + self._look_again
      return
    entry.told = False
    check_configuration(job)
    entry.state = self._state(job)
    if entry.state.finished:
      self._done(entry)
      return
    arguments = job.resume if entry.state.begun else job.start
    try:
      with open(os.path.join(job.folder, "log.txt"), "ab") as log:
        # In its own group, so that Ctrl-C on the terminal reaches it only through stop().
        entry.child = subprocess.Popen([self._program, *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                       process_group=0)
    except OSError as error:
      raise Refusal(f"cannot start {self._program}: {error.strerror}") from None
    self._print(f"{'resumes' if entry.state.begun else 'starts'}: {job.name}")
    if self._stopping:  # a signal came while it was started
      entry.child.terminate()

  @staticmethod
  def _state(job: Job) -> State:
    state = states([job])[0]
    if isinstance(state, Refusal):
      raise state
    return state

  def _finish(self, entry: _Entry) -> None:
    job, code = entry.job, entry.child.returncode
    code = code if code >= 0 else 128 - code
    entry.child = None
    state = self._state(job)
    log = os.path.join(job.folder, "log.txt")
    if state.finished:
      self._done(entry)
    elif self._stopping:
      entry.stage = "waiting"
    elif code and folder_user(job.folder):
      entry.look_at = 0  # it failed because a process that was started earlier locked the folder only now
      self._try_to_start(entry)
    elif code:
      raise Refusal(f"exit code {code}: {_last_line(log)} ({log})")
    else:
      raise Refusal(f"it ended at {state.steps} of {job.steps} steps; see {log}")

  def _wait(self, until: float) -> None:
    """Until something has happened, or may have."""
    waits = [entry.look_at for entry in self._entries if entry.stage == "running" and entry.child is None]
    timeout = max(0.0, min([until, *waits]) - time.monotonic())
    # Without signals, as in a thread, children are looked at now and then.
    ready, _, _ = select.select([self._wake_read], [], [], min(timeout, 1.0))
    if ready:
      os.read(self._wake_read, 4096)

  def _count(self, stage: str) -> int:
    return sum(entry.stage == stage for entry in self._entries)

  def _progress(self) -> str:
    running = [entry.job for entry in self._entries if entry.stage == "running"]
    now = {job.name: state.steps for job, state in zip(running, states(running)) if isinstance(state, State)}
    total = reached = gained = 0
    for entry in self._entries:
      wanted = entry.job.steps
      steps = wanted if entry.stage == "done" else min(now.get(entry.job.name, entry.first_steps), wanted)
      total += wanted
      reached += steps
      gained += steps - entry.first_steps
    seconds = time.monotonic() - self._begun
    rate = gained / seconds if seconds > 0 else 0
    left = time_left_text((total - reached) / rate) if rate > 0 else "-"
    return (f"{self._count('done')} done, {self._count('running')} running, {self._count('waiting')} left, "
            f"{self._count('failed')} failed | {reached:,}/{total:,} steps, {rate:.0f}/s, {left} left")

  def _print(self, line: str) -> None:
    """Goes on without a reader."""
    try:
      print(line, file=self._out, flush=True)
    except BrokenPipeError:
      self._out = open(os.devnull, "w", encoding="utf-8")  # pylint: disable=consider-using-with
    except OSError as error:
      self._output_error = reason(error)
      self._out = open(os.devnull, "w", encoding="utf-8")  # pylint: disable=consider-using-with


def _handle_signals(sweep: Sweep) -> None:
  """The first SIGTERM, SIGINT or SIGHUP stops the sweep; a second SIGTERM or SIGINT ends this process at once."""
  received = []
  def on_signal(number, _frame):
    if number != signal.SIGHUP:
      received.append(number)
    if len(received) > 1:
      os._exit(130)  # pylint: disable=protected-access
    sweep.stop()
  signal.signal(signal.SIGTERM, on_signal)
  signal.signal(signal.SIGINT, on_signal)
  if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # as under nohup
    signal.signal(signal.SIGHUP, on_signal)
  signal.signal(signal.SIGCHLD, lambda _number, _frame: sweep.wake())


# The command.


def _list(cells: list[Cell], flags) -> None:
  for cell in cells:
    line = f"{f'{cell.experiment}/{cell.name}':48} {cell.steps:9d} steps"
    if flags.logdir:
      done = sum(state.finished for state in _states_or_none(plan([cell], flags.logdir, flags.seeds, flags.steps)))
      line += f"   {done} of {flags.seeds} done"
    print(line + (f"   as {cell.folder}" if cell.folder != f"{cell.experiment}/{cell.name}" else ""))
  print(f"{len(cells)} cells")


def _write_configs(cells: list[Cell], folder: str) -> None:
  for cell in cells:
    path = os.path.join(folder, cell.experiment, f"{cell.name}.txt")
    _make_folders("--write_configs", os.path.dirname(path))
    try:
      _cli.replace_file(path, cell_file(cell).encode())
    except OSError as error:
      raise Refusal(f"--write_configs: cannot write {path}: {error.strerror}") from None


def _named_runs(jobs: list[Job], names: list[str]) -> list[Job]:
  found = {job.name: job for job in jobs}
  for name in names:
    if name not in found:
      raise Refusal(f'--run: no run "{name}", want one like {jobs[0].name}')
  return [found[name] for name in names] if names else jobs


def _train_flags(flags) -> list[str]:
  threads = flags.threads or max(1, programs.ask([{"machine": True}])[0]["threads"] // flags.jobs)
  return [f"--threads={threads}"] + ([f"--textures={flags.textures}"] if flags.textures else [])


def _run_on_slurm(file: str, flags, jobs: list[Job]) -> None:
  # Slurm 22.05 replaces these in names of an array's logs, however they are written.
  if "%A" in flags.logdir or "%a" in flags.logdir:
    raise Refusal(f"--logdir={flags.logdir}, want a folder without %A and %a, which Slurm replaces by numbers of the job")
  command = [programs.find("craftfleet-sweep"), os.path.abspath(file), f"--logdir={flags.logdir}", f"--seeds={flags.seeds}",
             f"--steps={flags.steps}"] + ([f"--textures={os.path.abspath(flags.textures)}"] if flags.textures else [])
  unfinished = [job for job, state in zip(jobs, _states_or_none(jobs)) if not state.finished]
  if not unfinished:
    print(f"all runs are done: {len(jobs)}")
    return
  array = slurm.Array(os.path.join(flags.logdir, "slurm"), flags.jobs, max(1, flags.threads), command,
                      [job.name for job in unfinished])
  if flags.dry_run:
    print(slurm.script(array), end="")
    return
  for job in jobs:
    prepare_folder(job)
  _make_folders("--logdir", array.logs)
  path = os.path.join(array.logs, "sweep.sbatch")
  try:
    _cli.replace_file(path, slurm.script(array).encode())
  except OSError as error:
    raise Refusal(f"cannot write {path}: {error.strerror}") from None
  print(f"unfinished runs: {len(unfinished)}; logs will be in {array.logs}", flush=True)
  try:
    os.execvp("sbatch", ["sbatch", *flags.slurm_flags.split(), path])
  except OSError as error:
    raise Refusal(f"cannot start sbatch: {error.strerror}; submit {path} on a machine with Slurm") from None


def _check_flags(flags) -> None:
  in_range("seeds", flags.seeds, 1, 1000)
  in_range("jobs", flags.jobs, 1, 1000)
  in_range("threads", flags.threads, 0, 256)
  in_range("steps", flags.steps, 0, 10**12)
  if flags.executor not in ("local", "slurm"):
    raise Refusal(f"--executor={flags.executor}, want local or slurm")


def _jobs(cells: list[Cell], flags) -> list[Job]:
  answer = programs.ask([{"textures_in": flags.textures}])[0]
  if "error" in answer:
    raise Refusal(answer["error"])
  drawn = cells_with_textures(cells, answer["digest"])
  if len(drawn) < len(cells):
    print(f"{PROGRAM}: {len(cells) - len(drawn)} cells want other textures and are left out; --textures selects the textures",
          file=sys.stderr)
  if flags.executor == "slurm":
    flags.logdir = os.path.abspath(flags.logdir)
  return _named_runs(plan(drawn, flags.logdir, flags.seeds, flags.steps, _train_flags(flags)), flags.run)


def _run(flags, arguments: list[str]) -> int:
  if len(arguments) != 1:
    raise Refusal("name one file with experiments, such as deploy/experiments/paper.toml; see --help")
  _check_flags(flags)
  cells = select_cells(experiments.load(arguments[0]), flags.experiment, flags.cell)
  if flags.write_configs:
    _write_configs(cells, flags.write_configs)
    return 0
  if flags.list:
    _list(cells, flags)
    return 0
  if not flags.logdir:
    raise Refusal("--logdir is missing: the folder for the runs")
  jobs = _jobs(cells, flags)
  if flags.executor == "slurm":
    _run_on_slurm(arguments[0], flags, jobs)
  elif flags.dry_run:
    for job, state in zip(jobs, _states_or_none(jobs)):
      if not state.finished:
        print("craftfleet train " + " ".join(job.resume if state.begun else job.start))
  else:
    sweep = Sweep(jobs, programs.find("craftfleet-train"), flags.jobs)
    _handle_signals(sweep)
    try:
      sweep.run()
    except Stopped as stopped:
      print(f"{PROGRAM}: {stopped}", file=sys.stderr)
      return slurm.STOPPED
  return 0


def main(arguments: list[str]) -> int:
  return _cli.run(PROGRAM, USAGE, FLAGS, arguments, _run)

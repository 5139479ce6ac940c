"""Runs the jobs of a sweep as child processes, several at a time."""

from __future__ import annotations

import concurrent.futures
import datetime
import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence

from . import programs
from ._cli import Refusal, reason
from .sweep_plan import Job, State, configuration_problems, prepare_folder, states

_REPORT_EVERY = 30.0  # seconds between lines of progress
_LOOK_AGAIN = 2.0  # seconds between looks at a folder that another process uses
# Stops a run with a checkpoint, also one that got a SIGTERM with its sweep, as from Slurm and systemd: a second SIGTERM would
# end it at once.
_STOP = signal.SIGHUP


def check_configuration(job: Job) -> None:
  """Refusal: the folder has a run of another configuration."""
  problem, = configuration_problems([job])
  if problem:
    raise problem


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


def _state(job: Job) -> State:
  state = states([job])[0]
  if isinstance(state, Refusal):
    raise state
  return state


class Stopped(Exception):
  """A signal ended the sweep before all was done; the message says how much was."""


class Sweep:
  """Runs jobs as child processes, a thread for each that runs.

  Finished runs are skipped, unfinished ones are resumed, and the others are started. If another process uses the folder of a
  run (such as a child that outlived its sweep), the job waits for it. The output of each run is appended to log.txt in its
  folder.
  """

  def __init__(self, jobs: Sequence[Job], train: Sequence[str], environment: dict[str, str], at_a_time: int, out=sys.stdout,
               look_again: float = _LOOK_AGAIN):
    self._jobs, self._train, self._environment, self._at_a_time = list(jobs), train, environment, at_a_time
    self._out, self._look_again = out, look_again
    self._stages = {job.name: "left" for job in jobs}  # or running, done, failed
    self._first_steps: dict[str, int] = {}  # done when the sweep began
    self._started: set[str] = set()
    self._children: dict[str, subprocess.Popen] = {}
    self._stopping = threading.Event()
    self._output_error = ""

  def run(self) -> None:
    """Returns when every job is done.   Refusal: some failed, says how many.   Stopped: stop() was called before."""
    self._look_at_folders()
    begun = time.monotonic()
    with concurrent.futures.ThreadPoolExecutor(self._at_a_time) as threads:
      ends = [threads.submit(self._run_job, job) for job in self._jobs if self._stages[job.name] == "left"]
      while concurrent.futures.wait(ends, _REPORT_EVERY).not_done:
        self._print(self._progress(begun))
      for end in ends:
        end.result()
    self._print(self._progress(begun))
    failed, done = self._count("failed"), self._count("done")
    if failed:
      raise Refusal(f"{failed} of {len(self._jobs)} runs failed")
    if done < len(self._jobs):
      raise Stopped(f"stopped with {done} of {len(self._jobs)} runs done; the same command resumes the sweep")
    if self._output_error:
      raise Refusal(f"cannot write all of standard output: {self._output_error}")

  def stop(self) -> None:
    """Ends the children and starts no more. May be called by a signal handler and by other threads."""
    self._stopping.set()
    for child in list(self._children.values()):
      child.send_signal(_STOP)

  def _look_at_folders(self) -> None:
    for job in self._jobs:
      try:
        prepare_folder(job)
      except Refusal:
        pass  # reported when the job starts
    for job, state in zip(self._jobs, states(self._jobs)):
      state = State() if isinstance(state, Refusal) else state
      self._first_steps[job.name] = min(state.steps, job.steps)
      if state.finished:
        self._stages[job.name] = "done"
    count, done = len(self._jobs), self._count("done")
    self._print(f"{count:,} run{'' if count == 1 else 's'}, of which {done} {'is' if done == 1 else 'are'} done already; "
                f"{self._at_a_time} at a time")

  def _run_job(self, job: Job) -> None:
    if self._stopping.is_set():
      return
    self._stages[job.name] = "running"
    try:
      is_done = self._train_to_the_end(job)
    except (Refusal, OSError) as error:
      self._stages[job.name] = "failed"
      self._print(f"FAILED: {job.name}: {reason(error)}")
      return
    self._stages[job.name] = "done" if is_done else "left"
    if is_done:
      self._print(f"done: {job.name}")

  def _train_to_the_end(self, job: Job) -> bool:
    """False: the sweep was stopped before.   Refusal: the run failed."""
    log = os.path.join(job.folder, "log.txt")
    prepare_folder(job)
    while self._waits_for_folder(job):
      check_configuration(job)
      state = _state(job)
      if state.finished:
        return True
      code = self._run_child(job, state.begun, log)
      state = _state(job)
      if state.finished:
        return True
      if self._stopping.is_set():
        return False
      if code and folder_user(job.folder):
        continue  # it failed because a process that was started earlier locked the folder only now
      if code:
        raise Refusal(f"exit code {code}: {_last_line(log)} ({log})")
      raise Refusal(f"it ended at {state.steps} of {job.steps} steps; see {log}")
    return False

  def _waits_for_folder(self, job: Job) -> bool:
    """Waits while another process uses the folder. False: the sweep was stopped."""
    is_told = False
    while not self._stopping.is_set():
      user = folder_user(job.folder)
      if not user:
        return True
      if not is_told:
        self._print(f"waits: run folder {job.folder} is in use by {user}: stop that process or use another --logdir")
      is_told = True
      self._stopping.wait(self._look_again)
    return False

  def _run_child(self, job: Job, resumes: bool, log: str) -> int:
    """Runs `craftfleet train`; returns its exit code, as a shell's."""
    try:
      output = open(log, "ab")
    except OSError as error:
      raise Refusal(f"cannot open {log}: {error.strerror}") from None
    with output:
      try:
        # In its own group, so that Ctrl-C on the terminal reaches it only through stop().
        child = subprocess.Popen([*self._train, *(job.resume if resumes else job.start)], stdin=subprocess.DEVNULL, stdout=output,
                                 stderr=output, env=self._environment, process_group=0)
      except OSError as error:
        raise Refusal(f"cannot start {self._train[0]}: {error.strerror}") from None
    self._children[job.name] = child
    self._started.add(job.name)
    self._print(f"{'resumes' if resumes else 'starts'}: {job.name}")
    if self._stopping.is_set():  # a signal came while it was started
      child.send_signal(_STOP)
    code = child.wait()
    del self._children[job.name]
    return code if code >= 0 else 128 - code

  def _count(self, stage: str) -> int:
    return list(self._stages.values()).count(stage)

  def _progress(self, begun: float) -> str:
    asked = [job for job in self._jobs if job.name in self._started and self._stages[job.name] != "done"]
    try:
      now = {job.name: state.steps for job, state in zip(asked, states(asked)) if isinstance(state, State)}
    except OSError:
      now = {}  # no reason to stop runs
    total = reached = gained = 0
    for job in self._jobs:
      steps = job.steps if self._stages[job.name] == "done" else min(now.get(job.name, self._first_steps[job.name]), job.steps)
      total += job.steps
      reached += steps
      gained += steps - self._first_steps[job.name]
    rate = gained / max(time.monotonic() - begun, 1e-9)
    left = datetime.timedelta(seconds=round((total - reached) / rate)) if rate > 0 else "-"
    return (", ".join(f"{self._count(stage)} {stage}" for stage in ("done", "running", "left", "failed")) +
            f" | {reached:,}/{total:,} steps, {rate:.0f}/s, {left} left")

  def _print(self, line: str) -> None:
    """Goes on without a reader."""
    try:
      self._out.write(line + "\n")  # in one piece: other threads write too
      self._out.flush()
    except OSError as error:
      if not isinstance(error, BrokenPipeError):
        self._output_error = reason(error)
      self._out = open(os.devnull, "w", encoding="utf-8")  # pylint: disable=consider-using-with

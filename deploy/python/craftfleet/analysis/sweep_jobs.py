"""Runs the jobs of a sweep as child processes, several at a time."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Sequence

from . import programs
from ._cli import Refusal, reason
from .sweep_plan import Job, State, prepare_folder, states

_REPORT_EVERY = 30.0  # seconds between lines of progress
_LOOK_AGAIN = 2.0  # seconds between looks at a folder that another process uses


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

  def __init__(self, jobs: Sequence[Job], train: Sequence[str], at_a_time: int, out=sys.stdout, look_again: float = _LOOK_AGAIN):
    self._entries = [_Entry(job) for job in jobs]
    self._train, self._at_a_time, self._out, self._look_again = train, at_a_time, out, look_again
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
        entry.child = subprocess.Popen([*self._train, *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                       process_group=0)
    except OSError as error:
      raise Refusal(f"cannot start {self._train[0]}: {error.strerror}") from None
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

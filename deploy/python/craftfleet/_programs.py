"""Runs CraftFleet's programs: their progress, their errors."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import pathlib
import queue
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import IO, Any

from craftfleet.analysis import programs

# A line of progress: how much is done, of how much, and the unit.
PROGRESS = re.compile(r"(?:\w+: )?([\d,]+)(?:/| of )([\d,]+) (steps|episodes)\b")
LOG = re.compile(r"\d\d:\d\d:\d\d\.\d+ \w+: ")  # how a line of the log begins


def flags(**values: Any) -> list[str]:
  """`--name=value` of each value that is not None."""
  return [f"--{name}={_text(value)}" for name, value in values.items() if value is not None]


def _text(value: Any) -> str:
  if isinstance(value, bool):
    return str(value).lower()
  return os.fsdecode(value) if isinstance(value, (bytes, os.PathLike)) else str(value)


def start(name: str, arguments: list[str], before: Sequence[str] = (), **options: Any) -> subprocess.Popen:
  """Starts `craftfleet NAME` behind the words `before`, in its own session: Ctrl-C in a terminal reaches this process alone."""
  command, environment = programs.find(name)
  return subprocess.Popen([*before, *command, *arguments], env=environment, start_new_session=True, **options)


def _until_python_ends() -> list[str]:
  """The words before a program that get it SIGTERM when the thread that starts it is gone, however Python ended."""
  setpriv = shutil.which("setpriv")
  return [setpriv, "--pdeathsig", "TERM"] if setpriv else []


def run(name: str, progress: bool, /, **values: Any) -> None:
  """Runs `craftfleet NAME` with flags() of the values to its end; shows its warnings and errors, and its progress if wanted.

  ValueError: the program refused what it was given; RuntimeError: it failed later. Both carry its message. KeyboardInterrupt stops
  the program as Ctrl-C does, a second one at once, and is raised when it has ended. When Python ends otherwise, SIGTERM stops it.
  """
  if values.get("log_format") not in (None, "text"):
    raise ValueError(f"log_format {values['log_format']!r}, want 'text', of which Python shows the log and the progress")
  process = start(
      name, flags(**{"log_level": "warning", **values}), _until_python_ends(), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
      stderr=subprocess.PIPE, text=True, errors="replace")
  began = False  # its work: it has printed a result, or progress
  errors: list[str] = []
  with _stopping(process), contextlib.closing(_Display(progress)) as display:
    for is_error, line in _lines(process):
      began = began or not is_error or PROGRESS.match(line) is not None
      if is_error:
        errors.append(line)
      display.show(line, is_error)
  code = process.wait()
  if code != 0:
    message = failure(name, code, errors)
    # Negative: a signal ended it. It prints a run's name before it listens: a message about a flag is a refusal even then.
    refused = code > 0 and (not began or message.startswith("--"))
    raise (ValueError if refused else RuntimeError)(message)


def failure(name: str, code: int, errors: list[str]) -> str:
  """What a program that ended with `code` said on standard error, without its name and without its log."""
  said = [line for line in errors if line.strip() and not LOG.match(line) and not PROGRESS.match(line)]
  text = "\n".join(said).removeprefix(f"craftfleet {name}: ").removeprefix("ERROR: ")
  return text or f"craftfleet {name} ended with exit code {code}"


@contextlib.contextmanager
def _stopping(process: subprocess.Popen) -> Iterator[None]:
  """Stops the process when the block is left by an exception; the program saves what it has."""
  try:
    yield
  except BaseException:
    while process.poll() is None:
      with contextlib.suppress(KeyboardInterrupt):  # the next one ends the program at once
        process.send_signal(signal.SIGINT)
        process.wait()
    raise


def _lines(process: subprocess.Popen) -> Iterator[tuple[bool, str]]:
  """The lines of standard output and standard error (True), in the order in which they come."""
  lines: queue.Queue[tuple[bool, str | None]] = queue.Queue()

  def read(stream: IO[str], is_error: bool) -> None:
    with stream:
      for line in stream:
        lines.put((is_error, line.rstrip("\n")))
    lines.put((is_error, None))

  for stream, is_error in ((process.stdout, False), (process.stderr, True)):
    threading.Thread(target=read, args=(stream, is_error), daemon=True).start()
  open_streams = 2
  while open_streams:
    is_error, line = lines.get()
    if line is None:
      open_streams -= 1
    else:
      yield is_error, line


class _Display:
  """Shows progress with tqdm if it is installed, also in notebooks; else the programs' lines."""

  def __init__(self, enabled: bool) -> None:
    self._bar: Any = None
    self._make_bar: Callable[..., Any] | None = None
    self._enabled = enabled
    if enabled and importlib.util.find_spec("tqdm") is not None:
      from tqdm.auto import tqdm  # pylint: disable=import-outside-toplevel  # an optional package
      self._make_bar = tqdm

  def close(self) -> None:
    """Leaves the bar as it is."""
    if self._bar is not None:
      self._bar.close()

  def show(self, line: str, is_error: bool) -> None:
    """Shows a line of progress or of the program's log."""
    found = PROGRESS.match(line)
    if found is None:
      if LOG.match(line):
        print(line, file=sys.stderr)
      return
    if not self._enabled:
      return
    if self._make_bar is None:
      print(line, file=sys.stderr if is_error else sys.stdout, flush=True)
      return
    done, total = (int(number.replace(",", "")) for number in found.group(1, 2))
    if self._bar is None or self._bar.total != total:
      self.close()
      self._bar = self._make_bar(total=total, initial=done, unit=f" {found[3]}")  # a resumed run does not begin at 0
    self._bar.n = done
    self._bar.set_postfix_str(line.partition(" left")[2].strip(" |"), refresh=False)
    self._bar.refresh()


def absolute(path: str | os.PathLike[str]) -> pathlib.Path:
  """The absolute path, with ~ expanded."""
  return pathlib.Path(path).expanduser().absolute()

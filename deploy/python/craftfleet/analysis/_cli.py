"""The command line of the commands: flags, help, errors and targets of output, as in the programs."""

from __future__ import annotations

import codecs
import contextlib
import dataclasses
import difflib
import errno
import os
import re
import secrets
import shutil
import stat
import subprocess
import sys
import tempfile
import types
from typing import Callable

from . import programs


class Refusal(Exception):
  """Something that the user asked for cannot be done; the message says what and why."""


def reason(error: Exception) -> str:
  """What a user reads about an error of the system: "/a/b: Permission denied"."""
  if isinstance(error, OSError) and error.strerror:
    return f"{os.fsdecode(error.filename)}: {error.strerror}" if error.filename else error.strerror
  return str(error)


def read_text(path: str) -> str:
  """Refusal: the file cannot be read, or is no text."""
  try:
    with open(path, encoding="utf-8-sig", newline="") as file:  # Excel and Notepad begin files with a mark
      return file.read()
  except (OSError, UnicodeDecodeError) as error:
    raise Refusal(reason(error) if isinstance(error, OSError) else f"{path}: not a text file: {error}") from None


def _with_home(text: str) -> str:
  """A shell expands "~/" at the start of a word only, so not in --out=~/report."""
  return os.path.expanduser(text) if text == "~" or text.startswith("~/") else text


@dataclasses.dataclass(frozen=True)
class Flag:
  name: str
  type: str  # bool, integer, list or string, as in --help_json of the other commands
  default: object
  help: str
  main: bool = True

  def parse(self, program: str, text: str) -> object:
    if self.type == "bool":
      if text not in ("true", "false"):
        raise Refusal(f"--{self.name}={text}, want true or false; see {program} --help")
      return text == "true"
    if self.type == "integer":
      return self._integer(program, text)
    if self.type == "list":
      return [_with_home(word) for word in text.split(",") if word]
    return _with_home(text)

  def _integer(self, program: str, text: str) -> int:
    """A whole number; 1e6, 300k and 1M are some."""
    match = re.fullmatch(r"(-?\d+)([kM]?)|(\d+)[eE](\d{1,2})", text)
    if not match:
      raise Refusal(f"--{self.name}={text}, want a whole number; see {program} --help")
    if match[3]:
      return int(match[3]) * 10**int(match[4])
    return int(match[1]) * {"": 1, "k": 10**3, "M": 10**6}[match[2]]


def default_text(flag: Flag) -> str:
  if flag.type == "bool":
    return "true" if flag.default else "false"
  if flag.type == "list":
    return ",".join(flag.default)
  return str(flag.default) if flag.default != "" else ""


def parse(program: str, flags: list[Flag], arguments: list[str]) -> tuple[types.SimpleNamespace, list[str]]:
  """The values of the flags, as attributes, and the other arguments."""
  by_name = {flag.name: flag for flag in flags}
  values = types.SimpleNamespace(**{flag.name: flag.default for flag in flags})
  rest = []
  words = iter(arguments)
  for word in words:
    if word == "--":
      rest += words
      break
    if not word.startswith("-") or word == "-":
      rest.append(word)
      continue
    name, equals, text = word.lstrip("-").partition("=")
    flag = by_name.get(name)
    if flag is None and name.startswith("no") and not equals and getattr(by_name.get(name[2:]), "type", "") == "bool":
      flag, equals, text = by_name[name[2:]], "=", "false"
    if flag is None:
      close = difflib.get_close_matches(name, by_name, 1)
      suggestion = f" (did you mean --{close[0]}?)" if close else ""
      raise Refusal(f"unknown flag '{name}'{suggestion}; see {program} --help")
    if not equals:
      text = "true" if flag.type == "bool" else next(words, None)
      if text is None:
        raise Refusal(f"--{name} needs a value: --{name}=VALUE; see {program} --help")
    setattr(values, flag.name, flag.parse(program, text))
  return values, rest


def in_range(name: str, value: int, low: int, high: int) -> None:
  if not low <= value <= high:
    raise Refusal(f"--{name}={value}, want {low}..{high}")


# Help.


def _one_line(text: str) -> str:
  first, *more = text.split("\n")
  bracketed = re.search(r"\[[^\[]*\]$", text)
  return first.rstrip(";,") + (f" {bracketed[0]}" if more and bracketed else "")


def _with_default(flag: Flag) -> str:
  default = default_text(flag)
  return f"--{flag.name} (default {default})" if default else f"--{flag.name}"


def short_help(program: str, usage: str, flags: list[Flag]) -> str:
  main = [flag for flag in flags if flag.main]
  width = max(len(_with_default(flag)) for flag in main)
  lines = "".join(f"  {_with_default(flag):{width}}  {_one_line(flag.help)}\n" for flag in main)
  return (f"{usage}\n\nFlags:\n{lines}\n{program} --helpfull explains all {len(flags)} flags in full; --version shows the "
          "version.\n")


def full_help(program: str, usage: str, flags: list[Flag]) -> str:
  def details(some):
    return "".join(f"  {_with_default(flag)}\n      " + flag.help.replace("\n", "\n      ") + "\n" for flag in some)
  text = f"{usage}\n\nFlags of {program}:\n" + details([flag for flag in flags if flag.main])
  others = [flag for flag in flags if not flag.main]
  return text + ("\nMore flags:\n" + details(others) if others else "") + "\n  --help, --helpfull, --version\n"


def version(program: str) -> str:
  words, environment = programs.find("inspect")
  text = subprocess.run([*words, "--version"], capture_output=True, text=True, check=True, env=environment).stdout
  return text.replace("craftfleet inspect", program)


# Running.


def _finish_output() -> str:
  """Writes what is left of standard output; returns what went wrong. A reader that is gone is no error."""
  try:
    sys.stdout.flush()
    return ""
  except BrokenPipeError:
    problem = ""
  except (OSError, ValueError) as error:
    problem = f"cannot write all of standard output: {reason(error)}"
  os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python writes what is left again at its end
  return problem


def run(program: str, usage: str, flags: list[Flag], arguments: list[str],
        body: Callable[[types.SimpleNamespace, list[str]], int | None]) -> int:
  """Runs `body` and returns the exit code: 0, its own, or 1 after an error on standard error."""
  code, error = 0, ""
  if getattr(sys.stdout, "errors", "") == "strict":
    # Names of files that are no text leave as they came; encodings that lack a letter get its number.
    sys.stdout.reconfigure(errors="surrogateescape" if codecs.lookup(sys.stdout.encoding).name == "utf-8" else "backslashreplace")
  try:
    asked = next((word for word in arguments if word in ("-h", "-help", "--help", "--helpfull", "--version")), "")
    if asked == "--version":
      sys.stdout.write(version(program))
    elif asked:
      sys.stdout.write((full_help if asked == "--helpfull" else short_help)(program, usage, flags))
    else:
      code = body(*parse(program, flags, arguments)) or 0
  except (BrokenPipeError, KeyboardInterrupt) as stopped:
    code, error = (0, "") if isinstance(stopped, BrokenPipeError) else (130, "stopped")
  except (Refusal, OSError) as problem:
    code, error = 1, reason(problem)
    if isinstance(problem, OSError) and problem.errno == errno.ENOSPC and not problem.filename:
      error = f"cannot write all of standard output: {error}"
  problem = _finish_output()
  if code == 0 and problem:
    code, error = 1, problem
  if error:
    with contextlib.suppress(OSError):
      print(f"{program}: {error}", file=sys.stderr)
  return code


def warn(message: str) -> None:
  print(f"warning: {message}", file=sys.stderr)


# Targets of output.

STANDARD_OUTPUT = ("-", "/dev/stdout")


def is_stream(path: str) -> bool:
  """Whether bytes that are written to `path` go on to someone, instead of being kept in a file."""
  try:
    return path in STANDARD_OUTPUT or not stat.S_IFMT(os.stat(path).st_mode) in (stat.S_IFREG, stat.S_IFDIR)
  except OSError:
    return False


class OutputFile:
  """The file or stream that a flag names. Opened before the work, so that a target that cannot be written is refused then.

  A file is replaced at once: it has its old content or the new one, and a link to it stays one. One that may be written
  but not replaced, such as a mounted file, is overwritten.
  """

  def __init__(self, flag: str, path: str):
    self.flag, self.path = flag, path
    self.is_standard_output = path in STANDARD_OUTPUT
    self._stream = None
    if self.is_standard_output:
      return
    if os.path.isdir(path):
      raise Refusal(f"{flag}: {path} is a folder, want a file")
    if is_stream(path):
      if stat.S_IFMT(os.stat(path).st_mode) not in (stat.S_IFIFO, stat.S_IFCHR):
        raise Refusal(f"{flag}: {path} is no file, want a file or a stream")
      self._stream = self._try("open", lambda: open(path, "wb"))
      return
    self.path = os.path.realpath(path)
    if os.path.exists(self.path) and not os.access(self.path, os.W_OK):
      raise Refusal(f"{flag}: cannot open {self.path}: Permission denied")
    self._try("create", lambda: tempfile.TemporaryFile(dir=os.path.dirname(self.path)).close())

  def _try(self, what, action):
    try:
      return action()
    except OSError as error:
      raise Refusal(f"{self.flag}: cannot {what} {self.path}: {error.strerror}") from None

  def _write_stream(self, content: bytes) -> None:
    with self._stream as stream:
      stream.write(content)

  def write(self, content: bytes) -> None:
    if self.is_standard_output:
      sys.stdout.flush()
      sys.stdout.buffer.write(content)
    elif self._stream is not None:
      self._try("write", lambda: self._write_stream(content))
    else:
      self._try("write", lambda: self._write_file(content))

  def _write_file(self, content: bytes) -> None:
    try:
      replace_file(self.path, content)
    except OSError as error:
      # No file may be renamed to a mounted one (EBUSY), or to another user's in a folder like /tmp (EPERM).
      if error.errno not in (errno.EBUSY, errno.EPERM) or not os.path.exists(self.path):
        raise
      with open(os.open(self.path, os.O_WRONLY | os.O_TRUNC | os.O_NOFOLLOW), "wb") as file:
        file.write(content)


def replace_file(path: str, content: bytes) -> None:
  """Replaces the file at once. OSError: it is unchanged, and nothing else is left."""
  new = os.path.join(os.path.dirname(os.path.abspath(path)), f".craftfleet-{secrets.token_hex(8)}")
  try:
    with open(new, "xb") as file:
      file.write(content)
      file.flush()
      os.fsync(file.fileno())
    if os.path.exists(path):
      shutil.copymode(path, new)
    os.replace(new, path)
  except OSError:
    with contextlib.suppress(OSError):
      os.unlink(new)
    raise

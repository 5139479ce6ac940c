#!/usr/bin/env python3
"""Finds missing includes: names of std, Abseil and other libraries that a file uses, but for which neither it nor one of our
headers that it includes has the library's header. Such a file compiles only where another library's header happens to include
that one. Prints FILE:LINE: NAME, want <HEADER>, and exits with 1; a name that is not in .ci/includes.txt is an error, too.

Usage: .ci/includes.py [FILE]...    default: every .h and .cc file in git
"""

import functools
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
TABLE = ROOT / ".ci/includes.txt"
FOLDERS = ("", "deploy/python/")  # in which the compiler looks for our headers

# Headers of the language's C library, which C++ offers under two names.
SAME = {"signal.h": "csignal", "stdlib.h": "cstdlib", "string.h": "cstring", "stdio.h": "cstdio", "time.h": "ctime", "errno.h": "cerrno",
        "stdint.h": "cstdint", "math.h": "cmath", "stddef.h": "cstddef"}
# Generated headers, and headers that hold what their class returns or takes.
ALSO = {r"craftfleet/v1/.*\.grpc\.pb\.h": "grpcpp/* google/protobuf/*", r"craftfleet/v1/.*\.pb\.h": "google/protobuf/*", r"iostream": "istream ostream",
        r"sstream|fstream": "istream ostream", r"gmock/gmock\.h": "gtest/gtest.h", r"string|vector|map|set|deque|array": "initializer_list iterator",
        r"absl/strings/str_format\.h": "absl/strings/string_view.h", r"absl/(flags/flag|time/clock)\.h": "absl/flags/declare.h",
        r"absl/time/clock\.h": "absl/time/time.h", r"absl/strings/(str_cat|match|strip|numbers|str_split|str_join|escaping|ascii|str_replace)\.h":
        "absl/strings/string_view.h", r"unordered_map|map": "utility", r"absl/flags/reflection\.h": "absl/strings/string_view.h",
        r"opencv2/.*": "opencv2/*", r"grpcpp/.*": "grpcpp/*", r"google/protobuf/.*": "google/protobuf/*", r"prometheus/.*": "prometheus/*"}

NAME = re.compile(r"(?<![\w:])(?:std|absl|nlohmann|benchmark|prometheus|cv|grpc|google::protobuf)::\w+|\b(?:[A-Z]+_)*[A-Z]+(?:_[A-Z]\w*)?(?=\()")
INCLUDE = re.compile(r'^\s*#\s*include\s+(?:<([^>]+)>|"([^"]+)")', re.MULTILINE)
COMMENT_OR_TEXT = re.compile(r'//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])+\'', re.DOTALL)


def headers_by_name():
  """(name -> headers, [(pattern of names, header)])."""
  exact, patterns = {}, []
  text = re.sub(r"^#.*\n|\n +", lambda match: " " if match[0][0] == "\n" else "", TABLE.read_text(encoding="utf-8"), flags=re.MULTILINE)
  for header, names in re.findall(r"^(\S+): (.*)$", text, re.MULTILINE):
    for name in names.split():
      if "/" not in header:
        name = f"std::{name}"
      if "*" in name:
        patterns.append((re.compile(re.escape(name).replace(r"\*", r"\w*")), header))
      else:
        exact.setdefault(name, set()).add(header)
  return exact, patterns


EXACT, PATTERNS = headers_by_name()


@functools.lru_cache(maxsize=None)
def providers(name):
  """The headers that provide a name; empty if it is not in the table."""
  return EXACT.get(name) or {header for pattern, header in PATTERNS if pattern.fullmatch(name)}


@functools.lru_cache(maxsize=None)
def text_of(path):
  return (ROOT / path).read_text(encoding="utf-8")


@functools.lru_cache(maxsize=None)
def included(path):
  """The libraries' headers that a file or one of our headers in it includes."""
  found, seen, waiting = set(), {path}, [path]
  while waiting:
    for system, own in INCLUDE.findall(text_of(waiting.pop())):
      found.add(SAME.get(system, system) or own)
      for header in (folder + own for folder in FOLDERS if own):
        if header not in seen and (ROOT / header).exists():
          seen.add(header)
          waiting.append(header)
  for pattern, headers in ALSO.items():
    if any(re.fullmatch(pattern, header) for header in found):
      found.update(headers.split())
  return found


def blank(match):
  return re.sub(r"[^\n]", " ", match[0])


def missing(path):
  """(line, name, headers that would do) of the first use of each name without its header; no headers: not in the table."""
  code = COMMENT_OR_TEXT.sub(blank, INCLUDE.sub(blank, text_of(path)))
  have, seen = included(path), set()
  for match in NAME.finditer(code):
    name = match[0]
    if name in seen or ("::" not in name and not providers(name)):
      continue
    seen.add(name)
    wanted = providers(name)
    declared = re.search(rf"^(class|struct) {name.rpartition('::')[2]};", code, re.MULTILINE)  # a forward declaration is enough
    if not wanted & have and not declared:
      yield code.count("\n", 0, match.start()) + 1, name, sorted(wanted)


def main():
  files = sys.argv[1:] or subprocess.run(["git", "ls-files", "*.h", "*.cc"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
  failures = 0
  for path in files:
    for line, name, headers in missing(path):
      failures += 1
      wanted = " or ".join(f"<{header}>" for header in headers)
      print(f"{path}:{line}: {name}, want {wanted}" if headers else f"{path}:{line}: {name} is not in .ci/includes.txt")
  print(f"{len(files)} files, {failures} missing includes")
  sys.exit(1 if failures else 0)


if __name__ == "__main__":
  main()

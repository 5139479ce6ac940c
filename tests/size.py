#!/usr/bin/env python3
"""Prints how large the project is: lines of code, words, files, programs and flags. Runs in a second, from anywhere."""

import pathlib
import re
import subprocess

ROOT = pathlib.Path(__file__).resolve().parent.parent
CODE = (".cc", ".h", ".py", ".sh", ".proto", ".js", ".cmake")
GENERATED = "deploy/experiments/report/"


def main():
  listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
  files = [name for name in listed if name and (ROOT / name).is_file()]
  contents = {name: (ROOT / name).read_bytes() for name in files}
  is_test = {name: name.startswith("tests/") for name in files}
  code = [name for name in files if name.endswith(CODE)]
  product = [name for name in code if not is_test[name]]
  pages = [name for name in files if name.endswith(".md") and not name.startswith(GENERATED)]
  lists = b"".join(contents[name] for name in files if name.endswith("CMakeLists.txt"))
  scripts = [contents[name] for name in product if name.startswith("deploy/python/craftfleet/analysis/")]  # craftfleet report, ...
  programs = len(re.findall(rb"^ *craftfleet_program\(NAME", lists, re.M))
  tests = len(re.findall(rb"^ *craftfleet_test\(NAME", lists, re.M))
  flags = sum(len(re.findall(rb"^ *ABSL_FLAG\(", contents[name], re.M)) for name in product)
  flags += sum(len(re.findall(rb"^    Flag\(", script, re.M)) for script in scripts)
  rows = [
      ("product lines", sum(contents[name].count(b"\n") for name in product)),
      ("test lines", sum(contents[name].count(b"\n") for name in code if is_test[name])),
      ("words of pages", sum(len(contents[name].split()) for name in pages)),
      ("tracked files", len(files)),
      ("megabytes of a checkout", round(sum(map(len, contents.values())) / 2**20)),
      ("programs", programs),
      ("flags", flags),
      ("declarations of C++ tests", tests),
  ]
  for name, value in rows:
    print(f"{name:26} {value:>8,}")


main()

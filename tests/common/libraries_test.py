"""Each library names the libraries that it uses. GNU ld reads them in that order, and would not find what others define."""

import subprocess
import unittest

from tests.fakes import python_case
from tests.fakes.python_case import BIN


def symbols(file, which):
  """The defined or undefined symbols of our own code in a static library."""
  lines = subprocess.run(["nm", "--quiet", which, "--format=posix", file], capture_output=True, text=True, check=True).stdout
  return {line.split()[0] for line in lines.splitlines() if "craftfleet" in line and not line.endswith(":")}


class Libraries(unittest.TestCase):

  def test_each_names_what_it_uses(self):
    files, named = {}, {}
    for line in (BIN.parent / "libraries.txt").read_text().splitlines():
      library, files[library], names = line.split("|")
      named[library] = {name.replace("craftfleet::", "craftfleet_") for name in names.split(";")}
    defined = {library: symbols(file, "--defined-only") for library, file in files.items()}
    owners = {symbol: library for library, found in defined.items() for symbol in found}
    self.assertIn("craftfleet_base", owners.values())

    def reached(library, seen):
      for name in (named[library] & files.keys()) - seen:
        seen.add(name)
        reached(name, seen)
      return seen

    missing = set()
    for library, file in files.items():
      there = set().union(*(defined[name] for name in reached(library, {library})))
      missing |= {f"{library} uses {owners[symbol]}: {symbol}"
                  for symbol in symbols(file, "--undefined-only") - there if symbol in owners}
    self.assertEqual(missing, set())


if __name__ == "__main__":
  python_case.main()

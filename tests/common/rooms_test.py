"""The folders of common/ include and link each other only as listed in its README, so that there are no cycles; and rules for all
rooms, about clocks and names."""

import re
import unittest

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

COMMON = SOURCE / "common"
# Files that may read the date of the system, which can jump: for what people or certificates see, or as gRPC's deadlines.
# All others measure and wait with SteadyNow (common/base/clock.h).
DATES = {"common/base/clock.h", "common/telemetry/log.cc", "common/wire/channel.cc", "common/wire/security.cc",
         "common/wire/server.cc", "learner/admin_service.cc"}


def table(text):
  """The folders of the README's first table, in order, each with the set of folders that it uses."""
  rows = re.findall(r"^\| \[(\w+)\]\(\w+\) \| .* \| (.*) \|$", text, re.M)
  uses = {}
  for folder, used in rows:
    uses[folder] = set(uses).union(*uses.values()) if used == "all of the above" else set(re.findall(r"\w+", used))
  return uses


def libraries(folder):
  """The libraries that a folder's CMakeLists.txt declares: name -> (sources, libraries of this project that it links)."""
  text = re.sub("#.*", "", (COMMON / folder / "CMakeLists.txt").read_text())
  declared = {}
  for name, sources, links in re.findall(r"craftfleet_library\(NAME (\w+)\s+SRCS\s([^)]*?)\sDEPS\s([^)]*)\)", text):
    declared[name] = (sources.split(), set(re.findall(r"craftfleet::(\w+)", links)))
  return declared


def included_rooms(folder):
  """The folders whose headers the files of `folder` include."""
  files = [path for path in (COMMON / folder).rglob("*") if path.suffix in (".h", ".cc")]
  return {room for path in files for room in re.findall(r'^#include "common/(\w+)/', path.read_text(), re.M)} - {folder}


class Clocks(unittest.TestCase):

  def test_nothing_waits_for_the_systems_date(self):
    found = set()
    for room in ["common", "actor", "learner", "envserver"]:
      for path in [*(SOURCE / room).rglob("*.h"), *(SOURCE / room).rglob("*.cc")]:
        if re.search(r"absl::Now\(|system_clock::now|gettimeofday|\btime\((nullptr|NULL|0)\)", path.read_text()):
          found.add(str(path.relative_to(SOURCE)))
    self.assertEqual(found - DATES, set())
    self.assertEqual(DATES - found, set(), "no longer needed in the list")


class Names(unittest.TestCase):

  def test_each_class_has_a_name_of_its_own(self):
    """A program that links two classes of one name may run the destructor of one for the other."""
    headers = {}
    for room in ["common", "actor", "learner", "envserver", "deploy"]:
      for path in (SOURCE / room).rglob("*.h"):
        text = path.read_text()
        namespace = "::".join(re.findall(r"^namespace (\w+) {", text, re.M))
        for name in re.findall(r"^(?:class|struct|enum class) (?:ABSL_\S+ )?(\w+)[^;{]*{", text, re.M):
          headers.setdefault(f"{namespace}::{name}", set()).add(str(path.relative_to(SOURCE)))
    self.assertGreater(len(headers), 200)
    self.assertEqual({name: sorted(paths) for name, paths in headers.items() if len(paths) > 1}, {})


class Rooms(unittest.TestCase):

  def test_every_folder_is_in_the_table(self):
    folders = {path.name for path in COMMON.iterdir() if path.is_dir()}
    self.assertEqual(set(table((COMMON / "README.md").read_text())), folders)

  def test_includes_match_the_table(self):
    uses = table((COMMON / "README.md").read_text())
    checked = 0
    for path in [*COMMON.rglob("*.h"), *COMMON.rglob("*.cc")]:
      room = path.relative_to(COMMON).parts[0]
      for used in re.findall(r'^#include "common/(\w+)/', path.read_text(), re.M):
        self.assertIn(used, uses[room] | {room}, path)
        checked += 1
      self.assertEqual(re.findall(r'^#include "(?:actor|learner|envserver|deploy)/.*', path.read_text(), re.M), [], path)
    self.assertGreater(checked, 100)

  def test_a_folder_uses_only_those_above_it(self):
    above = {"proto"}
    for folder, used in table((COMMON / "README.md").read_text()).items():
      self.assertLessEqual(used, above, folder)
      above.add(folder)

  def test_each_folder_has_a_library_of_its_sources(self):
    for folder in table((COMMON / "README.md").read_text()):
      declared = libraries(folder)
      self.assertIn(folder, declared)
      sources = [source for srcs, _ in declared.values() for source in srcs if not source.startswith("$")]
      found = [str(path.relative_to(COMMON / folder)) for path in (COMMON / folder).rglob("*.cc")]
      self.assertEqual(sorted(sources), sorted(found), folder)

  def test_a_folders_libraries_link_those_that_it_includes(self):
    rooms = table((COMMON / "README.md").read_text())
    proto = {"proto", "config_proto"}
    for folder, uses in rooms.items():
      declared = libraries(folder)
      linked = set().union(*(links for _, links in declared.values())) - set(declared)
      self.assertEqual(linked - proto - {"torch"}, included_rooms(folder), folder)
      self.assertEqual(bool(linked & proto), "proto" in uses, folder)
    self.assertEqual(re.findall(r"craftfleet_library", (COMMON / "CMakeLists.txt").read_text()), [])


if __name__ == "__main__":
  python_case.main()

"""Rules for the sources: clocks, names, and no circles among the folders of common/."""

import re
import unittest

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

COMMON = SOURCE / "common"
# Files that may read the date of the system, which can jump: for what people or certificates see, or as gRPC's deadlines.
# All others measure and wait with SteadyNow (common/base/clock.h).
DATES = {"common/base/clock.h", "common/telemetry/log.cc", "common/wire/channel.cc", "common/wire/security.cc",
         "common/wire/server.cc", "learner/service/admin_service.cc"}


def included_folders(folder):
  """The other folders of common/ whose headers the files of `folder` include."""
  files = [path for path in (COMMON / folder).rglob("*") if path.suffix in (".h", ".cc")]
  return {used for path in files for used in re.findall(r'^#include "common/(\w+)/', path.read_text(), re.M)} - {folder}


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


class Folders(unittest.TestCase):

  def test_folders_of_common_do_not_include_each_other_in_a_circle(self):
    uses = {path.name: included_folders(path.name) for path in COMMON.iterdir() if path.is_dir()}
    self.assertGreater(sum(map(len, uses.values())), 10)
    while uses:
      free = [folder for folder, used in uses.items() if not used & set(uses)]
      self.assertTrue(free, f"a circle: {uses}")
      for folder in free:
        del uses[folder]

  def test_common_includes_no_other_room(self):
    for path in [*COMMON.rglob("*.h"), *COMMON.rglob("*.cc")]:
      self.assertEqual(re.findall(r'^#include "(?:actor|learner|envserver|deploy)/.*', path.read_text(), re.M), [], path)


if __name__ == "__main__":
  python_case.main()

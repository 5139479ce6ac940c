"""The tables of files in the READMEs of the rooms name every header, and no file that does not exist."""

import pathlib
import re
import unittest

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

ROOMS = ["common", "common/wire", "common/agent", "envserver", "envserver/world", "envserver/render", "actor", "learner", "learner/ppo", "learner/ppo/distillation",
         "learner/run", "learner/ranks", "deploy/cli/top"]


def named_files(room, columns=r"\|.*"):
  """What is in backquotes in the tables of a room's README, in the columns that match."""
  rows = re.findall(f"^{columns}", (SOURCE / room / "README.md").read_text(), re.M)
  return {name for row in rows for name in re.findall(r"`([\w/.]+)`", row)}


def headers(room):
  """The headers of a room and of its folders, but for those that have a README of their own."""
  folder = SOURCE / room
  return [path.relative_to(folder) for path in folder.rglob("*.h") if room == nearest_room(path)]


def nearest_room(path):
  folder = next(parent for parent in path.parents if (parent / "README.md").exists())
  return str(folder.relative_to(SOURCE))


class ReadmeTables(unittest.TestCase):

  def test_name_every_header(self):
    for room in ROOMS:
      found = headers(room)
      self.assertTrue(found, room)
      names = named_files(room)
      missing = [str(path) for path in found if not {str(path), str(path.with_suffix("")), path.name} & names]
      self.assertEqual(missing, [], f"{room}/README.md does not name them")

  def test_name_no_header_that_does_not_exist(self):
    for room in ROOMS:
      for name in named_files(room, columns=r"\|[^|]*"):
        if name.endswith((".h", ".cc")):
          path = pathlib.Path(name)
          places = [SOURCE / path, SOURCE / room / path, *(SOURCE / room).rglob(path.name)]
          self.assertTrue(any(place.exists() for place in places), f"{room}/README.md names {name}")


python_case.main()

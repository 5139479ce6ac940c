"""Every field of every message has a comment, beside it or on the lines above it; that of a number states its range. The ranges
themselves are tried in field_edges_test.cc, which names each file."""

import re
import unittest

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

FIELD = re.compile(r"\s*(?:optional |repeated )?([\w.]+) (\w+) = \d+;")
NUMBERS = {"int32", "int64", "uint32", "uint64", "float", "double"}
# "0..9", "from 1", "at most 10", "any number", or another field or constant with a range.
RANGE = re.compile(r"\d\.\.|\.\.\d|from \d|at (least|most) \d|more than \d|\bany\b|\bas (in |`|\w+Request|to )|likewise|"
                   r"\bk[A-Z]\w+|finite|a divisor of|22 counts|ranges of \w+\.\w+")
PROTOS = sorted((SOURCE / "proto/craftfleet/v1").glob("*.proto"))


def fields(text):
  """Type, name and comment of each field. A comment goes on in the next line if that begins far to the right."""
  lines = text.splitlines()
  for i, line in enumerate(lines):
    field = FIELD.match(line)
    if not field:
      continue
    comment = line.partition("//")[2]
    below = i + 1
    while comment and re.match(r"\s{20,}//", lines[below]):
      comment += lines[below].partition("//")[2]
      below += 1
    above = i - 1
    while not line.partition("//")[2] and lines[above].lstrip().startswith("//"):
      comment = lines[above].partition("//")[2] + comment
      above -= 1
    yield field[1], field[2], comment


class ProtoComments(unittest.TestCase):

  def test_every_field_has_a_comment_and_every_number_a_range(self):
    count = 0
    for path in PROTOS:
      for kind, name, comment in fields(path.read_text(encoding="utf-8")):
        count += 1
        self.assertTrue(comment.strip(), f"{path.name}: {name} has no comment")
        if kind in NUMBERS:
          self.assertRegex(comment, RANGE, f"{path.name}: {name} has no range")
    self.assertGreater(count, 200)

  def test_every_file_is_in_the_test_of_ranges(self):
    text = (SOURCE / "tests/common/wire/field_edges_test.cc").read_text(encoding="utf-8")
    for path in PROTOS:
      walked = f"craftfleet/v1/{path.stem}.pb.h" in text or f"craftfleet/v1/{path.stem}.grpc.pb.h" in text
      self.assertTrue(walked or f"//   {path.name} " in text, path.name)

  def test_fields_without_comment_or_range_are_found(self):
    text = ("message M {\n  int32 a = 1;  // from 0\n  repeated v1.Peer b = 2;\n  // From 0.\n  optional int64 c = 3;\n"
            "  double d = 4;      // seconds,\n                     // 0..9\n  float e = 5;  // degrees\n}\n")
    found = [(name, bool(comment), bool(RANGE.search(comment))) for _, name, comment in fields(text)]
    self.assertEqual(found, [("a", True, True), ("b", False, False), ("c", True, False), ("d", True, True),
                             ("e", True, False)])


if __name__ == "__main__":
  python_case.main()

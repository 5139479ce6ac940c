"""PPO.md and FORMATS.md agree with the code: fields, defaults, curves."""

import re
import unittest

from tests.fakes import python_case


def read(path):
  return (python_case.SOURCE / path).read_text()


def message_fields(proto, message):
  """The names of the fields of a message that contains no other messages, without the values of its enumerations."""
  body = re.search(rf"^message {message} {{\n(.*?)^}}", proto, re.DOTALL | re.MULTILINE)[1]
  return re.findall(r"^  (?:optional |repeated )?\w+ (\w+) = \d+;", body, re.MULTILINE)


def table_rows(page, heading):
  """The cells of the first table below a heading, row by row."""
  section = page.split(f"## {heading}")[1].split("\n## ")[0]
  return [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line.startswith("| `")]


class Formats(unittest.TestCase):

  def test_ppo_page_has_every_field_with_its_default(self):
    rows = {row[0].strip("`"): row[1].strip("`") for row in table_rows(read("learner/ppo/PPO.md"), "1. ")}
    fields = message_fields(read("proto/craftfleet/v1/config.proto"), "PpoConfig")
    self.assertEqual(sorted(rows), sorted(fields))
    code = dict(re.findall(r"ppo\.set_(\w+)\((?:v1::PpoConfig::)?([^)]*)\);", read("common/config/config.cc")))
    # Fields that are off are left out of the configuration.
    off = re.findall(r"if \(.*\) ppo(?:\.|->)clear_(\w+)\(\);", read("common/config/config.cc"))
    code.update({name: "false" if f"bool {name} =" in read("proto/craftfleet/v1/config.proto") else "0" for name in off})
    self.assertEqual(rows, code)

  def test_formats_page_has_every_field_of_a_checkpoint(self):
    page = read("learner/run/FORMATS.md").split("## 7. ")[1].split("\n## ")[0]
    fields = message_fields(read("proto/craftfleet/v1/checkpoint.proto"), "CheckpointState")
    self.assertGreater(len(fields), 10)
    rows = [name for line in page.splitlines() if line.startswith("| `") for name in re.findall(r"`(\w+)`", line.split("|")[1])]
    self.assertEqual([field for field in fields if field not in rows], [])

  def test_formats_page_has_every_curve(self):
    page = read("learner/run/FORMATS.md").split("## 6. ")[1].split("\n## ")[0]
    tags = re.findall(r'{"(\w+/\w+)"', read("learner/training_log.cc"))
    self.assertGreater(len(tags), 10)
    tags += [f"eval/{kind}" for kind in re.findall(r'group \+ "(\w+)"', read("learner/evaluation_planner.cc"))]
    self.assertIn("eval/sampled_reward", tags)
    self.assertEqual([tag for tag in tags if f"`{tag}`" not in page], [])

  def test_formats_page_has_every_file(self):
    page = read("learner/run/FORMATS.md")
    names = re.findall(r'"([\w.]+\.(?:jsonl|txt|json|journal|safetensors|pb)|events[\w.]+|MANIFEST)"',
                       read("learner/run/run_folder.cc") + read("learner/run/checkpoint.cc") + read("learner/learner.cc"))
    self.assertGreater(len(set(names)), 10)
    self.assertEqual([name for name in sorted(set(names)) if f"`{name}`" not in page], [])


if __name__ == "__main__":
  python_case.main()

"""The commands of the README: every program, script and folder that they name is there, and every flag is its program's."""

import re
import unittest

from tests.deploy.flags import unknown_flags
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE


class Readme(unittest.TestCase):

  def commands(self):
    text = (SOURCE / "README.md").read_text(encoding="utf-8")
    lines = [line.partition("  #")[0].strip() for line in text.splitlines() if line.startswith("    ")]
    commands = [command.split() for line in lines for command in re.split(r"&& | \| ", line)]
    self.assertGreater(len(commands), 30)
    return [[word for word in words if word != "sudo"] for words in commands if words]

  def test_files_are_there(self):
    for words in self.commands():
      for word in words:
        path = word.strip('"').removeprefix("$PWD/").partition("*")[0]
        if re.match(r"(deploy|tests|build/bin)/", path):
          path = path.replace("build/bin", str(BIN), 1)
          found = (SOURCE / path).exists() or list((SOURCE / path).parent.glob((SOURCE / path).name + "*"))
          self.assertTrue(found, " ".join(words))

  def test_flags_are_those_of_the_programs(self):
    checked = 0
    for words in self.commands():
      name = words[0].rpartition("/")[2]
      arguments = [re.sub(r'="[^"]*$', "=x", word) for word in words[1:] if word.startswith("--")]
      if name == "craftfleet" and len(words) > 1 and not words[1].startswith("-"):
        name = f"craftfleet-{words[1]}"
      elif name == "local-fleet.sh":
        name = "craftfleet-learner"
        arguments = [argument for argument in arguments if not re.match("--(actors|envservers|bin)=", argument)]
      elif name == "sbatch":
        name = "craftfleet-learner"
      if not name.startswith("craftfleet") or name == "craftfleet":
        continue
      if arguments and '="' in " ".join(words):  # a quoted value has blanks in it
        arguments = [argument for argument in arguments if not re.match(r"--(time|mem)=", argument)]
      self.assertEqual(unknown_flags(name, arguments), [], " ".join(words))
      checked += len(arguments)
    self.assertGreater(checked, 40)


python_case.main()

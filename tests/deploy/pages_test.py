"""Runs the commands of README.md, and checks the links of every page."""

import re
import unittest

from tests.deploy import pages
from tests.deploy.page_runner import PageRunner
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

# Commands of README.md that are not run here: they install and build.
LEFT_OUT = re.compile(r"deploy/(quickstart|test)\.sh")


class Pages(python_case.FolderCase):

  def test_commands_of_readme_run_from_a_clean_checkout(self):
    commands = [command for command in pages.commands("README.md") if not LEFT_OUT.match(command)]
    self.assertGreater(len(commands), 10)
    PageRunner(self, self.folder).run(commands)

  def test_links_are_valid(self):
    checked = 0
    for page in pages.pages():
      for link in pages.links(page):
        path, _, anchor = link.partition("#")
        if re.match(r"https?://", link):
          self.assertRegex(link, r"^https://[\w.-]+(/[\w./-]*)?$", page)
          continue
        target = (SOURCE / page).parent / path if path else SOURCE / page
        self.assertTrue(target.exists(), f"{page}: {link}")
        if anchor:
          self.assertIn(anchor, pages.anchors(target.resolve().relative_to(SOURCE).as_posix()), f"{page}: {link}")
        checked += 1
    self.assertGreater(checked, 60)


if __name__ == "__main__":
  python_case.main()

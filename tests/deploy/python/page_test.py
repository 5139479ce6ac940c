"""The Python of the package's pages runs as it stands there, block after block, and prints what stands below it."""

import contextlib
import io
import os
import re

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "imageio_ffmpeg", "matplotlib")
PAGES = SOURCE / "deploy/python"


class Page(python_case.FolderCase, package.PackageCase):

  def run_blocks(self, page):
    """Runs the blocks of Python in a folder of their own; returns the number of blocks with output."""
    blocks = re.findall(r"^```python\n(.*?)^```(?:\n\n```text\n(.*?)^```)?", (PAGES / page).read_text(), re.MULTILINE | re.DOTALL)
    self.assertGreater(len(blocks), 4)
    names = {}
    self.addCleanup(os.chdir, os.getcwd())
    os.chdir(self.folder)
    for block, expected in blocks:
      if "/path/to/" in block or "RemoteVectorEnv" in block:  # remote_test.py starts servers
        continue
      with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(block, page, "exec"), names)  # pylint: disable=exec-used
      if expected:
        self.assertEqual(printed.getvalue(), expected)
    return sum(expected != "" for _, expected in blocks)

  def test_the_python_of_the_readme_runs(self):
    self.run_blocks("README.md")

  def test_the_python_of_the_tutorial_runs_and_draws_its_plot(self):
    self.assertEqual(self.run_blocks("TUTORIAL.md"), 3)
    for picture in ("game.png", "achievements.png"):
      self.assertTrue((self.folder / picture).read_bytes().startswith(b"\x89PNG"))


if __name__ == "__main__":
  python_case.main()

"""The blocks of the tutorial run one after the other, with a shorter training, and print what stands below them."""

import os
import re
import subprocess
import sys

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

package.need("craftfleet", "numpy", "pandas", "tqdm", "matplotlib")


class Tutorial(python_case.FolderCase):

  def test_its_blocks_lead_to_a_plot_of_a_trained_agent(self):
    page = (SOURCE / "deploy/python/TUTORIAL.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    program = "\n".join(blocks)
    shorter = program.replace("steps=100_000", "steps=8192")
    self.assertNotEqual(shorter, program)
    (self.folder / "tutorial.py").write_text(shorter)
    ended = subprocess.run(
        [sys.executable, "tutorial.py"], capture_output=True, text=True, timeout=600, check=False, cwd=self.folder,
        env={**os.environ, "MPLBACKEND": "agg", "PATH": f"{BIN}:{os.environ['PATH']}", "PYTHONPATH": str(package.SITE)})
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertEqual(ended.stdout, "".join(re.findall(r"^```text\n(.*?)^```", page, re.MULTILINE | re.DOTALL)))
    for picture in ("curve.png", "achievements.png"):
      self.assertEqual((self.folder / picture).read_bytes()[1:4], b"PNG")


if __name__ == "__main__":
  python_case.main()

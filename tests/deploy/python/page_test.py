"""The Python of the package's page runs as it stands there, block after block."""

import os
import re
import tempfile

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "imageio_ffmpeg")
PAGE = SOURCE / "deploy/python/README.md"


class Page(package.PackageCase):

  def test_its_python_runs(self):
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    self.assertGreater(len(blocks), 4)
    names = {}
    here = os.getcwd()
    self.addCleanup(os.chdir, here)
    with tempfile.TemporaryDirectory(prefix="craftfleet-") as folder:
      os.chdir(folder)
      for block in blocks:
        if "/path/to/" not in block and "RemoteVectorEnv" not in block:  # remote_test.py starts servers
          exec(compile(block, str(PAGE), "exec"), names)  # pylint: disable=exec-used
      os.chdir(here)


if __name__ == "__main__":
  python_case.main()

"""A small disk of its own for a test, which the test fills up."""

import contextlib
import os
import pathlib
import subprocess
import tempfile


@contextlib.contextmanager
def small_disk(case, mib=16):
  """The folder of a new file system in memory; skips the test where it may not mount one, with the reason."""
  folder = pathlib.Path(tempfile.mkdtemp(prefix="craftfleet-disk-"))
  mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={mib}m", "craftfleet-test", folder], capture_output=True,
                           text=True, check=False)
  if mounted.returncode != 0:
    folder.rmdir()
    case.skipTest(f"cannot mount a small disk: {mounted.stderr.strip()}; want root")
  try:
    yield folder
  finally:
    subprocess.run(["umount", "--lazy", folder], check=True)
    folder.rmdir()


def fill(disk, left=0):
  """Leaves `left` bytes of the disk free."""
  filler = disk / "filler"
  with filler.open("ab", buffering=0) as file:
    with contextlib.suppress(OSError):
      while True:
        file.write(bytes(1 << 16))
    with contextlib.suppress(OSError):
      while True:
        file.write(bytes(1 << 12))
    if left:
      file.truncate(os.path.getsize(filler) - left)

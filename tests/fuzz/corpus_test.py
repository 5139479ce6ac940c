"""tests/fuzz/corpus.sh: archives of fuzz inputs do not depend on when, where and in which order their files were written."""

import os
import subprocess
import tarfile

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

FUZZ = SOURCE / "tests/fuzz"


def corpus(command, archive, folder):
  subprocess.run([FUZZ / "corpus.sh", command, archive, folder], check=True)


class Corpus(python_case.FolderCase):

  def written(self, name, inputs, mtime):
    folder = self.folder / name
    folder.mkdir()
    for path, data in inputs:
      (folder / path).write_bytes(data)
      os.utime(folder / path, (mtime, mtime))
    return folder

  def test_equal_files_make_equal_archives_and_unpack_unchanged(self):
    inputs = [("b", b"\0\xff" * 300), ("a", b""), ("sound-0", b"text\n")]
    corpus("pack", self.folder / "one.tar.gz", self.written("one", inputs, 1_000_000))
    corpus("pack", self.folder / "two.tar.gz", self.written("two", reversed(inputs), 2_000_000))
    self.assertEqual((self.folder / "one.tar.gz").read_bytes(), (self.folder / "two.tar.gz").read_bytes())
    corpus("unpack", self.folder / "one.tar.gz", self.folder / "back")
    self.assertEqual({path.name: path.read_bytes() for path in (self.folder / "back").iterdir()}, dict(inputs))

  def test_every_archive_and_regression_belongs_to_a_target(self):
    targets = {path.stem.removeprefix("fuzz_") for path in FUZZ.glob("fuzz_*.cc")}
    archives = list((FUZZ / "corpus").iterdir())
    self.assertGreater(len(archives), 10)
    for archive in archives:
      self.assertIn(archive.name.removesuffix(".tar.gz"), targets)
      with tarfile.open(archive) as tar:
        self.assertGreater(len(tar.getmembers()), 0, archive)
        self.assertTrue(all(member.isfile() and "/" not in member.name for member in tar.getmembers()), archive)
    for folder in (FUZZ / "regressions").iterdir():
      self.assertIn(folder.name, targets)
      self.assertTrue(list(folder.iterdir()), folder)


python_case.main()

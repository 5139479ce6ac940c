"""Every output of every program on a disk that fills up: an error, and no half file under a final name."""

import json
import os
import struct
import subprocess
import zipfile

from tests.fakes import full_disk, python_case
from tests.fakes.python_case import BIN, SOURCE, built


def is_whole(path):
  """Whether a file has the end of one of its kind."""
  content = path.read_bytes()
  try:
    if path.suffix == ".mp4":
      at = 0
      while at < len(content):  # each box begins with its length
        at += struct.unpack(">I", content[at:at + 4])[0] or len(content) + 1
      return at == len(content) and b"moov" in content
    if path.suffix == ".npz":
      return zipfile.ZipFile(path).testzip() is None
    if path.suffix == ".json":
      return bool(json.loads(content))
  except (struct.error, ValueError, zipfile.BadZipFile):
    return False
  return content.endswith(b"IEND\xaeB`\x82" if path.suffix == ".png" else b"\n")


class FullDisk(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    (self.folder / "config.txt").write_text(python_case.SMALL_RUN)
    (self.folder / "experiments.toml").write_text(python_case.SMALL_EXPERIMENT)
    python_case.trained_run(self.folder / "run", python_case.SMALL_RUN)

  def outputs(self, out):
    """Commands that write below the folder `out`."""
    run = self.folder / "run"
    return [
        ["craftfleet curve", run, f"--out={out}/curve.png"],
        ["craftfleet eval", f"--checkpoint={run}", "--episodes=1", f"--out={out}/eval.json"],
        ["craftfleet eval", f"--checkpoint={run}", "--episodes=1", f"--pictures={out}/pictures"],
        ["craftfleet eval", f"--checkpoint={run}", "--episodes=1", f"--video={out}/videos"],
        ["craftfleet eval", f"--checkpoint={run}", "--episodes=1", f"--episodes_npz={out}/episodes"],
        ["craftfleet watch", f"--video={out}/watch.mp4", run],
        ["craftfleet report", run, f"--out={out}/report", "--html"],
        ["craftfleet sweep", self.folder / "experiments.toml", f"--write_configs={out}/configs"],
        ["craftfleet sweep", self.folder / "experiments.toml", "--executor=slurm", f"--logdir={out}/sweep"],
        ["craftfleet train", f"--config={self.folder}/config.txt", f"--logdir={out}/train"],
    ]

  def test_no_output_is_half_written_under_its_final_name(self):
    for left in (0, 4096, 20000):
      with full_disk.small_disk(self) as disk:
        for number, command in enumerate(self.outputs(disk)):
          out = disk / str(number)
          with self.subTest(command=command, left=left):
            out.mkdir()
            # The old file at the target stays, or the new one is whole.
            command = [str(word).replace(f"={disk}/", f"={out}/") for word in command]
            full_disk.fill(disk, left)
            ended = subprocess.run([*built(command[0]), *command[1:]], stdin=subprocess.DEVNULL, capture_output=True, text=True,
                                   timeout=120, check=False)
            made = [path for path in out.rglob("*") if path.is_file() and path.name not in ("lock", "epoch")]
            (disk / "filler").unlink()
            if command[0] == "craftfleet train":
              self.check_run_that_did_not_begin(ended, made)
              continue
            self.assertIn(ended.returncode, (0, 1), ended.stderr)
            final = [path for path in made if not path.name.startswith(".")]
            self.assertEqual([path for path in final if not is_whole(path)], [], ended.stderr)
            if left == 0:
              self.assertEqual(ended.returncode, 1, ended.stderr)
              self.assertEqual([path.name for path in made if path.stat().st_size > 0], [], ended.stderr)
            if ended.returncode == 1:
              self.assertRegex(ended.stderr, "No space left on device|free space on that disk|sbatch")
            else:
              self.assertTrue(final, "it says that it has written")
            self.assertEqual([path.name for path in made if path.name.startswith(".craftfleet-")], [], "leftovers")

  def check_run_that_did_not_begin(self, ended, made):
    self.assertEqual(ended.returncode, 1, ended.stderr)
    self.assertRegex(ended.stderr, "No space left on device")
    for path in made:
      if path.suffix in (".safetensors", ".pb") and not path.parent.name.startswith("."):
        self.assertTrue((path.parent / "MANIFEST").exists(), path)

  def test_a_file_that_is_replaced_keeps_its_old_content(self):
    run = self.folder / "run"
    for flag, file, command in (("--out", "old.png", ["craftfleet curve", run]), ("--video", "old.mp4", ["craftfleet watch", run]),
                                ("--out", "old.json", ["craftfleet eval", f"--checkpoint={run}", "--episodes=1"])):
      with self.subTest(file), full_disk.small_disk(self) as disk:
        target = disk / file
        target.write_bytes(b"old")
        (disk / f"{target.name}.tmp").write_bytes(b"mine")
        full_disk.fill(disk)
        ended = subprocess.run([*built(command[0]), *command[1:], f"{flag}={target}"], capture_output=True, text=True, timeout=120,
                               check=False)
        self.assertEqual(ended.returncode, 1, ended.stderr)
        self.assertEqual(target.read_bytes(), b"old")
        (disk / "filler").unlink()
        ended = subprocess.run([*built(command[0]), *command[1:], f"{flag}={target}"], capture_output=True, text=True, timeout=120,
                               check=False)
        self.assertEqual(ended.returncode, 0, ended.stderr)
        self.assertTrue(is_whole(target))
        self.assertEqual((disk / f"{target.name}.tmp").read_bytes(), b"mine", "a user's file is not touched")
        self.assertEqual({path.name for path in disk.iterdir()}, {target.name, f"{target.name}.tmp"})

  def test_results_are_collected_whole_or_not_at_all(self):
    for left in (0, 4096):
      with self.subTest(left=left), full_disk.small_disk(self) as disk:
        full_disk.fill(disk, left)
        command = [SOURCE / "deploy/experiments/collect.py", "--weights", self.folder / "run", disk / "result"]
        ended = subprocess.run(command, env=os.environ | {"CRAFTFLEET_BIN": str(BIN)}, capture_output=True, text=True, timeout=120,
                               check=False)
        self.assertEqual(ended.returncode, 1, ended.stderr)
        self.assertIn("No space left on device", ended.stderr)
        self.assertEqual([path.name for path in disk.iterdir() if path.name != "filler"], [], ended.stderr)


python_case.main()

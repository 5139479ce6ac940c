"""The golden traces replay through the Python package, bit for bit, pictures included."""

import collections
import copy
import gzip
import json
import os
import pathlib
import unittest
import zlib

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet")
import craftfleet  # pylint: disable=wrong-import-position

GOLDEN = os.environ.get("CRAFTFLEET_GOLDEN_DIR")
OWN = SOURCE / "tests/data/own"
NAMED_LETTERS = "tczsuk"  # the appearance that environments have names for
MAX_EPISODE = 100  # later ones would take a thousand resets; tests/envserver/world opens them directly


def crc(array):
  return f"{zlib.crc32(array.tobytes()):08x}"


def lines(path):
  text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
  return [json.loads(line) for line in text.splitlines()]


def name_of(variant):
  """The environment of a trace's `ood` settings."""
  options = []
  if "el_freq" in variant:
    assert variant["el_vars"] == NAMED_LETTERS, variant
    options.append("appearance=" + variant["el_freq"].replace(",", "/"))
  if "el_app_freq" in variant:
    options.append("numbers=" + variant["el_app_freq"].replace("X", "-x"))
  if not variant.get("render_scoreboard", True):
    options.append("inventory=off")
  return "crafter:" + ",".join(options) if options else "crafter"


def pictures_of(folder):
  """The reference's pictures by trace and step of the trace: (width, height, whether it is extra, bytes)."""
  found = collections.defaultdict(list)
  bins = {}
  for row in lines(folder / "frames.jsonl"):
    for frame in row["frames"]:
      file = frame["bin"]
      bins[file] = bins.get(file) or gzip.decompress((folder / f"{file}.gz").read_bytes())
      size = frame["w"] * frame["h"] * 3
      found[row["trace"], row["g"], row["n"]].append(
          (frame["w"], frame["h"], frame["kind"] == "extra", bins[file][frame["off"]:frame["off"] + size]))
  return found


class OwnGoldens(package.PackageCase):

  def test_worlds_with_our_textures_look_as_the_model_draws_them(self):
    compared = 0
    for row in lines(OWN / "worlds.jsonl"):
      if row["ep"] > MAX_EPISODE or row["letters"] not in ("", NAMED_LETTERS):
        continue
      options = [f"numbers={row['numbers']}"]
      if row["letters"]:
        options.append("appearance=" + "/".join(map(str, row["percentages"])))
      env = craftfleet.Env(row["area"], row["view"], row["size"], seed=row["seed"], env="crafter:" + ",".join(options))
      for _ in range(row["ep"]):
        observation = env.reset()
      self.assertEqual(crc(observation), row["img"], row)
      compared += 1
    self.assertGreater(compared, 60)


@unittest.skipUnless(GOLDEN, "CRAFTFLEET_GOLDEN_DIR is not set")
class ReferenceGoldens(package.PackageCase):

  def replay(self, path, textures, pictures):
    header, *rest = lines(path)
    env = craftfleet.Env(
        header["area"], header["view"], header["size"], length=header["length"], seed=header["seed"],
        env=name_of(header["ood"] or {}), textures=textures)
    compared = 0
    for line in rest:
      where = f"{path.name} step {line['g']}"
      if line["k"] == "reset":
        observation = env.reset()
      else:
        observation, reward, done, info = env.step(line["a"])
        self.assertEqual((reward, done), (line["r"], bool(line["d"])), where)
        self.assertEqual(info["player_pos"].tolist(), line["p"], where)
        self.assertEqual(list(info["inventory"].values()), line["inv"], where)
        self.assertEqual(list(info["achievements"].values()), line["ach"], where)
        self.assertEqual(crc(info["semantic"]), line["sem"], where)
      self.assertEqual(crc(observation), line["img"], where)
      for width, height, extra, expected in pictures.get((path.name, line["g"], line.get("n", 0)), ()):
        drawn = copy.copy(env).render((width, height)) if extra else observation
        self.assertEqual(drawn.tobytes(), expected, f"{where}: {width}x{height}")
        compared += 1
    return compared

  def replay_all(self, folder, textures, traces):
    golden = pathlib.Path(GOLDEN)
    pictures = pictures_of(golden / "crafter" / folder)
    paths = sorted((golden / "crafter" / folder).glob("s*.jsonl.gz"))
    self.assertEqual(len(paths), traces)
    compared = sum(self.replay(path, golden.parent / "assets" / textures, pictures) for path in paths)
    self.assertEqual(compared, sum(map(len, pictures.values())))

  def test_plain_games_replay(self):
    self.replay_all("", "crafter", 32)

  def test_farms_replay(self):
    self.replay_all("farm", "crafter", 4)

  def test_a_long_episode_replays(self):
    self.replay_all("long", "crafter", 1)

  def test_variants_replay(self):
    self.replay_all("ood", "crafter-ood", 16)


if __name__ == "__main__":
  python_case.main()

"""The examples of the Python package that need nothing else: the beam search plans, and its plan works."""

import re
import sys

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "numpy", "imageio_ffmpeg")
sys.path.insert(0, str(SOURCE / "deploy/python/examples"))
import beam_search  # pylint: disable=wrong-import-position
import craftfleet  # pylint: disable=wrong-import-position


class Examples(python_case.FolderCase, package.PackageCase):

  def test_the_beam_search_shows_a_plan_that_collects_a_stone(self):
    shown = package.run_example("beam_search.py", "--record=recordings", cwd=self.folder)
    self.assertEqual(shown.returncode, 0, shown.stderr)
    plan = [name for name, count in re.findall(r"(\w+) x(\d+)", shown.stdout) for _ in range(int(count))]
    self.assertIn(f"takes {len(plan)} steps", shown.stdout)
    env = craftfleet.Env(seed=1)
    env.reset()
    infos = [env.step(craftfleet.ACTIONS.index(name))[3] for name in plan]
    self.assertEqual([info["achievements"]["collect_stone"] for info in infos], [0] * (len(plan) - 1) + [1])
    self.assertIn("collect_stone", shown.stdout.splitlines()[-1])
    self.assertEqual(craftfleet.score(self.folder / "recordings").success_rates["collect_stone"], 100)

  def test_other_worlds_have_other_plans(self):
    plans = [beam_search.search(seed, beam=24, depth=60) for seed in (2, 3)]
    self.assertNotEqual(*plans)
    for seed, plan in zip((2, 3), plans):
      self.assertEqual(beam_search.replay(seed, plan, record=None)["achievements"]["collect_stone"], 1)

  def test_a_search_without_success_says_so(self):
    ended = package.run_example("beam_search.py", "--depth=3", cwd=self.folder)
    self.assertEqual((ended.returncode, ended.stdout), (1, ""))
    self.assertEqual(ended.stderr, "no plan in 3 steps, try a larger --beam or another --seed\n")


if __name__ == "__main__":
  python_case.main()

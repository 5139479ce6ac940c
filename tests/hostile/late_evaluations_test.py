"""A run whose evaluations go beyond episode 10,000, which it used to wait for for ever."""

import json

from tests.fakes import python_case

EPISODES = 5001  # of each of two parts: the second ends with episode 10,002
CONFIG = f"""
steps: 64  lanes: 4  seed: 3  fragment_steps: 16
env {{ length: 1 }}
ppo {{ rollout_steps: 64  minibatch_size: 32  epochs: 1 }}
eval {{ every_steps: 0  final_episodes: {EPISODES} }}
"""


class LateEvaluations(python_case.FolderCase):

    def test_training_ends_with_all_of_them(self):
        config = self.folder / "config.txt"
        config.write_text(CONFIG, encoding="utf-8")
        self.run_program("craftfleet-train", f"--config={config}", f"--logdir={self.folder / 'run'}")
        for mode in ["argmax", "sampled"]:
            lines = (self.folder / "run" / f"final_{mode}.jsonl").read_text(encoding="utf-8").splitlines()
            self.assertEqual(len(lines), EPISODES)
            self.assertEqual(json.loads(lines[-1])["length"], 1)


if __name__ == "__main__":
    python_case.main()

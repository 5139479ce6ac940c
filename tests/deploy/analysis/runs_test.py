"""Reading runs: run folders, result files, groups and their names, experiments, curves, statistics."""

import contextlib
import gzip
import importlib
import io
import math
import os
import pathlib
import subprocess
import sys
import types
import unittest
import unittest.mock

from tests.deploy.analysis import package
from tests.deploy.analysis.package import same_episodes, write_run
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

import matplotlib

import analysis
from analysis import _cli, charts, collect, curve, experiments, programs, runs, statistics
from analysis.logs import read_log
from analysis.results import Group, group_runs, name_groups, short_names, spread_of_curves
from analysis.statistics import Spread, spread_of


class Runs(package.Case):

  def run_of(self, *arguments, **named):
    write_run(self.folder / "run", *arguments, **named)
    return self.read()

  def read(self):
    (run,), unreadable = runs.read_runs([str(self.folder / "run")])
    self.assertEqual(unreadable, [])
    return run

  def test_has_configuration_and_figures_of_its_episodes(self):
    run = self.run_of(3, {"agent": "lstm_cnn"}, episodes=38)
    self.assertEqual((run.agent, run.seed, len(run.training), run.training.unlocked, run.training.reward), ("lstm_cnn", 3, 38, 11, 11))
    self.assertAlmostEqual(run.training.score, math.sqrt(101) - 1, 12)
    self.assertEqual((run.training.success[10], run.training.success[11]), (100, 0))
    self.assertEqual(len(run.curve), 38)
    self.assertEqual(len(run.logs["eval_sampled"]), 0)

  # 30 episodes of 100 steps end within the third iteration of 1,000 steps, 31 within the fourth.
  def test_without_checkpoints_its_episodes_show_its_progress(self):
    for episodes, steps, complete in ((30, 3000, False), (31, 4000, True), (0, 0, False)):
      run = self.run_of(1, episodes=episodes)
      self.assertEqual((run.steps, run.complete), (steps, complete))

  def test_final_episodes_show_that_it_is_complete(self):
    self.run_of(1, {"eval": {"final_episodes": 4}}, episodes=20)
    (self.folder / "run/final_argmax.jsonl").write_text(same_episodes(4, 3))
    (self.folder / "run/final_sampled.jsonl").write_text(same_episodes(3, 4))
    self.assertFalse(self.read().complete)
    (self.folder / "run/final_sampled.jsonl").write_text(same_episodes(4, 4))
    self.assertEqual((self.read().complete, self.read().steps), (True, 4000))

  def test_the_newest_checkpoint_decides_where_there_is_one(self):
    python_case.trained_run(self.folder / "run", python_case.SMALL_RUN)
    self.assertEqual((self.read().steps, self.read().complete), (192, True))
    with (self.folder / "run/config.txt").open("a") as file:
      file.write("# more is wanted now\n")
    text = (self.folder / "run/config.txt").read_text()
    (self.folder / "run/config.txt").write_text(text.replace("steps: 192", "steps: 1920"))
    self.assertEqual((self.read().steps, self.read().complete), (192, False))
    newest = max((self.folder / "run/checkpoints").glob("iter-*"))
    (newest / "state.pb").write_text("garbage")
    write_run(self.folder / "other", 1)
    found, unreadable = runs.read_runs([str(self.folder)])
    self.assertEqual([run.folder for run in found], [f"{self.folder}/other"])
    self.assertIn(str(newest), unreadable[0])

  def test_an_invalid_file_and_line_is_named(self):
    def problem():
      found, unreadable = runs.read_runs([str(self.folder / "run")])
      self.assertEqual(found, [])
      return unreadable[0]
    for name, text, message in (
        ("stats.jsonl", same_episodes(2, 1) + '{"length": 3}\n', '/stats.jsonl:3: no number "reward"'),
        ("stats.jsonl", same_episodes(1, 1).replace('"length": 100', '"length": 0'), '/stats.jsonl:1: "length" is 0, want at least 1'),
        ("stats.jsonl", same_episodes(1, 1).replace("}", ', "more": 1}'), "/stats.jsonl:1: has 25 keys, want 24"),
        ("stats.jsonl", same_episodes(1, 1).replace("1.0", "Infinity"), '/stats.jsonl:1: "reward" is Infinity, want a number'),
        ("stats.jsonl", same_episodes(1, 1).replace("1.0", "1e30"), '/stats.jsonl:1: "reward" is 1e+30, want a number'),
        ("stats.jsonl", same_episodes(1, 1, length=10**20), f'/stats.jsonl:1: "length" is {10**20}, want at least 1, at most '),
        ("stats.jsonl", "[" * 100000 + "\n", "/stats.jsonl:1: not a JSON object"),
        ("eval_argmax.jsonl", "nonsense\n", "/eval_argmax.jsonl:1: not a JSON object"),
        ("config.txt", "seed: 1\nagnet: 'x'\n", "/config.txt:2:"),
        ("config.txt", "ppo { gamma: 2 }", "/config.txt: ppo.gamma"),
        ("run.json", "{}", '/run.json: no "texture_digest"')):
      write_run(self.folder / "run", 1)
      for other in ("eval_argmax.jsonl", "run.json"):
        (self.folder / "run" / other).unlink(missing_ok=True)
      (self.folder / "run" / name).write_text(text)
      self.assertIn(message, problem())

  def test_a_line_that_is_being_written_is_left_out(self):
    write_run(self.folder / "run", 1)
    with (self.folder / "run/stats.jsonl").open("a") as file:
      file.write('{"length": 3')
    self.assertEqual(len(self.read().training), 40)
    self.assertEqual(len(runs.read_curve(str(self.folder / "run"))), 40)
    self.assertIn("/stats.jsonl:41: the line is incomplete",
                  self.refusal(runs.save_result, str(self.folder / "run"), str(self.folder / "kept.npz")))

  def test_finds_each_run_in_or_below_the_folders_once_in_order(self):
    for name, seed in (("b/c/seed2", 2), ("b/c/seed1", 1), ("a", 1)):
      write_run(self.folder / name, seed)
    (self.folder / "b/config.txt").write_text("no run, it has no stats.jsonl")
    (self.folder / "b/other.npz").write_text("no result")
    (self.folder / "d").symlink_to("b")
    found, unreadable = runs.read_runs([f"{self.folder}{name}" for name in ("", "/a/", "/b")])
    self.assertEqual([run.folder for run in found], [f"{self.folder}/{name}" for name in ("a", "b/c/seed1", "b/c/seed2")])
    self.assertEqual(unreadable, [])
    for one in (self.folder, str(self.folder)):
      self.assertEqual([run.folder for run in runs.read_runs(one)[0]], [run.folder for run in found])
    for missing, message in (("/nowhere/runs", "^/nowhere/runs: no such folder$"),
                             (self.folder / "b/config.txt", "b/config.txt: not a folder, and no result file")):
      with self.assertRaisesRegex(FileNotFoundError, message):
        runs.read_runs([missing])

  def test_a_run_is_found_once_under_all_names_of_its_folder(self):
    write_run(self.folder / "runs/a", 1)
    (self.folder / "link").symlink_to("runs")
    names = (f"{self.folder}/runs", f"{self.folder}/runs/.", f"{self.folder}/link", os.path.relpath(self.folder / "runs"))
    found, unreadable = runs.read_runs(list(names))
    self.assertEqual((len(found), unreadable), (1, []))

  def test_a_folder_whose_name_is_not_utf_8_is_named_beside_the_others(self):
    write_run(self.folder / "a", 1)
    write_run(self.folder / os.fsdecode(b"caf\xe9"), 2)
    found, unreadable = runs.read_runs([str(self.folder)])
    self.assertEqual([run.folder for run in found], [f"{self.folder}/a"])
    self.assertEqual(unreadable, [f"{self.folder}/caf\udce9/config.txt: the name is not UTF-8"])


class Results(package.Case):

  def test_a_result_file_loses_nothing(self):
    write_run(self.folder / "run", 5, {"agent": "lstm_cnn"}, episodes=300)
    for number, log in enumerate(("eval_argmax", "eval_sampled", "final_argmax", "final_sampled"), 1):
      (self.folder / f"run/{log}.jsonl").write_text(same_episodes(number, number) + same_episodes(1, 3, length=70000).replace("3.0", "-0.9"))
    (self.folder / "run/run.json").write_text('{"texture_digest": "8140aa54698876d7", "git_revision": "abc"}\n')
    runs.save_result(str(self.folder / "run"), str(self.folder / "kept.npz"))
    (kept, run), unreadable = runs.read_runs([str(self.folder)])
    self.assertEqual(unreadable, [])
    self.assertEqual(kept.folder, f"{self.folder}/kept")
    for field in ("config", "identity", "settings", "defaults", "texture_digest", "steps", "complete", "steps_to_train"):
      self.assertEqual(getattr(kept, field), getattr(run, field), field)
    for log in runs.LOGS:
      episodes = read_log(str(self.folder / f"run/{log}.jsonl"))
      for field in ("length", "tenths", "counts"):
        self.assertEqual(getattr(kept.logs[log], field).tolist(), getattr(episodes, field).tolist(), (log, field))
    files = runs._read_result(str(self.folder / "kept.npz"))  # pylint: disable=protected-access
    self.assertEqual(files.config, (self.folder / "run/config.txt").read_text())
    self.assertEqual(files.run_json, (self.folder / "run/run.json").read_text())
    before = (self.folder / "kept.npz").read_bytes()
    runs.save_result(str(self.folder / "run"), str(self.folder / "kept.npz"))
    self.assertEqual((self.folder / "kept.npz").read_bytes(), before, "the same bytes again")

  # Its only episode ends long before its last step, and there is no final evaluation.
  def test_a_result_file_has_the_progress_of_the_runs_checkpoint(self):
    python_case.trained_run(self.folder / "run", python_case.SMALL_RUN)
    (self.folder / "run/stats.jsonl").write_text(same_episodes(1, 1, length=3))
    for log in runs.LOGS[1:]:
      (self.folder / f"run/{log}.jsonl").unlink(missing_ok=True)
    runs.save_result(str(self.folder / "run"), str(self.folder / "kept.npz"))
    (kept, _), unreadable = runs.read_runs([str(self.folder)])
    self.assertEqual((kept.folder, kept.steps, kept.complete, unreadable), (f"{self.folder}/kept", 192, True, []))

  def test_a_run_that_cannot_be_read_has_no_result_file(self):
    write_run(self.folder / "run", 1)
    (self.folder / "run/config.txt").write_text("ppo { gamma: 2 }")
    self.assertIn("/config.txt: ppo.gamma", self.refusal(runs.save_result, str(self.folder / "run"), str(self.folder / "kept.npz")))
    self.assertFalse((self.folder / "kept.npz").exists())

  def test_a_damaged_result_is_named_beside_the_others(self):
    for name in ("a", "b", "c"):
      write_run(self.folder / name, 1)
      (self.folder / "kept").mkdir(exist_ok=True)
      runs.save_result(str(self.folder / name), str(self.folder / f"kept/{name}.npz"))
    content = (self.folder / "kept/b.npz").read_bytes()
    for at in (100, len(content) // 3, content.index(b"PK\1\2") + 10):  # compressed data; the method of the first entry
      (self.folder / "kept/b.npz").write_bytes(content[:at] + bytes([content[at] ^ 255]) + content[at + 1:])
      found, unreadable = runs.read_runs([str(self.folder / "kept")])
      self.assertEqual([run.folder[-1] for run in found], ["a", "c"], at)
      self.assertEqual(len(unreadable), 1)
      self.assertIn("kept/b.npz", unreadable[0])

  def test_a_result_whose_end_is_missing_is_named(self):
    write_run(self.folder / "a", 1)
    runs.save_result(str(self.folder / "a"), str(self.folder / "kept.npz"))
    content = (self.folder / "kept.npz").read_bytes()
    method = content.index(b"PK\1\2") + 10
    for damaged in (content[:len(content) // 2], content[:100], content[:method] + b"\x08" + content[method + 1:]):
      (self.folder / "kept.npz").write_bytes(damaged)
      for where in (self.folder, self.folder / "kept.npz"):
        _, unreadable = runs.read_runs([str(where)])
        self.assertEqual(len(unreadable), 1)
        self.assertIn("kept.npz: ", unreadable[0])

  def test_weights_that_are_there_already_are_named(self):
    write_run(self.folder / "run", 1)
    (self.folder / "run/checkpoints/iter-00000001").mkdir(parents=True)
    for file in ("run.json", "checkpoints/iter-00000001/weights.safetensors"):
      (self.folder / "run" / file).write_text("")
    (self.folder / "kept").mkdir()
    (self.folder / "kept/weights.safetensors").write_text("other")
    with contextlib.redirect_stderr(io.StringIO()) as errors:
      self.assertEqual(collect.main(["--weights", f"{self.folder}/run", f"{self.folder}/kept"]), 1)
    self.assertEqual(errors.getvalue(),
                     f"collect.py: cannot collect {self.folder}/run: {self.folder}/kept: Directory not empty\n")
    self.assertEqual(sorted(path.name for path in self.folder.iterdir()), ["kept", "run"])

  def test_a_run_that_is_refused_leaves_no_weights(self):
    write_run(self.folder / "run", 1)
    (self.folder / "run/checkpoints/iter-00000001").mkdir(parents=True)
    for file in ("run.json", "checkpoints/iter-00000001/weights.safetensors"):
      (self.folder / "run" / file).write_text("")
    with contextlib.redirect_stderr(io.StringIO()) as errors:
      self.assertEqual(collect.main(["--weights", f"{self.folder}/run", f"{self.folder}/kept"]), 1)
    self.assertIn('run.json: no "texture_digest"', errors.getvalue())
    self.assertEqual([path.name for path in self.folder.iterdir()], ["run"])

  def test_an_unfinished_run_is_not_collected(self):
    python_case.trained_run(self.folder / "run", python_case.SMALL_RUN)
    (self.folder / "run/checkpoints/iter-00000003").rename(self.folder / "last")
    with contextlib.redirect_stderr(io.StringIO()) as errors:
      self.assertEqual(collect.main(["--weights", f"{self.folder}/run", f"{self.folder}/kept"]), 1)
    self.assertEqual(errors.getvalue(), f"collect.py: {self.folder}/run: unfinished after 128 of 192 steps, want all steps "
                     "and the final evaluation\n")
    self.assertEqual(sorted(path.name for path in self.folder.iterdir()), ["last", "run"])

  def test_a_result_has_the_name_of_its_run(self):
    write_run(self.folder / "run", 1)
    (self.folder / "kept").mkdir()
    runs.save_result(str(self.folder / "run"), str(self.folder / "kept/seed1.npz"))
    for _ in range(2):
      (name,) = (run.folder for run in runs.read_runs(self.folder / "kept")[0])
      self.assertEqual(name, f"{self.folder}/kept/seed1")
      self.assertEqual([run.folder for run in runs.read_runs(name)[0]], [name])
      self.assertEqual(len(analysis.episodes(f"{name}/")), 40)
      self.assertEqual(len(runs.read_curve(name)), 40)
      (self.folder / "kept/seed1").mkdir(exist_ok=True)  # of its weights
      (self.folder / "kept/seed1/config.txt").write_text("")

  def test_notebooks_compare_runs_and_take_one_without_episodes(self):
    write_run(self.folder / "a", 1)
    write_run(self.folder / "b", 1)
    (self.folder / "b/stats.jsonl").write_text("")
    table = analysis.load(str(self.folder))
    self.assertEqual((table["run"].nunique(), table["run"][0] == table["run"][1]), (2, False))
    self.assertTrue(math.isnan(table["unlocked"][1]))

  def test_notebooks_get_tables(self):
    write_run(self.folder / "a", 1)
    table = analysis.load(str(self.folder))
    self.assertEqual((table["agent"][0], table["seed"][0], bool(table["complete"][0])), ("ppo_cnn", 1, True))
    self.assertAlmostEqual(table["train"][0], math.sqrt(101) - 1)
    self.assertTrue(math.isnan(table["eval"][0]) and math.isnan(table["eval_argmax"][0]), "it has no evaluations")
    episodes = analysis.episodes(table["run"][0])
    self.assertEqual((len(episodes), episodes["length"][0], episodes["reward"][0], episodes["collect_coal"][0]), (40, 100, 11, 2))

  def test_notebooks_have_the_final_scores(self):
    write_run(self.folder / "a", 1)
    for log, unlocked in (("final_sampled", 22), ("final_argmax", 11)):
      (self.folder / f"a/{log}.jsonl").write_text(same_episodes(3, unlocked))
    table = analysis.load(self.folder)
    self.assertAlmostEqual(table["final"][0], 100)
    self.assertAlmostEqual(table["final_argmax"][0], math.sqrt(101) - 1)

  def test_notebooks_may_give_runs_and_paths_alike(self):
    write_run(self.folder / "a", 1)
    write_run(self.folder / "b", 2, episodes=30)
    run = analysis.load(self.folder)["run"][0]
    self.assertEqual(list(analysis.load([run, self.folder / "b"])["seed"]), [1, 2])
    self.assertEqual(list(analysis.load(run, self.folder, run)["seed"]), [1, 2], "each once")
    self.assertEqual([len(analysis.episodes(one)) for one in (run, self.folder / "b")], [40, 30])
    for arguments, words in (((run, "foo"), "log 'foo', want one of stats, eval_argmax, eval_sampled"),
                             ((self.folder,), f"{self.folder}: 2 runs, want one")):
      with self.assertRaisesRegex(ValueError, words):
        analysis.episodes(*arguments)
    self.assertLessEqual({"Run", "episodes", "load", "read_runs"}, set(dir(analysis)))

  def test_notebooks_may_name_folders_by_paths_and_from_home(self):
    write_run(self.folder / "a", 1)
    with unittest.mock.patch.dict(os.environ, HOME=str(self.folder)):
      for folder in (self.folder, pathlib.Path("~"), "~/a"):
        self.assertEqual(list(analysis.load(folder)["folder"]), [f"{self.folder}/a"])

  def test_notebooks_have_the_rewards_of_a_reports_csv(self):
    write_run(self.folder / "a", 1)
    (self.folder / "a/stats.jsonl").write_text(same_episodes(100, 1) + same_episodes(100, 3))
    table = analysis.load(str(self.folder))
    self.assertEqual((table["reward"][0], table["reward_last100"][0]), (2, 3))

  def test_notebooks_find_all_columns_where_there_is_no_run(self):
    empty = analysis.load(str(self.folder))
    write_run(self.folder / "a", 1)
    self.assertEqual((len(empty), list(empty)), (0, list(analysis.load(str(self.folder)))))

  def test_notebooks_are_told_what_cannot_be_read(self):
    write_run(self.folder / "a", 1)
    write_run(self.folder / "b", 1)
    (self.folder / "b/config.txt").write_text("ppo { gamma: 2 }")
    with self.assertWarnsRegex(UserWarning, "left out: .*/b/config.txt: ppo.gamma"):
      self.assertEqual(len(analysis.load(str(self.folder))), 1)
    with self.assertRaisesRegex(FileNotFoundError, "/nowhere: no such folder"):
      analysis.load("/nowhere")


def sample_run(folder, identity, seed, complete, score=0.0, curve_points=()):
  """Stands in for a run; `curve_points`: (episodes, steps, reward, score)."""
  steps = [point[1] for point in curve_points]
  points = types.SimpleNamespace(score=[point[3] for point in curve_points], reward=[point[2] for point in curve_points],
                                 index_at=lambda at: sum(step <= at for step in steps) - 1)
  class Log(types.SimpleNamespace):
    def __len__(self):
      return self.n
  logs = {log: Log(n=0, score=0) for log in runs.LOGS} | {"stats": Log(n=1, score=score)}
  return types.SimpleNamespace(folder=folder, identity=identity, seed=seed, complete=complete, steps=1000 if complete else 500,
                               training=logs["stats"], logs=logs, curve=points)


class Groups(unittest.TestCase):

  def test_spread_is_mean_and_sample_deviation(self):
    spread = spread_of([1, 2, 6])
    self.assertEqual((spread.n, spread.mean), (3, 3))
    self.assertAlmostEqual(spread.deviation, math.sqrt(7))  # ((1-3)^2 + (2-3)^2 + (6-3)^2) / 2
    self.assertEqual([spread.text(), spread_of([4]).text(), spread_of([]).text()], ["3.0 ± 2.6", "4.0", "-"])
    self.assertIsNone(spread_of([4]).deviation)

  def test_configurations_and_unfinished_runs_are_separate(self):
    four = [sample_run("r1", "a", 2, True), sample_run("r2", "b", 1, True), sample_run("r3", "a", 1, True), sample_run("r4", "a", 3, False)]
    groups = group_runs(four)
    self.assertEqual(list(groups), ["a", "b"])
    self.assertEqual(groups["a"].complete, [four[2], four[0]])
    self.assertEqual(groups["a"].incomplete, [four[3]])

  def test_a_seed_counts_once_the_complete_run_before_others(self):
    three = [sample_run("r1", "a", 1, False), sample_run("r2", "a", 1, True), sample_run("r3", "a", 1, True)]
    group = group_runs(three)["a"]
    self.assertEqual((group.complete, group.incomplete, group.repeated), ([three[1]], [], [three[2], three[0]]))

  def test_averages_complete_runs_that_have_the_measure(self):
    three = [sample_run("r1", "a", 1, True, 2), sample_run("r2", "a", 2, True, 4), sample_run("r3", "a", 3, False, 90)]
    three[1].logs["eval_sampled"].n, three[1].logs["eval_sampled"].score = 5, 7
    group = group_runs(three)["a"]
    self.assertEqual((group.over("train").n, group.over("train").mean), (2, 3))
    self.assertEqual((group.over("eval").n, group.over("eval").mean), (1, 7))
    self.assertEqual(group.over("final").n, 0)

  def test_scores_at_a_milestone_are_of_runs_that_got_there(self):
    two = [sample_run("r1", "a", 1, True, curve_points=[(1, 300, 0, 5), (2, 450, 0, 6), (3, 900, 0, 8)]),
           sample_run("r2", "a", 2, False, curve_points=[(1, 400, 0, 2)])]
    group = group_runs(two)["a"]
    at = {steps: group.scores_at("train", steps) for steps in (100, 500, 900, 1001)}
    self.assertEqual((at[500].mean, at[500].n), (4, 2))
    self.assertEqual((at[900].mean, at[900].n), (8, 1))
    self.assertEqual((at[100].n, at[1001].n), (0, 0))

  def test_curves_have_the_last_point_of_every_run_at_each_place(self):
    nine, ten = [(9, 100, 1, 1), (10, 200, 2, 3), (11, 800, 4, 5)], [(10, 300, 8, 7)]
    def run(points):
      padded = [(0, 0, 0, 0)] * (points[0][0] - 1) + points  # a curve has a point for each episode
      return sample_run("r", "a", 1, True, curve_points=padded)
    spread = spread_of_curves([run(nine), run(ten)], 1000)
    self.assertEqual(len(spread.steps), 141)  # 300, 305, ..., 1000: from where both have ten episodes
    self.assertEqual((spread.steps[0], spread.score[0].mean, spread.reward[0].mean), (300, 5, 5))
    self.assertEqual((spread.steps[140], spread.score[140].mean), (1000, 6))
    self.assertAlmostEqual(spread.score[140].deviation, math.sqrt(2))


class Names(package.Case):

  def names(self, *groups):
    """Each of `groups`: folders and a configuration."""
    answers = programs.ask([{"config": config} for _, config in groups])
    made = []
    for (folders, _), answer in zip(groups, answers):
      group = Group()
      group.complete = [types.SimpleNamespace(folder=folder, agent=answer["config"]["agent"], settings=answer["settings"],
                                              defaults=answer["defaults"], built_in_textures=True) for folder in folders]
      made.append(group)
    return name_groups(made)

  def test_runs_side_by_side_have_the_names_of_their_folders(self):
    self.assertEqual(self.names((["runs/first"], "steps: 5000"), (["runs/second"], "steps: 9000")),
                     [("runs/first", "first (ppo_cnn, steps=5000)"), ("runs/second", "second (ppo_cnn, steps=9000)")])

  def test_seeds_have_the_name_of_their_common_folder(self):
    self.assertEqual(self.names((["runs/wide/seed1", "runs/wide/seed2"], "lanes: 32"), (["runs/narrow/seed1"], "lanes: 8")),
                     [("runs/wide", "wide (ppo_cnn, lanes=32)"), ("runs/narrow", "narrow (ppo_cnn, lanes=8)")])

  def test_names_match_no_other_run(self):
    self.assertEqual(self.names((["runs/a1", "runs/a3"], "lanes: 32"), (["runs/a2"], "")),
                     [("runs/a1 and 1 more", "a1 and 1 more (ppo_cnn, lanes=32)"), ("runs/a2", "a2 (ppo_cnn)")])
    named = self.names((["runs"], "lanes: 32"), (["runs/seed1"], ""))
    self.assertEqual([folder for folder, _ in named], ["runs", "runs/seed1"], "an enclosing run keeps its own folder")

  def test_details_are_what_is_neither_the_agents_default_nor_usual(self):
    named = self.names((["r/a"], "steps: 5000"),
                       (["r/b"], "steps: 5000 agent: 'oc_sa' env { name: 'crafter:numbers=easy-x2' }"),
                       (["r/c"], "steps: 5000 env { name: 'crafter:numbers=easy-x2' } eval { env: 'crafter' } seed: 7"),
                       (["r/d"], "steps: 5000 ppo { gamma: 0.9 learning_rate: 0.001 epochs: 2 clip: 0.3 gae_lambda: 0.9 }"))
    self.assertEqual([label for _, label in named],
                     ["a (ppo_cnn)", "b (oc_sa, env=crafter:numbers=easy-x2)",
                      "c (ppo_cnn, env=crafter:numbers=easy-x2, eval.env=crafter)",
                      "d (ppo_cnn, clip=0.3, epochs=2, gae_lambda=0.9, 2 more)"])
    self.assertEqual(self.names((["mine/seed1"], "ppo { gamma: 0.123 }"))[0][1], "mine (ppo_cnn)")
    self.assertEqual(name_groups([]), [])

  def test_short_names_distinguish_runs_without_their_common_folders(self):
    for paths, names in ((["runs/a/seed1", "runs/a/seed2/"], ["seed1", "seed2"]),
                         (["/runs/a/seed1", "/runs/b/seed1/stats.jsonl.gz"], ["a/seed1", "b/seed1"]),
                         (["runs/first/stats.jsonl"], ["first"]), (["stats.jsonl"], ["stats.jsonl"]),
                         (["runs/a", "runs/a"], ["a", "a"]), (["runs", "runs/a"], ["runs", "runs/a"]),
                         (["r/a.npz", "r/b.npz"], ["a", "b"]), ([], [])):
      self.assertEqual(short_names(paths), names)


class Curves(package.Case):

  def test_the_reward_is_the_mean_of_the_last_hundred(self):
    (self.folder / "stats.jsonl").write_text(same_episodes(100, 1, 10) + same_episodes(50, 3, 10))
    points = read_log(str(self.folder / "stats.jsonl")).curve()
    self.assertEqual((points.reward[49], points.reward[149], points.steps[149], points.episodes[149]), (1, 2, 1500, 150))
    rates = [100] + [100 / 3] * 2 + [0] * 19
    self.assertAlmostEqual(points.score[149], math.expm1(sum(map(math.log1p, rates)) / 22))

  def test_reads_a_folder_its_file_plain_or_gzipped_or_a_result(self):
    write_run(self.folder / "plain", 1)
    runs.save_result(str(self.folder / "plain"), str(self.folder / "plain.npz"))
    (self.folder / "small").mkdir()
    with gzip.open(self.folder / "small/stats.jsonl.gz", "wt") as file:
      file.write(same_episodes(40, 11))
    for path in ("plain", "plain/", "plain/stats.jsonl", "small", "small/stats.jsonl.gz", "plain.npz"):
      self.assertEqual(runs.read_curve(str(self.folder / path)).score[-1], runs.read_curve(str(self.folder / "plain")).score[-1])

  def test_names_the_error_of_a_run(self):
    self.assertIn("it has no stats.jsonl", self.refusal(runs.read_curve, str(self.folder)))
    self.assertIn("/none: no such run folder or file", self.refusal(runs.read_curve, str(self.folder / "none")))
    (self.folder / "stats.jsonl").write_text("")
    self.assertIn("no episode has finished yet", self.refusal(runs.read_curve, str(self.folder)))
    (self.folder / "stats.jsonl").write_text("{}\n")
    self.assertIn("stats.jsonl:1: ", self.refusal(runs.read_curve, str(self.folder)))

  def reference(self, text):
    (self.folder / "table.csv").write_text(text)
    return curve.read_reference(str(self.folder / "table.csv"))

  def test_a_reference_finds_its_columns_among_others(self):
    points = self.reference("iter,steps,episodes,crafter_score_cum,ep_rew_mean100,losses\r\n1,4096,26,1.0045,1.25,\r\n"
                            "2,8192,50,1.2387,1.34,0.5\r\n")
    self.assertEqual((len(points), points.steps[1], points.episodes[1], points.reward[1], points.score[1]), (2, 8192, 50, 1.34, 1.2387))
    of_excel = "\ufeffepisodes,steps,ep_rew_mean100,crafter_score_cum\n1,2,3,4\n"
    self.assertEqual(len(self.reference(of_excel)), 1)

  def test_a_reference_names_the_line_and_column_that_are_wrong(self):
    names = "episodes,steps,ep_rew_mean100,crafter_score_cum\n"
    for text, message in (("", 'table.csv:1: no column "episodes"'), ("episodes,steps,reward\n", 'no column "ep_rew_mean100"'),
                          (names, "no line after"), (names + "1,2,3,4\n1,2,x,4\n", ':3: ep_rew_mean100 is "x", want a number'),
                          (names + "1,2,3\n", ':2: crafter_score_cum is ""'), (names + "nan,2,3,4\n", ':2: episodes is "nan", want'),
                          (names + "1,1e30,3,4\n", ':2: steps is "1e30", want a number')):
      self.assertIn(message, self.refusal(self.reference, text))

  @staticmethod
  def named(name, steps):
    import numpy as np  # pylint: disable=import-outside-toplevel
    from analysis.logs import Curve  # pylint: disable=import-outside-toplevel
    array = np.array(steps)
    return curve.NamedCurve(name, Curve(array // 100, array, 0.001 * array, 0.002 * array))

  def test_the_table_has_the_last_values_of_runs_and_those_of_references_at_that_step(self):
    self.assertEqual(curve.table([self.named("seed1", [1000, 2500]), self.named("seed2", [1000, 2000])],
                                 [self.named("table.csv", [2000, 9000])]),
                     "run        episodes      steps  reward, last 100  score\n"
                     "seed1            25       2500              2.50   5.00\n"
                     "seed2            20       2000              2.00   4.00\n"
                     "table.csv        20       2000              2.00   4.00\n")

  def test_curves_begin_at_ten_episodes_if_there_are_so_many_and_references_end_with_the_runs(self):
    for steps, until, drawn in (([900, 999, 1000, 1100], None, [1000, 1100]), ([100, 300], None, [300]),
                                ([1000, 2000, 3000], 2500, [1000, 2000]), ([4000, 5000], 2500, [4000])):
      one = self.named("a", steps).curve
      self.assertEqual(one.steps[curve.drawn_points(one, until)].tolist(), drawn)

  def test_the_picture_is_the_same_again(self):
    made = [curve.draw([self.named("a", [1000, 2000])], [self.named("b", [1000])]) for _ in range(2)]
    self.assertEqual(made[0][:8], b"\x89PNG\r\n\x1a\n")
    self.assertEqual(*made)

  @staticmethod
  def drawn(*curves):
    figures, png = [], charts.png
    with unittest.mock.patch.object(charts, "png", lambda figure: figures.append(figure) or png(figure)):
      curve.draw(*curves)
    return figures[0].axes[1]

  def test_a_run_of_few_episodes_can_be_seen(self):
    axes = self.drawn([self.named("few", [300]), self.named("more", [1000, 2000])], [])
    self.assertEqual([line.get_marker() for line in axes.get_lines()], [".", ""])

  def test_every_name_is_in_the_legend_as_it_is(self):
    axes = self.drawn([self.named(name, [1000, 2000]) for name in ("_a", "b_$\\foo{$", "$d$")], [self.named("_e", [1000])])
    names = [text.get_text().strip() for text in axes.get_legend().get_texts()]
    self.assertEqual(names, ["_e", "_a", "b_$\\foo{$", "$d$"])

  def test_a_users_own_style_changes_no_picture(self):
    with matplotlib.rc_context({"text.usetex": True, "font.size": 20}):
      importlib.reload(charts)
      self.assertEqual((matplotlib.rcParams["text.usetex"], matplotlib.rcParams["font.size"]), (False, 8))
    importlib.reload(charts)

  def test_a_picture_of_any_number_of_rows_can_be_drawn(self):
    self.assertEqual(charts.png(charts.new_figure(1, 1000)[0])[:8], b"\x89PNG\r\n\x1a\n")


class Experiments(package.Case):
  AXES = """
axes = [
  { name = "agent", choices = [ { name = "a", label = "Agent A", config = { agent = "ppo_cnn" } },
                                { name = "b", config = { agent = "ppo_spcnn" } } ] },
  { name = "gamma", choices = [ { name = "gamma=0.5", config = { ppo.gamma = 0.5 } }, { name = "gamma=0.95", config = { ppo.gamma = 0.95 } },
                                { name = "own" } ] },
  { name = "clip", choices = [ { name = "clip=0.1", config = { ppo.clip = 0.1 } } ] },
]
"""

  def parse(self, text):
    return experiments.parse(self.AXES + text, "file.toml")

  def test_a_product_has_every_combination_the_last_axis_fastest(self):
    experiment, = self.parse('experiments = [{ name = "t", axes = [{ axis = "agent" }, { axis = "gamma" }] }]')
    self.assertEqual([cell.name for cell in experiment.cells],
                     ["a/gamma=0.5", "a/gamma=0.95", "a/own", "b/gamma=0.5", "b/gamma=0.95", "b/own"])
    cell = experiment.cells[3]
    self.assertEqual((cell.experiment, cell.folder, cell.choices), ("t", "t/b/gamma=0.5", (1, 0)))
    self.assertEqual((cell.config["agent"], cell.config["ppo"]["gamma"], cell.config["ppo"]["clip"]), ("ppo_spcnn", 0.5, 0.2))
    self.assertEqual((experiment.title, [choice.label for choice in experiment.axes[0].choices]), ("t", ["Agent A", "b"]))

  def test_each_varies_one_axis_at_a_time(self):
    experiment, = self.parse('experiments = [{ name = "t", combine = "each", axes = [{ axis = "clip" }, { axis = "gamma", only = ["gamma=0.5"] }] }]')
    self.assertEqual([cell.name for cell in experiment.cells], ["clip=0.1", "gamma=0.5"])
    self.assertEqual((experiment.cells[1].config["ppo"]["clip"], experiment.cells[1].axes), (0.2, (1,)))

  def test_pairs_vary_every_two_axes(self):
    experiment, = self.parse('experiments = [{ name = "t", combine = "pairs", axes = [{ axis = "agent", only = ["b"] }, '
                             '{ axis = "clip" }, { axis = "gamma", only = ["own"] }] }]')
    self.assertEqual([cell.name for cell in experiment.cells], ["b/clip=0.1", "b/own", "clip=0.1/own"])
    self.assertEqual(experiment.cells[2].config["agent"], "ppo_cnn")

  def test_choices_override_the_base(self):
    cells = self.parse('experiments = [{ name = "t", base = { steps = 5000, ppo.gamma = 0.7, ppo.clip = 0.3 }, axes = [{ axis = "gamma" }] }]')[0].cells
    self.assertEqual((cells[0].config["ppo"]["gamma"], cells[2].config["ppo"]["gamma"], cells[0].config["ppo"]["clip"]), (0.5, 0.7, 0.3))
    self.assertEqual(cells[0].steps, 5000)

  def test_cells_of_one_configuration_share_the_first_ones_folder(self):
    _, second = self.parse('experiments = [{ name = "t", axes = [{ axis = "agent" }] }, '
                           '{ name = "u", base = { agent = "ppo_spcnn" }, axes = [{ axis = "gamma" }] }]')
    self.assertEqual([cell.folder for cell in second.cells], ["u/gamma=0.5", "t/b", "t/b"])

  def test_bad_files_are_refused_with_the_place(self):
    for text, message in (
        ('experiments = [{ nam = "t" }]', 'unknown field "nam", want one of name, title'),
        ('experiments = [{ name = "t", combine = "all" }]', "want one of product, each, pairs"),
        ('experiments = [{ name = "t", axes = ["agent"] }]', 'axes: "agent", want { axis = "agent" }'),
        ('experiments = [{ name = "t", axes = [{ axis = "x" }] }]', 'experiment "t": axis "x" is not in the file'),
        ('experiments = [{ name = "t", axes = [{ axis = "agent", only = ["x"] }] }]', 'axis "agent" has no choice "x"'),
        ('experiments = [{ name = "t" }, { name = "t" }]', 'experiment "t" occurs twice'),
        ('experiments = [{ name = "../t" }]', 'experiment "../t": want letters'), ("", "no experiment in it"),
        ("experiments = [{}]", 'experiment "": want letters'),
        ('experiments = [{ name = "t", base = { ppo.gamma = 2 } }]', 'experiment "t": cell "t": configuration: ppo.gamma is 2'),
        ('experiments = [{ name = "t", base = { ppo.gamma = 2 }, axes = [{ axis = "clip" }] }]', 'cell "clip=0.1": configuration: ppo.gamma is 2, want 0..1'),
        ('experiments = [{ name = "t", base = { agnet = "x" } }]', "agnet"),
        ('experiments = [{ name = "t", base = { env.name = "tetris" } }]', 'env.name: environment "tetris"'),
        ('experiments = [{ name = "t", base = { eval.env = "tetris" } }]', 'eval.env: environment "tetris"'),
        ('experiments = [{ name = "t", milestones = [2, 1] }]', "milestones do not ascend"),
        ('experiments = [{ name = "t", milestones = [1, "2"] }]', "milestones are [1, '2'], want numbers of environment steps"),
        ('experiments = [{ name = "t", axes = [{ axis = "agent", only = [["a"]] }] }]', "has no choice \"['a']\""),
        ('experiments = [{ name = "t", combine = "pairs", axes = [{ axis = "clip" }] }]', 'experiment "t": no cell: want an'),
        ('experiments = [{ name = "t", combine = "each" }]', 'experiment "t": no cell: want an axis'),
        ('experiments = [{ name = "runs" }]', 'experiment "runs": want another name: reports have a runs.csv of their own'),
        ('experiments = [{ name = "t", base = { seed = 3 } }]', "seed is 3, want none: a sweep gives each run its own"),
        ("experiments = " + "[" * 5000, "tables or lists are nested too deeply"),
        ('experiments = [{ name = "t", base = { ' + "a." * 5000 + "b = 1 } }]", "tables or lists are nested too deeply"),
        ('experiments = [{ name = "t" ', "at end of document"), ('experiments {\n name: "t" }', "version 0.1 are in another format")):
      refused = self.refusal(self.parse, text)
      self.assertTrue(refused.startswith("file.toml: "), refused)
      self.assertIn(message, refused)
    twice = 'axes = [{ name = "x", choices = [{ name = "c" }, { name = "c" }] }]'
    self.assertIn('axis "x": choice "c" occurs twice', self.refusal(experiments.parse, twice, "f"))

  # They share their runs, and only the first would be run.
  def test_cells_of_one_configuration_differ_in_nothing_else(self):
    text = ('experiments = [{ name = "t", base = { agent = "ppo_cnn" } }, '
            '{ name = "u", base = { env.name = "crafter:numbers=default"%s }, axes = [{ axis = "agent", only = ["a"] }] }]')
    self.assertEqual(self.parse(text % "")[1].cells[0].folder, "t/t")
    for field, value in (("eval", "eval.every_steps = 1000"), ("checkpoint", "checkpoint.keep = 7"), ("cpu", 'cpu = "AVX2"'),
                         ("eval, tile", "eval.seed = 5, tile = 4")):
      self.assertEqual(self.refusal(self.parse, text % f", {value}"),
                       f'file.toml: experiment "u": cell "a" differs from t/t in {field} alone, and would share its runs: want '
                       "the same in both")

  # Cells of one name would share a folder, and only the first would be run.
  def test_choices_of_axes_that_are_varied_apart_have_different_names(self):
    text = """
axes = [{ name = "clip", choices = [{ name = "1", config = { ppo.clip = 0.1 } }] },
        { name = "gamma", choices = [{ name = "1", config = { ppo.gamma = 0.5 } }] }]
experiments = [{ name = "t", axes = [{ axis = "clip" }, { axis = "gamma" }]%s }]
"""
    self.assertEqual([cell.name for cell in experiments.parse(text % "", "f")[0].cells], ["1/1"])
    self.assertIn('f: experiment "t": cell "1" occurs twice: want choices whose names differ',
                  self.refusal(experiments.parse, text % ', combine = "each"', "f"))


class CommandLine(package.Case):

  def test_a_home_folder_is_found_in_every_word_of_a_list(self):
    words = _cli.Flag("reference", "list", [], "").parse("craftfleet curve", "~/a.csv,b,~/c.csv")
    self.assertEqual(words, [os.path.expanduser("~/a.csv"), "b", os.path.expanduser("~/c.csv")])

  def test_an_empty_folder_of_programs_means_those_of_path(self):
    with unittest.mock.patch.dict(os.environ, CRAFTFLEET_BIN="", PATH=f"{BIN}:{os.environ['PATH']}"):
      self.assertEqual(programs.find("inspect")[0], [str(BIN / "craftfleet"), "inspect"])

  def test_names_in_another_encoding_are_printed_as_they_are(self):
    write_run(self.folder / os.fsdecode(b"caf\xe9"), 1)
    environment = {"PYTHONPATH": f"{SOURCE}/deploy/python/craftfleet", "PYTHONIOENCODING": "utf-8:strict"}
    ended = subprocess.run([sys.executable, "-m", "analysis", "curve", self.folder / os.fsdecode(b"caf\xe9")],
                           capture_output=True, check=True, env=os.environ | environment)
    self.assertIn(b"\ncaf\xe9 ", ended.stdout)

  def test_an_encoding_without_a_names_letters_gets_their_numbers(self):
    write_run(self.folder / "日本", 1)
    environment = {"PYTHONPATH": f"{SOURCE}/deploy/python/craftfleet", "PYTHONIOENCODING": "latin-1"}
    ended = subprocess.run([sys.executable, "-m", "analysis", "curve", self.folder / "日本"], capture_output=True, check=True,
                           env=os.environ | environment)
    self.assertIn(rb"\u65e5\u672c ", ended.stdout)

  def test_programs_that_need_torch_say_only_that(self):
    (self.folder / "craftfleet_programs.py").write_text("def command(*_):\n  raise ModuleNotFoundError('needs torch 2.11', name='torch')\n")
    environment = {name: value for name, value in os.environ.items() if name != "CRAFTFLEET_BIN"}
    ended = subprocess.run([sys.executable, "-m", "analysis", "sweep", package.PAPER, "--list"], capture_output=True, text=True, check=False,
                           env=environment | {"PYTHONPATH": f"{self.folder}:{SOURCE}/deploy/python/craftfleet"})
    self.assertEqual((ended.returncode, ended.stderr), (1, "craftfleet sweep: needs torch 2.11\n"))


class Statistics(unittest.TestCase):

  # With df = 2 the probability beyond t is 1 - t / sqrt(t^2 + 2). Two samples of two with equal deviations have df = 2.
  def test_welch(self):
    t = 3.0
    p = statistics.welch(Spread(2, t, 1.0), Spread(2, 0.0, 1.0))
    self.assertAlmostEqual(p, 1 - t / math.sqrt(t * t + 2), 6)
    self.assertAlmostEqual(statistics.welch(Spread(5, 11.1, 0.2), Spread(10, 10.3, 0.6)), 0.0028, 3)
    self.assertIsNone(statistics.welch(Spread(1, 1.0, None), Spread(10, 10.3, 0.6)))
    self.assertAlmostEqual(statistics.welch(Spread(2, 1.0, 0.5), Spread(2, 1.0, 0.5)), 1.0)

  def test_rows_to_expect_within_two_deviations(self):
    low, high = statistics.expected_within_two_deviations(10)
    self.assertEqual((round(30 * low, 1), round(30 * high, 1)), (27.3, 28.6))
    low, high = statistics.expected_within_two_deviations(10, 2)
    self.assertEqual((round(30 * low, 1), round(30 * high, 1)), (29.1, 29.9))

  def test_intervals_contain_the_mean_and_narrow_with_the_spread(self):
    low, high = statistics.interval_over_seeds([10, 11, 12, 13, 14])
    self.assertTrue(10 <= low < 12 < high <= 14)
    self.assertEqual(statistics.interval_over_seeds([5, 5, 5]), (5, 5))
    self.assertEqual((low, high), statistics.interval_over_seeds([10, 11, 12, 13, 14]), "the same again")
    import numpy as np  # pylint: disable=import-outside-toplevel
    from analysis.logs import Episodes  # pylint: disable=import-outside-toplevel
    half = np.zeros((400, 22), int)
    half[:200, :11] = 1
    episodes = Episodes(np.full(400, 9), np.zeros(400, int), half)
    low, high = statistics.interval_over_episodes([episodes])
    self.assertTrue(low < episodes.score < high)
    self.assertLess(high - low, 1.2)
    few = statistics.interval_over_episodes([Episodes(episodes.length[::10], episodes.tenths[::10], half[::10])])
    self.assertGreater(few[1] - few[0], 2 * (high - low))

  def test_correlation(self):
    self.assertAlmostEqual(statistics.correlation([1, 2, 3], [2, 4, 6]), 1)
    self.assertIsNone(statistics.correlation([1, 2], [2, 4]))
    self.assertIsNone(statistics.correlation([1, 1, 1], [2, 4, 5]))


python_case.main()

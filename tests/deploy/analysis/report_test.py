"""The tables, pictures, CSV files and web page of craftfleet report."""

import csv
import dataclasses
import gzip
import io
import math
import os
import re
import threading
import unittest
import unittest.mock

from tests.deploy.analysis import package
from tests.deploy.analysis.package import same_episodes, write_run
from tests.fakes import python_case

from analysis import charts, experiments, figures, report, results, runs, tables, web_page
from analysis._cli import Refusal

# A table of two agents, a matrix of settings and agents, pairs: of 4,000 steps, like the sample runs.
EXPERIMENTS = """
axes = [
  { name = "agent", choices = [
    { name = "ppo_cnn", label = "PPO-CNN", config = { agent = "ppo_cnn" } },
    { name = "lstm_cnn", label = "LSTM-CNN", config = { agent = "lstm_cnn" } } ] },
  { name = "numbers", choices = [
    { name = "easy", config = { env.name = "crafter:numbers=easy-x2", eval.env = "crafter" } },
    { name = "hard", config = { env.name = "crafter:numbers=hard-x2", eval.env = "crafter" } } ] },
  { name = "gamma", choices = [ { name = "gamma=0.5", label = "0.5", config = { ppo.gamma = 0.5 } },
                                { name = "gamma=0.6", label = "0.6", config = { ppo.gamma = 0.6 } } ] },
  { name = "clip", choices = [ { name = "clip=0.1", label = "0.1", config = { ppo.clip = 0.1 } } ] },
]
[[experiments]]
name = "table"
title = "The table"
axes = [{ axis = "agent" }]
base = { steps = 4000, lanes = 10, ppo.rollout_steps = 1000, ppo.minibatch_size = 100 }
[[experiments]]
name = "matrix"
title = "The matrix"
axes = [{ axis = "numbers" }, { axis = "agent" }]
base = { steps = 4000, lanes = 10, ppo.rollout_steps = 1000, ppo.minibatch_size = 100 }
[[experiments]]
name = "pairs"
title = "The pairs"
axes = [{ axis = "gamma" }, { axis = "clip" }]
combine = "pairs"
base = { steps = 4000, lanes = 10, ppo.rollout_steps = 1000, ppo.minibatch_size = 100 }
"""
FIGURES = """table,cell,measure,at,mean,std,source
table,ppo_cnn,train,,10.3,0.6,Stanic et al. 2022
table,ppo_cnn,eval,,9.3,0.5,Stanic et al. 2022
matrix,easy/lstm_cnn,eval,,11.5,0.7,S
matrix,average/ppo_cnn,train,,12.0,1.4,S
matrix,average/ppo_cnn,eval,,9.1,0.9,S
scale,human,train,,50.5,,Hafner 2021
"""


def line(text, begin):
  return next((line for line in text.split("\n") if line.startswith(begin)), "")


class Report(package.Case):

  def setUp(self):
    super().setUp()
    self.drawing = unittest.mock.patch.object(charts, "png", lambda figure: b"\x89PNG\r\n\x1a\n")  # drawing takes most of the time
    self.drawing.start()
    self.addCleanup(self.drawing.stop)

  def make(self):
    found, unreadable = runs.read_runs([str(self.folder)])
    self.assertEqual(unreadable, [])
    files = report.make_report(experiments.parse(EXPERIMENTS, "e"), figures.Figures(FIGURES, "f"), found)
    return {name: content.decode() if not name.endswith(".png") else content for name, content in files.items()}

  # Scores: 101^(11/22) - 1 = 9.0499 and 101^(22/22) - 1 = 100; mean 54.5249, deviation (100 - 9.0499) / sqrt 2 = 64.3115.
  def test_tables_have_mean_and_deviation_over_seeds_beside_the_papers(self):
    write_run(self.folder / "a/seed1", 1)
    write_run(self.folder / "a/seed2", 2, unlocked=22)
    files = self.make()
    shown = line(files["report.md"], "| PPO-CNN | 2 |")
    self.assertRegex(shown, r"\| PPO-CNN \| 2 \| 9.3 ± 0.5 \| - \| - \| 10.3 ± 0.6 \| 54.5 ± 64.3 \[54.5, 54.5\] \| 16.5 ± 7.8 \| 16.5 ± 7.8 \| 16.5 ± 7.8 \|")
    row = next(row for row in csv.DictReader(io.StringIO(files["table.csv"])) if row["cell"] == "ppo_cnn" and row["measure"] == "train")
    self.assertEqual(row["n"], "2")
    self.assertAlmostEqual(float(row["mean"]), (math.sqrt(101) - 1 + 100) / 2, 12)
    self.assertAlmostEqual(float(row["std"]), (100 - (math.sqrt(101) - 1)) / math.sqrt(2), 12)
    self.assertEqual((row["paper_mean"], row["paper_std"]), ("10.3", "0.6"))

  def test_all_three_measures_are_shown_and_tested_against_the_paper(self):
    for seed in (1, 2):
      write_run(self.folder / f"a/seed{seed}", seed)
      (self.folder / f"a/seed{seed}/eval_sampled.jsonl").write_text(same_episodes(10, 10 + seed))
      (self.folder / f"a/seed{seed}/eval_argmax.jsonl").write_text(same_episodes(10, 8 + seed))
    text = self.make()["report.md"]
    self.assertIn("| PPO-CNN | 2 | 9.3 ± 0.5 | 10.2 ± 1.7 [10.2, 10.2] | 6.4 ± 1.1 [6.4, 6.4] | 10.3 ± 0.6 | 9.0 ± 0.0", text)
    for measure, ours in (("training score", "9.0 ± 0.0"), ("evaluation score, sampled", "10.2 ± 1.7"), ("evaluation score, argmax", "6.4 ± 1.1")):
      self.assertRegex(text, rf"\| PPO-CNN \| {measure} \| {ours} \(n=2\) \| [\d.]+ ± [\d.]+ \(n=10\) \| [+-][\d.]+ \| ")

  def test_a_measure_of_other_seeds_than_the_row_says_so(self):
    for seed in (1, 2):
      write_run(self.folder / f"a/seed{seed}", seed)
    (self.folder / "a/seed1/eval_sampled.jsonl").write_text(same_episodes(10, 11))
    self.assertIn("| PPO-CNN | 2 | 9.3 ± 0.5 | 9.0 [9.0, 9.0] (n=1) | - | 10.3 ± 0.6 | 9.0 ± 0.0 [9.0, 9.0] |", self.make()["report.md"])

  def test_steps_are_those_of_whole_iterations(self):
    write_run(self.folder / "a", 1, {"steps": 3500})
    write_run(self.folder / "b", 1, {"steps": 3500}, episodes=20)
    text = self.make()["report.md"]
    self.assertIn("| 4,000 of 4,000 | yes |", line(text, f"| {self.folder}/a "))
    self.assertIn("| 2,000 of 4,000 | no |", line(text, f"| {self.folder}/b "))

  def test_a_cell_with_no_run_says_so(self):
    files = self.make()
    text = files["report.md"]
    self.assertIn("| PPO-CNN |  | 9.3 ± 0.5 | no run |  | 10.3 ± 0.6 |", text)
    self.assertIn("| no run | no run |", line(text, "| easy | training score "))
    self.assertIn("| 0.5 | no run |", text)
    self.assertEqual(line(files["table.csv"], "table,lstm_cnn,train,"), "table,lstm_cnn,train,,0,,,,,,")
    self.assertIn("0 of 8 configurations have a complete run", text)
    self.assertFalse([name for name in files if name.endswith(".png")])

  def test_a_configuration_of_several_cells_is_counted_once(self):
    write_run(self.folder / "a/seed1", 1)
    twice = EXPERIMENTS + EXPERIMENTS[EXPERIMENTS.index("[[experiments]]"):].replace('name = "', 'name = "again_').replace(
        'axis = "again_', 'axis = "')
    found, _ = runs.read_runs([str(self.folder)])
    text = report.make_report(experiments.parse(twice, "e"), figures.Figures(FIGURES, "f"), found)["report.md"].decode()
    self.assertIn("1 of 8 configurations have a complete run (16 cells", text)

  def test_runs_with_other_textures_are_other_cells(self):
    write_run(self.folder / "a/seed1", 1)
    write_run(self.folder / "original/seed2", 2, unlocked=22)
    (self.folder / "original/seed2/run.json").write_text('{"texture_digest": "8140aa54698876d7"}')
    text = self.make()["report.md"]
    self.assertIn("| 10.3 ± 0.6 | 9.0 ", line(text, "| PPO-CNN | 1 |"))
    self.assertIn("(ppo_cnn, textures=8140aa54698876d7)", text)

  def test_one_seed_has_no_deviation(self):
    write_run(self.folder / "a/seed1", 1)
    files = self.make()
    self.assertIn("| 10.3 ± 0.6 | 9.0 [9.0, 9.0] |", line(files["report.md"], "| PPO-CNN | 1 |"))
    self.assertTrue(line(files["table.csv"], "table,ppo_cnn,unlocked,").startswith("table,ppo_cnn,unlocked,,1,11,,"))

  def test_unfinished_runs_are_named_and_not_averaged(self):
    write_run(self.folder / "a/seed1", 1)
    write_run(self.folder / "a/seed2", 2, episodes=15, unlocked=22)
    write_run(self.folder / "b/seed1", 1, {"agent": "lstm_cnn"}, episodes=25)
    files = self.make()
    text = files["report.md"]
    self.assertIn("3 runs, 1 of them complete", text)
    self.assertIn("| 9.0 [9.0, 9.0] |", line(text, "| PPO-CNN | 1 |"))
    self.assertIn("- PPO-CNN: not averaged because unfinished: seed 2 at 2,000 of 4,000 steps", text)
    self.assertIn("unfinished: seed 1 at 3,000 of 4,000 steps", line(text, "| LSTM-CNN "))
    self.assertIn(",0,,,", line(files["table.csv"], "table,lstm_cnn,train,"))

  def test_a_seed_that_is_there_twice_counts_once(self):
    write_run(self.folder / "a/seed1", 1)
    write_run(self.folder / "b/seed1", 1)
    text = self.make()["report.md"]
    self.assertIn("| 9.0 [9.0, 9.0] |", line(text, "| PPO-CNN | 1 |"))
    self.assertIn("/b/seed1 not counted, seed 1 is there already", text)

  def test_a_matrix_has_training_and_evaluation_rows_and_averages(self):
    for numbers in ("easy-x2", "hard-x2"):
      run = self.folder / numbers / "seed1"
      write_run(run, 1, {"env": {"name": f"crafter:numbers={numbers}"}, "eval": {"env": "crafter"}})
      (run / "eval_sampled.jsonl").write_text(same_episodes(10, 22))
    files = self.make()
    text = files["report.md"]
    self.assertEqual(line(text, "| easy | training score "), "| easy | training score | 9.0 [9.0, 9.0] (n=1) | no run |")
    self.assertIn("|  | evaluation score, sampled | 100.0 [100.0, 100.0] (n=1) | no run<br>*paper 11.5 ± 0.7* |", text)
    self.assertEqual(line(text, "| average | training score "),
                     "| average | training score | 9.0 (n=1 each)<br>*paper 12.0 ± 1.4* | 0 of 2 rows have runs |")
    self.assertIn("matrix-heatmap.png", files)
    self.assertIn("matrix-curves.png", files)
    self.assertNotIn("</summary>\n\n</details>", text, "an empty fold")
    self.assertNotIn("matrix-evaluation.png", files, "the paper has no figure of PPO-CNN to show beside")

  # Means of several seeds are nearer to the paper's than single runs.
  def test_the_rows_to_expect_follow_from_the_seeds_of_each(self):
    for seed, expected in ((1, "0.9 to 1.0"), (2, "1.0 to 1.0")):
      run = self.folder / f"a/seed{seed}"
      write_run(run, seed, {"agent": "lstm_cnn", "env": {"name": "crafter:numbers=easy-x2"}, "eval": {"env": "crafter"}})
      (run / "eval_sampled.jsonl").write_text(same_episodes(10, 11))
      self.assertEqual(line(self.make()["report.md"], "| LSTM-CNN | evaluation score, sampled | 1 | "),
                       f"| LSTM-CNN | evaluation score, sampled | 1 | {seed} | -2.5 |  | 0 | {expected} |")

  def test_evaluation_has_a_chart_where_the_paper_has_figures(self):
    run = self.folder / "a/seed1"
    write_run(run, 1, {"agent": "lstm_cnn", "env": {"name": "crafter:numbers=easy-x2"}, "eval": {"env": "crafter"}})
    (run / "eval_sampled.jsonl").write_text(same_episodes(10, 22))
    files = self.make()
    self.assertIn("matrix-evaluation.png", files)
    self.assertIn("(matrix-evaluation.png)", files["report.md"])

  def test_runs_of_no_cell_have_a_table_of_their_own_first(self):
    write_run(self.folder / "runs/wide", 1, {"lanes": 20})
    write_run(self.folder / "runs/low", 1, {"ppo": {"gamma": 0.7}})
    write_run(self.folder / "paper/seed1", 1)
    files = self.make()
    text = files["report.md"]
    self.assertIn("| 9.0 ", line(text, "| wide (ppo_cnn, lanes=20) | 1 |"))
    self.assertIn("| 9.0 ", line(text, "| low (ppo_cnn, lanes=10, gamma=0.7) | 1 |"))
    self.assertLess(text.index("## Your own configurations"), text.index("## The table"))
    self.assertIn(f"other,{self.folder}/runs/wide,train,,1,", files["other.csv"])

  def test_runs_whose_names_begin_with_an_underscore_are_in_the_legends(self):
    drawn = []
    write_run(self.folder / "runs/_wide", 1, {"lanes": 20})
    write_run(self.folder / "runs/low", 1, {"ppo": {"gamma": 0.7}})
    with unittest.mock.patch.object(charts, "png", lambda figure: drawn.append(figure) or b""):
      self.make()
    _, curves, achievements = drawn
    for axes in (curves.axes[1], achievements.axes[0]):
      names = [text.get_text().split()[0] for text in axes.get_legend().get_texts()]
      self.assertEqual(sorted(names), ["_wide", "low"])

  def test_rows_without_a_run_are_folded(self):
    write_run(self.folder / "a/seed1", 1)
    text = self.make()["report.md"]
    folded = "".join(re.findall(r"<details>.*?</details>", text, re.DOTALL))
    self.assertNotIn("\n| PPO-CNN |", folded)
    self.assertIn("<details><summary>1 cell without a run: LSTM-CNN</summary>\n\n| agent |", text)
    self.assertIn("\n| LSTM-CNN |", folded)
    self.assertIn("| easy | training score |", folded)
    self.assertLess(text.index("## Runs"), text.index("The matrix"), "what has no run at all comes after all that has")
    self.assertNotIn("| no run |", re.sub(r"<details>.*?</details>", "", text, flags=re.DOTALL))

  def test_a_heatmap_without_runs_or_with_one_number_is_not_drawn(self):
    write_run(self.folder / "a/seed1", 1, {"env": {"name": "crafter:numbers=easy-x2"}, "eval": {"env": "crafter"}}, episodes=0)
    write_run(self.folder / "b/seed1", 1, {"ppo": {"gamma": 0.5, "clip": 0.1}})
    files = self.make()
    self.assertNotIn("matrix-heatmap.png", files)
    self.assertNotIn("matrix-curves.png", files, "a chart without a line")
    self.assertNotIn("pairs-heatmap.png", files, "one number needs no map")

  def test_the_base_of_several_axes_alone_is_not_drawn(self):
    each = EXPERIMENTS.replace('combine = "pairs"\nbase = { ', 'combine = "each"\nbase = { ppo.gamma = 0.5, ppo.clip = 0.1, ')
    def pictures():
      found, _ = runs.read_runs([str(self.folder)])
      return report.make_report(experiments.parse(each, "e"), figures.Figures(FIGURES, "f"), found)
    write_run(self.folder / "a/seed1", 1, {"ppo": {"gamma": 0.5, "clip": 0.1}})
    self.assertNotIn("pairs-scores.png", pictures(), "one number needs no chart")
    write_run(self.folder / "b/seed1", 1, {"ppo": {"gamma": 0.6, "clip": 0.1}}, unlocked=12)
    self.assertIn("pairs-scores.png", pictures())

  def test_shows_every_picture_that_it_has_and_no_other(self):
    self.drawing.stop()
    write_run(self.folder / "a/seed1", 1)
    write_run(self.folder / "b/seed1", 1, {"ppo": {"gamma": 0.5, "clip": 0.1}})
    write_run(self.folder / "c/seed1", 1, {"ppo": {"gamma": 0.6, "clip": 0.1}}, unlocked=12)
    files = self.make()
    pictures = {name for name in files if name.endswith(".png")}
    self.assertEqual(pictures, {"table-scores.png", "table-curves.png", "table-achievements.png", "pairs-heatmap.png"})
    self.assertEqual(set(re.findall(r"\]\(([^)]+)\)", files["report.md"])), pictures)
    for name in pictures:
      self.assertEqual(files[name][:8], b"\x89PNG\r\n\x1a\n")
    self.assertEqual(self.make(), files, "the same bytes again")

  def test_a_complete_run_without_episodes_has_tables_alone(self):
    write_run(self.folder / "a", 1, episodes=0)
    found, _ = runs.read_runs([str(self.folder)])
    found[0].complete = True  # too short for an episode
    files = report.make_report(experiments.parse(EXPERIMENTS, "e"), figures.Figures(figures.HEADER, "f"), found)
    self.assertEqual([name for name in files if name.endswith(".png")], [])
    self.assertIn("| PPO-CNN | 0 | - | - | - | - | - | - |", files["report.md"].decode())

  def test_achievements_have_their_success_rates(self):
    write_run(self.folder / "a/seed1", 1, unlocked=1)
    write_run(self.folder / "a/seed2", 2, unlocked=2)
    files = self.make()
    self.assertEqual(line(files["report.md"], "| collect_coal "), "| collect_coal | 100.0 ± 0.0 |")
    self.assertEqual(line(files["report.md"], "| collect_diamond "), "| collect_diamond | 50.0 ± 70.7 |")
    self.assertIn("| success rate, % | PPO-CNN (n=2) |", files["report.md"])
    self.assertIn("table,ppo_cnn,collect_drink,2,0,0\n", files["achievements.csv"])

  def test_runs_are_listed_with_their_cells(self):
    write_run(self.folder / "a/seed7", 7)
    files = self.make()
    self.assertIn("| table/ppo_cnn |", line(files["report.md"], f"| {self.folder}/a/seed7"))
    self.assertIn(f"{self.folder}/a/seed7,table/ppo_cnn,ppo_cnn,crafter,,7,4000,4000,yes,", files["runs.csv"])


class Milestones(package.Case):

  def test_all_three_measures_at_each_milestone(self):
    write_run(self.folder / "a", 1, {"eval": {"every_steps": 1000, "episodes": 5}})
    (self.folder / "a/eval_sampled.jsonl").write_text(same_episodes(10, 11) + same_episodes(10, 22))
    found, _ = runs.read_runs([str(self.folder)])
    group = next(iter(results.group_runs(found).values()))
    self.assertAlmostEqual(group.scores_at("train", 2000).mean, math.sqrt(101) - 1)
    self.assertAlmostEqual(group.scores_at("eval", 2000).mean, math.sqrt(101) - 1, msg="the first ten episodes")
    self.assertGreater(group.scores_at("eval", 4000).mean, 20)
    self.assertEqual(group.scores_at("eval_argmax", 2000).n, 0)

  def test_an_iteration_has_one_evaluation_however_many_are_due(self):
    write_run(self.folder / "a", 1, {"eval": {"every_steps": 250, "episodes": 5}})
    (self.folder / "a/eval_sampled.jsonl").write_text(same_episodes(10, 11) + same_episodes(10, 22))
    (run,), _ = runs.read_runs([str(self.folder)])
    self.assertEqual([len(run.evaluation_at("eval_sampled", steps)) for steps in (0, 249, 250, 1000, 1250, 2000, 4000)],
                     [0, 0, 5, 5, 10, 10, 20])

  def test_a_milestone_without_evaluation_is_reached_all_the_same(self):
    write_run(self.folder / "a", 1)
    text = EXPERIMENTS.replace('title = "The table"\n', 'title = "The table"\nmilestones = [2000, 5000]\n')
    result, *_ = results.match(experiments.parse(text, "e"), results.group_runs(runs.read_runs([str(self.folder)])[0]))
    table = tables.experiment_tables(result, figures.Figures(figures.HEADER, "f"))
    self.assertEqual(line(table, "| PPO-CNN |"), "| PPO-CNN | training score | 9.0 (n=1) | not reached |")
    self.assertEqual(line(table, "|  | evaluation score, sampled |"), "|  | evaluation score, sampled | - | not reached |")


class Target(package.Case):
  FILES = {"report.md": b"# Report\n", "runs.csv": b"folder\n", "curve.png": b"picture"}

  def write_to(self, out):
    report.check_target(str(out))
    return report.write(str(out), self.FILES)

  def test_creates_a_folder_when_there_is_a_report(self):
    report.check_target(str(self.folder / "out/report"))
    self.assertEqual(list(self.folder.iterdir()), [], "not before there is something to write")
    self.assertEqual(self.write_to(self.folder / "out/report"), 3)
    self.assertEqual({path.name: path.read_bytes() for path in (self.folder / "out/report").iterdir()}, self.FILES)

  def test_replaces_files_and_keeps_links_and_others(self):
    (self.folder / "report").mkdir()
    for name in ("report/runs.csv", "report/notes.md", "kept.md"):
      (self.folder / name).write_text("old")
    (self.folder / "report/report.md").symlink_to("../kept.md")
    (self.folder / "link").symlink_to("report")
    self.assertEqual(self.write_to(self.folder / "link"), 3)
    self.assertTrue((self.folder / "report/report.md").is_symlink())
    self.assertEqual((self.folder / "kept.md").read_text(), "# Report\n")
    self.assertEqual((self.folder / "report/runs.csv").read_text(), "folder\n")
    self.assertEqual((self.folder / "report/notes.md").read_text(), "old")

  @unittest.skipIf(os.geteuid() != 0, "only root can make a file of another user")
  def test_a_file_that_may_not_be_replaced_is_overwritten(self):
    """A file of root in a folder like /tmp."""
    target = self.folder / "report.md"
    target.write_text("a long old text")
    target.chmod(0o666)
    self.folder.chmod(0o1777)
    os.seteuid(65534)
    try:
      self.assertEqual(self.write_to(self.folder), 3)
    finally:
      os.seteuid(0)
    self.assertEqual({path.name: path.read_bytes() for path in self.folder.iterdir()}, self.FILES)

  def test_a_stream_takes_the_page_alone(self):
    fifo = self.folder / "fifo"
    os.mkfifo(fifo)
    read = []
    reader = threading.Thread(target=lambda: read.append(fifo.read_bytes()))
    reader.start()
    self.assertEqual(self.write_to(fifo), 1)
    reader.join()
    self.assertEqual(read, [b"# Report\n"])
    self.assertTrue(fifo.is_fifo())

  def test_what_cannot_be_written_is_refused_before_the_work(self):
    (self.folder / "file").write_text("kept")
    (self.folder / "report/report.md").mkdir(parents=True)
    (self.folder / "dangling").symlink_to("nowhere")
    for out in ("file", "file/report", "dangling", "dangling/report"):
      refused = self.refusal(report.check_target, str(self.folder / out))
      self.assertRegex(refused, "^--out: .* is not a folder; want a folder, or - for standard output$")
    self.assertRegex(self.refusal(report.check_target, str(self.folder / "report")), "^--out: .* is a folder, want a file$")
    self.assertEqual((self.folder / "file").read_text(), "kept")

  def test_replaces_nothing_where_a_file_cannot_be_written(self):
    (self.folder / "curve.png").write_text("old")
    (self.folder / "runs.csv").mkdir()
    self.assertIn("runs.csv is a folder", self.refusal(self.write_to, self.folder))
    self.assertEqual((self.folder / "curve.png").read_text(), "old")


class WebPage(package.Case):

  def page(self):
    return web_page.web_page(runs.read_runs([str(self.folder)])[0])

  def test_has_what_the_files_of_each_run_say_the_best_first(self):
    write_run(self.folder / "sweep/a/seed1", 1, unlocked=3)
    write_run(self.folder / "sweep/b/seed2", 2, {"agent": "lstm_cnn"}, episodes=20, unlocked=22)
    page = self.page()
    rows = [re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr>(<td>.*?)</tr>", page)]
    self.assertEqual(rows[0], ["b/seed2", "100.00", "22.00", "-", "22/22", "2,000, unfinished", "lstm_cnn", "crafter", "2"])
    self.assertEqual(rows[1], ["a/seed1", "0.88", "3.00", "-", "3/22", "4,000", "ppo_cnn", "crafter", "1"])
    self.assertEqual((rows[4], rows[-1]), (["collect drink", "100.0", "100.0"], ["wake up", "100.0", "0.0"]))
    self.assertIn("<h1>2 runs, 1 complete</h1>", page)
    self.assertEqual(page.count('<img alt="Reward and score over steps" src="data:image/png;base64,'), 1)

  def test_needs_no_other_file_and_no_script(self):
    write_run(self.folder / "run", 1)
    self.assertNotRegex(self.page(), r"(src|href)=.(https?:)?//|<script")
    self.assertIn("<h1>1 run, 1 complete</h1>", self.page())

  def test_names_of_folders_stay_text(self):
    write_run(self.folder / "a<script>alert(1)<" / "script>&/run", 1)
    page = self.page()
    self.assertNotIn("<script>", page)
    self.assertIn("a&lt;script&gt;alert(1)&lt;/script&gt;&amp;/run", page)

  def test_a_run_without_episodes_has_a_line(self):
    write_run(self.folder / "run", 1, episodes=0)
    self.assertIn("<td>0.00</td>", self.page())


class PaperFigures(unittest.TestCase):

  def test_are_found_by_table_cell_measure_and_steps(self):
    found = figures.Figures(f"# a remark\n{figures.HEADER}\nt,a/b,train,,1.5,0.2,S\nt,c,train,1000,2,,S\n", "f")
    self.assertEqual((found.find("t", "a/b", "train").mean, found.find("t", "a/b", "train").deviation), (1.5, 0.2))
    self.assertIsNone(found.find("t", "c", "train"))
    self.assertIsNone(found.find("t", "c", "train", 1000).deviation)
    self.assertIsNone(found.find("t", "a/b", "eval"))

  def test_bad_lines_are_named(self):
    for text, message in (("table,cell\n", "f.csv:1: want the columns' names"), ("", "f.csv:1: want the columns' names"),
                          (f"{figures.HEADER}\nt,a,train,,x,,S\n", "f.csv:2: could not convert string to float: 'x', want table,cell"),
                          (f"{figures.HEADER}\n\nt,a,train,,1,y,S\n", "f.csv:3: "),
                          (f"{figures.HEADER}\nt,a,train,z,1,,S\n", "f.csv:2: "),
                          (f"{figures.HEADER}\nt,a,train,1,S\n", "f.csv:2: "),
                          (f"{figures.HEADER}\nt,a,train,,1,,S\nt,a,train,,2,,S\n", "f.csv:3: t a train occurs twice")):
      with self.assertRaises(Refusal) as caught:
        figures.Figures(text, "f.csv")
      self.assertIn(message, str(caught.exception))

  def test_each_of_the_paper_has_its_cell(self):
    cells = {f"{experiment.name}/{cell.name}" for experiment in experiments.load(package.PAPER) for cell in experiment.cells}
    shown = [figure for figure in figures.load(package.FIGURES).all
             if figure.table != "scale" and not figure.cell.startswith("average/")]
    for figure in shown:
      self.assertIn(figure.measure, results.MEASURES)
      self.assertIn(f"{figure.table}/{figure.cell}", cells)
    # Table 1 with its unlocked achievements, no inventory, asymptotic, the reproduction, CrafterOODapp, some of it again for other
    # textures, CrafterOODnum, ablation, beyond.
    self.assertEqual(len(shown), 12 + 1 + 2 + 12 + 2 + 96 + 12 + 96 + 21 + 4)

  # The paper's Table 1 is the evaluation row of O1 100%; the training row of that table has the figures of training episodes.
  def test_table_1_is_the_row_of_the_original_appearance(self):
    paper = figures.load(package.FIGURES)
    for agent in ("ppo_cnn", "ppo_spcnn", "lstm_cnn", "lstm_spcnn", "oc_sa", "oc_ca"):
      for measure in ("train", "eval"):
        row, table1 = paper.find("ood_app", f"ordinary/{agent}", measure), paper.find("table1", agent, measure)
        self.assertEqual((table1.mean, table1.deviation), (row.mean, row.deviation), (agent, measure))


class Committed(unittest.TestCase):
  """The report on the committed results."""

  # Further seeds of cells that had figures before.
  LATER = ("no_inventory_ppo_cnn_1m/seed2", "no_inventory_ppo_cnn_1m/seed3", "no_inventory_ppo_cnn_1m/seed4",
           "no_inventory_ppo_cnn_1m/seed5", "no_inventory_lstm_cnn_1m/seed2", "no_inventory_lstm_cnn_1m/seed3",
           "no_inventory_lstm_cnn_1m/seed4", "reproduction_original_1x4096/seed6", "reproduction_original_1x4096/seed7",
           "reproduction_original_1x4096/seed8", "reproduction_original_1x4096/seed9", "reproduction_original_1x4096/seed10",
           "ood_app_authors_25-25-25-25/seed1", "ood_app_authors_25-25-25-25/seed2", "ood_app_authors_88-4-4-4/seed1",
           "ood_app_authors_88-4-4-4/seed2", "ood_app_authors_100-0-0-0/seed1", "ood_app_authors_100-0-0-0/seed2",
           "no_inventory_lstm_cnn_1m/seed5", "ood_app_authors_25-25-25-25/seed3", "ood_app_authors_88-4-4-4/seed3",
           "ood_app_authors_100-0-0-0/seed3", "lstm_cnn_1m/seed2", "lstm_cnn_1m/seed3", "lstm_cnn_1m/seed4", "lstm_cnn_1m/seed5",
           "lstm_cnn_critic_lstm_1m/seed1", "lstm_cnn_critic_lstm_1m/seed2",
           "lstm_cnn_critic_lstm_1m/seed3", "lstm_cnn_gradients_128_1m/seed1",
           "lstm_cnn_gradients_128_1m/seed2",
           "lstm_cnn_gradients_128_1m/seed3")

  @classmethod
  def setUpClass(cls):
    cls.found, cls.unreadable = runs.read_runs([str(package.RESULTS)])

  def test_all_results_belong_to_a_cell(self):
    self.assertEqual((len(self.found), self.unreadable), (117, []))
    matched = results.match(experiments.load(package.PAPER), results.group_runs(self.found))
    self.assertEqual([result.name for result in matched if result.is_own], [])

  # Made by the report in C++ of 0.1, from the logs themselves.
  def test_has_every_figure_that_it_had_before(self):
    found = [run for run in self.found if not run.folder.endswith(self.LATER)]
    self.assertEqual(len(found), 85)
    matched = results.match(experiments.load(package.PAPER), results.group_runs(found))
    made = {}
    for result in matched:
      for row in csv.DictReader(io.StringIO(tables.experiment_csv(result, figures.Figures(figures.HEADER, "f")))):
        made["measure", row["experiment"], row["cell"], row["measure"], row["at"]] = (row["n"], row["mean"], row["std"])
    for row in csv.DictReader(io.StringIO(tables.achievements_csv(matched))):
      made["success", row["experiment"], row["cell"], row["achievement"], ""] = (row["n"], row["mean"], row["std"])
    for row in csv.DictReader(io.StringIO(tables.curves_csv(matched))):
      for value in ("score", "reward"):
        made[f"curve {value}", row["experiment"], row["cell"], "", row["steps"]] = (row["n"], row[f"{value}_mean"], row[f"{value}_std"])
    with gzip.open(python_case.SOURCE / "tests/data/report/figures.csv.gz", "rt", encoding="utf-8") as file:
      wanted = list(csv.DictReader(file))
    self.assertGreater(len(wanted), 900)
    for row in wanted:
      key = (row["kind"], row["experiment"], row["cell"], row["measure"], row["at"])
      self.assertEqual(made[key][0], row["n"], key)
      for ours, before in zip(made[key][1:], (row["mean"], row["std"])):
        self.assertAlmostEqual(float(ours or 0), float(before or 0), 9, key)

  def test_the_page_is_the_one_in_the_repository(self):
    found = [dataclasses.replace(run, folder=os.path.relpath(run.folder, python_case.SOURCE)) for run in self.found]
    with unittest.mock.patch.object(charts, "png", lambda figure: b""):  # drawing takes most of the time
      made = report.make_report(experiments.load(package.PAPER), figures.load(package.FIGURES), found, with_csv=False)
    folder = python_case.SOURCE / "deploy/experiments/report"
    self.assertEqual({path.name for path in folder.iterdir()}, set(made), "make it again, see deploy/experiments/results/README.md")
    self.assertEqual((folder / "report.md").read_text(encoding="utf-8"), made["report.md"].decode())


python_case.main()

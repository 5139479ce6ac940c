"""craftfleet sweep: runs experiments."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections import Counter

from . import _cli, experiments, programs, slurm
from ._cli import Flag, Refusal, in_range
from .experiments import Cell
from .sweep_jobs import Stopped, Sweep
from .sweep_plan import Job, cell_file, cells_with_textures, plan, prepare_folder, select_cells, states_or_none, write_file

PROGRAM = "craftfleet sweep"
USAGE = """craftfleet sweep FILE runs the experiments of a file: every cell with several seeds, each with `craftfleet train`. After
a stop or a crash, the same command continues: it skips complete runs and resumes the others. A run that fails is reported and
does not stop the others. The folder of each run has its output in log.txt.

  craftfleet sweep deploy/experiments/paper.toml --list
  craftfleet sweep deploy/experiments/paper.toml --experiment=table1 --cell=ppo_cnn --seeds=3 --jobs=2 --logdir=runs/paper
  craftfleet sweep deploy/experiments/paper.toml --experiment=table1 --executor=slurm --jobs=20 --logdir=/shared/runs/paper
  craftfleet report runs/paper --out=report

Ctrl-C, SIGTERM or closing the terminal stops it and its runs, each with a checkpoint. If its output is closed
(craftfleet sweep ... | head), it continues silently."""
FLAGS = [
    Flag("logdir", "string", "", "folder of the runs: LOGDIR/EXPERIMENT/CELL/seed1, ... (required to run)"),
    Flag("experiment", "list", [], "experiments of the file to run, joined by commas [all]"),
    Flag("cell", "list", [], "cells to run, joined by commas\n"
         "such as ppo_cnn, 94-2-2-2/ppo_cnn, or 94-2-2-2 for all cells below it\n[all]"),
    Flag("seeds", "integer", 10, "runs of each cell, with the seeds 1, 2, ...; 1..1000"),
    Flag("jobs", "integer", 1, "runs at a time, 1..1000"),
    Flag("steps", "integer", 0, "environment steps of each run, for a trial: 100000 or 100k; 0: those of the experiment"),
    Flag("list", "bool", False, "only list the cells; with --logdir also the number of their finished runs"),
    Flag("dry_run", "bool", False, "only print the commands that would be run, or with --executor=slurm the script\n"
         "the files of their --config are written by a sweep without this flag"),
    Flag("executor", "string", "local", "where to run: local (processes on this machine) or slurm (one array job)\n"
         "tasks that Slurm preempts are requeued and resume"),
    Flag("threads", "integer", 0, "threads of each run; 0: the CPU quota divided among --jobs\nwith --executor=slurm 0 means 1"),
    Flag("run", "list", [], "only these runs, joined by commas: table1/ppo_cnn/seed1 [all]", main=False),
    Flag("slurm_flags", "string", "", "with --executor=slurm: flags for sbatch, such as \"--partition=gpu --mem=8G --time=2-0\"",
         main=False),
    Flag("textures", "string", "", "textures of all runs, as for craftfleet train [the ones that come with this program]",
         main=False),
    Flag("write_configs", "string", "", "only write each cell's configuration to DIR/EXPERIMENT/CELL.txt", main=False),
]


def _handle_signals(sweep: Sweep) -> None:
  """The first SIGTERM, SIGINT or SIGHUP stops the sweep; a later SIGTERM or SIGINT ends this process at once. Those of half a
  second are one: timeout(1) signals its command and then their group."""
  received = []
  def on_signal(number, _frame):
    if number != signal.SIGHUP:
      received.append(time.monotonic())
    if received and received[-1] - received[0] > 0.5:
      os._exit(130)  # pylint: disable=protected-access
    sweep.stop()
  signal.signal(signal.SIGTERM, on_signal)
  signal.signal(signal.SIGINT, on_signal)
  # Under nohup it does nothing, but is not ignored: runs would inherit that, and sweep.stop() sends it to them.
  is_ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
  signal.signal(signal.SIGHUP, (lambda *_: None) if is_ignored else on_signal)


def _list(cells: list[Cell], flags, texture_digest: str) -> None:
  done: Counter[str] = Counter()
  if flags.logdir:
    jobs = plan(cells, flags.logdir, flags.seeds, texture_digest, flags.steps)
    done.update(os.path.dirname(job.folder) for job, state in zip(jobs, states_or_none(jobs)) if state.finished)
  for cell in cells:
    line = f"{f'{cell.experiment}/{cell.name}':48} {flags.steps or cell.steps:9d} steps"
    if flags.logdir:
      line += f"   {done[os.path.join(flags.logdir, cell.folder)]} of {flags.seeds} done"
    print(line + (f"   as {cell.folder}" if cell.folder != f"{cell.experiment}/{cell.name}" else ""))
  print(f"{len(cells)} cells")


def _write_configs(cells: list[Cell], folder: str) -> None:
  for cell in cells:
    write_file("--write_configs", os.path.join(folder, cell.experiment, f"{cell.name}.txt"), cell_file(cell))


def _named_runs(jobs: list[Job], names: list[str]) -> list[Job]:
  found = {job.name: job for job in jobs}
  for name in names:
    if name not in found:
      raise Refusal(f'--run: no run "{name}", want one like {jobs[0].name}')
  return [found[name] for name in dict.fromkeys(names)] if names else jobs


def _train_flags(flags) -> list[str]:
  threads = flags.threads or max(1, programs.ask([{"machine": True}])[0]["threads"] // flags.jobs)
  return [f"--threads={threads}"] + ([f"--textures={flags.textures}"] if flags.textures else [])


def _run_on_slurm(file: str, flags, jobs: list[Job]) -> None:
  # Slurm 22.05 replaces these in names of an array's logs, however they are written.
  if "%A" in flags.logdir or "%a" in flags.logdir:
    raise Refusal(f"--logdir={flags.logdir}, want a folder without %A and %a, which Slurm replaces by numbers of the job")
  command = [*programs.find("sweep")[0], os.path.abspath(file), f"--logdir={flags.logdir}", f"--seeds={flags.seeds}",
             f"--steps={flags.steps}"] + ([f"--textures={os.path.abspath(flags.textures)}"] if flags.textures else [])
  unfinished = [job for job, state in zip(jobs, states_or_none(jobs)) if not state.finished]
  if not unfinished:
    print(f"all runs are done: {len(jobs)}")
    return
  logs = os.path.join(flags.logdir, "slurm")
  script = slurm.script(logs, flags.jobs, max(1, flags.threads), command, [job.name for job in unfinished])
  if flags.dry_run:
    print(script, end="")
    return
  for job in jobs:
    prepare_folder(job)
  path = os.path.join(logs, "sweep.sbatch")
  write_file("--logdir", path, script)
  print(f"unfinished runs: {len(unfinished)}; logs will be in {logs}", flush=True)
  try:
    os.execvp("sbatch", ["sbatch", *flags.slurm_flags, path])
  except OSError as error:
    raise Refusal(f"cannot start sbatch: {error.strerror}; submit {path} on a machine with Slurm") from None


def _check_flags(flags) -> None:
  in_range("seeds", flags.seeds, 1, 1000)
  in_range("jobs", flags.jobs, 1, 1000)
  in_range("threads", flags.threads, 0, 256)
  in_range("steps", flags.steps, 0, 10**12)
  if flags.executor not in ("local", "slurm"):
    raise Refusal(f"--executor={flags.executor}, want local or slurm")
  try:
    flags.slurm_flags = shlex.split(flags.slurm_flags)
  except ValueError as error:
    raise Refusal(f"--slurm_flags={flags.slurm_flags}: {error}") from None


def _texture_digest(flags) -> str:
  answer = programs.ask([{"textures_in": flags.textures}])[0]
  if "error" in answer:
    raise Refusal(answer["error"])
  return answer["digest"]


def _jobs(cells: list[Cell], flags) -> list[Job]:
  digest = _texture_digest(flags)
  drawn = cells_with_textures(cells, digest)
  if len(drawn) < len(cells):
    print(f"{PROGRAM}: {len(cells) - len(drawn)} cells want other textures and are left out; --textures selects the textures",
          file=sys.stderr)
  if flags.executor == "slurm":
    flags.logdir = os.path.abspath(flags.logdir)
  return _named_runs(plan(drawn, flags.logdir, flags.seeds, digest, flags.steps, _train_flags(flags)), flags.run)


def _run(flags, arguments: list[str]) -> int:
  if len(arguments) != 1:
    raise Refusal("name one file with experiments, such as deploy/experiments/paper.toml; see --help")
  _check_flags(flags)
  cells = select_cells(experiments.load(arguments[0]), flags.experiment, flags.cell)
  if flags.write_configs:
    _write_configs(cells, flags.write_configs)
    return 0
  if flags.list:
    _list(cells, flags, _texture_digest(flags) if flags.logdir else "")
    return 0
  if not flags.logdir:
    raise Refusal("--logdir is missing: the folder for the runs")
  jobs = _jobs(cells, flags)
  if flags.executor == "slurm":
    _run_on_slurm(arguments[0], flags, jobs)
  elif flags.dry_run:
    for job, state in zip(jobs, states_or_none(jobs)):
      if not state.finished:
        print(shlex.join(["craftfleet", "train", *(job.resume if state.begun else job.start)]))
  else:
    sweep = Sweep(jobs, *programs.find("train"), flags.jobs)
    _handle_signals(sweep)
    try:
      sweep.run()
    except Stopped as stopped:
      print(f"{PROGRAM}: {stopped}", file=sys.stderr)
      return slurm.STOPPED
  return 0


def main(arguments: list[str]) -> int:
  return _cli.run(PROGRAM, USAGE, FLAGS, arguments, _run)

"""The jobs of a sweep: one for each configuration and seed, and what their folders have."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Sequence

from . import _cli, programs
from ._cli import Refusal, reason
from .experiments import Cell, Experiment


def select_cells(all_experiments: Sequence[Experiment], names: list[str], cells: list[str]) -> list[Cell]:
  """Cells of these experiments (empty: all) and of these names or first parts of names, in the file's order."""
  known = [experiment.name for experiment in all_experiments]
  for name in names:
    if name not in known:
      raise Refusal(f"--experiment={name}, want one of {', '.join(known)}")
  def fits(cell, wanted):
    return cell.name == wanted or cell.name.startswith(wanted + "/")
  among = [cell for experiment in all_experiments if not names or experiment.name in names for cell in experiment.cells]
  for name in cells:
    if not any(fits(cell, name) for cell in among):
      raise Refusal(f"--cell={name}, want a cell that --list names")
  return [cell for cell in among if not cells or any(fits(cell, name) for name in cells)]


def cells_with_textures(cells: list[Cell], digest: str) -> list[Cell]:
  """Those whose runs are drawn with these textures: cells without a digest of their own take any."""
  drawn = [cell for cell in cells if cell.texture_digest in ("", digest)]
  if cells and not drawn:
    raise Refusal(f"cell {cells[0].experiment}/{cells[0].name} wants textures {cells[0].texture_digest}, not {digest}: give their "
                  "folder with --textures")
  return drawn


@dataclasses.dataclass(frozen=True)
class Job:
  """A run of the sweep."""

  name: str  # "table1/ppo_cnn/seed1"
  folder: str
  config_path: str  # the file that the run is started with
  config_text: str  # its contents
  steps: int  # to train
  start: list[str]  # arguments of `craftfleet train` for a new run
  resume: list[str]
  texture_digest: str  # of its textures


@dataclasses.dataclass(frozen=True)
class State:
  begun: bool = False  # has a checkpoint to resume from
  steps: int = 0  # of the newest one
  finished: bool = False


def cell_file(cell: Cell) -> str:
  return f"# {cell.experiment}, {cell.name}; values that are not given have their defaults.\n{cell.config_text}"


def plan(cells: Sequence[Cell], logdir: str, seeds: int, texture_digest: str, steps: int = 0,
         train_flags: Sequence[str] = ()) -> list[Job]:
  """Seed 1 of every cell, then seed 2, ...; cells that share a folder are run once. `texture_digest`: of cells that take any."""
  distinct = {}
  for cell in cells:
    distinct.setdefault(cell.folder, cell)
  jobs = []
  for seed in range(1, seeds + 1):
    for cell in distinct.values():
      above = os.path.join(logdir, cell.folder)
      folder, config = os.path.join(above, f"seed{seed}"), os.path.join(above, "cell.txt")
      wanted = steps or cell.steps
      shared = [f"--steps={wanted}", f"--logdir={folder}", *train_flags]
      jobs.append(Job(f"{cell.folder}/seed{seed}", folder, config, cell_file(cell), wanted,
                      [f"--config={config}", f"--seed={seed}", *shared], ["--resume", *shared],
                      cell.texture_digest or texture_digest))
  return jobs


def write_file(flag: str, path: str, text: str) -> None:
  """Writes a file at once, and its folder if there is none."""
  try:
    os.makedirs(os.path.dirname(path), exist_ok=True)
    _cli.replace_file(path, text.encode())
  except OSError as error:
    raise Refusal(f"{flag}: cannot write {path}: {reason(error)}") from None


def prepare_folder(job: Job) -> None:
  """Creates the run's folder and its cell's file, which the jobs of the cell share."""
  try:
    os.makedirs(job.folder, exist_ok=True)
  except OSError as error:
    raise Refusal(f"--logdir: cannot create {reason(error)}") from None
  try:
    with open(job.config_path, encoding="utf-8") as file:
      if file.read() == job.config_text:
        return
  except (OSError, UnicodeDecodeError):
    pass
  write_file("--logdir", job.config_path, job.config_text)


def _with_steps(config: str, steps: int) -> str:
  return re.sub(r"(?m)^steps: .*\n", "", config) + f"\nsteps: {steps}\n"


def _check_textures(job: Job) -> None:
  """Refusal: the folder's run has other textures."""
  path = os.path.join(job.folder, "run.json")
  if not os.path.exists(path):
    return
  try:
    digest = json.loads(_cli.read_text(path))["texture_digest"]
  except (ValueError, KeyError, TypeError):
    raise Refusal(f'{path}: no "texture_digest", want the digest of the textures') from None
  if digest != job.texture_digest:
    raise Refusal(f"{path}: the run has textures {digest}, want {job.texture_digest}: use another --logdir, or give those of the "
                  "run with --textures")


def configuration_problems(jobs: Sequence[Job]) -> list[Refusal | None]:
  """For each job why its folder's run is not its own: it has another configuration, other textures, or none that can be read."""
  problems: list[Refusal | None] = [None] * len(jobs)
  questions = {}  # by number of the job
  for number, job in enumerate(jobs):
    path = os.path.join(job.folder, "config.txt")
    try:
      if os.path.exists(path):
        # The steps may change when the run is resumed.
        questions[number] = [{"config": _with_steps(_cli.read_text(path), job.steps), "path": path},
                             {"config": _with_steps(job.config_text, job.steps), "path": job.config_path}]
        _check_textures(job)
    except Refusal as error:
      problems[number] = error
  answers = programs.ask([question for both in questions.values() for question in both])
  for number, run, cell in zip(questions, answers[::2], answers[1::2]):
    error = run.get("error") or cell.get("error")
    if error is None and run["identity"] != cell["identity"]:
      job = jobs[number]
      error = f"{job.folder}/config.txt is not this cell's configuration ({job.config_path}): use another --logdir"
    if error:
      problems[number] = Refusal(error)
  return problems


def states(jobs: Sequence[Job]) -> list[State | Refusal]:
  """What each run has; a Refusal if that cannot be read, or is a finished run of another configuration."""
  answers = programs.ask([{"folder": job.folder, "steps": job.steps} for job in jobs])
  known = [Refusal(answer["error"]) if "error" in answer else State(**answer) for answer in answers]
  finished = [number for number, state in enumerate(known) if isinstance(state, State) and state.finished]
  if finished:
    for number, problem in zip(finished, configuration_problems([jobs[number] for number in finished])):
      known[number] = problem or known[number]
  return known


def states_or_none(jobs: Sequence[Job]) -> list[State]:
  """Names runs that cannot be read in warnings, and takes them for ones that have not begun."""
  known = []
  for job, state in zip(jobs, states(jobs)):
    if isinstance(state, Refusal):
      _cli.warn(f"{job.name}: {state}")
      state = State()
    known.append(state)
  return known

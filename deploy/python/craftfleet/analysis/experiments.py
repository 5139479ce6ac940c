"""The experiments of a file: the configurations behind each table and figure. The file's format: deploy/experiments/paper.toml."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import re

from . import programs
from ._cli import Refusal, read_text

_COMBINE = ("product", "each", "pairs")
_FILES = ("other", "runs", "achievements", "curves")  # .csv of a report, beside those of experiments


@dataclasses.dataclass(frozen=True)
class Choice:
  name: str
  label: str
  config: dict
  texture_digest: str = ""


@dataclasses.dataclass(frozen=True)
class Axis:
  name: str
  choices: list[Choice]


@dataclasses.dataclass
class Cell:
  """One configuration of an experiment."""

  experiment: str
  name: str  # its choices joined by slashes: "94-2-2-2/ppo_cnn"
  axes: tuple[int, ...]  # that it varies, ascending
  choices: tuple[int, ...]  # index within each of those
  config_text: str  # what differs from the defaults, in the text format of config.txt
  texture_digest: str = ""  # of the textures of its runs; "": those that come with the programs
  config: dict = dataclasses.field(default_factory=dict)  # complete
  identity: str = ""
  # Of its runs, below that of the sweep: the first cell's of the same configuration, so that tables share runs.
  folder: str = ""

  @property
  def steps(self) -> int:
    return int(self.config["steps"])


@dataclasses.dataclass
class Experiment:
  name: str
  title: str
  combine: str
  axes: list[Axis]
  milestones: list[int]  # environment steps, ascending
  cells: list[Cell]  # the last axis varies fastest

  @property
  def varies_one_of_several(self) -> bool:
    """Whether each cell varies one of several axes."""
    return self.combine == "each" and len(self.axes) > 1

  @property
  def has_two_axes(self) -> bool:
    return self.combine == "pairs" or (self.combine == "product" and len(self.axes) == 2)


def config_text(config: dict, indent: str = "") -> str:
  """A configuration in the text format of config.txt. Capitals are names of the format's own, such as BF16."""
  lines = []
  for key, value in config.items():
    if isinstance(value, dict):
      lines.append(f"{indent}{key} {{\n{config_text(value, indent + '  ')}{indent}}}\n")
    elif isinstance(value, bool):
      lines.append(f"{indent}{key}: {str(value).lower()}\n")
    elif isinstance(value, str) and not re.fullmatch(r"[A-Z][A-Z0-9_]*", value):
      escaped = value.replace("\\", "\\\\").replace('"', '\\"')
      lines.append(f'{indent}{key}: "{escaped}"\n')
    else:
      lines.append(f"{indent}{key}: {value}\n")
  return "".join(lines)


def merged(base: dict, over: dict) -> dict:
  """`base` with what `over` has laid over it, table by table."""
  result = copy.deepcopy(base)
  for key, value in over.items():
    both = isinstance(value, dict) and isinstance(result.get(key), dict)
    result[key] = merged(result[key], value) if both else copy.deepcopy(value)
  return result


def _fields(what: str, table: object, known: dict[str, type]) -> dict:
  if not isinstance(table, dict):
    raise Refusal(f"{what}: want a table with {', '.join(known)}")
  for key, value in table.items():
    if key not in known:
      raise Refusal(f'{what}: unknown field "{key}", want one of {", ".join(known)}')
    if not isinstance(value, known[key]):
      raise Refusal(f"{what}: {key} is {value!r}, want a {known[key].__name__}")
  return table


def _check_names(what: str, names: list[str]) -> None:
  """Names are also names of folders."""
  for number, name in enumerate(names):
    if not re.fullmatch(r"[A-Za-z0-9_=][A-Za-z0-9_=.-]*", name):
      raise Refusal(f'{what} "{name}": want letters, digits and any of _-=. , not beginning with . or -')
    if name in names[:number]:
      raise Refusal(f'{what} "{name}" occurs twice')


def _choice(what: str, table: object) -> Choice:
  fields = _fields(what, table, {"name": str, "label": str, "config": dict, "texture_digest": str})
  name = fields.get("name", "")
  return Choice(name, fields.get("label") or name, fields.get("config", {}), fields.get("texture_digest", ""))


def _axis(table: object) -> Axis:
  fields = _fields("axis", table, {"name": str, "choices": list})
  what = f'axis "{fields.get("name", "")}"'
  axis = Axis(fields.get("name", ""), [_choice(f"{what}: choice", choice) for choice in fields.get("choices", [])])
  _check_names(f"{what}: choice", [choice.name for choice in axis.choices])
  return axis


def _used_axis(axes: dict[str, Axis], use: object) -> Axis:
  if isinstance(use, str):
    raise Refusal(f'axes: "{use}", want {{ axis = "{use}" }}')
  fields = _fields("axes", use, {"axis": str, "only": list})
  name = fields.get("axis", "")
  if name not in axes:
    raise Refusal(f'axis "{name}" is not in the file')
  if not fields.get("only"):
    return axes[name]
  choices = {choice.name: choice for choice in axes[name].choices}
  for wanted in fields["only"]:
    if wanted not in list(choices):  # it may be no text at all
      raise Refusal(f'axis "{name}" has no choice "{wanted}"')
  return Axis(name, [choices[wanted] for wanted in fields["only"]])


def _varied_together(combine: str, axes: int) -> list[tuple[int, ...]]:
  if combine == "each":
    return [(axis,) for axis in range(axes)]
  return list(itertools.combinations(range(axes), 2)) if combine == "pairs" else [tuple(range(axes))]


def _cells(experiment: Experiment, base: dict) -> list[Cell]:
  cells = []
  for axes in _varied_together(experiment.combine, len(experiment.axes)):
    for numbers in itertools.product(*(range(len(experiment.axes[axis].choices)) for axis in axes)):
      choices = [experiment.axes[axis].choices[number] for axis, number in zip(axes, numbers)]
      config = base
      for choice in choices:
        config = merged(config, choice.config)
      if "seed" in config:
        raise Refusal(f"seed is {config['seed']!r}, want none: a sweep gives each run its own")
      digests = [choice.texture_digest for choice in choices if choice.texture_digest]
      name = "/".join(choice.name for choice in choices) or experiment.name
      cells.append(Cell(experiment.name, name, axes, numbers, config_text(config), digests[-1] if digests else ""))
  return cells


_EXPERIMENT = {"name": str, "title": str, "base": dict, "axes": list, "combine": str, "milestones": list}


def _experiment(axes: dict[str, Axis], fields: dict) -> Experiment:
  name, combine = fields.get("name", ""), fields.get("combine", "product")
  if combine not in _COMBINE:
    raise Refusal(f'combine is "{combine}", want one of {", ".join(_COMBINE)}')
  milestones = fields.get("milestones", [])
  if not all(isinstance(steps, int) and steps > 0 for steps in milestones):
    raise Refusal(f"milestones are {milestones!r}, want numbers of environment steps")
  if milestones != sorted(milestones):
    raise Refusal("milestones do not ascend")
  used = [_used_axis(axes, use) for use in fields.get("axes", [])]
  experiment = Experiment(name, fields.get("title") or name, combine, used, milestones, [])
  experiment.cells = _cells(experiment, fields.get("base", {}))
  names = [cell.name for cell in experiment.cells]
  if not names:
    raise Refusal("no cell: want an axis with choices, or two for pairs")
  repeated = next((name for number, name in enumerate(names) if name in names[:number]), None)
  if repeated:
    raise Refusal(f'cell "{repeated}" occurs twice: want choices whose names differ from those of other axes')
  return experiment


def _beside_identity(config: dict) -> dict:
  """A complete configuration without what cells of one identity may write in several ways: environments and the network."""
  rest = {field: value for field, value in config.items() if field != "network"}
  rest["env"] = {field: value for field, value in config["env"].items() if field != "name"}
  rest["eval"] = {field: value for field, value in config["eval"].items() if field != "env"}
  return rest


def _check_same(cell: Cell, first: Cell) -> None:
  """Refusal: `first` is run in place of `cell`, of the same identity, and differs from it all the same."""
  ours, theirs = _beside_identity(cell.config), _beside_identity(first.config)
  different = [field for field in ours | theirs if ours.get(field) != theirs.get(field)]
  if different:
    raise Refusal(f'experiment "{cell.experiment}": cell "{cell.name}" differs from {first.experiment}/{first.name} in '
                  f"{', '.join(different)} alone, and would share its runs: want the same in both")


def _complete(experiments: list[Experiment]) -> None:
  """Fills in the complete configurations of the cells, and their folders."""
  cells = [cell for experiment in experiments for cell in experiment.cells]
  answers = programs.ask([{"config": cell.config_text, "path": "configuration", "check_envs": True,
                           "textures": cell.texture_digest} for cell in cells])
  firsts: dict[str, Cell] = {}  # by identity
  for cell, answer in zip(cells, answers):
    if "error" in answer:
      raise Refusal(f'experiment "{cell.experiment}": cell "{cell.name}": {answer["error"]}')
    cell.config, cell.identity = answer["config"], answer["identity"]
    first = firsts.setdefault(cell.identity, cell)
    _check_same(cell, first)
    cell.folder = f"{first.experiment}/{first.name}"


def parse(text: str, filename: str) -> list[Experiment]:
  """The experiments of a file's text.   Refusal: names the file, and the line or the experiment and cell."""
  import tomllib  # of Python 3.11; older ones show help at least  # pylint: disable=import-outside-toplevel
  try:
    try:
      file = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
      old = "; experiments of version 0.1 are in another format" if re.search(r"^\s*(axes|experiments) \{", text, re.M) else ""
      raise Refusal(f"{error}{old}") from None
    fields = _fields("the file", file, {"axes": list, "experiments": list})
    axes = [_axis(table) for table in fields.get("axes", [])]
    _check_names("axis", [axis.name for axis in axes])
    tables = fields.get("experiments", [])
    if not tables:
      raise Refusal("no experiment in it")
    names = [_fields("experiment", table, _EXPERIMENT).get("name", "") for table in tables]
    _check_names("experiment", names)
    for name in names:
      if name in _FILES:
        raise Refusal(f'experiment "{name}": want another name: reports have a {name}.csv of their own')
    experiments = []
    for name, table in zip(names, tables):
      try:
        experiments.append(_experiment({axis.name: axis for axis in axes}, table))
      except Refusal as error:
        raise Refusal(f'experiment "{name}": {error}') from None
    _complete(experiments)
  except Refusal as error:
    raise Refusal(f"{filename}: {error}") from None
  except RecursionError:
    raise Refusal(f"{filename}: tables or lists are nested too deeply") from None
  return experiments


def load(path: str) -> list[Experiment]:
  """The experiments of a file.   Refusal: as parse, or it cannot be read."""
  return parse(read_text(path), path)

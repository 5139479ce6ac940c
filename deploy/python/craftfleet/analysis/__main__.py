"""python -m craftfleet.analysis report|curve|sweep|top|collect ...: the commands where only the Python package is installed.

The program craftfleet runs this file by its path, in a folder craftfleet_analysis.
"""

import importlib
import os
import sys

COMMANDS = ("collect", "curve", "report", "sweep", "top")
SYSTEM_PYTHON = "/usr/bin/python3"


def package() -> str:
  """The name under which this package can be imported."""
  if __package__:
    return __package__
  here = os.path.dirname(os.path.abspath(__file__))
  # Its modules must not hide those of Python.
  sys.path[:] = [os.path.dirname(here), *(path for path in sys.path if path != here)]
  return os.path.basename(here)


def main() -> int:
  if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
    sys.exit(f"craftfleet.analysis: name a command: {', '.join(COMMANDS)}")
  name = sys.argv[1]
  is_second = os.environ.pop("CRAFTFLEET_SECOND_PYTHON", None)  # not for the tasks of Slurm, whose first Python may be another
  try:
    return importlib.import_module(f"{package()}.{name}").main(sys.argv[2:])
  except ImportError as error:  # before the command has done anything
    # The packages of the distribution belong to its own Python, which need not be the first in PATH.
    if not __package__ and os.path.exists(SYSTEM_PYTHON) and not is_second:
      os.environ["CRAFTFLEET_SECOND_PYTHON"] = "1"
      os.execv(SYSTEM_PYTHON, [SYSTEM_PYTHON, *sys.argv])
    needs = "" if error.name == "torch" else (
        "; it needs Python 3.11 with NumPy and matplotlib: apt-get install python3-matplotlib, or pip install matplotlib")
    print(f"craftfleet {name}: {error}{needs}", file=sys.stderr)
    return 1


sys.exit(main())

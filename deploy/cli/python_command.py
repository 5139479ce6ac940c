#!/usr/bin/env python3
"""Runs the command of craftfleet.analysis that this file is named after: craftfleet-report, craftfleet-curve or craftfleet-sweep."""

import importlib
import os
import pathlib
import sys

SYSTEM_PYTHON = "/usr/bin/python3"


def main():
  own = pathlib.Path(__file__).resolve()
  os.environ.setdefault("CRAFTFLEET_BIN", str(own.parent))
  sys.path.insert(0, str(own.parent.parent / "share/craftfleet/python"))
  name = own.name.removeprefix("craftfleet-")
  try:
    return importlib.import_module(f"craftfleet_analysis.{name}").main(sys.argv[1:])
  except ImportError as error:  # before the command has done anything
    # The packages of the distribution belong to its own Python, which need not be the first in PATH.
    if os.path.exists(SYSTEM_PYTHON) and not os.environ.get("CRAFTFLEET_SECOND_PYTHON"):
      os.environ["CRAFTFLEET_SECOND_PYTHON"] = "1"
      os.execv(SYSTEM_PYTHON, [SYSTEM_PYTHON, str(own), *sys.argv[1:]])
    print(f"craftfleet {name}: {error}; it needs Python 3.11 with NumPy and matplotlib: apt-get install python3-matplotlib, or "
          "pip install matplotlib", file=sys.stderr)
    return 1


sys.exit(main())

"""python -m craftfleet.analysis report|curve|sweep ...: the commands where only the Python package is installed."""

import importlib
import sys

COMMANDS = ("curve", "report", "sweep")

if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
  sys.exit(f"craftfleet.analysis: name a command: {', '.join(COMMANDS)}")
sys.exit(importlib.import_module(f"{__package__}.{sys.argv[1]}").main(sys.argv[2:]))

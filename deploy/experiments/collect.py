#!/usr/bin/env python3
"""Keeps the result of a finished run; --help explains it."""

import os
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]

os.environ.setdefault("CRAFTFLEET_BIN", str(ROOT / "build/bin"))
os.execv(sys.executable, [sys.executable, str(ROOT / "deploy/python/craftfleet/analysis/__main__.py"), "collect", *sys.argv[1:]])

"""The figures of long runs, a line of JSON each, in results/runs.jsonl."""

import datetime
import json
import os
import pathlib
import subprocess
import sys


def record(bin_folder, figures, failures):
    """Adds a line about this run."""
    def said_by(*command):
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()

    here = pathlib.Path(__file__).resolve().parent
    line = {"date": datetime.datetime.now().isoformat(timespec="minutes"),
            "command": " ".join([pathlib.Path(sys.argv[0]).name, *sys.argv[1:]]),
            "build": said_by(pathlib.Path(bin_folder) / "craftfleet-learner", "--version"),
            "revision": said_by("git", "-C", here, "describe", "--always", "--dirty"),
            "cpus": os.cpu_count(), "figures": figures, "failures": failures}
    (here / "results").mkdir(exist_ok=True)
    with open(here / "results" / "runs.jsonl", "a", encoding="utf-8") as results:
        results.write(json.dumps(line) + "\n")

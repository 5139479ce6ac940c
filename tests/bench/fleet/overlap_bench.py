#!/usr/bin/env python3
"""Measures what overlapped play gains: the learner on one core, an actor and an environment server on another.

Trains the same run in pairs, with and without --overlap=1, with one epoch and with four. Prints environment steps per
second, the ratio of each pair, and how busy the learner was: the share of its time that it did not wait for fragments.

  tests/bench/fleet/overlap_bench.py --bin=build/bin                     three pairs of ten iterations each, some minutes
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet import Fleet, Site  # noqa: E402
from fleet_bench import STEPS_OF_AN_ITERATION, rate_of, wall_time_of_iterations  # noqa: E402

CONFIG = """steps: {steps} seed: 1 agent: "{agent}" overlap: {overlap} ppo {{ epochs: {epochs} }}
  eval {{ every_steps: 0 final_episodes: 0 }}"""


def activity_seconds(options, fleet):
    """Seconds that the learner's training thread has spent, by activity; empty while the learner does not answer."""
    answer = subprocess.run([pathlib.Path(options.bin) / "craftfleet", "status", f"--address={fleet.learner_address}", "--json"],
                            capture_output=True, text=True, timeout=30, check=False)
    if answer.returncode != 0:
        return {}
    return {time["activity"]: time["seconds"] for time in json.loads(answer.stdout)["summary"]["times"]}


def train(options, epochs, overlap, folder):
    """Returns steps per second from the first iteration to the last, and the learner's busy share until then."""
    config, logdir = folder / "config.txt", folder / "run"
    config.write_text(CONFIG.format(steps=STEPS_OF_AN_ITERATION * options.iterations, agent=options.agent,
                                    overlap=overlap, epochs=epochs), encoding="utf-8")
    fleet = Fleet(options.bin, folder, config, logdir, Site(), [Site()], actors=1, servers=1, threads=1)
    os.sched_setaffinity(fleet.learner.process.pid, {options.cores[0]})
    for worker in fleet.workers:
        os.sched_setaffinity(worker.process.pid, {options.cores[1]})
    first, last = {}, {}
    try:
        while fleet.learner.process.poll() is None:
            time.sleep(1)
            last = activity_seconds(options, fleet) or last
            if not first and last and wall_time_of_iterations(logdir):
                first = last
    finally:
        fleet.stop()
    if fleet.learner.process.returncode != 0:
        sys.exit(f"the learner failed:\n{pathlib.Path(fleet.learner.log).read_text(encoding='utf-8')}")
    ends = list(wall_time_of_iterations(logdir).values())
    spent = {activity: last[activity] - first.get(activity, 0) for activity in last}
    return rate_of([end - begin for begin, end in zip(ends, ends[1:])]), 1 - spent.get("intake", 0) / sum(spent.values())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--agent", default="ppo_cnn")
    parser.add_argument("--iterations", type=int, default=10, help="of 4,096 steps, a run")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cores", type=int, nargs=2, default=[0, 1], help="of the learner, and of actor and server")
    options = parser.parse_args()
    for epochs in [1, 4]:
        ratios, busy = [], {0: [], 1: []}
        for number in range(options.rounds):
            rates = {}
            # The order rotates, since other load on the machine may drift.
            for overlap in ([0, 1] if number % 2 == 0 else [1, 0]):
                with tempfile.TemporaryDirectory(prefix="overlap_bench-") as folder:
                    rates[overlap], share = train(options, epochs, overlap, pathlib.Path(folder))
                busy[overlap].append(share)
            ratios.append(rates[1] / rates[0])
            print(f"{epochs} epochs, pair {number + 1}: {rates[0]:.0f} steps/s, with overlap {rates[1]:.0f}: {ratios[-1]:.2f}",
                  flush=True)
        print(f"{epochs} epochs: overlap gives {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}); the learner "
              f"is busy {statistics.median(busy[0]):.0%} of the time, with overlap {statistics.median(busy[1]):.0%}")


if __name__ == "__main__":
    main()

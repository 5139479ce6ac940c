#!/usr/bin/env python3
"""Measures what disturbed workers cost a fleet with asynchronous play, and beside it a synchronous one.

Four actors play, each on its own environment server. Undisturbed; with an actor stopped for 5 s of every 10 s; and with an
environment server that is ten times slower, because it is stopped nine tenths of the time, in turns of 20 ms. Prints
environment steps per second, from the first iteration to the last, their share of the undisturbed rate in the same mode, and
with asynchronous play how old the weights were at the end and how many fragments were dropped.

  tests/bench/fleet/staleness_bench.py --bin=build/bin                   six runs of 40 iterations, some ten minutes
"""

import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet import Fleet, Site  # noqa: E402
from fleet_bench import STEPS_OF_AN_ITERATION, wall_time_of_iterations  # noqa: E402

CONFIG = """steps: {steps} seed: 1 agent: "{agent}" fragment_steps: {fragment_steps} max_staleness: {max_staleness}
  ppo {{ epochs: {epochs} }} eval {{ every_steps: 0 final_episodes: 0 }}"""
ACTORS = 4
# What is stopped, for how many seconds at a time, and how many seconds it runs in between.
DISTURBANCES = {"undisturbed": None, "a stopped actor": ("actor0", 5, 5), "a slow server": ("server0", 0.018, 0.002)}


class Disturbance:
    """Stops and wakes a worker in turns, on its own thread."""

    def __init__(self, worker, stopped_s, running_s):
        self.worker, self.stopped_s, self.running_s = worker, stopped_s, running_s
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        while not self.ending.wait(self.running_s):
            self.worker.pause()
            self.ending.wait(self.stopped_s)
            self.worker.wake()

    def stop(self):
        self.ending.set()
        self.thread.join()


def metrics(options, fleet):
    """The learner's metrics; empty while it does not answer."""
    answer = subprocess.run([pathlib.Path(options.bin) / "craftfleet", "status", f"--address={fleet.learner_address}", "--json"],
                            capture_output=True, text=True, timeout=30, check=False)
    if answer.returncode != 0:
        return {}
    return {metric["name"]: metric["value"] for metric in json.loads(answer.stdout)["metrics"]}


def train(options, max_staleness, disturbance, folder):
    """Returns steps per second from the first iteration to the last, and the learner's last metrics."""
    config, logdir = folder / "config.txt", folder / "run"
    config.write_text(CONFIG.format(steps=STEPS_OF_AN_ITERATION * options.iterations, agent=options.agent,
                                    fragment_steps=options.fragment_steps, max_staleness=max_staleness,
                                    epochs=options.epochs), encoding="utf-8")
    fleet = Fleet(options.bin, folder, config, logdir, Site(), [Site()], actors=ACTORS, servers=ACTORS, own_servers=True)
    disturbing, last = None, {}
    try:
        while fleet.learner.process.poll() is None:
            time.sleep(0.5)
            last = metrics(options, fleet) or last
            if disturbance is not None and disturbing is None and last.get("iteration", 0) >= 1:
                worker, stopped_s, running_s = disturbance
                disturbing = Disturbance(next(w for w in fleet.workers if w.name == worker), stopped_s, running_s)
    finally:
        if disturbing is not None:
            disturbing.stop()
        fleet.stop()
    if fleet.learner.process.returncode != 0:
        sys.exit(f"the learner failed:\n{pathlib.Path(fleet.learner.log).read_text(encoding='utf-8')}")
    ends = list(wall_time_of_iterations(logdir).values())
    return STEPS_OF_AN_ITERATION * (len(ends) - 1) / (ends[-1] - ends[0]), last


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--agent", default="ppo_cnn")
    parser.add_argument("--iterations", type=int, default=40, help="of 4,096 steps, a run")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--fragment_steps", type=int, default=64)
    parser.add_argument("--max_staleness", type=int, default=2, help="of the asynchronous runs")
    options = parser.parse_args()
    for max_staleness in [0, options.max_staleness]:
        mode = f"asynchronous, max_staleness {max_staleness}" if max_staleness > 0 else "synchronous"
        rates = {name: [] for name in DISTURBANCES}
        for _ in range(options.rounds):
            for name, disturbance in DISTURBANCES.items():
                with tempfile.TemporaryDirectory(prefix="staleness_bench-") as folder:
                    rate, last = train(options, max_staleness, disturbance, pathlib.Path(folder))
                rates[name].append(rate)
                ages = "" if max_staleness == 0 else (f"; weights {last['staleness_mean']:.2f} updates old, "
                                                      f"{last['fragments_dropped']:.0f} fragments dropped")
                print(f"{mode}, {name}: {rate:.0f} steps/s{ages}", flush=True)
        base = statistics.median(rates["undisturbed"])
        for name in list(DISTURBANCES)[1:]:
            print(f"{mode}: with {name} {statistics.median(rates[name]) / base:.0%} of the undisturbed rate", flush=True)


if __name__ == "__main__":
    main()

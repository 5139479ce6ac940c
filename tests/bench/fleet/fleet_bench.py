#!/usr/bin/env python3
"""Measures the cost of training with separate processes on one host (learner, actor, environment server) instead of one.

Trains the same run repeatedly: in one process, with processes over TCP, and with processes over Unix sockets, in turn.
Prints environment steps per second (wall time, from the first iteration to the last), CPU time per step, and the ratios to
one process: medians over the rounds, of adjacent runs. Then the same for the fastest quarter of each way's iterations,
which other load on the machine has slowed down least.

  tests/bench/fleet/fleet_bench.py --bin=build/bin                       three rounds of ten iterations, some minutes
"""

import argparse
import pathlib
import resource
import statistics
import struct
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet import Fleet, Site  # noqa: E402

CONFIG = "steps: {steps} seed: 1 agent: \"{agent}\" eval {{ every_steps: 0 final_episodes: 0 }}"
STEPS_OF_AN_ITERATION = 4096
WAYS = ["one process", "TCP", "Unix sockets"]


class SocketSite(Site):
    """This machine's file system."""

    def __init__(self, folder):
        self.folder, self.sockets = folder, 0

    def listen(self):
        self.sockets += 1
        return f"unix:{self.folder}/socket{self.sockets}"


def wall_time_of_iterations(logdir):
    """The end time of each iteration, from the run's TensorBoard file. A record is a length, a checksum, an event that
    begins with its wall time (field 1) and its step (field 2), and a checksum."""
    times = {}
    for file in logdir.glob("events.*"):
        data, at = file.read_bytes(), 0
        while at < len(data):
            (length,) = struct.unpack_from("<Q", data, at)
            event = data[at + 12:at + 12 + length]
            at += 16 + length
            (wall_time,) = struct.unpack_from("<d", event, 1)
            step, shift, byte = 0, 0, 10
            while event[9] == 0x10:
                step |= (event[byte] & 0x7F) << shift
                shift += 7
                byte += 1
                if event[byte - 1] < 0x80:
                    break
            times[step] = wall_time
    return {step: wall_time for step, wall_time in sorted(times.items()) if step > 0}


def train(options, way, folder):
    """Returns the seconds of each iteration but the first, and CPU seconds a step."""
    config, logdir = folder / "config.txt", folder / "run"
    config.write_text(CONFIG.format(steps=STEPS_OF_AN_ITERATION * options.iterations, agent=options.agent), encoding="utf-8")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    if way == WAYS[0]:
        with open(folder / "train.log", "wb") as log:
            subprocess.run([pathlib.Path(options.bin) / "craftfleet", "train", f"--config={config}", f"--logdir={logdir}",
                            f"--threads={options.threads}"], stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=True)
    else:
        site = Site() if way == "TCP" else SocketSite(folder)
        fleet = Fleet(options.bin, folder, config, logdir, site, [site], actors=1, servers=1, threads=options.threads)
        try:
            while fleet.learner.process.poll() is None:
                time.sleep(0.1)
        finally:
            fleet.stop()
        if fleet.learner.process.returncode != 0:
            sys.exit(f"the learner failed:\n{pathlib.Path(fleet.learner.log).read_text(encoding='utf-8')}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    times = wall_time_of_iterations(logdir)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    ends = list(times.values())
    return [end - begin for begin, end in zip(ends, ends[1:])], cpu_s / max(times)


def rate_of(seconds):
    """Steps a second of iterations that took so long."""
    return STEPS_OF_AN_ITERATION * len(seconds) / sum(seconds)


def fastest_quarter(seconds):
    return sorted(seconds)[:max(1, len(seconds) // 4)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--agent", default="ppo_cnn")
    parser.add_argument("--iterations", type=int, default=10, help="of 4,096 steps, a run")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=0, help="of each process [as many as its CPU quota allows]")
    options = parser.parse_args()
    iterations, rates, cpu = ({way: [] for way in WAYS} for _ in range(3))
    for number in range(options.rounds):
        # The order rotates, since other load on the machine may drift.
        for way in WAYS[number % 3:] + WAYS[:number % 3]:
            with tempfile.TemporaryDirectory(prefix="fleet_bench-") as folder:
                seconds, cpu_s = train(options, way, pathlib.Path(folder))
            iterations[way] += seconds
            rates[way].append(rate_of(seconds))
            cpu[way].append(cpu_s)
            print(f"round {number + 1}, {way}: {rates[way][-1]:.0f} steps/s, {1e6 * cpu_s:.0f} us of CPU a step", flush=True)
    for way in WAYS:
        ratios = [rate / one for rate, one in zip(rates[way], rates[WAYS[0]])]
        costs = [cpu_s / one for cpu_s, one in zip(cpu[way], cpu[WAYS[0]])]
        print(f"{way:14} {statistics.median(rates[way]):6.0f} steps/s, {statistics.median(ratios):.2f} of one process "
              f"({min(ratios):.2f} to {max(ratios):.2f}); CPU {statistics.median(costs):.2f} ({min(costs):.2f} to {max(costs):.2f})")
    best = {way: rate_of(fastest_quarter(iterations[way])) for way in WAYS}
    for way in WAYS:
        print(f"{way:14} {best[way]:6.0f} steps/s in the fastest quarter, {best[way] / best[WAYS[0]]:.2f} of one process")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Measures the formats of frames (craftfleet-actor --frames): bytes on the network, CPU time, and speed over a slow link.

The learner, an actor and an environment server have a host each (network namespaces on a bridge). For each format, prints

- the bytes a step that the server's and the actor's cables carry towards the actor and the learner, headers included, by day
  and by night: all lanes begin their first episode together, and night falls after some 180 steps;
- the CPU time a step of each process;
- the steps per second with cables of 100 Mbit/s, and of those without a limit.

  tests/bench/fleet/frames_bench.py --bin=build/bin                     as root; some minutes
"""

import argparse
import json
import os
import pathlib
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet import Fleet  # noqa: E402
from fleet_bench import rate_of, wall_time_of_iterations  # noqa: E402
from netns import Host, Network, run, why_not  # noqa: E402

LANES, FRAGMENT = 128, 32
STEPS_OF_AN_ITERATION = LANES * FRAGMENT
CONFIG = """steps: {steps} seed: 1 lanes: 128 fragment_steps: 32 overlap: {overlap} ppo {{ rollout_steps: 4096 epochs: {epochs} }}
  eval {{ every_steps: 0 final_episodes: 0 }}"""
DAY, NIGHT = range(2, 5), range(7, 9)  # iterations: steps 32 to 128 of an episode, and 192 to 256
FORMATS = ["raw", "scene"]


class PlainHost(Host):
    """A host without a proxy."""

    def reached_at(self, address):
        return address


class ThreeHosts(Network):
    """The hosts of the learner, the server and the actor, without faults."""

    def __init__(self, slow):
        self.remove_leftovers()
        self.prefix = f"{self.PREFIX}{os.getpid()}-"
        self.switch = self.prefix + "switch"
        self.hosts = [PlainHost(f"{self.prefix}{i}", i, 0, 0) for i in range(3)]
        self.lay_cables()
        for host in self.hosts if slow else []:
            self.slow_down(host)

    def sent(self, host):
        """The bytes that a host has sent so far."""
        return json.loads(run("ip", "-n", host.name, "-s", "-j", "link", "show", "eth0"))[0]["stats64"]["tx"]["bytes"]


def observe(network, fleet):
    """Bytes sent by the server's and the actor's host, and CPU seconds of learner, server and actor."""
    return [network.sent(network.hosts[1]), network.sent(network.hosts[2]),
            *[worker.cpu_seconds() for worker in [fleet.learner, *fleet.workers]]]


def train(options, frames, slow, folder):
    """Returns steps per second, and what was observed after each iteration."""
    config, logdir = folder / "config.txt", folder / "run"
    config.write_text(CONFIG.format(steps=STEPS_OF_AN_ITERATION * options.iterations, epochs=options.epochs,
                                    overlap=int(options.overlap)), encoding="utf-8")
    network = ThreeHosts(slow)
    learner_host, server_host, actor_host = network.hosts
    try:
        # `ip netns exec` becomes the program that it starts, so a worker's process is the program.
        fleet = Fleet(options.bin, folder, config, logdir, learner_host, [server_host], actors=1, servers=1,
                      flags={"actor": [f"--frames={frames}"]}, actor_sites=[actor_host])
        observed = {}
        try:
            while fleet.learner.process.poll() is None:
                times = wall_time_of_iterations(logdir)
                if times and len(times) not in observed:
                    observed[len(times)] = observe(network, fleet)
                time.sleep(0.02)
        finally:
            fleet.stop()
        if fleet.learner.process.returncode != 0:
            sys.exit(f"the learner failed:\n{pathlib.Path(fleet.learner.log).read_text(encoding='utf-8')}")
        ends = list(wall_time_of_iterations(logdir).values())
        return rate_of([end - begin for begin, end in zip(ends, ends[1:])]), observed
    finally:
        network.remove()


def a_step(observed, iterations):
    """What was observed, for each step of some iterations."""
    steps = STEPS_OF_AN_ITERATION * len(iterations)
    begin, end = observed[iterations[0] - 1], observed[iterations[-1]]
    return [(after - before) / steps for before, after in zip(begin, end)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--iterations", type=int, default=10, help="of 4,096 steps, a run; at least 9")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=1, help="of an update")
    parser.add_argument("--overlap", action="store_true", help="play while the learner updates")
    parser.add_argument("--formats", type=lambda text: text.split(","), default=FORMATS, help="some of raw,scene")
    options = parser.parse_args()
    if (missing := why_not()) is not None:
        sys.exit(missing)
    for number in range(options.rounds):
        # The order rotates, since other load on the machine may drift.
        first = number % len(options.formats)
        for frames in options.formats[first:] + options.formats[:first]:
            rates = {}
            for slow in [False, True]:
                with tempfile.TemporaryDirectory(prefix="frames_bench-") as folder:
                    rates[slow], observed = train(options, frames, slow, pathlib.Path(folder))
                if not slow:
                    day, night, whole = (a_step(observed, part) for part in [DAY, NIGHT, range(2, options.iterations)])
            print(f"round {number + 1}, {frames}: bytes a step by day {day[0]:.0f} to the actor, {day[1]:.0f} to the learner; by night "
                  f"{night[0]:.0f}, {night[1]:.0f}; us of CPU a step: learner {1e6 * whole[2]:.0f}, server {1e6 * whole[3]:.0f}, "
                  f"actor {1e6 * whole[4]:.0f}; {rates[False]:.0f} steps/s, with 100 Mbit/s {rates[True]:.0f}: "
                  f"{rates[True] / rates[False]:.2f}", flush=True)


if __name__ == "__main__":
    main()

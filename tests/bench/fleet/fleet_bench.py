#!/usr/bin/env python3
"""Experiments with fleets on one host, in environment steps per second from the first iteration to the last.

  fleet_bench.py processes --bin=build/bin    one process, and processes over TCP and over Unix sockets: what these cost
  fleet_bench.py overlap --bin=build/bin      the learner on one core, an actor and a server on the other, with and without
                                              --overlap=1: what that gains
  fleet_bench.py staleness --bin=build/bin    four actors, each on its own server: undisturbed, one stopped for 5 s of every
                                              10 s, a server ten times slower; synchronous and with max_staleness 2
  fleet_bench.py ranks --bin=build/bin        the update rate of two learners, each on its own core, against one

Runs are in pairs, or rounds, whose order rotates, since other load on the machine may drift; ratios are within a round.
"""

import argparse
import os
import pathlib
import re
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet import Fleet, Site, Worker  # noqa: E402

STEPS_OF_AN_ITERATION = 4096
CONFIG = """steps: {steps} seed: 1 agent: "{agent}" {more} ppo {{ epochs: {epochs} minibatch_size: {minibatch} }}
  eval {{ every_steps: 0 final_episodes: 0 }}"""
# What is stopped, for how many seconds at a time, and how many seconds it runs in between.
DISTURBANCES = {"undisturbed": None, "a stopped actor": ("actor0", 5, 5), "a slow server": ("server0", 0.018, 0.002)}


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


def pin(worker, core):
    """All threads of a process, those that it has started already too."""
    for thread in pathlib.Path(f"/proc/{worker.process.pid}/task").iterdir():
        os.sched_setaffinity(int(thread.name), {core})


def metrics(address):
    """The learner's iteration and the seconds that it has spent on updates; nothing while it does not answer."""
    try:
        with urllib.request.urlopen(f"http://{address}/metrics", timeout=30) as answer:
            text = answer.read().decode()
    except OSError:
        return None
    updates = re.search(r'craftfleet_activity_seconds_total{activity="update",[^}]*} (\S+)', text)
    return int(re.search(r"craftfleet_iteration{[^}]*} (\d+)", text)[1]), float(updates[1]) if updates else 0.0


def train(options, start, more="", epochs=4, watch=lambda fleet: None):
    """Trains once, with what `start(config, logdir, folder)` starts: a Fleet, or None if it has trained by itself. Calls `watch`
    again and again. Returns the rate."""
    with tempfile.TemporaryDirectory(prefix="fleet_bench-") as name:
        folder = pathlib.Path(name)
        config, logdir = folder / "config.txt", folder / "run"
        config.write_text(CONFIG.format(steps=STEPS_OF_AN_ITERATION * options.iterations, agent=options.agent, more=more, epochs=epochs,
                                        minibatch=options.minibatch), encoding="utf-8")
        fleet = start(config, logdir, folder)
        try:
            while fleet and fleet.learner.process.poll() is None:
                watch(fleet)
                time.sleep(0.2)
        finally:
            if fleet:
                fleet.stop()
        if fleet and fleet.learner.process.returncode != 0:
            sys.exit(f"the learner failed:\n{pathlib.Path(fleet.learner.log).read_text(encoding='utf-8')}")
        ends = list(wall_time_of_iterations(logdir).values())
        return STEPS_OF_AN_ITERATION * (len(ends) - 1) / (ends[-1] - ends[0])


def fleet(options, site, actors=1, servers=1, **more):
    def start(config, logdir, folder):
        place = site or SocketSite(folder)
        return Fleet(options.bin, folder, config, logdir, place, [place], actors, servers, **more)
    return start


def rounds(options, what, runs, unit="steps/s"):
    """Makes each of `runs`, name -> function that returns a rate, in each round; prints rates and ratios to the first."""
    rates, names = {name: [] for name in runs}, list(runs)
    for number in range(options.rounds):
        for name in names[number % len(names):] + names[:number % len(names)]:
            rates[name].append(runs[name]())
            print(f"{what}round {number + 1}, {name}: {rates[name][-1]:.4g} {unit}", flush=True)
    for name in names[1:]:
        ratios = [rate / base for rate, base in zip(rates[name], rates[names[0]])]
        print(f"{what}{name}: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}) of {names[0]}", flush=True)


def processes(options):
    def one_process(config, logdir, folder):
        with open(folder / "train.log", "wb") as log:
            subprocess.run([pathlib.Path(options.bin) / "craftfleet", "train", f"--config={config}", f"--logdir={logdir}"],
                           stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=True)

    rounds(options, "", {"one process": lambda: train(options, one_process),
                         "TCP": lambda: train(options, fleet(options, Site(), threads=0)),
                         "Unix sockets": lambda: train(options, fleet(options, None, threads=0))})


def overlap(options):
    def start(*arguments):
        started = fleet(options, Site())(*arguments)
        for worker in started.all():
            pin(worker, options.cores[0 if worker is started.learner else 1])
        return started

    for epochs in [1, 4]:
        rounds(options, f"{epochs} epochs, ", {name: lambda of=of: train(options, start, f"overlap: {of}", epochs)
                                               for of, name in enumerate(["synchronous", "overlapped"])})


def staleness(options):
    def disturbed(max_staleness, disturbance):
        ending, begun = threading.Event(), []

        def disturb(worker, stopped_s, running_s):
            while not ending.wait(running_s):
                worker.pause()
                ending.wait(stopped_s)
                worker.wake()

        def watch(running):
            if disturbance and not begun and running.iteration() >= 1:
                worker = next(worker for worker in running.workers if worker.name == disturbance[0])
                begun.append(threading.Thread(target=disturb, args=(worker, *disturbance[1:])))
                begun[0].start()

        try:
            return train(options, fleet(options, Site(), 4, 4, own_servers=True), f"fragment_steps: 64 max_staleness: {max_staleness}",
                         watch=watch)
        finally:
            ending.set()

    for max_staleness in [0, 2]:
        rounds(options, f"max_staleness {max_staleness}, ",
               {name: lambda how=how: disturbed(max_staleness, how) for name, how in DISTURBANCES.items()})


def ranks(options):
    def update_rate(learners):
        seconds = {}  # that were spent on updates when each iteration had ended
        listen, port = Site().listen(), Site().listen().rsplit(":", 1)[1]
        flags = [f"--world_size={learners}", f"--master_port={port}"]

        def start(config, logdir, folder):
            started = fleet(options, Site(), flags={"learner": [*flags, "--rank=0", f"--metrics_listen={listen}"]})(config, logdir, folder)
            for rank in range(1, learners):
                started.workers.append(Worker(f"rank{rank}", [pathlib.Path(options.bin) / "craftfleet-learner", *flags, f"--rank={rank}",
                                                              "--threads=1"], folder / f"rank{rank}.log"))
            return started

        def watch(running):
            seen = metrics(listen)
            if seen and seen[0] not in seconds:
                seconds[seen[0]] = seen[1]
                if seen[0] == 1:  # loading and the canary are over
                    for worker, core in zip([running.learner, *running.workers[2:]], options.cores):
                        pin(worker, core)

        train(options, start, "gradient_shards: 2", watch=watch)
        last = max(seconds)
        return (last - 1) / (seconds[last] - seconds[1])

    rounds(options, "", {"one learner": lambda: update_rate(1), "two learners": lambda: update_rate(2)}, "updates/s")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    experiments = {"processes": processes, "overlap": overlap, "staleness": staleness, "ranks": ranks}
    parser.add_argument("experiment", choices=experiments)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--agent", default="ppo_cnn")
    parser.add_argument("--minibatch", type=int, default=128)
    parser.add_argument("--iterations", type=int, default=10, help="of 4,096 steps, a run")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cores", type=int, nargs=2, default=[0, 1], help="of the learner and the others, or of two learners")
    options = parser.parse_args()
    experiments[options.experiment](options)


if __name__ == "__main__":
    main()

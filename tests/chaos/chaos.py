#!/usr/bin/env python3
"""Trains with a fleet whose processes are continually killed, restarted and paused, and compares the result with that of an
undisturbed run.

First a single process trains undisturbed. Then a learner, actors and environment servers train the same run, while workers
and the learner are killed (SIGKILL) and restarted, and one worker at a time is paused (SIGSTOP). At the end logs,
evaluations and weights of both runs must be identical; no iteration may have taken more than a minute; no process may have
ended on its own, or grown by more than a MiB per minute after its second minute, which with --spare some live to see. Long
forms append their figures to tests/chaos/results/runs.jsonl.

  tests/chaos/chaos.py --bin=build/bin --out=/tmp/chaos                        49 iterations, ten minutes
  tests/chaos/chaos.py --bin=build/bin --out=/tmp/chaos --spare                three times as many; the learner, an actor and
                                                                               a server are not killed, to observe their memory
  tests/chaos/chaos.py --bin=build/bin --out=/tmp/chaos --short                the short form that the tests run
"""

import argparse
import json
import math
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import time

from fleet import Fleet, Memory, Site, Watch
from results import record

LONG_CONFIG = """steps: {steps} seed: 5 lanes: 16 checkpoint {{ every_iterations: 2 }}
  eval {{ every_steps: 50000 episodes: 5 final_episodes: 5 }}"""
LONG_STEPS = 49 * 4096
SPARING_STEPS = 3 * LONG_STEPS  # a heap reaches its full size within minutes; then memory should stop growing
SHORT_CONFIG = """steps: 16384 seed: 5 lanes: 16 fragment_steps: 32 env { length: 90 }
  ppo { rollout_steps: 1024 minibatch_size: 128 epochs: 2 } checkpoint { every_iterations: 2 }
  eval { every_steps: 4096 episodes: 2 final_episodes: 2 }"""
LONG_PACE = {"kill": 2, "learner": 60, "pause": 30}  # seconds between events of a kind
SHORT_PACE = {"kill": 3, "learner": 25, "pause": 14}
SHORT_CHAOS_S = 60  # no more events after that: on a busy machine workers that are killed all the time make no progress
COMPARED = ["stats.jsonl", "eval_argmax.jsonl", "eval_sampled.jsonl", "final_argmax.jsonl", "final_sampled.jsonl"]
COMPARED_OF_CHECKPOINT = ["weights.safetensors", "optimizer.safetensors"]
SLOWEST_ITERATION_S = 60
GROWTH_LIMIT_KIB_PER_MINUTE = 1024
MISSED_SHARE = 0.1  # most of the scheduled events that may be missing


class Chaos:
    """Kills and pauses processes. The seed and the seconds since the start determine which process and when. Subclasses add
    kinds of events: methods with the names in `pace`."""

    judges_growth = True  # whether a process that grows is a failure

    def __init__(self, fleet, seed, pace, pause_s, spare=False):
        self.fleet, self.pace, self.pause_s, self.spare = fleet, pace, pause_s, spare
        self.random = random.Random(seed)
        self.next = dict(pace)
        self.counts = dict.fromkeys(pace, 0)
        self.endings = []  # (time, action) that ends an event
        self.deaths = []   # processes that ended on their own
        self.since = 0
        self.lasts = math.inf  # seconds

    def act(self, since):
        """Triggers the events that are due `since` seconds after the start."""
        self.since = since
        for ending in [ending for ending in self.endings if ending[0] <= since]:
            self.endings.remove(ending)
            ending[1]()
        for worker in self.fleet.workers:
            if worker.process.poll() is not None:
                if worker.process.returncode != 0:
                    self.deaths.append(f"{worker.name} ended with {worker.process.returncode}: see {worker.log}")
                worker.start()
        for event, every in self.pace.items():
            if self.next[event] <= min(since, self.lasts):
                self.next[event] += every
                self.counts[event] += 1
                getattr(self, event)()

    def kill(self):
        spared = [self.fleet.workers[0], self.fleet.workers[-1]] if self.spare else []
        self.random.choice([w for w in self.fleet.workers if not w.paused and w not in spared]).restart()

    def learner(self):
        if self.fleet.learner.process.poll() is not None:
            return  # the run has ended
        if "--autoresume" not in self.fleet.learner.command:
            self.fleet.learner.command.append("--autoresume")  # it may be killed before there is a run
        self.fleet.learner.restart()

    def pause(self):
        worker = self.random.choice([w for w in self.fleet.workers if not w.paused])
        worker.pause()
        self.endings.append((self.since + self.pause_s, worker.wake))

    def figures(self):
        """A summary of the events."""
        return {"events": self.counts}

    def failures(self, since):
        """The processes that ended on their own, and the kinds of events that were too rare in `since` seconds."""
        since = min(since, self.lasts)
        fewest = {event: max(since > (1 + MISSED_SHARE) * every, (1 - MISSED_SHARE) * since / every - 1)
                  for event, every in self.pace.items()}
        return self.deaths + [f"only {self.counts[event]} times {event} in {since:.0f} s, want one every {every} s"
                for event, every in self.pace.items() if self.counts[event] < fewest[event]]


def train_quietly(options, config, logdir):
    command = [pathlib.Path(options.bin) / "craftfleet", "train", f"--config={config}", f"--logdir={logdir}"]
    with open(pathlib.Path(options.out) / "quiet.log", "wb") as log:
        subprocess.run(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=True)


def train_in_chaos(fleet, chaos, patience):
    """Trains to the end. Returns figures and failures."""
    start = printed = time.monotonic()
    memory, watch = Memory(), Watch(fleet)
    try:
        while fleet.learner.process.poll() is None:
            now = time.monotonic()
            if now - start > patience:
                return {}, [f"not over after {patience} s; iteration {watch.iteration}"]
            chaos.act(now - start)
            for worker in fleet.all():
                memory.note(worker, now)
            if now - printed > 10:
                printed = now
                print(f"{now - start:6.0f} s, iteration {watch.iteration}, {chaos.counts}", flush=True)
            time.sleep(0.2)
    finally:
        watch.stop()
    took, growth = time.monotonic() - start, memory.growth()
    figures = {"seconds": round(took), **chaos.figures(), "slowest_iteration_s": round(watch.slowest, 1),
               "growth_kib_per_minute": growth}
    failures = chaos.failures(took)
    if fleet.learner.process.returncode != 0:
        failures.append(f"the learner failed: see {fleet.learner.log}")
    return figures, failures


def limits_passed(figures, judges_growth):
    """Iterations that took too long and processes that grew. Not checked in the short form, which runs beside other tests."""
    failures = []
    if figures.get("slowest_iteration_s", 0) > SLOWEST_ITERATION_S:
        failures.append(f"an iteration took {figures['slowest_iteration_s']} s, want at most {SLOWEST_ITERATION_S}")
    if not judges_growth:
        return failures
    return failures + [f"{name} grows by {slope} KiB a minute, want at most {GROWTH_LIMIT_KIB_PER_MINUTE}"
                       for name, slope in figures.get("growth_kib_per_minute", {}).items() if slope > GROWTH_LIMIT_KIB_PER_MINUTE]


def newest_checkpoint(logdir):
    return max((logdir / "checkpoints").glob("iter-*"), default=None)


def differences(quiet, chaotic):
    def same(one, other):
        return one.exists() == other.exists() and (not one.exists() or one.read_bytes() == other.read_bytes())

    differing = [f"{name} differs" for name in COMPARED if not same(quiet / name, chaotic / name)]
    one, other = newest_checkpoint(quiet), newest_checkpoint(chaotic)
    if one is None or other is None or one.name != other.name:
        return differing + [f"the last checkpoint is {other}, want one like {one}"]
    return differing + [f"{name} differs" for name in COMPARED_OF_CHECKPOINT if not same(one / name, other / name)]


def empty_folder(name):
    shutil.rmtree(name, ignore_errors=True)
    folder = pathlib.Path(name)
    folder.mkdir(parents=True)
    return folder


def compare(options, config_text, make_fleet, make_chaos):
    """Runs the undisturbed run, then the same with a disturbed fleet, and prints the result. Returns the exit code.

    `make_fleet(config, logdir)` starts a fleet; `make_chaos(fleet)` makes the Chaos that disturbs it."""
    out = empty_folder(options.out)
    config = out / "config.txt"
    config.write_text(config_text, encoding="utf-8")
    train_quietly(options, config, out / "quiet")
    print("the undisturbed run is complete; now the same with disturbances", flush=True)
    fleet = make_fleet(config, out / "chaos")
    try:
        chaos = make_chaos(fleet)
        if options.short:
            chaos.lasts = SHORT_CHAOS_S
        figures, failures = train_in_chaos(fleet, chaos, options.patience)
    finally:
        fleet.stop()
    failures += differences(out / "quiet", out / "chaos")
    if not options.short:
        failures += limits_passed(figures, chaos.judges_growth)
    print(json.dumps(figures))
    print("FAILED: " + "; ".join(failures) if failures else "the same bytes as the undisturbed run")
    if not options.short:
        record(options.bin, figures, failures)
    return 1 if failures else 0


def arguments(description):
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--out", required=True, help="folder for runs and logs; replaced")
    parser.add_argument("--seed", type=int, default=1, help="of the chaos")
    parser.add_argument("--actors", type=int, default=4)
    parser.add_argument("--servers", type=int, default=4)
    parser.add_argument("--short", action="store_true", help="a small run, everything sooner")
    parser.add_argument("--patience", type=int, default=7200, help="time limit in seconds")
    return parser


def end_cleanly_when_stopped():
    """On Ctrl-C or SIGTERM the program stops its processes and ends; further signals are ignored."""
    def stop(*_):
        for number in [signal.SIGINT, signal.SIGTERM]:
            signal.signal(number, signal.SIG_IGN)
        sys.exit("stopped")

    for number in [signal.SIGINT, signal.SIGTERM]:
        signal.signal(number, stop)


def main():
    parser = arguments(__doc__)
    parser.add_argument("--spare", action="store_true", help="never kill the learner, the last actor, the first server")
    options = parser.parse_args()
    end_cleanly_when_stopped()
    pace = dict(SHORT_PACE if options.short else LONG_PACE)
    if options.spare:
        del pace["learner"]
    here = Site()
    long_config = LONG_CONFIG.format(steps=SPARING_STEPS if options.spare else LONG_STEPS)
    return compare(options, SHORT_CONFIG if options.short else long_config,
                   lambda config, logdir: Fleet(options.bin, options.out, config, logdir, here, [here],
                                                options.actors, options.servers),
                   lambda fleet: Chaos(fleet, options.seed, pace, 7 if options.short else 15, options.spare))


if __name__ == "__main__":
    sys.exit(main())

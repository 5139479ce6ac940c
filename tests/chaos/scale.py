#!/usr/bin/env python3
"""One learner with many lanes, actors and environment servers over real connections; the actors send made-up fragments.

Checks that shares are fair (the most fragments of an actor divided by the fewest are below 1.2, where there are as many lanes
as actors), that the status service answers within 50 ms, that the learner's threads follow the cores and not the actors (at
most 64), that its memory stays below 1.5 GB and does not grow (less than 1 MiB per minute after the second minute) and, where
actors take time to play, that the median time to a verdict on a fragment is at most 5 ms. The simulated workers have a lower
priority than the learner (nice 10). The long form appends its figures to tests/chaos/results/runs.jsonl.

  tests/chaos/scale.py --bin=build/bin --out=/tmp/scale             200 actors, 1,000 lanes, 10 minutes
  tests/chaos/scale.py --bin=build/bin --out=/tmp/scale --short     the short form that the tests run
  tests/chaos/scale.py --bin=build/bin --out=/tmp/scale --actors=10000 --servers=5000 --lanes=4000 --share=10 --play_ms=20000
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import time

from chaos import GROWTH_LIMIT_KIB_PER_MINUTE, empty_folder, end_cleanly_when_stopped
from fleet import Fleet, Memory, Site
from results import record

# The shortest possible fragments, so that there are many.
CONFIG = """steps: 1000000000 lanes: {lanes} fragment_steps: 4
  network {{ frame_size: 36 }} ppo {{ rollout_steps: {rollout} minibatch_size: 100 epochs: 1 }}
  eval {{ every_steps: 0 final_episodes: 0 }}"""
START_S = 60
FAIR_RATIO = 1.2
STATUS_LIMIT_MS = 50
THREADS_LIMIT = 64
VERDICT_LIMIT_MS = 5
MEMORY_LIMIT_KIB = 1_500_000


def start(options, program, *flags, nice=0):
    """Starts a program in this session: among sessions Linux shares the cores out evenly, whatever their nice values."""
    return subprocess.Popen([pathlib.Path(options.bin) / program, *flags, f"--seconds={options.seconds}"],
                            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True,
                            preexec_fn=lambda: os.nice(nice))


def run(options, fleet):
    """Starts the actors. Returns figures and failures."""
    give_up = time.monotonic() + START_S
    while fleet.iteration() < 0:
        if time.monotonic() > give_up or fleet.learner.process.poll() is not None:
            return {}, [f"the learner did not start: see {fleet.learner.log}"]
        time.sleep(0.2)
    # Real workers would have cores of their own.
    bots = start(options, "simulated_fleet", f"--learner={fleet.learner_address}", f"--actors={options.actors}",
                 f"--servers={options.servers}", f"--share={options.share}", f"--play_ms={options.play_ms}", nice=10)
    # A separate process; within that of the actors the probe would measure how busy they are.
    probe = start(options, "simulated_fleet", "--probe", f"--learner={fleet.learner_address}")
    memory, threads = Memory(), 0
    try:
        while bots.poll() is None:
            threads = max(threads, fleet.learner.threads())
            memory.note(fleet.learner, time.monotonic())
            time.sleep(0.5)
        shares = json.loads(bots.communicate()[0] or "{}")
        status_ms = json.loads(probe.communicate(timeout=15)[0] or "{}")
    finally:
        for process in [bots, probe]:
            process.kill()
            process.wait()
    if bots.returncode != 0 or probe.returncode != 0:
        return {}, [f"simulated_fleet ended with {bots.returncode}, its probe with {probe.returncode}"]
    growth = memory.growth().get("learner")
    figures = {**shares, "status_ms": status_ms, "iterations": fleet.iteration(),
               "learner_resident_kib": fleet.learner.resident_kib(), "learner_peak_kib": fleet.learner.peak_kib(),
               "learner_cpu_s": round(fleet.learner.cpu_seconds(), 1),
               "learner_threads": threads, "growth_kib_per_minute": growth}
    failures = []
    if figures["failed"] > 0:
        failures.append(f"{figures['failed']} actors failed")
    # When the actors stop, some have already played their share of the current iteration.
    most = figures["most_fragments"] - options.lanes // options.actors
    if options.lanes >= options.actors and most >= FAIR_RATIO * figures["fewest_fragments"]:
        failures.append(f"shares of {figures['fewest_fragments']} to {figures['most_fragments']} fragments")
    # The short form runs beside other tests, which may delay a single answer.
    slow_ms = figures["status_ms"]["median" if options.short else "p99"]
    if slow_ms >= STATUS_LIMIT_MS:
        failures.append(f"the status is answered after {slow_ms} ms, want {STATUS_LIMIT_MS}")
    if threads > THREADS_LIMIT:
        failures.append(f"the learner has {threads} threads, want at most {THREADS_LIMIT}")
    if options.play_ms and figures["verdict_ms"]["median"] > VERDICT_LIMIT_MS:
        failures.append(f"verdicts take {figures['verdict_ms']['median']} ms, want {VERDICT_LIMIT_MS}")
    if figures["learner_peak_kib"] > MEMORY_LIMIT_KIB:
        failures.append(f"the learner takes {figures['learner_peak_kib']} KiB, want at most {MEMORY_LIMIT_KIB}")
    if growth is not None and growth > GROWTH_LIMIT_KIB_PER_MINUTE:
        failures.append(f"the learner grows by {growth} KiB a minute, want at most {GROWTH_LIMIT_KIB_PER_MINUTE}")
    if growth is None and not options.short:
        failures.append("it was over before memory could be watched")
    return figures, failures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--out", required=True, help="folder for the run and logs; replaced")
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--actors", type=int, default=200)
    parser.add_argument("--servers", type=int, default=0)
    parser.add_argument("--lanes", type=int, default=1000)
    parser.add_argument("--share", type=int, default=1, help="workers on one connection")
    parser.add_argument("--play_ms", type=int, default=0, help="mean time to play a fragment")
    parser.add_argument("--keep", action="store_true", help="do not append the figures to the results")
    parser.add_argument("--short", action="store_true", help="40 actors, 200 lanes, 15 s")
    options = parser.parse_args()
    if options.short:
        options.seconds, options.actors, options.lanes = 15, 40, 200
    end_cleanly_when_stopped()
    config = empty_folder(options.out) / "config.txt"
    config.write_text(CONFIG.format(lanes=options.lanes, rollout=4 * options.lanes), encoding="utf-8")
    here = Site()
    fleet = Fleet(options.bin, options.out, config, pathlib.Path(options.out) / "run", here, [])
    try:
        figures, failures = run(options, fleet)
    finally:
        fleet.stop()
    print(json.dumps(figures))
    print("FAILED: " + "; ".join(failures) if failures else "fair shares, quick answers, bounded memory")
    if not (options.short or options.keep):
        record(options.bin, figures, failures)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())

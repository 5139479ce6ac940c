#!/usr/bin/env python3
"""Trains with a fleet whose processes are killed, restarted and paused all the time, and compares with a quiet run.

First one process trains undisturbed. Then a learner, actors and environment servers train the same run as processes,
while workers are killed (SIGKILL) and restarted, the learner too, and one worker at a time is paused (SIGSTOP). At the
end logs, evaluations and weights of both runs must be the same bytes, no iteration may have taken more than a minute,
and no process may have grown.

  tests/chaos/chaos.py --bin=build/bin --out=/tmp/chaos                        49 iterations, half an hour
  tests/chaos/chaos.py --bin=build/bin --out=/tmp/chaos --short                the short form that the tests run
"""

import argparse
import json
import os
import pathlib
import random
import shutil
import signal
import socket
import subprocess
import sys
import time

LONG_CONFIG = """steps: 200704 seed: 5 lanes: 16 checkpoint { every_iterations: 2 }
  eval { every_steps: 50000 episodes: 5 final_episodes: 5 }"""
SHORT_CONFIG = """steps: 16384 seed: 5 lanes: 16 fragment_steps: 32 env { length: 90 }
  ppo { rollout_steps: 1024 minibatch_size: 128 epochs: 2 } checkpoint { every_iterations: 2 }
  eval { every_steps: 4096 episodes: 2 final_episodes: 2 }"""
COMPARED = ["stats.jsonl", "eval_argmax.jsonl", "eval_sampled.jsonl", "final_argmax.jsonl", "final_sampled.jsonl"]
SLOWEST_ITERATION_S = 60
WARM_UP_S = 120
GROWTH_LIMIT_KIB_PER_MINUTE = 1024


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Worker:
    """A process that is started again with the same command whenever it was killed."""

    def __init__(self, name, command, log):
        self.name, self.command, self.log = name, command, log
        self.process, self.paused_until, self.rss = None, None, []
        self.start()

    def start(self):
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(self.command, stdout=log, stderr=log)
        self.rss = []

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.paused_until = None

    def stop(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(15)
            except subprocess.TimeoutExpired:
                self.kill()

    def note_memory(self, now):
        try:
            status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        except OSError:
            return
        for line in status.splitlines():
            if line.startswith("VmRSS:"):
                self.rss.append((now, int(line.split()[1])))

    def growth_kib_per_minute(self, life_start):
        """Slope of resident memory after the warm-up; None if it did not live long enough to tell."""
        points = [(t, kib) for t, kib in self.rss if t - life_start >= WARM_UP_S]
        if len(points) < 2 or points[-1][0] - points[0][0] < 60:
            return None
        return (points[-1][1] - points[0][1]) / (points[-1][0] - points[0][0]) * 60


class Fleet:
    """Learner, actors and environment servers on loopback."""

    def __init__(self, options, config, logdir):
        self.bin, self.out = pathlib.Path(options.bin), pathlib.Path(options.out)
        self.learner_address = f"127.0.0.1:{free_port()}"
        learner = [self.bin / "craftfleet-learner", f"--config={config}", f"--logdir={logdir}",
                   f"--listen={self.learner_address}", "--threads=1"]
        self.learner = Worker("learner", learner, self.out / "learner.log")
        self.workers = []
        for i in range(options.servers):
            command = [self.bin / "craftfleet-envserver", f"--listen=127.0.0.1:{free_port()}",
                       f"--learner={self.learner_address}"]
            self.workers.append(Worker(f"server{i}", command, self.out / f"server{i}.log"))
        for i in range(options.actors):
            command = [self.bin / "craftfleet-actor", f"--learner={self.learner_address}", "--envservers=learner",
                       "--threads=1"]
            self.workers.append(Worker(f"actor{i}", command, self.out / f"actor{i}.log"))

    def iteration(self):
        """What the learner says, -1 while it says nothing."""
        command = [self.bin / "craftfleet-status", f"--address={self.learner_address}", "--json"]
        result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        if result.returncode != 0:
            return -1
        metrics = {metric["name"]: metric["value"] for metric in json.loads(result.stdout)["metrics"]}
        return int(metrics["iteration"])

    def all(self):
        return [self.learner] + self.workers

    def stop(self):
        for worker in self.workers + [self.learner]:
            worker.stop()


class Chaos:
    """Who is killed or paused when: follows from the seed and the seconds since the start."""

    def __init__(self, options):
        self.random = random.Random(options.seed)
        short = options.short
        self.every = {"kill": 3, "learner": 25, "pause": 14} if short else {"kill": 2, "learner": 60, "pause": 30}
        self.pause_s = 7 if short else 15
        self.next = dict(self.every)
        self.counts = {"kill": 0, "learner": 0, "pause": 0}

    def act(self, fleet, since):
        for worker in fleet.workers:
            if worker.paused_until is not None and since >= worker.paused_until:
                worker.process.send_signal(signal.SIGCONT)
                worker.paused_until = None
            if worker.process.poll() is not None:
                worker.start()
        for event, every in self.every.items():
            if since < self.next[event]:
                continue
            self.next[event] += every
            self.counts[event] += 1
            if event == "learner":
                fleet.learner.kill()
                if "--resume" not in fleet.learner.command:
                    fleet.learner.command.append("--resume")
                fleet.learner.start()
                continue
            worker = self.random.choice([w for w in fleet.workers if w.paused_until is None])
            if event == "kill":
                worker.kill()
                worker.start()
            else:
                worker.process.send_signal(signal.SIGSTOP)
                worker.paused_until = since + self.pause_s


def train_quietly(options, config, logdir):
    command = [pathlib.Path(options.bin) / "craftfleet-train", f"--config={config}", f"--logdir={logdir}"]
    with open(pathlib.Path(options.out) / "quiet.log", "wb") as log:
        subprocess.run(command, stdout=log, stderr=log, check=True)


def train_in_chaos(options, config, logdir):
    """Returns what was done, the slowest iteration and the growth of each process that lived long enough."""
    fleet = Fleet(options, config, logdir)
    chaos = Chaos(options)
    start = time.monotonic()
    iteration, changed, slowest, said = 0, start, 0.0, start
    growth = {}
    lives = {worker.name: (worker.process.pid, start) for worker in fleet.all()}
    try:
        while fleet.learner.process.poll() is None:
            now = time.monotonic()
            if now - start > options.patience:
                sys.exit(f"not over after {options.patience} s; iteration {iteration}")
            chaos.act(fleet, now - start)
            latest = fleet.iteration()
            if latest > iteration:
                slowest, iteration, changed = max(slowest, now - changed), latest, now
            for worker in fleet.all():
                if lives[worker.name][0] != worker.process.pid:
                    lives[worker.name] = (worker.process.pid, now)
                worker.note_memory(now)
                slope = worker.growth_kib_per_minute(lives[worker.name][1])
                if slope is not None:
                    growth[f"{worker.name}, process {worker.process.pid}"] = slope
            if now - said > 10:
                said = now
                print(f"{now - start:6.0f} s, iteration {iteration}, {chaos.counts}", flush=True)
            time.sleep(0.2)
        if fleet.learner.process.returncode != 0:
            sys.exit(f"the learner failed: see {fleet.learner.log}")
    finally:
        fleet.stop()
    return chaos.counts, max(slowest, time.monotonic() - changed), growth


def newest_checkpoint(logdir):
    return sorted((logdir / "checkpoints").glob("iter-*"))[-1]


def differences(quiet, chaotic):
    names = [name for name in COMPARED if (quiet / name).read_bytes() != (chaotic / name).read_bytes()]
    one, other = newest_checkpoint(quiet), newest_checkpoint(chaotic)
    for name in ["weights.safetensors", "optimizer.safetensors"]:
        if one.name != other.name or (one / name).read_bytes() != (other / name).read_bytes():
            names.append(name)
    return names


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--out", required=True, help="folder for runs and logs; replaced")
    parser.add_argument("--seed", type=int, default=1, help="of the chaos")
    parser.add_argument("--actors", type=int, default=4)
    parser.add_argument("--servers", type=int, default=4)
    parser.add_argument("--short", action="store_true", help="16 small iterations, everything sooner")
    parser.add_argument("--patience", type=int, default=7200, help="seconds until it is given up")
    options = parser.parse_args()

    out = pathlib.Path(options.out)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    config = out / "config.txt"
    config.write_text(SHORT_CONFIG if options.short else LONG_CONFIG, encoding="utf-8")
    train_quietly(options, config, out / "quiet")
    print("the quiet run is complete; now the same in chaos", flush=True)
    counts, slowest, growth = train_in_chaos(options, config, out / "chaos")

    failures = [f"{name} differs" for name in differences(out / "quiet", out / "chaos")]
    if slowest > SLOWEST_ITERATION_S:
        failures.append(f"an iteration took {slowest:.0f} s, want at most {SLOWEST_ITERATION_S}")
    for name, slope in growth.items():
        if slope > GROWTH_LIMIT_KIB_PER_MINUTE:
            failures.append(f"{name} grows by {slope:.0f} KiB a minute")
    print(f"{counts['kill']} workers killed, {counts['learner']} times the learner, {counts['pause']} workers paused; "
          f"slowest iteration {slowest:.1f} s; fastest growth after two minutes "
          f"{max(growth.values(), default=0):.0f} KiB a minute over {len(growth)} processes")
    print("FAILED: " + "; ".join(failures) if failures else "the same bytes as the quiet run")
    return 1 if failures else 0


if __name__ == "__main__":
    os.setpgrp()
    sys.exit(main())

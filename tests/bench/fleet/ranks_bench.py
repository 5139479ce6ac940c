#!/usr/bin/env python3
"""Measures what a second learner gains: two learners, each on a core of its own, against one on one core.

Trains the same run in pairs, with one learner and with two. An actor and an environment server share the cores: they wait
while the learners update. Prints the seconds of an update, with everything that the ranks exchange, and the ratio of the
rates of each pair; and the same of CPU time, which other load disturbs less but which lacks what learners wait for each other.

  tests/bench/fleet/ranks_bench.py --bin=build/bin                       three pairs of five iterations, some minutes
"""

import argparse
import os
import pathlib
import re
import statistics
import sys
import tempfile
import time
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet import Fleet, Site, Worker  # noqa: E402
from fleet_bench import STEPS_OF_AN_ITERATION  # noqa: E402

LANES = 16  # with --rollout
CONFIG = """steps: {steps} seed: 1 agent: "{agent}" gradient_shards: 2
  {lanes} ppo {{ rollout_steps: {rollout} epochs: {epochs} minibatch_size: {minibatch} }} eval {{ every_steps: 0 final_episodes: 0 }}"""


def update_seconds(address):
    """The learner's iteration and the seconds that it has spent on updates; nothing while it does not answer. From its metrics,
    which cost it a millisecond: a status program would take the cores from the learners."""
    try:
        with urllib.request.urlopen(f"http://{address}/metrics", timeout=30) as answer:
            text = answer.read().decode()
    except OSError:
        return None
    updates = re.search(r'craftfleet_activity_seconds_total{activity="update",[^}]*} (\S+)', text)
    return int(re.search(r"craftfleet_iteration{[^}]*} (\d+)", text)[1]), float(updates[1]) if updates else 0.0


def pin(worker, cores):
    """All threads of a process, those that it has started already too."""
    for thread in pathlib.Path(f"/proc/{worker.process.pid}/task").iterdir():
        os.sched_setaffinity(int(thread.name), cores)


def train(options, learners, folder):
    """Returns the seconds of an update, and the CPU seconds of the busiest learner in an iteration: means over all iterations
    but the first."""
    config, logdir = folder / "config.txt", folder / "run"
    # One iteration more: the learner must still answer when the last one has ended.
    is_default = options.rollout == STEPS_OF_AN_ITERATION  # then lanes and fragments are the agent's own
    lanes = "" if is_default else f"lanes: {LANES} fragment_steps: {options.rollout // LANES}"
    config.write_text(CONFIG.format(steps=options.rollout * (options.iterations + 1), agent=options.agent, lanes=lanes,
                                    rollout=options.rollout, epochs=options.epochs, minibatch=options.minibatch),
                      encoding="utf-8")
    port = Site().listen().rsplit(":", 1)[1]
    metrics = Site().listen()
    ranks = [f"--world_size={learners}", f"--master_port={port}"]
    fleet = Fleet(options.bin, folder, config, logdir, Site(), [Site()], actors=1, servers=1, threads=1,
                  flags={"learner": [*ranks, "--rank=0", f"--metrics_listen={metrics}"]})
    others = [Worker(f"rank{rank}", [pathlib.Path(options.bin) / "craftfleet-learner", *ranks, f"--rank={rank}", "--threads=1"],
                     folder / f"rank{rank}.log") for rank in range(1, learners)]
    done, used = {}, {}  # when each iteration had ended, seen while the learner waits for the next one's steps
    try:
        while fleet.learner.process.poll() is None:
            time.sleep(0.2)
            seen = update_seconds(metrics)
            if seen is not None and seen[0] not in done:
                done[seen[0]] = seen[1]
                used[seen[0]] = [worker.cpu_seconds() for worker in [fleet.learner, *others]]
                if seen[0] == 1:  # loading and the canary are over
                    for worker, core in zip([fleet.learner, *others], options.cores):
                        pin(worker, {core})
    finally:
        fleet.stop()
        for worker in others:
            worker.ask_to_stop()
            worker.wait()
    if fleet.learner.process.returncode != 0:
        sys.exit(f"the learner failed:\n{pathlib.Path(fleet.learner.log).read_text(encoding='utf-8')}")
    last, count = options.iterations, options.iterations - 1
    return (done[last] - done[1]) / count, max(end - begin for begin, end in zip(used[1], used[last])) / count


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--agent", default="ppo_cnn")
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--minibatch", type=int, default=128)
    parser.add_argument("--iterations", type=int, default=5, help="of a run")
    parser.add_argument("--rollout", type=int, default=STEPS_OF_AN_ITERATION, help="steps of an iteration: fewer for large agents")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cores", type=int, nargs=2, default=[0, 1], help="of the learners")
    options = parser.parse_args()
    ratios = []
    for number in range(options.rounds):
        seconds, cpu = {}, {}
        # The order rotates, since other load on the machine may drift.
        for learners in ([1, 2] if number % 2 == 0 else [2, 1]):
            with tempfile.TemporaryDirectory(prefix="ranks_bench-") as folder:
                seconds[learners], cpu[learners] = train(options, learners, pathlib.Path(folder))
        ratios.append(seconds[1] / seconds[2])
        print(f"pair {number + 1}: an update takes {seconds[1]:.2f} s, with two learners {seconds[2]:.2f} s: {ratios[-1]:.2f}; "
              f"an iteration {cpu[1]:.2f} s of a learner's CPU time, with two learners {cpu[2]:.2f} s: {cpu[1] / cpu[2]:.2f}",
              flush=True)
    print(f"two learners give {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}) times the update rate of one")


if __name__ == "__main__":
    main()

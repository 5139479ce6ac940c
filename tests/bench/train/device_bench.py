#!/usr/bin/env python3
"""Measures how fast each agent trains in one process on a device, and whether two equal runs give equal weights.

Trains each agent for some iterations in each precision: all agents in the first one, then all in the next, the most telling
first, until --limit is over. Prints environment steps per second (of the median iteration, the
first one not counted) and, on an NVIDIA GPU, the most memory and the mean utilisation of the whole GPU. With --repeat each
run is made twice. A line of JSON is added to --out after each run, whose log is kept in --logs. Needs Python alone, so that it can run beside a wheel.

  tests/bench/train/device_bench.py --bin=build/bin --device=cuda --precisions=FP32,TF32,BF16 --out=gpu.jsonl
  tests/bench/train/device_bench.py --bin=build/bin --agents=ppo_cnn --iterations=4 --repeat          on the CPU
"""

import argparse
import hashlib
import itertools
import json
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "fleet"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "chaos"))
from fleet_bench import STEPS_OF_AN_ITERATION, wall_time_of_iterations  # noqa: E402

AGENTS = ["ppo_cnn", "oc_sa", "lstm_cnn", "ppo_spcnn", "oc_ca", "lstm_spcnn", "ppo_resnet", "achievement_distillation",
          "grid_distillation", "cnn_distillation"]
CONFIG = """agent: "{agent}" seed: 1 steps: {steps} {precision} checkpoint {{ every_iterations: 1000 }}
  eval {{ every_steps: 0 final_episodes: 0 }} {more}"""


class GpuWatch:
    """Asks NVIDIA's driver every half second until it is stopped; without nvidia-smi it knows nothing."""

    def __init__(self, device):
        self.memory_mib, self.utilisation = [], []
        self.query = ["nvidia-smi", f"--id={device.partition(':')[2] or 0}", "--query-gpu=memory.used,utilization.gpu",
                      "--format=csv,noheader,nounits"]
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self.watch)
        if device.startswith("cuda") and shutil.which("nvidia-smi"):
            self.thread.start()

    def watch(self):
        while not self.stopped.wait(0.5):
            answer = subprocess.run(self.query, capture_output=True, text=True, check=False).stdout.split(",")
            if len(answer) == 2:
                self.memory_mib.append(int(answer[0]))
                self.utilisation.append(int(answer[1]))

    def stop(self):
        self.stopped.set()
        if self.thread.is_alive():
            self.thread.join()
        if not self.memory_mib:
            return {}
        return {"gpu_memory_mib": max(self.memory_mib), "gpu_utilisation": round(statistics.mean(self.utilisation))}


def train(options, agent, precision, folder, limit):
    """Returns what one run of at most `limit` seconds shows; an `error` if it failed."""
    config, logdir = folder / "config.txt", folder / "run"
    config.write_text(CONFIG.format(agent=agent, steps=STEPS_OF_AN_ITERATION * options.iterations, more=options.config,
                                    precision=f"precision: {precision}" if precision else ""), encoding="utf-8")
    watch = GpuWatch(options.device)
    command = ([pathlib.Path(options.bin) / "craftfleet", "train", f"--device={options.device}",
                          f"--threads={options.threads}", f"--config={config}", f"--logdir={logdir}"])
    with (options.logs or folder).joinpath(f"{agent}-{precision or 'default'}.log").open("w+", encoding="utf-8") as log:
        try:
            code = subprocess.run(command, stdout=log, stderr=log, timeout=limit, check=False).returncode
            failure = f"exit code {code}"
        except subprocess.TimeoutExpired:
            code, failure = None, f"not ready after {limit:.0f} s"
        log.seek(0)
        lines = log.read().strip().splitlines()
    result = {"agent": agent, "precision": precision, "device": options.device, "iterations": options.iterations,
              "threads": options.threads, "config": options.config, **watch.stop()}
    if code != 0:
        return {**result, "error": f"{failure}: {lines[-1]}" if lines else failure}
    ends = list(wall_time_of_iterations(logdir).values())
    seconds = [end - begin for begin, end in zip(ends, ends[1:])]
    result["seconds"] = [round(value, 3) for value in seconds]
    result["steps_per_second"] = round(STEPS_OF_AN_ITERATION / statistics.median(seconds), 1)
    weights = max((logdir / "checkpoints").glob("*/weights.safetensors"))
    result["weights"] = hashlib.sha256(weights.read_bytes()).hexdigest()[:16]
    return result


def line_of(result):
    text = f"{result['agent']:26}{result['precision'] or 'default':>9}  "
    if "error" in result:
        return text + result["error"]
    text += f"{result['steps_per_second']:>9} steps/s, 1M steps in {1e6 / result['steps_per_second'] / 60:.1f} minutes"
    if "gpu_memory_mib" in result:
        text += f"; GPU {result['gpu_utilisation']}% busy, {result['gpu_memory_mib']} MiB"
    return text


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--device", default="cpu", help="cpu, cuda or cuda:N")
    parser.add_argument("--agents", default=",".join(AGENTS), help="joined by commas [all of the paper, and three more]")
    parser.add_argument("--precisions", default="", help="joined by commas [the configuration's]")
    parser.add_argument("--iterations", type=int, default=6, help="of 4,096 steps, a run; at least 2")
    parser.add_argument("--threads", type=int, default=0, help="of a run; 0: as many as there are cores")
    parser.add_argument("--config", default="", help="more fields of the configuration, such as 'lanes: 64'")
    parser.add_argument("--repeat", action="store_true", help="make each run twice and compare the weights")
    parser.add_argument("--run_limit", type=float, default=600, help="seconds of one run")
    parser.add_argument("--limit", type=float, default=86400, help="seconds of all runs; none begins later")
    parser.add_argument("--logs", type=pathlib.Path, help="folder that keeps the log of each run [none]")
    parser.add_argument("--out", type=pathlib.Path, help="file that gets a line of JSON after each run")
    options = parser.parse_args()
    if options.iterations < 2:
        parser.error(f"--iterations={options.iterations}, want 2 or more, since the first is not counted")
    is_good = True
    end = time.monotonic() + options.limit
    if options.logs:
        options.logs.mkdir(parents=True, exist_ok=True)
    for precision, agent in itertools.product(options.precisions.split(","), options.agents.split(",")):
        results = []
        for _ in range(2 if options.repeat else 1):
            limit = min(options.run_limit, end - time.monotonic())
            if limit < 1:
                print(f"{agent:26}{precision or 'default':>9}  left out: --limit={options.limit:g} s are over", flush=True)
                break
            with tempfile.TemporaryDirectory(prefix="device_bench-") as folder:
                results.append(train(options, agent, precision, pathlib.Path(folder), limit))
            print(line_of(results[-1]), flush=True)
            if options.out:
                with options.out.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(results[-1]) + "\n")
        is_good = is_good and not any("error" in result for result in results)
        if len({result.get("weights") for result in results}) > 1:
            is_good = False
            print(f"{agent}: the weights of two equal runs differ")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())

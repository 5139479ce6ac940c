#!/usr/bin/env python3
"""Makes the runs of this folder: make.py BIN TEXTURES OUT, with BIN the folder of version 0.1's programs (a74ad1c).

Each is killed within an iteration, so that its journal holds fragments; then a copy is resumed by the same programs and
what they come to is written down beside it. README.md says what is what.
"""

import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time

CONFIG = """agent: "{agent}" steps: 384 lanes: 2 seed: 7 fragment_steps: 4
env {{ length: 24 }} network {{ frame_size: 36 }}
ppo {{ rollout_steps: 64 minibatch_size: 32 epochs: 1 }}
checkpoint {{ every_iterations: 1 keep: 1 keep_fragments: true }}
eval {{ every_steps: 100 episodes: 1 final_episodes: 2 }}
"""
LOGS = ["stats.jsonl", "eval_argmax.jsonl", "eval_sampled.jsonl", "final_argmax.jsonl", "final_sampled.jsonl"]
LAST = "checkpoints/iter-00000006"
# Of a journal with some fragments of the 16 of an iteration: with all of them it may be the last one's.
JOURNAL_BYTES = range(40_000, 240_000)


def cpu():
    """What decides which loops BLAS and LibTorch choose, as tests/hostile/old_runs_test.cc has it."""
    fields = dict(re.findall(r"^(vendor_id|cpu family|model|flags)\s*: (.*)$", open("/proc/cpuinfo").read(), re.M))
    flags = fields["flags"].split()
    features = [f for f in ("avx2", "fma", "avx512f", "avx512bw", "avx512_vnni", "avx512_bf16") if f in flags]
    return " ".join([fields["vendor_id"], fields["cpu family"], fields["model"], *features])


def play_until_killed(bin_, textures, agent, iteration, run):
    """A fleet whose learner is killed early in the iteration after `iteration`."""
    config = run + "-config.txt"
    with open(config, "w") as file:
        file.write(CONFIG.format(agent=agent))
    fleet = []

    def start(program, *arguments):
        fleet.append(subprocess.Popen([os.path.join(bin_, program), *arguments],
                                      stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True))
        for line in fleet[-1].stderr:
            if match := re.search(r"listening on (\S+)", line):
                return match.group(1).rstrip(";,")
        raise RuntimeError(program + " does not listen")

    learner = start("craftfleet-learner", "--config=" + config, "--logdir=" + run, "--listen=127.0.0.1:0",
                    "--textures=" + textures)
    server = start("craftfleet-envserver", "--listen=127.0.0.1:0", "--textures=" + textures)
    fleet.append(subprocess.Popen([os.path.join(bin_, "craftfleet-actor"), "--learner=" + learner,
                                   "--envservers=" + server, "--threads=1"], stderr=subprocess.DEVNULL))
    checkpoint = os.path.join(run, "checkpoints", f"iter-{iteration:08}")
    journal = os.path.join(run, "fragments.journal")
    while fleet[0].poll() is None and not (os.path.exists(checkpoint) and os.path.getsize(journal) in JOURNAL_BYTES):
        time.sleep(0)
    for process in fleet:
        process.send_signal(signal.SIGKILL)
        process.wait()
    os.remove(config)


def tensor_sums(path):
    """A line a tensor: name, numbers in it, their sum, the sum of their squares."""
    data = open(path, "rb").read()
    (head,) = struct.unpack("<Q", data[:8])
    lines = []
    for name, tensor in sorted(json.loads(data[8:8 + head]).items()):
        if name == "__metadata__":
            continue
        begin, end = (8 + head + offset for offset in tensor["data_offsets"])
        numbers = struct.unpack(f"<{(end - begin) // 4}f", data[begin:end])
        lines.append(f"{name} {len(numbers)} {sum(numbers):.9g} {sum(n * n for n in numbers):.9g}\n")
    return "".join(lines)


def main(bin_, textures, out):
    for agent, iteration in (("ppo_cnn", 4), ("lstm_cnn", 3)):
        folder = os.path.join(out, agent)
        shutil.rmtree(folder, ignore_errors=True)
        run, copy = os.path.join(folder, "run"), os.path.join(folder, "copy")
        os.makedirs(folder)
        play_until_killed(bin_, textures, agent, iteration, run)
        os.remove(os.path.join(run, "lock"))
        for name in os.listdir(os.path.join(run, "checkpoints")):
            if name != f"iter-{iteration:08}":  # the best one: of no use here
                shutil.rmtree(os.path.join(run, "checkpoints", name))
        shutil.copytree(run, copy)
        subprocess.run([os.path.join(bin_, "craftfleet-eval"), "--checkpoint=" + copy, "--textures=" + textures,
                        "--episodes=3", "--json=" + os.path.join(folder, "eval.json")], check=True)
        subprocess.run([os.path.join(bin_, "craftfleet-train"), "--resume", "--logdir=" + copy,
                        "--textures=" + textures], check=True)
        for name in LOGS:
            shutil.copy(os.path.join(copy, name), os.path.join(folder, name))
        weights = os.path.join(copy, LAST, "weights.safetensors")
        with open(os.path.join(folder, "weights.txt"), "w") as file:
            file.write(tensor_sums(weights))
        with open(os.path.join(folder, "manifest.txt"), "w") as file:
            file.write(cpu() + "\n")
            for line in open(os.path.join(copy, LAST, "MANIFEST")):
                if line.startswith(("weights.", "optimizer.")):
                    file.write(line)
        shutil.rmtree(copy)


if __name__ == "__main__":
    main(*sys.argv[1:])

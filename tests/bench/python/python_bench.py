#!/usr/bin/env python3
"""How many steps a second the Python package plays on one core, beside the original.

Usage: python_bench.py [--seconds=S] [--rounds=N] [--envserver=PROGRAM]
  --seconds=S          CPU time of each measurement, default 3
  --rounds=N           measurements of each, in turn, default 5
  --envserver=PROGRAM  also RemoteVectorEnv over loopback, with this craftfleet-envserver

Needs the packages craftfleet and crafter 1.8.3; for RemoteVectorEnv also grpcio and protobuf. All play random actions with the
original's textures, resets included. This process and the server share one core, to which they are pinned. Prints the steps per
second of CPU time in each round, the server's time included, and their ratios to the original in the same round: median, lowest and
highest.
"""

import argparse
import os
import pathlib
import platform
import re
import statistics
import subprocess
import time

import crafter
import craftfleet
import numpy as np

LANES = 64
ACTIONS = np.random.default_rng(0).integers(17, size=(1000, LANES))


def single(env):
  """Plays the interface of crafter.Env; yields after each step."""
  env.reset()
  while True:
    for action in ACTIONS[:, 0].tolist():
      if env.step(action)[2]:
        env.reset()
      yield 1


def vector(envs):
  envs.reset(seed=0)
  while True:
    for actions in ACTIONS:
      envs.step(actions)
      yield LANES


def serve(program):
  """Starts an environment server; returns its process and address."""
  textures = pathlib.Path(crafter.__file__).parent / "assets"
  server = subprocess.Popen(
      [program, "--listen=127.0.0.1:0", f"--textures={textures}"], stderr=subprocess.PIPE, text=True, encoding="utf-8")
  for line in server.stderr:
    if listening := re.search(r"listening on (\S+)", line):
      return server, listening[1]
  raise SystemExit(f"{program}: exit code {server.wait()}")


def cpu_time(server):
  """Seconds of this process and the server."""
  used = time.process_time()
  if server is not None:
    user_and_system = pathlib.Path(f"/proc/{server.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    used += sum(map(int, user_and_system)) / os.sysconf("SC_CLK_TCK")
  return used


def rate(steps, seconds, server):
  """Steps per second of CPU time."""
  begin = time.process_time()
  begin_with_server = cpu_time(server)
  played = 0
  while time.process_time() - begin < seconds:
    played += next(steps)
  return played / (cpu_time(server) - begin_with_server)


def cpu():
  with open("/proc/cpuinfo", encoding="utf-8") as lines:
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def measure(games, server, seconds, rounds):
  """Prints the steps per second of each game in each round; returns them."""
  rates = {name: [] for name in games}
  for number in range(rounds):
    for name, steps in games.items():
      rates[name].append(rate(steps, seconds, server))
    print(f"round {number + 1}: " + ", ".join(f"{name} {found[-1]:,.0f} steps/s" for name, found in rates.items()), flush=True)
  return rates


def main():
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--seconds", type=float, default=3)
  parser.add_argument("--rounds", type=int, default=5)
  parser.add_argument("--envserver", metavar="PROGRAM")
  arguments = parser.parse_args()
  os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # what this process starts inherits it
  games = {
      "crafter.Env": single(crafter.Env(seed=0)),
      "craftfleet.Env": single(craftfleet.Env(seed=0, textures="crafter")),
      f"craftfleet.VectorEnv({LANES})": vector(craftfleet.VectorEnv(LANES, textures="crafter", copy=False)),
  }
  server = None
  if arguments.envserver:
    server, address = serve(arguments.envserver)
    games[f"craftfleet.RemoteVectorEnv({LANES})"] = vector(craftfleet.RemoteVectorEnv(address, LANES))
  print(f"{cpu()}, Python {platform.python_version()}, NumPy {np.__version__}")
  try:
    rates = measure(games, server, arguments.seconds, arguments.rounds)
  finally:
    if server is not None:
      server.kill()
  original = rates.pop("crafter.Env")
  for name, found in rates.items():
    ratios = [ours / theirs for ours, theirs in zip(found, original)]
    print(f"{name}: {statistics.median(ratios):.0f} times the original ({min(ratios):.0f} to {max(ratios):.0f})")


if __name__ == "__main__":
  main()

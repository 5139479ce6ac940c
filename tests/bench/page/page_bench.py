#!/usr/bin/env python3
"""The cost of the live page: a learner trains while browsers watch it, as many as --clients.

Each client asks for what the page asks for, as often, over one connection. The cost is the CPU time of the thread that serves the
page, in percent of one core and of the process's CPU time.

  tests/bench/page/page_bench.py --clients=20 --seconds=60
"""

import argparse
import hashlib
import http.client
import os
import pathlib
import re
import ssl
import subprocess
import sys
import tempfile
import threading
import time

SOURCE = pathlib.Path(__file__).resolve().parents[3]
POLL_S = 2
TOKEN = "bench"


class Client(threading.Thread):
  """A browser that shows the page."""

  def __init__(self, port, tls, stop):
    super().__init__()
    self.port, self.tls, self.stop = port, tls, stop
    self.requests, self.bytes, self.failures = 0, 0, 0
    self.connection = None

  def connect(self):
    if not self.tls:
      return http.client.HTTPConnection("localhost", self.port, timeout=10)
    context = ssl._create_unverified_context()  # pylint: disable=protected-access
    return http.client.HTTPSConnection("localhost", self.port, context=context, timeout=10)

  def get(self, path, **headers):
    try:
      self.connection = self.connection or self.connect()
      self.connection.request("GET", path, headers={"Authorization": f"Bearer {TOKEN}", **headers})
      reply = self.connection.getresponse()
      body = reply.read()
    except (OSError, http.client.HTTPException):
      self.connection = None
      self.failures += 1
      return None, {}
    self.requests += 1
    self.bytes += len(body)
    return reply.status, reply.headers

  def run(self):
    tag = ""
    while not self.stop.wait(POLL_S):
      self.get("/status.json")
      status, headers = self.get("/curves.json", **({"If-None-Match": tag} if tag else {}))
      if status == 200:
        tag = headers["ETag"]
        self.get("/frame.png")


def cpu_seconds(pid, threads=None):
  """CPU time of a process, or of its threads of that name."""
  total = 0
  for task in pathlib.Path(f"/proc/{pid}/task").iterdir():
    try:
      name, rest = re.match(r"\d+ \((.*)\) (.*)", (task / "stat").read_text(), re.S).groups()
    except OSError:
      continue
    if threads is None or name.startswith(threads):
      fields = rest.split()
      total += int(fields[11]) + int(fields[12])
  return total / os.sysconf("SC_CLK_TCK")


def start(arguments, folder):
  """Starts a run; returns it and its page's port."""
  command = [arguments.bin / "craftfleet", "train", f"--logdir={folder}/run", "--steps=100000000", "--http_listen=127.0.0.1:0"]
  if arguments.tls:
    subprocess.run([SOURCE / "deploy/make-certs.sh", f"{folder}/certs", "learner"], check=True, capture_output=True)
    digest = hashlib.sha256(TOKEN.encode()).hexdigest()
    pathlib.Path(folder, "access.txt").write_text(f'client {{ name: "bench" token_sha256: "{digest}" right: WATCH }}')
    command += [f"--tls_cert={folder}/certs/learner.pem", f"--tls_key={folder}/certs/learner.key", f"--access_file={folder}/access.txt"]
  process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
  for line in process.stderr:
    if found := re.search(r"live page on \S+:(\d+)/", line):
      threading.Thread(target=process.stderr.read, daemon=True).start()
      return process, int(found[1])
  sys.exit("the learner has ended")


def main():
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--bin", type=pathlib.Path, default=SOURCE / "build/bin")
  parser.add_argument("--clients", type=int, default=20)
  parser.add_argument("--seconds", type=float, default=60)
  parser.add_argument("--tls", action="store_true")
  arguments = parser.parse_args()
  with tempfile.TemporaryDirectory() as folder:
    process, port = start(arguments, folder)
    stop = threading.Event()
    clients = [Client(port, arguments.tls, stop) for _ in range(arguments.clients)]
    try:
      time.sleep(5)
      for client in clients:
        client.start()
      before = cpu_seconds(process.pid), cpu_seconds(process.pid, "MHD")
      time.sleep(arguments.seconds)
      spent, served = cpu_seconds(process.pid) - before[0], cpu_seconds(process.pid, "MHD") - before[1]
    finally:
      stop.set()
      for client in clients:
        client.join()
      process.terminate()
      process.wait()
  requests, failures = sum(client.requests for client in clients), sum(client.failures for client in clients)
  print(f"{arguments.clients} clients, {'TLS' if arguments.tls else 'no TLS'}, {arguments.seconds:.0f} s: {requests} requests, "
        f"{sum(client.bytes for client in clients) / 2**20:.1f} MiB, {failures} failed")
  print(f"CPU time of the page {served:.2f} s: {100 * served / arguments.seconds:.2f}% of a core, "
        f"{100 * served / spent:.2f}% of the process's {spent:.1f} s")


if __name__ == "__main__":
  main()

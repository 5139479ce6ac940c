"""A fleet of real processes that a test can kill, pause and watch: on this machine, or spread over several hosts."""

import json
import os
import pathlib
import signal
import socket
import statistics
import subprocess
import threading
import time

WARM_UP_S = 120
WATCHED_S = 180


class Site:
    """A host of processes and its addresses. This one is the local machine with its loopback addresses."""

    command_prefix = []  # prepended to every command on this host
    flags = []           # of every process that listens on this host

    def listen(self):
        """A new address, HOST:PORT, to listen on."""
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return f"127.0.0.1:{probe.getsockname()[1]}"

    def reached_at(self, address):
        """The address at which other hosts reach a process that listens on `address`."""
        return address


class Worker:
    """A process that is restarted with the same command after it was killed."""

    def __init__(self, name, command, log, address=None):
        """`address`: the address on which it listens, if any."""
        self.name, self.command, self.log, self.address = name, [str(part) for part in command], log, address
        self.process, self.started, self.paused = None, 0, False
        self.start()

    def start(self):
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self.started, self.paused = time.monotonic(), False

    def restart(self):
        self.process.kill()
        self.process.wait()
        self.start()

    def pause(self):
        self.process.send_signal(signal.SIGSTOP)
        self.paused = True

    def wake(self):
        if self.paused:
            self.process.send_signal(signal.SIGCONT)
            self.paused = False

    def ask_to_stop(self):
        if self.process.poll() is None:
            self.wake()
            self.process.terminate()

    def wait(self):
        """Stops the process and waits for its end; sends SIGKILL after 15 s."""
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def resident_kib(self):
        """The resident memory. None if the process has ended."""
        return self._memory_kib("VmRSS:")

    def peak_kib(self):
        """The highest resident memory of the process so far. None if it has ended."""
        return self._memory_kib("VmHWM:")

    def threads(self):
        """The number of threads. 0 if the process has ended."""
        try:
            return len(list(pathlib.Path(f"/proc/{self.process.pid}/task").iterdir()))
        except OSError:
            return 0

    def cpu_seconds(self):
        """The CPU time of all threads so far. 0 if the process has ended."""
        try:
            stat = pathlib.Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8")
        except OSError:
            return 0
        user, system = stat.rsplit(") ", 1)[1].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    def _memory_kib(self, field):
        try:
            status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        except OSError:
            return None
        return next((int(line.split()[1]) for line in status.splitlines() if line.startswith(field)), None)


class Fleet:
    """A learner on `learner_site`, with environment servers and actors distributed over `sites`. Logs are in the folder `out`.

    `flags`: additional flags by role: learner, server, actor, and status,
    for the queries to the learner. `own_servers`: each actor plays on the environment server of its number alone, not on all
    of them."""

    def __init__(self, bin_folder, out, config, logdir, learner_site, sites, actors=0, servers=0,
                 threads=1, flags=None, own_servers=False):
        self.bin, out = pathlib.Path(bin_folder), pathlib.Path(out)
        self.flags = {"learner": [], "server": [], "actor": [], "status": [], **(flags or {})}
        self.learner_site, self.learner_address = learner_site, learner_site.listen()
        reached = learner_site.reached_at(self.learner_address)
        learner = [*learner_site.command_prefix, self.bin / "craftfleet-learner", f"--config={config}",
                   f"--logdir={logdir}", f"--listen={self.learner_address}", f"--threads={threads}", *learner_site.flags,
                   *self.flags["learner"]]
        self.learner = Worker("learner", learner, out / "learner.log", self.learner_address)
        self.workers = []
        try:
            for i in range(servers):
                site = sites[i % len(sites)]
                listen = site.listen()
                command = [*site.command_prefix, self.bin / "craftfleet-envserver", f"--listen={listen}",
                           f"--advertise={site.reached_at(listen)}", f"--learner={reached}", *site.flags,
                           *self.flags["server"]]
                self.workers.append(Worker(f"server{i}", command, out / f"server{i}.log", listen))
            for i in range(actors):
                site = sites[i % len(sites)]
                games = site.reached_at(self.workers[i].address) if own_servers else "learner"
                command = [*site.command_prefix, self.bin / "craftfleet-actor", f"--learner={reached}",
                           f"--envservers={games}", f"--threads={threads}", *self.flags["actor"]]
                self.workers.append(Worker(f"actor{i}", command, out / f"actor{i}.log"))
        except BaseException:
            self.stop()
            raise

    def iteration(self):
        """The iteration that the learner reports; -1 while it does not answer."""
        command = [*self.learner_site.command_prefix, self.bin / "craftfleet", "status",
                   f"--address={self.learner_address}", "--json", *self.flags["status"]]
        result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        if result.returncode != 0:
            return -1
        metrics = {metric["name"]: metric["value"] for metric in json.loads(result.stdout)["metrics"]}
        return int(metrics["iteration"])

    def all(self):
        return [self.learner] + self.workers

    def stop(self):
        for worker in self.all():
            worker.ask_to_stop()
        for worker in self.all():
            worker.wait()


class Watch:
    """Queries the learner's iteration repeatedly, on its own thread, so that a slow answer delays nothing else."""

    def __init__(self, fleet):
        self.fleet, self.iteration, self.changed, self.slowest = fleet, 0, time.monotonic(), 0.0
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        while not self.stopping.wait(1):
            latest = self.fleet.iteration()
            if latest > self.iteration:
                now = time.monotonic()
                self.slowest, self.iteration, self.changed = max(self.slowest, now - self.changed), latest, now

    def stop(self):
        """Also counts the time from the last iteration to the end of the run."""
        self.stopping.set()
        self.thread.join()
        self.slowest = max(self.slowest, time.monotonic() - self.changed)


class Memory:
    """The growth of the resident memory of processes that live long, after their second minute."""

    def __init__(self):
        self.samples = {}  # by name and start: seconds and KiB

    def note(self, worker, now):
        kib = worker.resident_kib()
        if kib is not None and now - worker.started > WARM_UP_S:
            self.samples.setdefault((worker.name, worker.started), []).append((now, kib))

    def growth(self):
        """KiB a minute by name, of processes that were watched for long enough."""
        long = {name: samples for (name, _), samples in self.samples.items() if samples[-1][0] - samples[0][0] > WATCHED_S}
        return {name: round(60 * statistics.linear_regression(*zip(*samples)).slope) for name, samples in long.items()}

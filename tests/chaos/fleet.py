"""A fleet of real processes that a test can kill, pause and watch: on this machine, or spread over several hosts."""

import json
import math
import pathlib
import signal
import socket
import statistics
import subprocess
import threading
import time
import typing

WARM_UP_S = 120
YOUNG_S = 4  # before that a process is still loading
OBSERVATION_S = 10  # of an old process
FEWEST_OBSERVATIONS = 15


class Site:
    """Where processes run and how others reach them: here, this machine's loopback."""

    command_prefix = []  # of every command that is run here
    flags = []           # of every process that listens here

    def listen(self):
        """An address, HOST:PORT, for one more process to listen on."""
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return f"127.0.0.1:{probe.getsockname()[1]}"

    def reached_at(self, address):
        """The address at which others find what listens on `address`."""
        return address


class Worker:
    """A process that is started again with the same command whenever it was killed."""

    def __init__(self, name, command, log, address=None):
        """`address`: where it listens, if it does."""
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
        """Until it has stopped; SIGKILL after 15 s."""
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def resident_kib(self):
        """None if it is gone."""
        try:
            status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        except OSError:
            return None
        return next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS:")), None)


class Fleet:
    """A learner on `learner_site`; environment servers and actors dealt out over `sites`. Logs go to the folder `out`.

    `flags`: more of them by role: learner, server, actor, and status, which asks the learner."""

    def __init__(self, bin_folder, out, config, logdir, learner_site, sites, actors=0, servers=0,
                 threads=1, flags=None):
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
                command = [*site.command_prefix, self.bin / "craftfleet-actor", f"--learner={reached}",
                           "--envservers=learner", f"--threads={threads}", *self.flags["actor"]]
                self.workers.append(Worker(f"actor{i}", command, out / f"actor{i}.log"))
        except BaseException:
            self.stop()
            raise

    def iteration(self):
        """What the learner says, -1 while it says nothing."""
        command = [*self.learner_site.command_prefix, self.bin / "craftfleet-status",
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
    """Asks the learner for its iteration, again and again, on a thread of its own: a slow answer holds up nothing else."""

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
        """Also counts the time since the last iteration, in which the run ended."""
        self.stopping.set()
        self.thread.join()
        self.slowest = max(self.slowest, time.monotonic() - self.changed)


class Memory:
    """How the resident memory of each process grows after the second minute of the test, be it killed and started anew all
    the time."""

    def __init__(self, start):
        self.start, self.samples = start, {}  # by name, by class of age: time, KiB, observation

    def note(self, worker, now):
        kib, age, since = worker.resident_kib(), now - worker.started, now - self.start
        if kib is None or age < YOUNG_S or since < WARM_UP_S:
            return
        # A process that lives for a moment is one observation, an old one another every ten seconds.
        observed = (worker.started, 0 if age < WARM_UP_S else int(age / OBSERVATION_S))
        self.samples.setdefault(worker.name, {}).setdefault(age_class(age), []).append((since, kib, observed))

    def growth(self):
        """Growth by name, of those observed often enough: of what is older than two minutes, where there is any."""
        growths = {}
        for name, classes in self.samples.items():
            old = [classes.get(age_class(WARM_UP_S), [])]
            if observations(old) >= FEWEST_OBSERVATIONS:
                growths[name] = Growth(*common_slope(old), old=True)
            elif observations(classes.values()) >= FEWEST_OBSERVATIONS:
                growths[name] = Growth(*common_slope(classes.values()), old=False)
        return growths


class Growth(typing.NamedTuple):
    """KiB a minute. `error` is three times the standard error; `old` says that the processes were older than two minutes."""
    slope: int
    error: int
    old: bool

    def above(self, limit):
        """An old process has no excuse; of those killed all the time each has another part of the games."""
        return self.slope - (0 if self.old else self.error) > limit


def age_class(age):
    """A power of two of seconds, one class from two minutes on."""
    return int(min(age, WARM_UP_S)).bit_length()


def observations(classes):
    return len({observed for samples in classes for _, _, observed in samples})


def common_slope(classes):
    """Slope, KiB a minute, and three times its standard error. Samples are only compared with others of their class: memory
    may depend on how old a process is, but not on how long the run goes on."""
    points = []  # time and kib less the means of their class; observation
    for samples in classes:
        mean_t, mean_kib = (statistics.fmean(sample[k] for sample in samples) for k in range(2))
        points += [(t - mean_t, kib - mean_kib, observed) for t, kib, observed in samples]
    square = sum(t ** 2 for t, _, _ in points)
    slope = sum(t * kib for t, kib, _ in points) / square
    pulls = {}  # of each observation on the slope: they are independent, its samples are not
    for t, kib, observed in points:
        pulls[observed] = pulls.get(observed, 0) + t * (kib - slope * t)
    error = math.sqrt(sum(pull ** 2 for pull in pulls.values())) / square
    return round(60 * slope), round(180 * error)

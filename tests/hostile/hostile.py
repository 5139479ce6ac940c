#!/usr/bin/env python3
"""Trains with a fleet among misbehaving peers, and compares the result with that of an undisturbed run.

First a single process trains undisturbed. Then a learner, actors and environment servers train the same run. Workers and
the learner are killed (SIGKILL) and restarted, while peers of all three roles join and leave that are silent, slow (a byte
per second; a reply after half a minute or 0.3 s), lying or flooding. A bad learner gets its own actor and server, which must
survive it. At the end logs, evaluations and weights of both runs must be identical; no iteration may have taken more than
a minute; no process may have ended on its own or exceeded its memory bound (MEMORY_BOUND_MIB). The growth of memory is
recorded with its error, but not checked. Long forms append their figures to tests/chaos/results/runs.jsonl.

  tests/hostile/hostile.py --bin=build/bin --out=/tmp/hostile           some ten minutes
  tests/hostile/hostile.py --bin=build/bin --out=/tmp/hostile --tls     the same with TLS and rights
  tests/hostile/hostile.py --bin=build/bin --out=/tmp/hostile --short   the short form that the tests run
"""

import pathlib
import socket
import subprocess
import sys
import threading

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "chaos"))

# pylint: disable=wrong-import-position
from chaos import LONG_CONFIG, LONG_STEPS, Chaos, arguments, compare, end_cleanly_when_stopped
from fleet import Fleet, Site, Worker

SHORT_CONFIG = """steps: 10240 seed: 5 lanes: 16 fragment_steps: 32 env { length: 90 }
  network { frame_size: 36 } ppo { rollout_steps: 1024 minibatch_size: 128 epochs: 2 } checkpoint { every_iterations: 2 }
  eval { every_steps: 4096 episodes: 2 final_episodes: 2 }"""
LONG_PACE = {"bad_peer": 5, "kill": 10, "learner": 60}  # seconds from one to the next
SHORT_PACE = {"bad_peer": 2, "kill": 10}
STAYS_S = {False: 20, True: 5}  # lifetime of a bad peer; the key is whether this is the short form
MEMORY_BOUND_MIB = {"learner": 1536, "actor": 1024, "server": 1024}
DRIPS = 20  # connections that send a byte a second
PEERS = [("actor", "silent"), ("actor", "lying"), ("actor", "flooding"), ("actor", "slow"),
         ("envserver", "silent"), ("envserver", "lying"), ("envserver", "flooding"), ("envserver", "slow"),
         ("envserver", "sluggish"), ("envserver", "endless"),
         ("learner", "silent"), ("learner", "lying"), ("learner", "flooding")]
RIGHTS = """client { name: "actors" certificate: "actor" right: PLAY right: WATCH }
client { name: "servers" certificate: "envserver" right: SERVE right: WATCH }
client { name: "bad peers" certificate: "bad" right: PLAY right: SERVE right: WATCH }
client { name: "ops" certificate: "ops" right: WATCH right: STEER }
"""
HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0\4\0\0\0\0\0"


class Security:
    """The flags with the credentials of each role of the fleet; none without TLS."""

    def __init__(self, tls, out):
        self.folder = pathlib.Path(out) / "certs" if tls else None

    def make(self):
        if self.folder is None:
            return
        script = HERE.parent.parent / "deploy" / "make-certs.sh"
        subprocess.run([script, self.folder, "learner", "actor", "envserver", "ops", "bad"], check=True, capture_output=True)
        (self.folder / "access.txt").write_text(RIGHTS, encoding="utf-8")

    def connects(self, name):
        if self.folder is None:
            return []
        return [f"--tls_cert={self.folder}/{name}.pem", f"--tls_key={self.folder}/{name}.key",
                f"--tls_ca={self.folder}/ca.pem"]

    def listens(self, name):
        return self.connects(name) + ([f"--access_file={self.folder}/access.txt"] if self.folder else [])


class Drips:
    """Connections to each address that send the HTTP/2 preface at one byte per second."""

    def __init__(self, addresses):
        self.addresses, self.over = addresses, threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        connections = []
        for i in range(DRIPS):
            host, port = self.addresses[i % len(self.addresses)].rsplit(":", 1)
            try:
                connections.append(socket.create_connection((host, int(port)), timeout=2))
            except OSError:
                pass  # the process was just killed
        sent = 0
        while not self.over.wait(1):
            for connection in connections:
                try:
                    connection.send(HTTP2_PREFACE[sent % len(HTTP2_PREFACE):][:1])
                except OSError:
                    pass  # the process closed the connection
            sent += 1
        for connection in connections:
            connection.close()

    def stop(self):
        self.over.set()
        self.thread.join()


class Hostility(Chaos):
    """Also starts bad peers; the seed determines their order."""

    judges_growth = False  # there are bounds instead: the error of a slope is larger than the slope here

    def __init__(self, fleet, options, pace, security):
        super().__init__(fleet, options.seed, pace, pause_s=0)
        self.options, self.security = options, security
        self.stays = STAYS_S[options.short]
        self.came, self.guests, self.peaks = {}, [], {}
        self.order = []

    def bad_peer(self):
        if not self.order:  # each kind starts once before any of them starts again
            self.order = self.random.sample(PEERS, len(PEERS))
        role, misdeed = self.order.pop()
        kind = f"{misdeed} {role}"
        self.came[kind] = self.came.get(kind, 0) + 1
        if (role, misdeed) == ("actor", "slow"):
            drips = Drips([w.address for w in [self.fleet.learner] + self.fleet.workers if w.address])
            self.endings.append((self.since + self.stays, drips.stop))
        else:
            self.invite(role, misdeed)

    def invite(self, role, misdeed):
        site, out = Site(), pathlib.Path(self.options.out)
        listen = site.listen()
        command = [pathlib.Path(self.options.bin) / "bad_peer", f"--role={role}", f"--misdeed={misdeed}",
                   f"--seed={self.random.randrange(1 << 32)}", f"--listen={listen}",
                   f"--learner={self.fleet.learner_address}", f"--behind={self.fleet.workers[0].address}",
                   *self.security.connects("bad")]
        guests = [Worker(f"bad-{role}-{misdeed}", command, out / f"bad-{role}-{misdeed}.log")]
        if role == "learner":
            guests += self.victims(listen)
        self.guests += guests
        self.endings.append((self.since + self.stays, lambda: self.dismiss(guests)))

    def victims(self, learner):
        """A well-behaved actor and server with a bad learner."""
        programs, out, site = pathlib.Path(self.options.bin), pathlib.Path(self.options.out), Site()
        actor = [programs / "craftfleet-actor", f"--learner={learner}", f"--envservers={self.fleet.workers[0].address}",
                 *self.security.connects("actor")]
        server = [programs / "craftfleet-envserver", f"--learner={learner}", f"--listen={site.listen()}",
                  *self.security.listens("envserver")]
        return [Worker("victim-actor", actor, out / "victim-actor.log"),
                Worker("victim-server", server, out / "victim-server.log")]

    def dismiss(self, guests):
        for guest in guests:
            code = guest.process.poll()
            # Exit code 1 is an acceptable response to invalid messages; a crash is not.
            if guest.name.startswith("victim") and code not in (None, 0, 1):
                self.deaths.append(f"{guest.name} ended with {code}: see {guest.log}")
            guest.process.kill()
            guest.process.wait()
            self.guests.remove(guest)

    def act(self, since):
        super().act(since)
        for worker in self.fleet.all() + self.guests:
            if not worker.name.startswith("bad-"):
                self.peaks[worker.name] = max(self.peaks.get(worker.name, 0), (worker.peak_kib() or 0) >> 10)

    def stop(self):
        for _, end in self.endings:
            end()
        self.endings = []

    def figures(self):
        self.stop()
        return {**super().figures(), "bad_peers": self.came, "peak_memory_mib": self.peaks}

    def failures(self, since):
        above = [f"{name} used {peak} MiB, want at most {bound_of(name)}" for name, peak in self.peaks.items()
                 if peak > bound_of(name)]
        return super().failures(since) + above


def bound_of(name):
    return next(bound for role, bound in MEMORY_BOUND_MIB.items() if role in name)


def main():
    parser = arguments(__doc__)
    parser.add_argument("--tls", action="store_true", help="with certificates, and rights to play and to serve")
    options = parser.parse_args()
    end_cleanly_when_stopped()
    security = Security(options.tls, options.out)
    here = Site()

    def make_fleet(config, logdir):
        security.make()
        flags = {"learner": security.listens("learner"), "server": security.listens("envserver"),
                 "actor": security.connects("actor"), "status": security.connects("ops")}
        return Fleet(options.bin, options.out, config, logdir, here, [here], options.actors, options.servers, flags=flags)

    return compare(options, SHORT_CONFIG if options.short else LONG_CONFIG.format(steps=LONG_STEPS), make_fleet,
                   lambda fleet: Hostility(fleet, options, dict(SHORT_PACE if options.short else LONG_PACE), security))


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""chaos.py over a network: five hosts (network namespaces) on a bridge, with faults on every connection.

The learner has one host; actors and environment servers are distributed over the other four. All connections to a host go
through a proxy there (proxy.py), which delays each message by 50 ms in either direction, stalls 1% of them for 1 s and
resets connections. The cable of the last host carries 100 Mbit/s (tc tbf). From time to time a host is cut off for 20 s,
alternately by the proxies, which leave its connections half open, and by its cable. Processes are killed and paused as well.
Logs and weights must be identical to those of an undisturbed run in a single process.

  tests/chaos/netns.py --bin=build/bin --out=/tmp/netns              49 iterations, 20 to 30 minutes
  tests/chaos/netns.py --bin=build/bin --out=/tmp/netns --short      the short form that the tests run

Needs root, ip and tc; exits with 77 (skipped) without them. The namespaces are named craftfleet-PID-...; the program removes
them when it ends, and when it starts it removes those of earlier programs that were killed.
"""

import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys

from chaos import Chaos, arguments, compare, end_cleanly_when_stopped
from fleet import Fleet, Site

SKIPPED = 77
HOSTS = 5
SLOW_LINK = ["rate", "100mbit", "burst", "64kb", "latency", "400ms"]
FAULTS = ["--delay_ms=50", "--stall_share=0.01", "--stall_ms=1000"]
# Many lanes, so that a lane has few steps in an iteration: every step takes a round trip.
LONG_CONFIG = """steps: 200704 seed: 5 lanes: 512 fragment_steps: 8 checkpoint { every_iterations: 1 }
  eval { every_steps: 0 final_episodes: 0 }"""
SHORT_CONFIG = """steps: 1024 seed: 5 lanes: 32 fragment_steps: 16 env { length: 30 }
  ppo { rollout_steps: 512 minibatch_size: 128 epochs: 2 } checkpoint { every_iterations: 1 }
  eval { every_steps: 0 final_episodes: 0 }"""
LONG_PACE = {"kill": 2, "learner": 60, "pause": 30, "reset": 10, "cut": 90}  # seconds between events of a kind
SHORT_PACE = {"kill": 15, "reset": 2, "cut": 18}  # the run may end after 15 s


def run(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


class Host(Site):
    """A network namespace. Other hosts reach each of its ports through the proxy, at the port number plus 1000."""

    def __init__(self, name, number, ports, seed):
        self.name, self.address, self.next_port = name, f"10.77.0.{number + 1}", 6000
        self.ports, self.seed, self.proxy = ports, seed, None
        self.command_prefix, self.flags = ["ip", "netns", "exec", name], ["--insecure"]

    def listen(self):
        self.next_port += 1
        return f"{self.address}:{self.next_port - 1}"

    def reached_at(self, address):
        host, port = address.rsplit(":", 1)
        return f"{host}:{int(port) + 1000}"

    def start_proxy(self):
        maps = [f"--map={self.address}:{7000 + i}={self.address}:{6000 + i}" for i in range(self.ports)]
        self.proxy = subprocess.Popen(
            [*self.command_prefix, sys.executable, pathlib.Path(__file__).parent / "proxy.py", *maps, *FAULTS,
             f"--seed={self.seed}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)
        if self.proxy.stdout.readline() != "ready\n":
            sys.exit(f"the proxy of {self.name} did not start")

    def tell_proxy(self, command):
        self.proxy.stdin.write(command + "\n")
        self.proxy.stdin.flush()

    def report(self):
        self.tell_proxy("report")
        return json.loads(self.proxy.stdout.readline())


class Network:
    """The hosts, the bridge, and the cables between them (pairs of virtual devices)."""

    PREFIX = "craftfleet-"

    def __init__(self, options):
        self.remove_leftovers()
        self.prefix = f"{self.PREFIX}{os.getpid()}-"
        self.switch = self.prefix + "switch"
        ports = max(1, -(-options.servers // (HOSTS - 1)))
        self.hosts = [Host(f"{self.prefix}{i}", i, ports, options.seed + i) for i in range(HOSTS)]
        self.learner_host, self.worker_hosts = self.hosts[0], self.hosts[1:]

    def build(self):
        self.lay_cables()
        self.slow_down(self.hosts[-1])
        for host in self.hosts:
            host.start_proxy()

    def lay_cables(self):
        run("ip", "netns", "add", self.switch)
        run("ip", "-n", self.switch, "link", "add", "name", "bridge", "type", "bridge")
        run("ip", "-n", self.switch, "link", "set", "bridge", "up")
        for host in self.hosts:
            run("ip", "netns", "add", host.name)
            run("ip", "link", "add", "name", "eth0", "netns", host.name, "type", "veth",
                "peer", "name", self.cable(host), "netns", self.switch)
            run("ip", "-n", self.switch, "link", "set", self.cable(host), "master", "bridge")
            run("ip", "-n", host.name, "address", "add", f"{host.address}/24", "dev", "eth0")
            for namespace, device in [(host.name, "lo"), (host.name, "eth0"), (self.switch, self.cable(host))]:
                run("ip", "-n", namespace, "link", "set", device, "up")

    def slow_down(self, host):
        """Limits the cable of a host to 100 Mbit/s in each direction."""
        for namespace, device in [(host.name, "eth0"), (self.switch, self.cable(host))]:
            run("tc", "-n", namespace, "qdisc", "add", "dev", device, "root", "tbf", *SLOW_LINK)

    @staticmethod
    def cable(host):
        """The device at the bridge's end of a host's cable."""
        return "port" + host.name.rsplit("-", 1)[1]

    def cut(self, host, by_cable):
        if by_cable:
            run("ip", "-n", self.switch, "link", "set", self.cable(host), "down")
            return
        host.tell_proxy("cut *")
        for other in self.hosts:
            other.tell_proxy(f"cut {host.address}")

    def heal(self, host):
        run("ip", "-n", self.switch, "link", "set", self.cable(host), "up")
        host.tell_proxy("heal *")
        for other in self.hosts:
            other.tell_proxy(f"heal {host.address}")

    def report(self):
        """The total counts of the proxies, and how often a packet had to wait at the slow link."""
        total = {}
        for host in self.hosts:
            for name, count in host.report().items():
                total[name] = total.get(name, 0) + count
        slow = self.hosts[-1]
        queues = [json.loads(run("tc", "-n", namespace, "-s", "-j", "qdisc", "show", "dev", device))[0]
                  for namespace, device in [(slow.name, "eth0"), (self.switch, self.cable(slow))]]
        return total | {"slow_link_bytes": sum(queue["bytes"] for queue in queues),
                        "slow_link_waits": sum(queue["overlimits"] for queue in queues)}

    def remove(self):
        for host in self.hosts:
            if host.proxy is not None:
                host.proxy.kill()
                host.proxy.wait()
        for namespace in [host.name for host in self.hosts] + [self.switch]:
            self.remove_namespace(namespace)

    @staticmethod
    def remove_namespace(name):
        """Removes a namespace and kills the processes in it, if it exists."""
        pids = subprocess.run(["ip", "netns", "pids", name], capture_output=True, text=True, check=False)
        for pid in pids.stdout.split():
            os.kill(int(pid), signal.SIGKILL)
        subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)

    @classmethod
    def remove_leftovers(cls):
        """Removes the namespaces of earlier scripts that were killed."""
        for name in run("ip", "netns", "list").split():
            match = re.fullmatch(cls.PREFIX + r"(\d+)-\w+", name)
            if match and not pathlib.Path(f"/proc/{match[1]}").exists():
                cls.remove_namespace(name)


class NetworkChaos(Chaos):
    """Also cuts off hosts and resets connections."""

    def __init__(self, network, cut_s, *arguments_of_chaos):
        super().__init__(*arguments_of_chaos)
        self.network, self.cut_s = network, cut_s

    def reset(self):
        self.random.choice(self.network.hosts).tell_proxy("reset")

    def cut(self):
        host = self.random.choice(self.network.hosts)
        self.network.cut(host, by_cable=self.counts["cut"] % 2 == 0)
        self.endings.append((self.since + self.cut_s, lambda: self.network.heal(host)))

    def figures(self):
        return {**super().figures(), "network": self.network.report()}

    def failures(self, since):
        idle = [name for name, count in self.network.report().items() if count == 0]
        return super().failures(since) + [f"the network had no {name}" for name in idle]


def why_not():
    """The missing requirement; None if there is none."""
    for tool in ["ip", "tc"]:
        if shutil.which(tool) is None:
            return f"there is no program {tool} (Debian: iproute2)"
    if os.geteuid() != 0:
        return "network namespaces need root"
    name = f"{Network.PREFIX}{os.getpid()}-probe"
    try:
        run("ip", "netns", "add", name)
        run("ip", "-n", name, "link", "add", "name", "bridge", "type", "bridge")
        run("ip", "-n", name, "link", "add", "name", "a", "type", "veth", "peer", "name", "b")
        run("tc", "-n", name, "qdisc", "add", "dev", "a", "root", "tbf", *SLOW_LINK)
    except subprocess.CalledProcessError as error:
        return f"{' '.join(error.cmd)}: {error.stderr.strip()}"
    finally:
        Network.remove_namespace(name)
    return None


def main():
    options = arguments(__doc__).parse_args()
    reason = why_not()
    if reason is not None:
        print(f"skipped: {reason}")
        return SKIPPED
    end_cleanly_when_stopped()
    pace = SHORT_PACE if options.short else LONG_PACE
    network = Network(options)
    try:
        network.build()
        return compare(options, SHORT_CONFIG if options.short else LONG_CONFIG,
                       lambda config, logdir: Fleet(options.bin, options.out, config, logdir, network.learner_host,
                                                    network.worker_hosts, options.actors, options.servers),
                       lambda fleet: NetworkChaos(network, 6 if options.short else 20, fleet, options.seed, pace, 15))
    finally:
        network.remove()


if __name__ == "__main__":
    sys.exit(main())

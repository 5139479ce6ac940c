"""A private Slurm on this machine: munged, slurmctld and a slurmd for each node, in a temporary folder, on free ports.

Needs root (slurmd does) and Debian's munge, slurmctld, slurmd and slurm-client; why_not() says what is missing.
"""

import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import tempfile

from tests.fakes.python_case import free_port, wait_until

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "scontrol", "sinfo")
PATH = "/usr/sbin:/usr/bin:/sbin:/bin"

CONFIG = """
ClusterName=craftfleet
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmctldPort={controller_port}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
TopologyPlugin=topology/tree
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerType=sched/backfill
SchedulerParameters=bf_interval=1,batch_sched_delay=0,sched_min_interval=0,requeue_delay=1
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
KillWait=12
ReturnToService=2
SlurmdParameters=config_overrides
SlurmdTimeout=30
{nodes}
PartitionName=low Nodes=ALL Default=YES PriorityTier=1 PreemptMode=REQUEUE GraceTime=15 MaxTime=60 State=UP
PartitionName=high Nodes=ALL PriorityTier=10 PreemptMode=OFF MaxTime=60 State=UP
"""


def why_not():
  """The reason why no cluster can be started here; empty if it can."""
  missing = [program for program in PROGRAMS if shutil.which(program, path=PATH) is None]
  if missing:
    return f"no {', '.join(missing)} here: deploy/install-deps.sh --tests"
  try:
    socket.gethostbyname(socket.gethostname())
  except OSError:
    return f"the name of this host, {socket.gethostname()}, has no address"
  return "" if os.geteuid() == 0 else "slurmd needs root"


class SlurmCluster:
  """`with SlurmCluster() as cluster:`; nodes n1, n2, ... at the switch `leaf` below `root`; partitions `low` (default, preempted
  by requeueing) and `high`."""

  def __init__(self, nodes=3, cpus=8):
    self._temp = tempfile.TemporaryDirectory(prefix="craftfleet-slurm-")
    self.folder = pathlib.Path(self._temp.name)
    self.folder.chmod(0o755)
    self._nodes = [f"n{i + 1}" for i in range(nodes)]
    self._cpus = cpus
    self._daemons = []
    self.env = {"PATH": PATH, "SLURM_CONF": f"{self.folder}/slurm.conf", "HOME": str(self.folder), "LANG": "C.UTF-8"}

  def __enter__(self):
    try:
      self._start()
    except BaseException:
      self._stop()
      raise
    return self

  def __exit__(self, *_):
    self._stop()

  def _start(self):
    (self.folder / "state").mkdir()
    host = socket.gethostname().split(".")[0]
    (self.folder / "slurm.conf").write_text(CONFIG.format(
        host=host, folder=self.folder, controller_port=free_port(), nodes="\n".join(
            f"NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={free_port()} CPUs={self._cpus} RealMemory=4000"
            for node in self._nodes)))
    (self.folder / "topology.conf").write_text(
        f"SwitchName=root Switches=leaf\nSwitchName=leaf Nodes={','.join(self._nodes)}\n")
    key = self.folder / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o400)
    self._daemon("munged", "--foreground", "--force", f"--key-file={key}", f"--socket={self.folder}/munge.socket",
                 f"--pid-file={self.folder}/munged.pid", f"--log-file={self.folder}/munged.log",
                 f"--seed-file={self.folder}/munged.seed")
    wait_until((self.folder / "munge.socket").exists, "munged's socket")
    self._daemon("slurmctld", "-D", "-i", "-f", f"{self.folder}/slurm.conf")
    for node in self._nodes:
      self._daemon("slurmd", "-D", "-f", f"{self.folder}/slurm.conf", "-N", node)
    wait_until(lambda: self.run("sinfo", "-h", "-p", "low", "-t", "idle", "-o", "%D", check=False).stdout.strip() ==
               str(len(self._nodes)), "idle nodes")

  def _daemon(self, program, *arguments):
    log = open(self.folder / f"{program}.out", "ab")
    self._daemons.append(subprocess.Popen([program, *arguments], env=self.env, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                          start_new_session=True))
    log.close()

  def _stop(self):
    if len(self._daemons) == 2 + len(self._nodes):
      self.run("scancel", "--full", "--user=root", "--signal=KILL", check=False)
      self.run("scancel", "--user=root", check=False)
    for daemon in reversed(self._daemons):
      daemon.send_signal(signal.SIGTERM)
      try:
        daemon.wait(timeout=20)
      except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()
    self._temp.cleanup()

  def run(self, *command, check=True, **options):
    """Runs a command of this Slurm."""
    ended = subprocess.run([str(word) for word in command], env=self.env, text=True, capture_output=True, timeout=60,
                           check=False, **options)
    if check and ended.returncode != 0:
      raise AssertionError(f"{' '.join(map(str, command))}: exit code {ended.returncode}: {ended.stdout}{ended.stderr}")
    return ended

  def job(self, number):
    """The output of scontrol for a job as a dictionary; for a heterogeneous job, that of its first component."""
    text = self.run("scontrol", "show", "job", "-o", number).stdout.splitlines()[0]
    return dict(word.split("=", 1) for word in text.split() if "=" in word)

  def wait_for_state(self, number, *states, seconds=120):
    """Waits until the job is in one of `states`; returns that state."""

    def state():
      now = self.job(number)["JobState"]
      return now if now in states else ""

    return wait_until(state, f"job {number} {' or '.join(states)}", seconds)

  def logs(self):
    return "\n".join(f"== {name}\n" + (self.folder / name).read_text(errors="replace")[-3000:]
                     for name in ["slurmctld.log"] + [f"slurmd-{node}.log" for node in self._nodes]
                     if (self.folder / name).exists())


if __name__ == "__main__":
  with SlurmCluster() as cluster:
    sys.exit(subprocess.run(sys.argv[1:], env={**os.environ, **cluster.env}, check=False).returncode)

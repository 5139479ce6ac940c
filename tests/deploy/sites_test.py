"""What programs and scripts meet at sites: variables of the environment, limits, odd names, names of hosts, PID 1."""

import calendar
import contextlib
import json
import os
import pathlib
import pwd
import re
import shutil
import signal
import socket
import subprocess
import time
import unittest
import unittest.mock

from tests.fakes import python_case
from tests.fakes.python_case import BIN, ENDLESS, SOURCE, built, wait_until

CPUS = len(os.sched_getaffinity(0))
TWO_CPUS = " ".join(map(str, sorted(os.sched_getaffinity(0))[:2]))
PROXY = {name: "http://127.0.0.1:9" for name in ("http_proxy", "https_proxy", "grpc_proxy", "all_proxy")}
ODD = "größe 50% a"  # of a folder
NO_THREAD = "cannot start another thread: raise the limit of threads (ulimit -u"


def environment(**variables):
  return {**os.environ, **variables}


def has_ipv6():
  """Whether this host has ::1."""
  with contextlib.suppress(OSError), socket.socket(socket.AF_INET6) as tried:
    tried.bind(("::1", 0))
    return True
  return False


class Case(python_case.ProcessCase):

  def setUp(self):
    super().setUp()
    self.config = self.folder / "config.txt"
    self.config.write_text(python_case.SMALL_RUN)
    self.run_folder = self.folder / "run"

  def train(self):
    python_case.trained_run(self.run_folder, python_case.SMALL_RUN)

  def run_in(self, command, seconds=120, **options):
    return subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False, **options)

  def start_in(self, command, **options):
    """Starts a command; returns it and the file of its standard error."""
    self.programs += 1
    log = self.folder / f"{self.programs}.log"
    with log.open("w") as errors:
      process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, **options)
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    return process, log

  def in_other_mounts(self, script):
    """The start of a command that runs `script` with mounts of its own, then what follows; skips where it may not."""
    tried = self.run_in(["unshare", "--mount", "true"])
    if tried.returncode != 0:
      self.skipTest(f"no mounts of its own: {tried.stderr.strip()}; want root")
    return ["unshare", "--mount", "sh", "-euc", f'{script}\nexec "$@"', "sh"]

  def start_stub_fleet(self, variables, *flags, script=SOURCE / "deploy/local-fleet.sh"):
    """Runs local-fleet.sh with programs that only write their arguments; returns these by program."""
    stubs = self.folder / "stubs"
    stubs.mkdir(exist_ok=True)
    for name in ("learner", "actor", "envserver"):
      stub = stubs / f"craftfleet-{name}"
      stub.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" >"{self.folder}/{name}.args"\n' +
                      ("sleep 1\n" if name == "learner" else "sleep 60\n"))
      stub.chmod(0o755)
    ended = self.run_in([script, f"--bin={stubs}", f"--logdir={self.run_folder}", *flags], env=environment(**variables))
    self.assertEqual(ended.returncode, 0, ended.stderr)
    return {name: (self.folder / f"{name}.args").read_text().splitlines() for name in ("learner", "actor", "envserver")}


class Variables(Case):

  def test_the_proxy_for_web_pages_is_not_used(self):
    with unittest.mock.patch.dict(os.environ, PROXY):
      _, log = self.start("craftfleet-learner", f"--config={self.config}", f"--logdir={self.run_folder}", "--threads=1",
                          "--listen=127.0.0.1:0")
      learner = self.word_after(log, "listening on ")
      self.assertIn("learner", self.run_program("craftfleet status", f"--address={learner}").stdout)
      self.start("craftfleet-envserver", "--listen=127.0.0.1:0", f"--learner={learner}")
      actor, log = self.start("craftfleet-actor", f"--learner={learner}", "--envservers=learner", "--threads=1")
      self.assertEqual(actor.wait(60), 0, log.read_text())

  @unittest.skipIf(CPUS < 2, "one CPU, want two")
  def test_threads_use_all_cpus_whatever_openmp_is_told(self):
    self.config.write_text(ENDLESS)
    doctor = [*built("craftfleet doctor"), f"--logdir={self.folder}"]
    allowed = int(re.search(r"; (\d+) threads;", self.run_in(doctor).stdout)[1])  # fewer than CPUS under a quota
    for number, (variables, cpus) in enumerate(
        (({"OMP_PROC_BIND": "true"}, CPUS), ({"OMP_PROC_BIND": "spread", "OMP_PLACES": "cores"}, CPUS),
         ({"GOMP_CPU_AFFINITY": TWO_CPUS}, 2))):
      with self.subTest(variables):
        logdir = self.folder / f"run-{number}"
        command = [*built("craftfleet train"), f"--config={self.config}", f"--logdir={logdir}", "--threads=2"]
        process, log = self.start_in(command, env=environment(**variables))
        wait_until((logdir / "checkpoints/iter-00000002").exists, f"checkpoints in {log}")
        masks = {task.name: len(os.sched_getaffinity(int(task.name)))
                 for task in pathlib.Path(f"/proc/{process.pid}/task").iterdir()}
        process.kill()
        self.assertEqual(set(masks.values()), {cpus}, masks)
        self.assertIn(f"; {min(cpus, allowed)} threads;", self.run_in(doctor, env=environment(**variables)).stdout)

  def test_a_home_is_known_and_an_empty_python_is_none(self):
    without_home = {name: value for name, value in os.environ.items() if name != "HOME"}
    ended = self.run_in([BIN / "craftfleet-envserver", "--textures=~/no-textures"], env=without_home)
    self.assertIn(f" {pwd.getpwuid(os.getuid()).pw_dir}/no-textures", ended.stderr)
    self.assertEqual(self.run_in([BIN / "craftfleet", "top", "--help"], env=environment(CRAFTFLEET_PYTHON="")).returncode, 0)

  def test_the_variable_that_sets_the_number_of_ranks_is_named(self):
    ended = self.run_in([BIN / "craftfleet-learner", f"--config={self.config}", f"--logdir={self.run_folder}"],
                        env=environment(WORLD_SIZE="9", RANK="0"))
    self.assertEqual(ended.returncode, 1)
    self.assertIn("WORLD_SIZE=9 of the environment, but gradient_shards is 2: start at most that many learners", ended.stderr)
    self.assertNotIn("--world_size=9", ended.stderr)

  def test_a_fleet_counts_the_cpus_not_the_threads_of_openmp_and_expands_a_home(self):
    args = self.start_stub_fleet({"OMP_NUM_THREADS": "1", "OMP_THREAD_LIMIT": "1", "HOME": "/home/someone"}, "--textures=~/textures")
    self.assertIn(f"--threads={CPUS}", args["actor"])
    for program in ("envserver", "learner"):
      self.assertIn("--textures=/home/someone/textures", args[program])


class Limits(Case):

  def commands(self):
    """For each program, a command that works; those without an end of their own are stopped once they serve."""
    run, config = self.run_folder, self.config
    return {
        "craftfleet": ["--version"],
        "craftfleet-actor": ["--learner=127.0.0.1:1", "--threads=2"],
        "craftfleet admin": ["pause", "--address=127.0.0.1:1"],
        "craftfleet agents": [],
        "craftfleet curve": [run],
        "craftfleet doctor": [f"--logdir={self.folder}"],
        "craftfleet envs": ["--worlds=1"],
        "craftfleet-envserver": ["--listen=127.0.0.1:0"],
        "craftfleet eval": [f"--checkpoint={run}", "--episodes=1"],
        "craftfleet inspect": [],
        "craftfleet-learner": [f"--config={config}", f"--logdir={self.folder}/learner", "--listen=127.0.0.1:0"],
        "craftfleet play": [],
        "craftfleet policy": [f"--checkpoint={run}"],
        "craftfleet report": [run, f"--out={self.folder}/report"],
        "craftfleet status": ["--address=127.0.0.1:1"],
        "craftfleet sweep": [SOURCE / "deploy/experiments/paper.toml", "--list"],
        "craftfleet top": ["--address=127.0.0.1:1", "--once"],
        "craftfleet train": [f"--config={config}", f"--logdir={self.folder}/train-%", "--threads=2"],
        "craftfleet watch": [f"--video={self.folder}/watch.mp4", run],
    }

  def test_a_limit_of_threads_is_a_sentence_and_an_exit_code_of_one(self):
    self.train()
    library = BIN / "libcraftfleet_few_threads.so"
    commands = self.commands()
    listed = json.loads(self.run_program("craftfleet", "--help_json").stdout)["commands"]
    self.assertLessEqual({f"craftfleet {command['name']}" for command in listed}, set(commands), "each command has a row")
    refused = 0
    for program in sorted(commands):
      for limit in (1, 2, 4, 8, 12, 16):
        with self.subTest(program, limit=limit):
          arguments = [str(argument).replace("%", str(limit)) for argument in commands[program]]
          process, log = self.start_in([*built(program), *arguments], stdin=subprocess.DEVNULL, env=environment(
              LD_PRELOAD=str(library), FEW_THREADS=str(limit), OPENBLAS_NUM_THREADS="1"))
          wait_until(lambda: process.poll() is not None or re.search("listening on|status on|trying again", log.read_text()),
                     f"the end of {program} with {limit} threads")
          process.terminate()
          code = process.wait(60)
          self.assertIn(code, (0, 1, -signal.SIGTERM), log.read_text())
          if NO_THREAD not in log.read_text():
            break  # a higher limit only allows more
          self.assertEqual(code, 1, log.read_text())
          refused += 1
    self.assertGreater(refused, 5)

  def memory_of(self, version, limit):
    """The start of a command in a group of cgroups whose parent has a limit of memory, in bytes."""
    own, root = self.folder / "own", "/sys/fs/cgroup"
    if version == 2:
      own.write_text("0::/job/step\n")
      files = {"job/memory.max": limit, "job/memory.current": 1 << 20, "job/step/memory.max": "max", "job/step/memory.current": 0}
    else:
      own.write_text("4:cpu,memory:/job/step\n0::/\n")
      files = {"memory/job/memory.limit_in_bytes": limit, "memory/job/memory.usage_in_bytes": 1 << 20,
               "memory/job/step/memory.limit_in_bytes": 2**63 - 4096, "memory/memory.limit_in_bytes": 2**63 - 4096}
    script = f"mount -t tmpfs none {root}\n" + "".join(
        f"mkdir -p $(dirname {root}/{name})\necho {value} >{root}/{name}\n" for name, value in files.items())
    return self.in_other_mounts(f"{script}mount --bind {own} /proc/$$/cgroup")

  def test_the_memory_of_a_group_is_seen_in_both_versions_of_cgroups(self):
    for version in (1, 2):
      with self.subTest(version):
        limited = self.memory_of(version, 1 << 30)
        doctor = self.run_in([*limited, *built("craftfleet doctor"), f"--logdir={self.folder}"])
        self.assertRegex(doctor.stdout, r"memory +10\d\d MiB available")
        limited = self.memory_of(version, 1 << 29)
        refused = self.run_in([*limited, *built("craftfleet train"), "--agent=ppo_spcnn", f"--logdir={self.run_folder}"])
        self.assertEqual(refused.returncode, 1, refused.stderr)
        self.assertRegex(refused.stderr, r"the learner needs at least [\d.]+ GiB of memory, .*; it has 0\.5 GiB")
        self.assertFalse(self.run_folder.exists())


class Names(Case):

  def test_a_home_that_the_shell_did_not_expand(self):
    self.train()
    here, home = self.folder / "here", self.folder / "home"
    here.mkdir()
    home.mkdir()
    for program, *arguments in (
        ["craftfleet train", f"--config={self.config}", "--logdir=~/run", "--threads=1"],
        ["craftfleet curve", f"{self.run_folder}", "--out=~/curve.png"],
        ["craftfleet eval", f"--checkpoint={self.run_folder}", "--episodes=1", "--out=~/eval.json", "--pictures=~/pictures"],
        ["craftfleet report", f"{self.run_folder}", "--out=~/report"],
        ["craftfleet sweep", SOURCE / "deploy/experiments/paper.toml", "--write_configs=~/configs", "--experiment=table1"]):
      ended = self.run_in([*built(program), *arguments], cwd=here, env=environment(HOME=str(home)))
      self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertEqual(list(here.iterdir()), [], "no folder named ~")
    made = {path.name for path in home.iterdir()} - {".cache", ".config"}  # where matplotlib keeps its list of fonts
    self.assertEqual(made, {"run", "curve.png", "eval.json", "pictures", "report", "configs"})

  def test_a_unix_socket_in_a_folder_with_an_odd_name(self):
    folder = self.folder / ODD
    folder.mkdir()
    server, log = self.start("craftfleet-envserver", f"--listen=unix:{folder}/socket")
    wait_until(lambda: "listening on" in log.read_text(), log)
    self.assertIn("envserver", self.run_program("craftfleet status", f"--address=unix:{folder}/socket").stdout)
    server.terminate()
    self.assertEqual(server.wait(20), 0)
    # A file that is left by a killed process is no obstacle.
    server, log = self.start("craftfleet-envserver", f"--listen=unix:{folder}/socket")
    wait_until(lambda: "listening on" in log.read_text(), log)
    server.kill()
    server.wait()
    _, log = self.start("craftfleet-envserver", f"--listen=unix:{folder}/socket")
    wait_until(lambda: "listening on" in log.read_text(), log)

  def test_a_second_process_on_an_address_refuses_and_harms_neither(self):
    for listen in (f"unix:{self.folder}/socket", "127.0.0.1:0", *(["[::1]:0"] if has_ipv6() else [])):
      _, log = self.start("craftfleet-envserver", f"--listen={listen}")
      address = self.word_after(log, "listening on ")
      others = (("craftfleet-actor", ["--learner=127.0.0.1:1"]),
                ("craftfleet-learner", [f"--config={self.config}", f"--logdir={self.run_folder}"]),
                ("craftfleet train", [f"--config={self.config}", f"--logdir={self.run_folder}"]))
      for program, more in (("craftfleet-envserver", []), *(others if listen.startswith("unix:") else ())):
        with self.subTest(program, address=address):
          refused = self.run_program(program, f"--listen={address}", *more, code=1)
          self.assertIn(f"cannot listen on {address}", refused.stderr)
          self.assertIn("envserver", self.run_program("craftfleet status", f"--address={address}").stdout)
    self.assertFalse((self.run_folder / "config.txt").exists())


class Scripts(Case):

  def local_fleet(self, *flags, **variables):
    return self.run_in([SOURCE / "deploy/local-fleet.sh", f"--bin={BIN}", f"--config={self.config}", "--threads=1", *flags],
                       env=environment(**variables))

  def test_a_fleet_runs_in_folders_with_odd_names(self):
    temporary, logdir = self.folder / ODD, self.folder / f"run, {ODD}"
    temporary.mkdir()
    ended = self.local_fleet(f"--logdir={logdir}", TMPDIR=str(temporary))
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertTrue((logdir / "checkpoints/iter-00000003").exists())
    self.assertEqual(list(temporary.iterdir()), [])

  def test_a_folder_that_sockets_cannot_be_in_is_named_and_nothing_is_begun(self):
    long, commas = self.folder / ("a" * 90), self.folder / "a,b"
    long.mkdir()
    commas.mkdir()
    for folder, text in ((long, "want at most 107: set TMPDIR to a shorter folder"), (commas, "may not have commas"),
                         (self.folder / "none", "is not a folder that can be written")):
      refused = self.local_fleet(f"--logdir={self.run_folder}", TMPDIR=str(folder))
      self.assertEqual(refused.returncode, 2)
      self.assertIn(f"TMPDIR={folder}", refused.stderr)
      self.assertIn(text, refused.stderr)
      self.assertEqual(python_case.processes_with(str(self.folder)), [])
    self.assertFalse(self.run_folder.exists())
    self.assertEqual([*long.iterdir(), *commas.iterdir()], [])

  def test_scripts_may_be_started_through_a_link(self):
    link = self.folder / "fleet"
    link.symlink_to(SOURCE / "deploy/local-fleet.sh")
    self.assertIn("--envservers=M", self.run_in([link, "--help"]).stdout)
    stubs = self.start_stub_fleet({}, script=link)
    self.assertIn("--rank=0", stubs["learner"])

  def test_an_installation_has_programs_textures_and_the_licence(self):
    ended = self.run_in(["cmake", "--install", BIN.parent, "--prefix", self.folder / "usr"])
    self.assertEqual(ended.returncode, 0, ended.stderr)
    for path in ("bin/craftfleet-learner", "share/craftfleet/textures/stone.png", "share/doc/craftfleet/LICENSE"):
      self.assertTrue((self.folder / "usr" / path).is_file(), path)

  def test_what_reads_many_runs_names_and_skips_what_it_cannot_read(self):
    """As another user: root may read everything."""
    self.train()
    runs = self.folder / "runs"
    shutil.copytree(self.run_folder, runs / "good")
    shutil.copytree(self.run_folder, runs / "empty")
    for name in ("stats.jsonl", "config.txt"):
      (runs / "empty" / name).write_text("")
    shutil.copytree(self.run_folder, runs / "closed")
    (runs / "unlisted/below").mkdir(parents=True)
    as_nobody = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
    if self.run_in([*as_nobody, BIN / "craftfleet", "--version"]).returncode != 0:
      self.skipTest(f"another user cannot run the programs in {BIN}")
    for path in (self.folder, runs, *runs.rglob("*")):  # whatever the umask is
      path.chmod(0o755 if path.is_dir() else 0o644)
    for path in (runs / "closed/stats.jsonl", runs / "unlisted"):
      path.chmod(0)
    out = self.folder / "out"
    out.mkdir()
    out.chmod(0o777)
    report = self.run_in([*as_nobody, *built("craftfleet report"), runs, f"--out={out}/report", "--html"])
    self.assertEqual(report.returncode, 0, report.stderr)
    for name in ("closed/stats.jsonl", "unlisted"):
      self.assertIn(f"{runs}/{name}: Permission denied", report.stderr)
    self.assertIn("1 complete", report.stdout)
    curve = self.run_in([*as_nobody, *built("craftfleet curve"), *(runs / name for name in ("good", "empty", "closed", "unlisted")),
                         f"--out={out}/curve.png"])
    self.assertEqual(curve.returncode, 0, curve.stderr)
    for text in (f"{runs}/empty/stats.jsonl: no episode has finished yet", "closed/stats.jsonl", "unlisted"):
      self.assertRegex(curve.stderr, f"warning: left out: .*{re.escape(text)}")
    self.assertTrue((out / "curve.png").exists())
    alone = self.run_in([*as_nobody, *built("craftfleet curve"), runs / "closed"])
    self.assertEqual(alone.returncode, 1)
    (runs / "unlisted").chmod(0o755)

  def test_results_are_collected_beside_odd_names(self):
    self.train()
    (self.run_folder / "checkpoints/iter-99999999.bak").mkdir()
    result = self.folder / "result"
    ended = self.run_in(["env", f"CRAFTFLEET_BIN={BIN}", SOURCE / "deploy/experiments/collect.py", "--weights", self.run_folder, result])
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertEqual({path.name for path in result.iterdir()}, {"config.txt", "run.json", "weights.safetensors"})
    drawn = self.run_in([*built("craftfleet curve"), f"{result}.npz", self.run_folder])
    self.assertEqual(*(line.split()[1:] for line in drawn.stdout.splitlines()[1:]))


class Networks(Case):

  def with_hosts(self, line):
    hosts = self.folder / "hosts"
    hosts.write_text(f"127.0.0.1 localhost\n{line}\n")
    return self.in_other_mounts(f"mount --bind {hosts} /etc/hosts")

  def test_a_name_that_is_an_address_of_loopback_is_warned_of(self):
    for line, warned in (("127.0.1.1 node1", True), *([("::1 node1", True)] if has_ipv6() else []), ("127.0.1.1 node0", False)):
      name = "node1" if warned else "localhost"
      _, log = self.start_in([*self.with_hosts(line), BIN / "craftfleet-envserver", f"--listen={name}:0", "--insecure"])
      address = self.word_after(log, "listening on ")
      self.assertTrue(address.startswith(f"{name}:"))
      self.assertEqual(f"{name}:0: on this host the name is an address of loopback" in log.read_text(), warned, log.read_text())

  def test_slurms_steps_listen_where_other_hosts_reach_them(self):
    script = SOURCE / "deploy/slurm/own-host.sh"
    name = socket.gethostname()
    addresses = self.run_in(["hostname", "-I"]).stdout.split()
    if not any("." in address for address in addresses):
      self.skipTest("this host has no address but those of loopback")
    found = self.run_in([*self.with_hosts(f"127.0.1.1 {name}"), script]).stdout.strip()
    self.assertIn(found, addresses)
    self.assertEqual(self.run_in([*self.with_hosts(f"{addresses[0]} {name}"), script]).stdout.strip(), name)

  def test_all_addresses_means_those_of_both_families(self):
    for listen in ("[::]:0", "0.0.0.0:0"):
      _, log = self.start("craftfleet-envserver", f"--listen={listen}", "--insecure")
      port = self.word_after(log, "listening on ").rpartition(":")[2]
      hosts = ["127.0.0.1"] + (["[::1]"] if listen.startswith("[") and has_ipv6() else [])
      for host in hosts:
        self.assertIn("envserver", self.run_program("craftfleet status", f"--address={host}:{port}").stdout)

  def test_a_registered_server_that_only_its_host_reaches_says_so(self):
    _, log = self.start("craftfleet-envserver", "--listen=127.0.0.1:0", "--learner=learner.invalid:1")
    wait_until(lambda: "--listen=127.0.0.1:0 is reached from this host only" in log.read_text(), "a warning")

  def test_process_1_ends_at_the_first_signal(self):
    tried = self.run_in(["unshare", "--pid", "--fork", "true"])
    if tried.returncode != 0:
      self.skipTest(f"no process ids of its own: {tried.stderr.strip()}; want root")
    for program, *flags in (
        ["craftfleet-learner", f"--config={self.config}", f"--logdir={self.run_folder}", "--listen=127.0.0.1:0"],
        ["craftfleet train", f"--config={self.config}", f"--logdir={self.run_folder}"],
        ["craftfleet-envserver", "--listen=127.0.0.1:0"], ["craftfleet-actor", "--learner=127.0.0.1:1"]):
      with self.subTest(program):
        # With nice, so that the signal comes before it has begun anything, but on a busy machine.
        process, log = self.start_in(["unshare", "--pid", "--fork", "--kill-child", "nice", "-n", "19", *built(program), *flags])
        child = pathlib.Path(f"/proc/{process.pid}/task/{process.pid}/children")
        first = int(wait_until(lambda: child.read_text().split(), "process 1")[0])
        wait_until(lambda: self.handles_term(first), "a handler of SIGTERM")
        os.kill(first, signal.SIGTERM)
        code = process.wait(20)
        self.assertEqual(code, 0 if log.read_text() else 128 + signal.SIGTERM, log.read_text())
        if code != 0:
          self.assertFalse((self.run_folder / "config.txt").exists())
        shutil.rmtree(self.run_folder, ignore_errors=True)

  def handles_term(self, pid):
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    caught = int(re.search(r"SigCgt:\s*(\w+)", status)[1], 16)
    return "craftfleet" in status and caught >> (signal.SIGTERM - 1) & 1

  def test_certificates_are_valid_on_hosts_whose_clocks_are_behind(self):
    certs = self.folder / ODD
    subprocess.run([SOURCE / "deploy/make-certs.sh", certs, "server"], check=True, capture_output=True)
    for name in ("ca", "server"):
      dates = self.run_in(["openssl", "x509", "-in", certs / f"{name}.pem", "-noout", "-startdate", "-checkend", "0"]).stdout
      begin = calendar.timegm(time.strptime(re.search("notBefore=(.*) GMT", dates)[1], "%b %d %H:%M:%S %Y"))
      self.assertLess(begin, time.time() - 3600)

  def test_the_key_of_an_authority_without_its_certificate_is_kept(self):
    certs = self.folder / "certs"
    certs.mkdir()
    (certs / "ca.key").write_text("key")
    made = self.run_in([SOURCE / "deploy/make-certs.sh", certs, "server"])
    self.assertEqual(made.returncode, 2, made.stderr)
    self.assertIn(f"{certs}/ca.key is there without ca.pem", made.stderr)
    self.assertEqual((certs / "ca.key").read_text(), "key")

  def test_a_folder_that_cannot_be_unmounted_keeps_what_it_has(self):
    """With stand-ins for what try-distro.sh runs; only its ccache is really mounted."""
    if subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode != 0:
      self.skipTest("no mounts of its own; want root")
    tools, ccache = self.folder / "tools", self.folder / "ccache"
    tools.mkdir()
    ccache.mkdir()
    (ccache / "kept").touch()
    for name, script in (("mmdebstrap", "for root; do :; done; mkdir -p \"$root/etc\""), ("git", "exit 0"), ("chroot", "exit 1"), ("umount", "exit 32"),
                         ("mount", "case $1:$2 in --rbind:/proc | --rbind:/sys | --rbind:/dev | --make-rslave:*) exit 0 ;; esac\nexec /bin/mount \"$@\"")):
      (tools / name).write_text(f"#!/bin/sh\n{script}\n")
      (tools / name).chmod(0o755)
    tried = self.run_in([SOURCE / "deploy/try-distro.sh", "bookworm", f"--ccache={ccache}", f"--dir={self.folder}"],
                        env={"PATH": f"{tools}:/usr/bin:/bin"})
    self.assertIn("still mounted, not removed", tried.stderr)
    self.assertTrue((ccache / "kept").exists())


python_case.main()

"""craftfleet doctor: what it prints, where, and how it exits."""

import json
import os
import pty
import socket
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import built


class Doctor(python_case.FolderCase):

  def test_a_machine_that_can_train_passes(self):
    report = json.loads(self.run_program("craftfleet doctor", "--json", "--listen=127.0.0.1:0", f"--logdir={self.folder}/runs").stdout)
    self.assertTrue(report["ok"])
    names = [check["check"] for check in report["checks"]]
    self.assertEqual(names, ["CPU", "BLAS", "memory", "open files", "disk space", "disk speed", "clock", "GPU",
                             "port 127.0.0.1:0", "versions"])
    for check in report["checks"]:
      self.assertEqual(check["remedy"] == "", check["verdict"] == "ok", check)
    self.assertEqual(list(self.folder.iterdir()), [])

  def test_what_it_finds_is_this_machine(self):
    ended = self.run_program("craftfleet doctor", "--json", "--listen=", "--logdir=/proc", code=1)
    checks = {check["check"]: check for check in json.loads(ended.stdout)["checks"]}
    self.assertRegex(checks["BLAS"]["found"], "^/.*(blas|mkl)|^built into LibTorch$")
    self.assertRegex(checks["memory"]["found"], r"^\d.* available$")
    self.assertRegex(checks["open files"]["found"], r"^at most \d+$")
    self.assertIn("/proc/.craftfleet-doctor-", checks["disk speed"]["found"])
    self.assertEqual(checks["disk speed"]["verdict"], "fail")
    self.assertRegex(checks["versions"]["found"], r"^CraftFleet \S+ \(.*\), LibTorch \S+, gRPC \S+, Protobuf \S+, OpenSSL \S+, Linux \S+$")
    below = self.run_program("craftfleet doctor", "--listen=", f"--logdir={self.folder}/runs/first")
    self.assertIn(f"free in {self.folder}\n", below.stdout, "the nearest folder that exists")

  def test_it_does_not_write_through_a_link(self):
    script = f'ln -s "{self.folder}/target" "{self.folder}/.craftfleet-doctor-$$"; exec "$@"'
    ended = subprocess.run(["sh", "-c", script, "sh", *built("craftfleet doctor"), "--listen=", f"--logdir={self.folder}"],
                           capture_output=True, text=True, timeout=60, check=False)
    self.assertRegex(ended.stdout, r"FAIL  disk speed +cannot create .*: File exists")
    self.assertFalse((self.folder / "target").exists())

  def test_a_port_in_use_fails_with_a_remedy(self):
    with socket.socket() as taken:
      taken.bind(("127.0.0.1", 0))
      taken.listen()
      address = f"127.0.0.1:{taken.getsockname()[1]}"
      ended = self.run_program("craftfleet", "doctor", f"--listen=127.0.0.1:0,{address},unix:/tmp/x", f"--logdir={self.folder}", code=1)
    self.assertRegex(ended.stdout, rf"FAIL  port {address}  .*")
    self.assertIn("-> end the program that has the port", ended.stdout)
    self.assertNotIn("unix:", ended.stdout)
    self.assertIn(f"failed checks: port {address}", ended.stderr)

  def test_tls_files_are_checked_when_they_are_given(self):
    ended = self.run_program("craftfleet doctor", "--json", f"--tls_cert={self.folder}/a.pem", f"--tls_key={self.folder}/a.key",
                             "--listen=", code=1)
    report = json.loads(ended.stdout)
    self.assertFalse(report["ok"])
    check, = [check for check in report["checks"] if check["check"] == "TLS files"]
    self.assertEqual(check["verdict"], "fail")
    self.assertIn(f"{self.folder}/a.pem", check["found"])

  def on_a_terminal(self, **variables):
    main, terminal = pty.openpty()
    environment = {**{name: value for name, value in os.environ.items() if name != "NO_COLOR"}, "TERM": "xterm", **variables}
    ended = subprocess.run([*built("craftfleet doctor"), "--listen=", f"--logdir={self.folder}"], stdout=terminal, env=environment, check=False)
    os.close(terminal)
    self.assertEqual(ended.returncode, 0)
    return os.read(main, 65536).decode()

  def test_colour_is_for_terminals_that_want_it(self):
    self.assertIn("\x1b[32mok", self.on_a_terminal())
    for variables in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
      self.assertNotIn("\x1b", self.on_a_terminal(**variables))
    self.assertNotIn("\x1b", self.run_program("craftfleet doctor", "--listen=", f"--logdir={self.folder}").stdout)


python_case.main()

"""The script for fifteen minutes on a GPU, from beginning to end on the CPU, and device_check on the tests' stand-in."""

import json
import re
import subprocess

from tests.fakes import python_case


class GpuSession(python_case.FolderCase):

  def figures(self, text):
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]

  def test_learns_everything_on_the_cpu(self):
    session = python_case.SOURCE / "deploy/gpu_session.sh"
    run = lambda *arguments: subprocess.run([session, *arguments], capture_output=True, text=True, check=False, timeout=280)
    bundle = run("bundle", f"--bin={python_case.BIN}", f"--out={self.folder}/bundle")
    self.assertEqual(bundle.returncode, 0, bundle.stderr)
    # LibTorch, glibc and the libraries of C++ are there.
    there = re.compile(r"(ld-linux.*|lib(torch|c10)[_.].*|lib(c|m|mvec|dl|rt|pthread|util|resolv|anl|stdc\+\+|gcc_s)\.so.*)$")
    listed = subprocess.run(["ldd", *(self.folder / "bundle/bin").iterdir()], capture_output=True, text=True, check=True).stdout
    wanted = {name for name in re.findall(r"^\s*(\S+) =>", listed, re.MULTILINE) if not there.match(name)}
    self.assertGreater(len(wanted), 20)
    self.assertEqual(wanted - {path.name for path in (self.folder / "bundle/lib").iterdir()}, set())
    for part in "ab":
      result = run(part, f"--bin={self.folder}/bundle/bin", f"--out={self.folder}/{part}", f"--work={self.folder}/work",
                   "--device=cpu", "--small", "--seconds=250")
      self.assertEqual(result.returncode, 0, result.stdout + result.stderr)
      self.assertIn(f"part {part}: 0 steps failed", result.stdout)
    figures = self.figures((self.folder / "a/check.log").read_text())
    self.assertGreater(len(figures), 5)
    loops = [json.loads(line) for line in (self.folder / "a/loops.jsonl").read_text().splitlines()]
    self.assertGreater(loops[0]["steps_per_second"], 0)
    self.assertTrue((self.folder / "a/loops/ppo_cnn-default.log").exists())
    streams = [json.loads(line) for line in (self.folder / "a/acting_stream.jsonl").read_text().splitlines()]
    self.assertIn("acting_stream: true", streams[1]["config"])
    self.assertEqual(streams[0]["weights"], streams[1]["weights"])
    self.assertTrue((self.folder / "b/oc_sa/weights.safetensors").exists())
    self.assertTrue((self.folder / "b/oc_sa/stats.jsonl").exists())

  def test_a_step_ends_at_its_limit(self):
    (self.folder / "bin").mkdir()
    for name, script in [("craftfleet", "[ \"$1\" = doctor ] || sleep 8"), ("device_check", "exit 1")]:
      (self.folder / "bin" / name).write_text(f"#!/bin/sh\n{script}\n")
      (self.folder / "bin" / name).chmod(0o755)
    run = lambda: subprocess.run([python_case.SOURCE / "deploy/gpu_session.sh", "a", f"--bin={self.folder}/bin", "--small",
                                  f"--out={self.folder}/out", f"--work={self.folder}/work", "--device=cpu", "--seconds=3"],
                                 capture_output=True, text=True, check=False, timeout=60)
    result = run()
    self.assertEqual(result.returncode, 1)
    self.assertRegex((self.folder / "out/steps.txt").read_text(), r"smoke: exit code 124 after \d of \d s")
    self.assertIn("left out, 3 s are over", result.stdout)
    self.assertIn("oc_sa: runs", result.stdout)
    again = run()
    self.assertEqual(again.returncode, 2, again.stdout)
    self.assertIn(f"--work={self.folder}/work: has a run already; stop it and remove the folder", again.stderr)

  def test_device_check_agrees_on_the_stand_in(self):
    for agent in ["ppo_cnn", "lstm_cnn", "oc_sa"]:
      with self.subTest(agent):
        check = self.run_program("device_check_stand_in", "--device=privateuseone:0", "--small", f"--agents={agent}",
                                 "--precisions=FP32", "--checks=update,act,repeat,speed")
        figures = self.figures(check.stdout)
        self.assertGreater(len(figures), 8)
        for figure in figures:
          self.assertTrue(figure.get("ok", True), figure)

  def test_device_check_fails_beyond_a_limit(self):
    check = self.run_program("device_check", "--device=cpu", "--small", "--agents=ppo_cnn", "--checks=none", code=1)
    self.assertIn('"ok": false', check.stdout)
    self.assertIn("no such check", check.stdout)


if __name__ == "__main__":
  python_case.main()

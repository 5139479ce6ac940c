"""deploy/bundle.sh: a bundle of this build runs elsewhere with its own libraries, and its programs find LibTorch."""

import os
import pathlib
import re
import shlex
import shutil
import subprocess
import tarfile

from tests.fakes import python_case
from tests.fakes.python_case import BIN, SMALL_RUN, SOURCE, cmake_setting

LAUNCHER = SOURCE / "deploy/bundle-launcher.sh"
GLIBC = re.compile(r"/(ld-linux.*\.so\.\d|lib(c|m|mvec|dl|pthread|rt|util|resolv|anl)\.so\.\d|libnsl\.so\.1)$")
TOOLS = ("sh", "env", "true", "readlink", "basename", "dirname", "getconf", "sed", "sort", "head")  # a shell, coreutils, sed, libc-bin
OF_LIBTORCH = re.compile(r"/lib(torch|c10|caffe2)")


def libraries(program, **environment):
  """Paths of the libraries that the loader finds for the program, links not followed; None where it finds none."""
  text = subprocess.run(["ldd", program], capture_output=True, text=True, check=True, env={"PATH": "/usr/bin:/bin", **environment}).stdout
  found = re.findall(r"^\s*(\S+) => (not found|/.*?)(?: \(0x\w+\))?$", text, re.MULTILINE)
  return {name: None if path == "not found" else path for name, path in found}


def enter_root(root):
  """Makes a root with glibc and the tools of the launcher alone. What it returns makes of a command one that runs in it, with
  /proc and /dev there, as root or in a user namespace."""
  for name in ("proc", "dev", "tmp", "bin", "lib64", "libtorch"):
    (root / name).mkdir(parents=True)
  needed = {path for tool in TOOLS for path in libraries(shutil.which(tool)).values()}
  libc, = (path for path in needed if "/libc.so" in path)
  needed.update(str(path) for path in pathlib.Path(libc).parent.glob("lib*.so.*") if GLIBC.search(str(path)))
  for path in needed:
    target = root / path.lstrip("/")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(path, target)
  loader, = pathlib.Path("/lib64").glob("ld-linux*")
  shutil.copy(loader, root / "lib64")
  for tool in TOOLS:
    shutil.copy(shutil.which(tool), root / "bin")
  place = shlex.quote(str(root))
  user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
  return lambda words: ["unshare", "--mount", *user, "sh", "-c",
                        f"mount --rbind /proc {place}/proc && mount --rbind /dev {place}/dev && exec chroot {place} {shlex.join(words)}"]


class Bundle(python_case.FolderCase):

  def bundle(self):
    """Makes a bundle, unpacks it elsewhere, and removes the archive."""
    if b"__asan_init" in (BIN / "craftfleet").read_bytes():
      self.skipTest("programs under AddressSanitizer are not bundled")
    made = subprocess.run([SOURCE / "deploy/bundle.sh", f"--build={BIN.parent}", f"--out={self.folder}", "--level=0"],
                          capture_output=True, text=True, check=False)
    self.assertEqual(made.returncode, 0, made.stderr)
    archive, = self.folder.iterdir()
    self.assertRegex(archive.name, r"^craftfleet-\d+\.\d+\.\d+-linux-\w+(-cuda)?\.tar\.xz$")
    self.assertIn(str(archive), made.stdout)
    with tarfile.open(archive) as tar:
      tar.extractall(self.folder / "else where")
    archive.unlink()
    root, = (self.folder / "else where").iterdir()
    self.assertEqual(root.name, archive.name.removesuffix(".tar.xz"))
    return root

  def test_a_moved_bundle_trains_with_its_own_libraries(self):
    root = self.bundle()
    libtorch = cmake_setting("CRAFTFLEET_LIBTORCH_LIB_DIR")
    environment = {"PATH": "/usr/bin:/bin", "CRAFTFLEET_LIBTORCH": libtorch}

    def run(*words):
      ended = subprocess.run([root / "bin" / words[0], *words[1:]], capture_output=True, text=True, check=False, env=environment,
                             timeout=120)
      self.assertEqual(ended.returncode, 0, ended.stderr)
      return ended.stdout

    for program in sorted((root / "bin").iterdir()):
      self.assertIn(program.name.replace("-", " "), run(program.name, "--version").replace("-", " "))
    self.assertEqual({path.name for path in (root / "bin").iterdir()}, {path.name for path in BIN.glob("craftfleet*") if "_" not in path.name})
    (self.folder / "config.txt").write_text(SMALL_RUN)
    run("craftfleet", "train", f"--config={self.folder}/config.txt", f"--logdir={self.folder}/run", "--device=cpu")
    self.assertTrue((self.folder / "run/stats.jsonl").exists())
    fleet = subprocess.run([root / "share/craftfleet/local-fleet.sh", "--actors=1", "--envservers=1", f"--config={self.folder}/config.txt",
                            f"--logdir={self.folder}/fleet"], capture_output=True, text=True, check=False, env=environment, timeout=200)
    self.assertEqual(fleet.returncode, 0, fleet.stdout + fleet.stderr)
    self.assertEqual((self.folder / "fleet/stats.jsonl").read_bytes(), (self.folder / "run/stats.jsonl").read_bytes())
    self.assertTrue(os.access(root / "share/craftfleet/slurm/fleet.sbatch", os.X_OK))
    self.assertIn("ppo_cnn", run("craftfleet", "sweep", str(root / "share/craftfleet/experiments/paper.toml"), "--list"))

    # A distribution's LibTorch uses libraries of the system; no other library may come from there.
    brought = {os.path.realpath(path) for path in libraries(f"{libtorch}/libtorch.so").values()}
    own = {path.name for path in (root / "lib/craftfleet").iterdir()}
    programs = [path for path in (root / "bin").iterdir() if path.read_bytes()[:4] == b"\x7fELF"] + list((root / "libexec").iterdir())
    self.assertGreater(len(own), 20)
    commands = [path for path in (root / "bin").iterdir() if path.read_bytes().startswith(b"#!/usr/bin/env python3")]
    self.assertEqual({path.name for path in commands}, {"craftfleet-curve", "craftfleet-report", "craftfleet-sweep"})
    self.assertEqual(len(programs) + len(commands), len(list((root / "bin").iterdir())))
    for program in programs:
      launched = {"LD_LIBRARY_PATH": f"{root}/lib/craftfleet:{libtorch}"} if program.parent.name == "libexec" else {}
      for name, path in libraries(program, **launched).items():
        self.assertIsNotNone(path, f"{program.name} finds no {name}")
        # A wheel comes with an OpenMP library of its own, which LibTorch finds first.
        if "/site-packages/torch/lib/libgomp.so" in path:
          continue
        inside = pathlib.Path(os.path.abspath(path)).is_relative_to(root)
        self.assertEqual(inside, name in own, f"{program.name} takes {path}")
        self.assertTrue(inside or GLIBC.search(path) or OF_LIBTORCH.search(path) or os.path.realpath(path) in brought, f"{program.name} takes {path}")
      self.assertFalse([name for name in own if OF_LIBTORCH.search("/" + name)])

  def test_an_empty_root_runs_it(self):
    """A root with glibc, what the launcher runs, and LibTorch where CRAFTFLEET_LIBTORCH says; nothing else of this system."""
    bundle = self.bundle()
    root = self.folder / "root"
    enter = enter_root(root)
    ended = subprocess.run(enter(["true"]), capture_output=True, text=True, check=False)
    if ended.returncode != 0:
      self.skipTest(f"no root can be entered here: {ended.stderr.strip()}")
    shutil.move(bundle, root / "bundle")

    def run(*words, code=0, **environment):
      settings = [f"{name}={value}" for name, value in {"PATH": "/bin", **environment}.items()]
      ended = subprocess.run(enter(["/bin/env", "-i", *settings, *words]), capture_output=True, text=True, check=False, timeout=120)
      self.assertEqual(ended.returncode, code, ended.stderr)
      return ended.stderr if code else ended.stdout

    for program in sorted((root / "bundle/bin").iterdir()):
      if program.read_bytes()[:4] == b"\x7fELF":
        self.assertIn("craftfleet", run(f"/bundle/bin/{program.name}", "--version"))
    missing = run("/bundle/bin/craftfleet", "train", "--logdir=/tmp/run", code=1)
    self.assertRegex(missing, r"^craftfleet-train: no LibTorch: .*pip install.*CRAFTFLEET_LIBTORCH")
    self.assertEqual(len(missing.splitlines()), 1)

    if cmake_setting("CRAFTFLEET_LIBTORCH_CUDA") == "ON":
      return  # gigabytes to copy; test_a_moved_bundle_trains_with_its_own_libraries runs it where it is
    libtorch = pathlib.Path(cmake_setting("CRAFTFLEET_LIBTORCH_LIB_DIR"))
    brought = {name: path for name, path in libraries(libtorch / "libtorch.so").items() if path and not GLIBC.search(path)}
    for path in (*libtorch.glob("libtorch*.so*"), *libtorch.glob("libc10*.so*"), *map(pathlib.Path, brought.values())):
      shutil.copy(path, root / "libtorch" / path.name)
    (root / "tmp/config.txt").write_text(SMALL_RUN)
    run("/bundle/bin/craftfleet", "train", "--config=/tmp/config.txt", "--logdir=/tmp/run", "--device=cpu", CRAFTFLEET_LIBTORCH="/libtorch")
    self.assertTrue((root / "tmp/run/stats.jsonl").read_text())
    run("/bundle/bin/craftfleet", "curve", "--out=/tmp/curve.png", "/tmp/run")
    self.assertEqual((root / "tmp/curve.png").read_bytes()[1:4], b"PNG")

  def test_a_folder_without_a_build_is_refused(self):
    for flags, reason in ((["--build=/nowhere"], "--build=/nowhere: no build there"), (["--level=12"], "unknown argument '--level=12'")):
      ended = subprocess.run([SOURCE / "deploy/bundle.sh", f"--out={self.folder}", *flags], capture_output=True, text=True, check=False)
      self.assertEqual(ended.returncode, 2)
      self.assertIn(reason, ended.stderr)
    self.assertEqual(list(self.folder.iterdir()), [])


class Launcher(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    self.root = self.folder / "bundle"
    for name in ("bin", "libexec", "lib/craftfleet"):
      (self.root / name).mkdir(parents=True)
    shutil.copy(LAUNCHER, self.root / "bin/craftfleet-train")
    program = self.root / "libexec/craftfleet-train"
    program.write_text('#!/bin/sh\necho "$LD_LIBRARY_PATH"\nfor word; do echo "$word"; done\n')
    program.chmod(0o755)
    self.describe()

  def describe(self, libtorch="2.11", glibc="2.17"):
    (self.root / "lib/craftfleet/bundle.env").write_text(f"LIBTORCH_VERSION={libtorch}\nGLIBC_VERSION={glibc}\n")

  def libtorch(self, folder, version="2.11.0+cu130"):
    """Makes a LibTorch as in a wheel, where a Python that searches `folder` finds it. Returns its library folder."""
    package = self.folder / folder / "torch"
    (package / "lib").mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('not to be imported')\n")
    (package / "version.py").write_text(f"from typing import Optional\n__version__ = '{version}'\n")
    (package / "lib/libtorch_cpu.so").touch()
    return package / "lib"

  def launch(self, *arguments, program=None, cwd=None, **environment):
    return subprocess.run([program or self.root / "bin/craftfleet-train", *arguments], capture_output=True, text=True, check=False, cwd=cwd,
                          env={"PATH": os.environ["PATH"], "PYTHONDONTWRITEBYTECODE": "1", **environment})

  def assert_found(self, library_folder, ended, arguments=()):
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertEqual(ended.stdout.splitlines(), [f"{self.root}/lib/craftfleet:{library_folder}", *arguments])

  def assert_refused(self, reason, ended):
    self.assertEqual(ended.returncode, 1)
    self.assertEqual(ended.stdout, "")
    self.assertRegex(ended.stderr, reason)
    self.assertEqual(len(ended.stderr.splitlines()), 1)

  def test_the_variable_comes_before_python(self):
    in_python, named = self.libtorch("python"), self.libtorch("named")
    self.assert_found(in_python, self.launch(PYTHONPATH=str(self.folder / "python")))
    self.assert_found(named, self.launch(PYTHONPATH=str(self.folder / "python"), CRAFTFLEET_LIBTORCH=str(self.folder / "named")))
    self.assert_found(in_python, self.launch(PYTHONPATH=str(self.folder / "python"), CRAFTFLEET_LIBTORCH=""))

  def test_a_torch_in_the_current_folder_is_not_meant(self):
    here, in_python = self.libtorch("here"), self.libtorch("python")
    alone = self.launch(cwd=self.folder / "here")  # with the torch of this python3, if it has one
    self.assertNotIn(str(here), alone.stdout + alone.stderr)
    self.assert_found(in_python, self.launch(cwd=self.folder / "here", PYTHONPATH=str(self.folder / "python")))
    self.assert_found(here, self.launch(cwd=self.folder / "here", PYTHONPATH=str(self.folder / "here")))

  def test_the_variable_names_any_folder_around_the_libraries(self):
    site = "venv/lib/python3.12/site-packages"
    library_folder = self.libtorch(site)
    for folder in (library_folder, library_folder.parent, self.folder / site, self.folder / "venv"):
      self.assert_found(library_folder, self.launch(CRAFTFLEET_LIBTORCH=str(folder)))
    archive = self.folder / "unpacked/libtorch"
    (archive / "lib").mkdir(parents=True)
    (archive / "lib/libtorch_cpu.so").touch()
    (archive / "build-version").write_text("2.11.0+cpu\n")
    for folder in (archive, archive.parent):
      self.assert_found(archive / "lib", self.launch(CRAFTFLEET_LIBTORCH=str(folder)))
    system = self.folder / "system"
    system.mkdir()
    for version in ("2.11", "2.11.0"):
      (system / f"libtorch_cpu.so.{version}").touch()
    self.assert_found(system, self.launch(CRAFTFLEET_LIBTORCH=str(system)))

  def test_arguments_links_and_library_path_pass_through(self):
    library_folder = self.libtorch("named")
    link = self.folder / "my-train"
    link.symlink_to(self.root / "bin/craftfleet-train")
    named = {"CRAFTFLEET_LIBTORCH": str(self.folder / "named")}
    self.assert_found(library_folder, self.launch("--a=b c", "", program=link, **named), ["--a=b c", ""])
    self.assert_found(f"{library_folder}:/mine", self.launch(LD_LIBRARY_PATH="/mine", **named))

  def test_the_error_names_what_is_missing(self):
    advice = r"activate a Python environment with torch 2\.11 \(pip install 'torch==2\.11\.\*'\), or set CRAFTFLEET_LIBTORCH"
    # First without Python, then with a Python that has no torch.
    tools = self.folder / "tools"
    tools.mkdir()
    for tool in ("sh", "readlink", "basename", "dirname", "getconf", "sed", "sort", "head"):
      (tools / tool).symlink_to(shutil.which(tool))
    self.assert_refused(rf"^craftfleet-train: no LibTorch: .*{advice}", self.launch(PATH=str(tools)))
    (tools / "python3").write_text("#!/bin/sh\necho\n")
    (tools / "python3").chmod(0o755)
    self.assert_refused(rf"no LibTorch: python3 has no torch; {advice}", self.launch(PATH=str(tools)))
    self.assert_refused(rf"CRAFTFLEET_LIBTORCH=/nowhere: no LibTorch there; {advice}", self.launch(CRAFTFLEET_LIBTORCH="/nowhere"))

  def test_another_version_is_refused(self):
    for version, said in (("2.1.1", r"2\.1"), ("2.110.0", r"2\.110"), ("1.13.1", r"1\.13"), ("?", "of unknown version")):
      folder = f"torch-{version}"
      library_folder = self.libtorch(folder, version)
      self.assert_refused(rf"LibTorch in {re.escape(str(library_folder))} is {said}, want 2\.11; ",
                          self.launch(CRAFTFLEET_LIBTORCH=str(self.folder / folder)))

  def test_an_older_glibc_is_refused(self):
    self.libtorch("named")
    self.describe(glibc="9.9")
    self.assert_refused(r"this system has glibc \d+\.\d+, want 9\.9 or newer", self.launch(CRAFTFLEET_LIBTORCH=str(self.folder / "named")))


python_case.main()

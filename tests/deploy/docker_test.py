"""deploy/docker: the files and packages in the Dockerfiles exist, and the environment server's image runs as in a container.

No daemon is needed: the image's file system is assembled from this build and entered by chroot.
"""

import os
import pathlib
import re
import shlex
import shutil
import subprocess
import tempfile
import unittest

from tests.deploy.flags import unknown_flags
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE, cmake_setting, wait_until

DOCKER = SOURCE / "deploy/docker"
DOCKERFILES = ("Dockerfile", "Dockerfile.envserver", "Dockerfile.gpu")
ENVSERVER_MIB = 60  # the maximum size of the files in its image
FOREIGN = re.compile(r"torch|opencv|gdal", re.IGNORECASE)  # libraries that the environment server must not load


def instructions(name):
  """The instructions of a Dockerfile, (instruction, arguments) with continued lines joined."""
  text = (DOCKER / name).read_text(encoding="utf-8")
  lines = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)).splitlines()
  return [tuple(line.split(None, 1)) for line in lines if line.strip()]


def packages(run):
  """The packages that a RUN instruction installs with apt-get."""
  return {word for command in re.findall(r"apt-get install ([^&]*)", run) for word in command.split() if not word.startswith("-")}


def known_packages():
  script = (SOURCE / "deploy/install-deps.sh").read_text(encoding="utf-8")
  block = re.search(r"^packages=\(\n(.*?)^\)", script, re.DOTALL | re.MULTILINE)[1]
  return {word for line in block.splitlines() for word in line.partition("#")[0].split()}


def packages_of_libraries(programs):
  """The libraries that the programs need directly: name -> Debian packages that contain it."""
  text = subprocess.run(["readelf", "-d", *programs], capture_output=True, text=True, check=True).stdout
  found = {library: set() for library in re.findall(r"\(NEEDED\).*\[(.*)\]", text)}
  text = subprocess.run(["dpkg-query", "--search", *[f"*/{library}" for library in found]], capture_output=True, text=True,
                        check=False).stdout
  for line in text.splitlines():
    package, _, path = line.partition(": ")
    library = path.rpartition("/")[2]
    if library in found:  # not one whose name only begins alike
      found[library].add(package.partition(":")[0])
  return found


class Dockerfiles(unittest.TestCase):

  def test_files_that_are_copied_are_there_and_not_ignored(self):
    ignored = [line.rstrip("/") for line in (SOURCE / ".dockerignore").read_text(encoding="utf-8").splitlines()
               if line and not line.startswith("#")]
    for name in DOCKERFILES:
      stages = set()
      for instruction, arguments in instructions(name):
        if instruction == "FROM":
          image, *alias = arguments.split(" AS ")
          self.assertIn(image, ("debian:12-slim", "scratch"))
          stages.update(alias)
        if instruction == "COPY" and "--from=" in arguments:
          self.assertIn(re.search(r"--from=(\S+)", arguments)[1], stages)
        elif instruction == "COPY":
          for source in arguments.split()[:-1]:
            self.assertTrue((SOURCE / source).exists(), source)
            self.assertFalse(any(pathlib.PurePath(source).match(pattern) for pattern in ignored), source)
        for script in re.findall(r"/src/(\S+\.sh)", arguments):
          self.assertTrue(os.access(SOURCE / script, os.X_OK), script)
    for needed in ("deploy/k8s", "envserver/textures", "deploy/experiments/paper.toml", "CMakeLists.txt"):
      self.assertFalse(any(pathlib.PurePath(needed).match(pattern) for pattern in ignored), needed)

  def test_packages_are_those_that_the_project_is_built_with(self):
    run, = [arguments for instruction, arguments in instructions("Dockerfile.envserver") if instruction == "RUN" and packages(arguments)]
    self.assertGreater(len(packages(run)), 10)
    self.assertEqual(packages(run) - known_packages(), set())
    builds = [arguments for instruction, arguments in instructions("Dockerfile") if instruction == "RUN"]
    self.assertIn("/src/deploy/install-deps.sh", builds[0])

  def test_the_gpu_image_has_the_libraries_of_the_other_but_another_libtorch(self):
    def installed(name):
      run, = [arguments for instruction, arguments in instructions(name) if instruction == "RUN" and packages(arguments)]
      return packages(run)
    debians = {"libtorch1.13", "libopenblas0-pthread"}
    self.assertEqual(installed("Dockerfile.gpu"), installed("Dockerfile") - debians | {"python3"})

  def test_programs_of_images_need_no_library_for_windows(self):
    for name in ("Dockerfile", "Dockerfile.gpu"):
      build, = [arguments for instruction, arguments in instructions(name) if instruction == "RUN" and "cmake -S" in arguments]
      self.assertIn(" -DCRAFTFLEET_WITH_WINDOW=OFF ", build, name)

  def test_every_library_of_the_programs_is_in_a_package_of_the_image(self):
    for tool in ("readelf", "dpkg-query"):
      if shutil.which(tool) is None:
        self.skipTest(f"no {tool} here")
    if "VERSION_ID=\"12\"" not in pathlib.Path("/etc/os-release").read_text(encoding="utf-8"):
      self.skipTest("the images have Debian 12's packages")
    if b"__asan_init" in (BIN / "craftfleet").read_bytes():
      self.skipTest("programs under AddressSanitizer want other libraries than those of an image")
    folder = cmake_setting("CRAFTFLEET_LIBTORCH")
    image = "Dockerfile.gpu" if folder else "Dockerfile"
    copied = {path.name for path in pathlib.Path(folder).rglob("*.so*")} if folder else set()
    run, = [arguments for instruction, arguments in instructions(image) if instruction == "RUN" and packages(arguments)]
    base = {"libc6", "libstdc++6", "libgcc-s1"}  # in the base image, or required by every C++ library
    found = packages_of_libraries(sorted(path for path in BIN.glob("craftfleet*") if path.read_bytes()[:4] == b"\x7fELF"))
    self.assertGreater(len(found), 20)
    for library, owners in found.items():
      if library.startswith("libopencv_highgui") or library in copied:
        continue  # only for windows, which this build may have; or part of LibTorch, which the GPU image copies
      self.assertTrue(owners & (packages(run) | base), f"a program wants {library}, of {owners}")

  def test_a_checkout_without_what_is_ignored_is_not_called_changed(self):
    source = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory())) / "src"
    source.mkdir()
    git = ["git", "-C", source, "-c", "user.name=t", "-c", "user.email=t@t"]
    for line in (SOURCE / ".dockerignore").read_text(encoding="utf-8").split():
      if line.endswith("/") and "*" not in line:
        (source / line).mkdir(parents=True)
        (source / line / "file").touch()
    (source / "CMakeLists.txt").touch()
    for command in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message=all"]):
      subprocess.run([*git, *command], check=True)
    (source.parent / "in").write_text("@GIT_REVISION@", encoding="utf-8")

    def revision():
      subprocess.run(["cmake", f"-DSOURCE_DIR={source}", f"-DINPUT={source.parent}/in", f"-DOUTPUT={source.parent}/out", "-P",
                      SOURCE / "cmake/version.cmake"], check=True)
      return (source.parent / "out").read_text(encoding="utf-8")

    for file in source.rglob("*/file"):
      if ".git" not in file.parts:
        file.unlink()
    self.assertRegex(revision(), "^[0-9a-f]{7,40}$")
    (source / "CMakeLists.txt").write_text("changed", encoding="utf-8")
    self.assertRegex(revision(), "^[0-9a-f]{7,40}-dirty$")

  def test_matplotlib_has_a_folder_under_a_read_only_root(self):
    tried = subprocess.run(["unshare", "--mount", "true"], capture_output=True, text=True, check=False)
    if tried.returncode != 0 or subprocess.run(["/usr/bin/python3", "-c", "import matplotlib"], capture_output=True, check=False).returncode:
      self.skipTest("want root and matplotlib")
    for name in ("Dockerfile", "Dockerfile.gpu"):
      variables = [word for instruction, arguments in instructions(name) if instruction == "ENV" for word in shlex.split(arguments)]
      drawn = subprocess.run(
          ["unshare", "--mount", "sh", "-c", "mount -t tmpfs tmpfs /dev/shm && mount -o remount,bind,ro / && exec \"$@\"", "-", "env", "-i",
           "PATH=/usr/bin:/bin", "HOME=/home/craftfleet", *variables, "/usr/bin/python3", "-c", "import matplotlib; print(matplotlib.get_cachedir())"],
          capture_output=True, text=True, check=False, cwd="/")
      self.assertEqual((drawn.returncode, drawn.stdout), (0, "/dev/shm/matplotlib\n"), drawn.stderr)

  def test_images_run_without_root_and_watch_their_health(self):
    for name in DOCKERFILES:
      last = dict(instructions(name))  # a repeated instruction has the value of the last stage
      self.assertRegex(last["USER"], r"^[1-9]\d{3,}:[1-9]\d{3,}$")
      self.assertEqual(last["STOPSIGNAL"], "SIGTERM")
      check = re.findall(r"--(?:address|tryfromenv)[=\w.,:]*", last["HEALTHCHECK"])
      self.assertGreater(len(check), 0)
      names = [f"--{flag}=x" for argument in check for flag in argument.partition("--tryfromenv=")[2].split(",") if flag]
      self.assertEqual(unknown_flags("craftfleet status", names), [])


class EnvserverImage(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    self.root = self.folder / "root"
    subprocess.run([DOCKER / "closure.sh", self.root, BIN.parent, "craftfleet-envserver", "craftfleet"], check=True)

  def command(self, *words):
    """Runs a program as in a container: read-only root, with /proc, without root privileges and any way to gain them."""
    root = shlex.quote(str(self.root))
    return ["unshare", "--mount", "sh", "-c",
            f"mount --bind {root} {root} && mount --bind /proc {root}/proc && mount -o remount,bind,ro {root} && "
            f"exec setpriv --no-new-privs chroot --userspec=10001:10001 {root} {shlex.join(words)}"]

  def test_the_image_is_small_and_has_no_foreign_library(self):
    if b"__asan_init" in (BIN / "craftfleet-envserver").read_bytes():
      self.skipTest("programs under AddressSanitizer are several times as large")
    size = sum(path.lstat().st_size for path in self.root.rglob("*") if path.is_file() and not path.is_symlink()) / 2**20
    print(f"environment server's image: {size:.0f} MiB")
    self.assertLess(size, ENVSERVER_MIB)
    self.assertEqual([path for path in self.root.rglob("*") if FOREIGN.search(path.name)], [])
    self.assertEqual(list(self.root.rglob("*.png")), [], "the textures are compiled in")
    self.assertEqual([path.name for path in (self.root / "usr/local/bin").iterdir() if not path.name.startswith("craftfleet")], [])

  def test_the_environment_server_runs_in_its_image(self):
    tried = subprocess.run(["unshare", "--mount", "true"], capture_output=True, text=True, check=False)
    if tried.returncode != 0:
      self.skipTest(f"no mounts of its own: {tried.stderr.strip()}; want root")
    (self.root / "proc").mkdir()
    log = self.folder / "log"
    with open(log, "wb") as out:
      server = subprocess.Popen(self.command("/usr/local/bin/craftfleet-envserver", "--listen=127.0.0.1:0"), stdout=out, stderr=out)
    self.addCleanup(server.wait)
    self.addCleanup(server.kill)

    def address():
      self.assertIsNone(server.poll(), log.read_text())
      return re.search(r"listening on (\S+)", log.read_text())

    check = dict(instructions("Dockerfile.envserver"))["HEALTHCHECK"]
    words = [word.strip(' "') for word in check[check.index("[") + 1:check.index("]")].split('", ')]
    asked = subprocess.run(["env", f"FLAGS_address={wait_until(address, 'an address')[1]}", *self.command("/usr/local/bin/" + words[0], *words[1:])],
                           capture_output=True, text=True, check=False)
    self.assertEqual(asked.returncode, 0, asked.stdout + asked.stderr)
    self.assertIn("envserver", asked.stdout)
    server.terminate()
    self.assertEqual(server.wait(timeout=20), 0, log.read_text())


python_case.main()

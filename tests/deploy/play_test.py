"""craftfleet play: episodes in a window on a virtual display, and in a terminal."""

import contextlib
import fcntl
import os
import pty
import re
import shlex
import signal
import struct
import subprocess
import termios

from tests.fakes import python_case
from tests.fakes.python_case import BIN, built, wait_until
from tests.fakes.screens import Display, Tmux

PLAY = built("craftfleet play")


class Play(python_case.FolderCase):

  def recorded(self):
    """Name of the video of the only recorded episode; its NumPy file has the same."""
    video, table = sorted((self.folder / "recordings").iterdir())
    self.assertEqual((video.stem, video.suffix, table.suffix), (table.stem, ".mp4", ".npz"))
    return video.name

  def test_in_a_terminal(self):
    command = shlex.join([*map(str, PLAY), "--terminal", "--wait", "--seed=3", f"--record={self.folder}/recordings"])
    with Tmux(self.folder, command) as terminal:
      terminal.wait_for("seed 3, episode 1")
      terminal.press("h")
      terminal.wait_for("place a table")
      terminal.press("h")
      for number, key in enumerate(["a", "Right", "Space", "Tab", "."], start=1):
        terminal.press(key)
        terminal.wait_for(f"step {number},")
      self.assertGreater(len(terminal.colors()), 10)
      terminal.press("n")
      terminal.wait_for("seed 3, episode 2")
      terminal.press("a")
      terminal.wait_for("step 1,")
      terminal.press("q")
      terminal.wait_for_exit(0)
      self.assertIn("crafter, seed 3, episode 2: 1 steps", terminal.page())
    names = [path.name[15:] for path in sorted((self.folder / "recordings").iterdir())]
    self.assertEqual(names, [f"-episode000{end}" for end in ("1-ach0-len5.mp4", "1-ach0-len5.npz", "2-ach0-len1.mp4", "2-ach0-len1.npz")])

  def test_a_terminal_gets_no_colours_that_it_does_not_have(self):
    for variables, wanted, unwanted in (({"TERM": "xterm-256color"}, b"8;5;", b"8;2;"), ({"TERM": "linux"}, b"\x1b[4", b"8;5;"),
                                        ({"TERM": "linux"}, b"\x1b[4", b"8;2;"), ({"TERM": "xterm", "COLORTERM": "truecolor"}, b"8;2;", b"8;5;")):
      with self.subTest(variables):
        environment = {name: value for name, value in os.environ.items() if name != "COLORTERM"} | variables
        master, terminal = pty.openpty()
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
        process = subprocess.Popen([*PLAY, "--terminal", "--wait", "--seed=3"], stdin=terminal, stdout=terminal, env=environment)
        self.addCleanup(process.kill)
        os.close(terminal)
        os.write(master, b"q")
        shown = b""
        with contextlib.suppress(OSError):  # the end of a terminal
          while part := os.read(master, 65536):
            shown += part
        os.close(master)
        self.assertEqual(process.wait(20), 0)
        self.assertIn(wanted, shown)
        self.assertNotIn(unwanted, shown)

  def test_without_its_terminal_it_ends_even_if_hangups_are_ignored(self):
    master, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    process = subprocess.Popen([*PLAY, "--terminal", "--wait", "--seed=3"], stdin=terminal, stdout=terminal, stderr=subprocess.PIPE)
    signal.signal(signal.SIGHUP, before)
    self.addCleanup(process.kill)
    os.close(terminal)
    os.read(master, 65536)  # it has begun
    os.close(master)
    _, errors = process.communicate(timeout=20)
    self.assertEqual((process.returncode, errors), (0, b""))

  def test_a_signal_restores_the_terminal_and_keeps_the_recording(self):
    command = shlex.join([*map(str, PLAY), "--terminal", "--fps=20", "--seed=3", f"--record={self.folder}/recordings"])
    with Tmux(self.folder, f"{command}; stty -a | tr ' ;' '\\n\\n' | grep -x -e -echo -e echo") as terminal:
      terminal.resize(120, 40)
      wait_until(lambda: re.search(r"step \d\d", terminal.page()), "ten steps on the terminal")  # each stands for 50 ms
      pid, = (pid for pid in python_case.processes_with(f"--record={self.folder}")
              if python_case.command_line(pid).startswith(str(BIN / "craftfleet-play")))
      os.kill(pid, 15)
      terminal.wait_for_exit(0)
      self.assertIn("crafter, seed 3, episode 1: ", terminal.page())
      self.assertRegex(terminal.page(), r"(?m)^echo$")
    self.recorded()

  def test_a_small_terminal_is_refused(self):
    with Tmux(self.folder, shlex.join([*map(str, PLAY), "--terminal"]), columns=40, rows=10) as terminal:
      wait_until(lambda: "want at least" in terminal.page().replace("\n", ""), "the error")

  def test_in_a_window(self):
    with Display(self.folder) as display:
      process = subprocess.Popen([*PLAY, "--wait", "--seed=3", "--size=288", f"--record={self.folder}/recordings"],
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=display.environment)
      self.addCleanup(process.kill)
      window = display.window("craftfleet play", process)
      for key in ("d", "Up", "space", "z", "h", "h", "period"):
        display.press(window, key)
      display.press_until_exit(window, "Escape", process)
      output, errors = process.communicate(timeout=60)
      self.assertEqual((process.returncode, errors), (0, ""))
      self.assertRegex(output, "^crafter, seed 3, episode 1: [1-5] steps")
    self.assertRegex(self.recorded(), "len[1-5]")

  def test_without_a_display_it_says_what_to_do(self):
    nowhere = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    for display, expected in [({}, "there is no display"), ({"DISPLAY": ":987"}, "cannot open a window on the display :987")]:
      ended = subprocess.run(PLAY, capture_output=True, text=True, timeout=60, env={**nowhere, **display}, check=False)
      self.assertEqual((ended.returncode, ended.stdout), (1, ""))
      self.assertIn(expected, ended.stderr)
      self.assertIn("--terminal", ended.stderr)

  def test_the_display_is_tried_before_anything_is_recorded(self):
    # The encoder of a video starts threads, and the child that tries the display must not inherit a lock of one of them.
    folder = self.folder / "recordings"
    ended = subprocess.run([*PLAY, f"--record={folder}"], capture_output=True, text=True, timeout=60,
                           env={**os.environ, "DISPLAY": ":987"}, check=False)
    self.assertIn("cannot open a window", ended.stderr)
    self.assertFalse(folder.exists())

  def test_the_terminal_is_checked_before_anything_is_recorded(self):
    folder = self.folder / "recordings"
    ended = self.run_program("craftfleet play", "--terminal", f"--record={folder}", code=1)
    self.assertIn("--terminal: standard input and output are not a terminal", ended.stderr)
    self.assertFalse(folder.exists())

  def test_bad_flags_are_refused(self):
    for flag, expected in [("--fps=0", "--fps=0, want 0.1..60"), ("--size=5000", "--size=5000, want 64..1024"),
                           ("--env=cr", "--env: "), ("--episode=0", "--episode=0, want 1..1000000000"),
                           ("--textures=/nowhere", "--textures=/nowhere: "), ("--terminal", "--terminal: standard input")]:
      ended = self.run_program("craftfleet play", flag, code=1)
      self.assertIn(expected, ended.stderr)


if __name__ == "__main__":
  python_case.main()

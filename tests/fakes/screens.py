"""Terminals and displays on which tests run programs. A test is skipped where their tools are missing."""

import os
import re
import shutil
import subprocess
import time
import unittest

from tests.fakes.python_case import wait_until


def need(*tools):
  for tool in tools:
    if shutil.which(tool) is None:
      raise unittest.SkipTest(f"{tool} is missing: deploy/install-deps.sh --tests installs it")


class Tmux:
  """A terminal that runs `command` by a shell and stays open after it. For `with`."""

  def __init__(self, folder, command, columns=100, rows=30):
    need("tmux")
    self._socket = str(folder / "tmux")
    self._run("-f", "/dev/null", "new-session", "-d", "-x", str(columns), "-y", str(rows), f"{command}; echo exit $?; sleep 1000")

  def __enter__(self):
    return self

  def __exit__(self, *_):
    subprocess.run(["tmux", "-S", self._socket, "kill-server"], capture_output=True, check=False)

  def _run(self, *words):
    return subprocess.run(["tmux", "-S", self._socket, *words], capture_output=True, text=True, check=True).stdout

  def press(self, key):
    """A key as tmux names it: "a", "Space", "Right"."""
    self._run("send-keys", key)

  def resize(self, columns, rows):
    self._run("resize-window", "-x", str(columns), "-y", str(rows))

  def page(self):
    """The text on the terminal."""
    return self._run("capture-pane", "-p", "-J")

  def wait_for(self, text):
    wait_until(lambda: text in self.page(), f"{text!r} on the terminal")

  def wait_for_exit(self, code):
    self.wait_for(f"exit {code}")

  def colors(self):
    """The 24-bit background colours on the terminal, as "red;green;blue"."""
    return set(re.findall(r"48;2;(\d+;\d+;\d+)m", self._run("capture-pane", "-p", "-e")))


class Display:
  """A virtual display. For `with`."""

  def __init__(self, folder):
    need("Xvfb", "xdotool")
    reading, writing = os.pipe()
    self._server = subprocess.Popen(["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
                                    pass_fds=[writing], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(writing)
    with open(reading, encoding="utf-8") as numbers:
      self.environment = {**os.environ, "DISPLAY": ":" + numbers.readline().strip(), "XDG_RUNTIME_DIR": str(folder)}

  def __enter__(self):
    return self

  def __exit__(self, *_):
    self._server.terminate()
    self._server.wait()

  def _xdotool(self, *words):
    return subprocess.run(["xdotool", *words], capture_output=True, text=True, env=self.environment, check=False).stdout.split()

  def window(self, title):
    """Waits for a visible window and gives it the focus. Returns its id."""
    window = wait_until(lambda: self._xdotool("search", "--onlyvisible", "--name", title), f"a window {title!r}")[-1]
    self._xdotool("windowfocus", "--sync", window)
    return window

  def press(self, window, *keys):
    """Keys as X11 names them: "a", "space", "Up". A program sees only the last of the keys that come while it does not wait for one."""
    for key in keys:
      self._xdotool("key", "--window", window, key)
      time.sleep(0.3)

  def press_until_exit(self, window, key, process):
    """Presses a key again and again until the process ends."""
    def ended():
      self.press(window, key)
      return process.poll() is not None
    wait_until(ended, f"the end after {key}")

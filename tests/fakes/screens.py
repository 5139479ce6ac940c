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
    self._run("-f", "/dev/null", "new-session", "-d", "-e", "COLORTERM=truecolor", "-x", str(columns), "-y", str(rows),
              f"{command}; echo exit $?; sleep 1000")

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
    self._log = folder / "Xvfb.log"
    # Without -noreset the server starts anew whenever its last client leaves, such as the child with which a program tries the
    # display, and the next client may lose its window.
    with open(self._log, "w", encoding="utf-8") as log:
      self._server = subprocess.Popen(["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x800x24", "-nolisten", "tcp",
                                       "-noreset"], pass_fds=[writing], stdout=log, stderr=log)
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

  def window(self, title, process):
    """Waits for a visible window of `process` and gives it the focus. Returns its id. If the process ends or shows none, kills it
    and fails with its output, where that is a pipe, and the X server's."""
    windows = []

    def has_shown_or_ended():
      windows.extend(self._xdotool("search", "--onlyvisible", "--name", title))
      return windows or process.poll() is not None

    try:
      wait_until(has_shown_or_ended, f"a window {title!r}")
    except AssertionError as error:
      self._fail(str(error), process)
    if not windows:
      self._fail(f"no window {title!r}: exit code {process.returncode}", process)
    self._xdotool("windowfocus", "--sync", windows[-1])
    return windows[-1]

  def _fail(self, text, process):
    process.kill()
    output, errors = process.communicate()
    raise AssertionError(f"{text}\noutput: {output}\nerrors: {errors}\nX server, exit code {self._server.poll()}: "
                         f"{self._log.read_text()}")

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

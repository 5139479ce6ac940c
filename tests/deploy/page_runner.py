"""Runs the commands of a page in order in a clean checkout, with runs of a few seconds.

The programs in the checkout's build/bin are wrappers that run the real ones on a smaller task: they keep the flags of the page
and add others. Ports are replaced by free ones. Commands that serve until they are stopped run in the background, and must
end without an error when they are stopped. Those that show a game get a virtual display or a terminal, and the key q.
"""

import os
import pathlib
import re
import signal
import subprocess
import time

from tests.fakes.python_case import BIN, SMALL_RUN, SOURCE, free_port
from tests.fakes.screens import Display, Tmux

# name of a program -> a shell command that runs the real one, $REAL, with the arguments of the page, "$@".
SMALLER = {
    "craftfleet-learner": 'exec "$REAL" --config="$SMALL" "$@" --lanes=4',
    "craftfleet": """case "$* " in
"train"*" --resume "*) ;;
"train"*" --config="*) set -- "$@" --steps=192 --lanes=4 ;;
"train "*) set -- "$@" --config="$SMALL" --steps=192 --lanes=4 ;;
"eval "*) set -- "$@" --episodes=1 ;;
"sweep"*" --list "*) ;;
"sweep "*) set -- "$@" --seeds=1 --steps=1 ;;
"top "*) set -- "$@" --once ;;
"doctor "*) set -- "$@" --listen=127.0.0.1:0 ;;
esac
exec "$REAL" "$@"
""",
}
SERVES = re.compile(r"(build/bin/craftfleet-(learner|actor|envserver)|deploy/local-fleet\.sh) ")
SHOWS = re.compile(r"build/bin/craftfleet (watch|play)(?!.*--(video|strip)=)")
ASKS = re.compile(r"build/bin/craftfleet (status|top|admin) ")  # queries to a fleet that may still be starting


class PageRunner:

  def __init__(self, case, folder):
    self.case, self.checkout = case, pathlib.Path(folder) / "checkout"
    self.serving, self.ports = [], {}
    self.link_below(SOURCE / "deploy", self.checkout / "deploy")
    bin_folder = self.checkout / "build/bin"
    bin_folder.mkdir(parents=True)
    (self.checkout / "build/share").symlink_to(BIN.parent / "share")
    small = self.checkout / "small.txt"
    small.write_text(SMALL_RUN.replace("final_episodes: 0", "final_episodes: 1"))
    for program in BIN.iterdir():
      if not program.name.startswith("craftfleet"):
        continue
      run = SMALLER.get(program.name, 'exec "$REAL" "$@"')
      (bin_folder / program.name).write_text(f'#!/bin/sh\nREAL={program} SMALL={small}\n{run}\n')
      (bin_folder / program.name).chmod(0o755)

  @staticmethod
  def link_below(source, target):
    target.mkdir(parents=True)
    for path in source.iterdir():
      (target / path.name).symlink_to(path)

  def run(self, commands):
    try:
      for command in commands:
        self.run_one(re.sub(r":(50\d\d\d)\b", self.port, command))
      self.stop()
    finally:
      for command, process, _ in self.serving:
        if process.poll() is None:
          os.killpg(process.pid, signal.SIGKILL)
          process.wait()

  def port(self, match):
    return f":{self.ports.setdefault(match[1], free_port())}"

  def run_one(self, command):
    if SHOWS.match(command):
      self.run_on_screen(command)
      return
    if SERVES.match(command):
      log = open(self.checkout / f"serving-{len(self.serving)}.log", "w+", encoding="utf-8")  # closed by stop()
      process = subprocess.Popen(["bash", "-c", "exec " + command], cwd=self.checkout, stdout=log, stderr=log, start_new_session=True)
      self.serving.append((command, process, log))
      return
    end = time.monotonic() + (60 if ASKS.match(command) else 0)
    while True:
      ended = subprocess.run(["bash", "-c", command], cwd=self.checkout, capture_output=True, text=True, check=False, timeout=300)
      if ended.returncode == 0 or time.monotonic() > end:
        break
      time.sleep(0.5)
    self.case.assertEqual(ended.returncode, 0, f"{command}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}\n{self.logs()}")

  def run_on_screen(self, command):
    """Runs a command that shows a game until a person quits."""
    if "--terminal" in command:
      with Tmux(self.checkout, f"cd {self.checkout} && {command}") as terminal:
        terminal.wait_for("episode ")
        terminal.press("q")
        terminal.wait_for_exit(0)
      return
    with Display(self.checkout) as display:
      process = subprocess.Popen(["bash", "-c", "exec " + command], cwd=self.checkout, env=display.environment, start_new_session=True)
      self.serving.append((command, process, None))
      display.press_until_exit(display.window("^craftfleet (watch|play)$", process), "q", process)
      self.serving.pop()
      self.case.assertEqual(process.returncode, 0, command)

  def logs(self):
    return "\n".join(pathlib.Path(log.name).read_text(encoding="utf-8")[-1500:] for _, _, log in self.serving)

  def stop(self):
    """Stops the background commands in reverse order; some may already have ended without an error."""
    # Before a program has set up its handlers, a signal would kill it. That takes seconds on a busy machine.
    end = time.monotonic() + 60
    while any(process.poll() is None and log.tell() == 0 for _, process, log in self.serving) and time.monotonic() < end:
      time.sleep(0.1)
    time.sleep(1)
    for command, process, log in reversed(self.serving):
      if process.poll() is None:
        process.send_signal(signal.SIGTERM)
      code = process.wait(timeout=60)
      self.case.assertEqual(code, 0, f"{command}\n{self.logs()}")
      log.close()

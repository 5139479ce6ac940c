"""Man pages and completions from deploy/help_files.py cover every program and flag, and work in bash, zsh and man."""

import json
import re
import shutil
import subprocess
import unittest

from tests.fakes import python_case
from tests.fakes.python_case import BIN, built

SHARE = BIN.parent / "share"
BASH = SHARE / "bash-completion/completions"


FLEET = {"craftfleet-learner", "craftfleet-actor", "craftfleet-envserver"}


def described(name):
  """The help of a program, or of a command, which is called like its man page: craftfleet-train."""
  words = built(name if name in FLEET else name.replace("-", " "))
  return json.loads(subprocess.run([*words, "--help_json"], capture_output=True, text=True, check=True).stdout)


def flags_of(name):
  return described(name).get("flags", [])


def programs():
  return sorted(path.name for path in (SHARE / "man/man1").iterdir())


class HelpFiles(python_case.FolderCase):

  def complete(self, *words):
    """The completions that bash offers for the last word."""
    quoted = " ".join(f"'{word}'" for word in words)
    script = (f"source {BASH}/craftfleet\nCOMP_WORDS=({quoted}) COMP_CWORD={len(words) - 1}\n"
              "function=$(complete -p \"$1\" | sed 's/.*-F \\([^ ]*\\) .*/\\1/')\n$function\nprintf '%s\\n' \"${COMPREPLY[@]}\"")
    ended = subprocess.run(["bash", "--norc", "-c", script, "bash", words[0]], capture_output=True, text=True, check=True, cwd=self.folder)
    return ended.stdout.split()

  def test_every_program_has_a_man_page_and_a_completion(self):
    commands = [command["name"] for command in described("craftfleet")["commands"]]
    self.assertLess({"train", "eval", "play", "report", "status"}, set(commands))
    names = {"craftfleet", *FLEET, *(f"craftfleet-{command}" for command in commands)}
    self.assertEqual({name.removesuffix(".1") for name in programs()}, names)
    self.assertEqual({path.name for path in BASH.iterdir()}, {"craftfleet", *FLEET})

  def test_bash_offers_commands(self):
    self.assertEqual(self.complete("craftfleet", "tr"), ["train"])
    self.assertEqual(self.complete("craftfleet", "help", "tr"), ["train"])
    offered = self.complete("craftfleet", "")
    self.assertLess({"train", "eval", "doctor", "status", "help"}, set(offered))

  def test_bash_offers_every_flag(self):
    for name in programs():
      program = name.removesuffix(".1")
      flags = {f"--{flag['name']}" + ("" if flag["type"] == "bool" else "=") for flag in flags_of(program)}
      if program == "craftfleet":
        continue
      if program in FLEET:
        self.assertLess(flags, set(self.complete(program, "--")), program)
      command = program.removeprefix("craftfleet-")
      self.assertLess(flags, set(self.complete("craftfleet", command, "--")), program)
    self.assertEqual(self.complete("craftfleet", "train", "--logd"), ["--logdir="])

  def test_bash_offers_values(self):
    (self.folder / "runs").mkdir()
    self.assertEqual(self.complete("craftfleet", "train", "--logdir", "=", "ru"), ["runs"])
    self.assertEqual(self.complete("craftfleet", "train", "--logdir", "="), ["runs"])
    self.assertEqual(self.complete("craftfleet", "status", "--json", "=", "t"), ["true"])
    self.assertEqual(self.complete("craftfleet", "report", "ru"), ["runs"])

  @unittest.skipIf(shutil.which("zsh") is None, "no zsh here")
  def test_zsh_accepts_its_completion(self):
    path = SHARE / "zsh/site-functions/_craftfleet"
    subprocess.run(["zsh", "-n", path], check=True)
    script = (f"fpath=({path.parent} $fpath); autoload -Uz compinit; compinit -u -d {self.folder}/dump\n"
              "print ${_comps[craftfleet]} ${_comps[craftfleet-learner]}")
    ended = subprocess.run(["zsh", "-f", "-c", script], capture_output=True, text=True, check=True)
    self.assertEqual(ended.stdout.split(), ["_craftfleet", "_craftfleet"], ended.stderr)

  def test_zsh_completion_has_every_command_and_flag(self):
    text = (SHARE / "zsh/site-functions/_craftfleet").read_text(encoding="utf-8")
    for name in programs():
      for flag in flags_of(name.removesuffix(".1")):
        self.assertRegex(text, rf"'--{flag['name']}[=\[]", name)
    self.assertIn("'doctor:", text)

  @unittest.skipIf(shutil.which("groff") is None, "no groff here")
  def test_man_pages_render_without_warnings(self):
    for name in programs():
      ended = subprocess.run(["groff", "-man", "-Tutf8", "-ww", "-P-c", SHARE / "man/man1" / name], capture_output=True, text=True, check=True)
      self.assertEqual(ended.stderr, "", name)
      shown = re.sub(r"\x1b\[[\d;]*m|.\x08", "", ended.stdout)
      for flag in flags_of(name.removesuffix(".1")):
        self.assertRegex(shown, rf"--{flag['name']}\b", name)
      self.assertIn("SEE ALSO", shown)

  @unittest.skipIf(shutil.which("groff") is None, "no groff here")
  def test_man_pages_have_a_synopsis_and_a_line_for_each_statement(self):
    def shown(program):
      page = SHARE / "man/man1" / f"{program}.1"
      text = subprocess.run(["groff", "-man", "-Tascii", "-P-c", page], capture_output=True, text=True, check=True).stdout
      return re.sub(r"\x1b\[[\d;]*m|.\x08", "", text)
    self.assertRegex(shown("craftfleet"), r"SYNOPSIS\n +craftfleet COMMAND \[ARGUMENT\.\.\.\]\n")
    self.assertRegex(shown("craftfleet-report"), r"SYNOPSIS\n +craftfleet report \[FLAG\.\.\.\] DIR\.\.\.\n")
    self.assertRegex(shown("craftfleet-train"), r"\n +only +--steps +and +the +checkpoint +settings +may +change\n")

  def test_help_files_and_licence_are_installed(self):
    ended = subprocess.run(["cmake", "--install", BIN.parent, "--prefix", self.folder / "usr"], capture_output=True, text=True, check=False)
    self.assertEqual(ended.returncode, 0, ended.stderr)
    for path in ("bash-completion/completions/craftfleet-learner", "zsh/site-functions/_craftfleet", "man/man1/craftfleet-train.1",
                 "doc/craftfleet/LICENSE"):
      self.assertTrue((self.folder / "usr/share" / path).is_file(), path)


python_case.main()

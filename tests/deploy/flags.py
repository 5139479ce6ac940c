"""The flags of a program of the build, from its --helpfull."""

import functools
import re
import subprocess

from tests.fakes.python_case import built


@functools.cache
def flags_of(program):
  """The names of its flags, and of those that need no value."""
  text = subprocess.run([*built(program), "--helpfull"], capture_output=True, text=True, check=True).stdout
  flags = re.findall(r"^  --([a-z_]+)( \(default (?:true|false)\))?", text, re.MULTILINE)
  return {name for name, _ in flags}, {name for name, default in flags if default}


def split(argument):
  name, _, value = argument.removeprefix("--").partition("=")
  return name, value


def unknown_flags(program, arguments):
  """The `arguments` that the program would refuse: not a flag, an unknown flag, or a flag without its value."""
  names, bare = flags_of(program)
  return [argument for argument in arguments
          if not re.fullmatch(r"--[a-z_]+(=.+)?", argument) or split(argument)[0] not in names or
          ("=" not in argument and argument[2:] not in bare)]

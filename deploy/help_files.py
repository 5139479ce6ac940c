#!/usr/bin/env python3
"""Generates man pages and completions for bash and zsh from the --help_json of each program and command. Run by the build."""

import argparse
import json
import pathlib
import re
import shutil
import subprocess

FLEET = ("craftfleet-actor", "craftfleet-envserver", "craftfleet-learner")

BASH = r"""# Completion of CraftFleet's programs for bash; made by the build from their flags.

declare -gA _craftfleet_flags=(
@FLAGS@)
declare -gA _craftfleet_bools=(
@BOOLS@)

_craftfleet() {
  local current=${COMP_WORDS[COMP_CWORD]} program=${COMP_WORDS[0]##*/} flag=
  COMPREPLY=()
  if [[ $program == craftfleet ]]; then
    if ((COMP_CWORD == 1)); then
      mapfile -t COMPREPLY < <(compgen -W "@COMMANDS@ help --help --version" -- "$current")
      return
    fi
    if ((COMP_CWORD == 2)) && [[ ${COMP_WORDS[1]} == help ]]; then
      mapfile -t COMPREPLY < <(compgen -W "@COMMANDS@" -- "$current")
      return
    fi
    program=craftfleet-${COMP_WORDS[1]}
  fi
  # bash splits "--json=tr" into three words: the flag, "=" and the beginning of the value.
  if [[ $current == "=" ]]; then
    flag=${COMP_WORDS[COMP_CWORD - 1]} current=
  elif [[ ${COMP_WORDS[COMP_CWORD - 1]} == "=" ]]; then
    flag=${COMP_WORDS[COMP_CWORD - 2]}
  fi
  if [[ -n $flag ]]; then
    if [[ " ${_craftfleet_bools[$program]:-} " == *" $flag "* ]]; then
      mapfile -t COMPREPLY < <(compgen -W "true false" -- "$current")
    else
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -f -- "$current")
    fi
  elif [[ $current == -* ]]; then
    mapfile -t COMPREPLY < <(compgen -W "${_craftfleet_flags[$program]:-} --help --helpfull --version" -- "$current")
    [[ ${#COMPREPLY[@]} != 1 || ${COMPREPLY[0]} != *= ]] || compopt -o nospace 2>/dev/null
  else
    compopt -o filenames 2>/dev/null
    mapfile -t COMPREPLY < <(compgen -f -- "$current")
  fi
}
complete -F _craftfleet craftfleet @FLEET@
"""

ZSH = r"""#compdef craftfleet @FLEET@
# Completion of CraftFleet's programs for zsh; made by the build from their flags.

_craftfleet_flags() {
  case $1 in
@CASES@  esac
}

_craftfleet() {
  local program=${words[1]:t}
  if [[ $program == craftfleet ]]; then
    if ((CURRENT == 2)) || [[ $CURRENT == 3 && ${words[2]} == help ]]; then
      local -a commands=(
@COMMANDS@      )
      _describe command commands
      return
    fi
    program=craftfleet-${words[2]}
    shift words
    ((CURRENT--))
  fi
  _craftfleet_flags $program
}

_craftfleet "$@"
"""


def describe(bin_folder, program, *command):
  text = subprocess.run([bin_folder / program, *command, "--help_json"], capture_output=True, text=True, check=True).stdout
  described = json.loads(text)
  if "usage" in described:  # begins like "craftfleet make THING... makes things. They go ..."
    sentence = re.match(r".*?(?<!\.\.)[.:](?=\s)", " ".join(described["usage"].split()) + " ")[0][:-1]
    arguments, described["summary"] = re.fullmatch(r" ?((?:[A-Z._]+ )*)(.*)", sentence.removeprefix(described["program"])).groups()
    described["arguments"] = arguments.strip()
  return described


def roff(text):
  """Escapes plain text for roff."""
  text = text.replace("\\", "\\e").replace("-", "\\-").replace("~", "\\(ti").replace("^", "\\(ha")
  return "\n".join("\\&" + line if line[:1] in (".", "'") else line for line in text.split("\n"))


def roff_paragraphs(text):
  """Formats usage text; lines that begin with blanks are examples and are kept as they are."""
  parts, in_example = [], False
  for line in text.strip().split("\n"):
    example = line.startswith("  ")
    if example != in_example:
      parts.append(".PP\n.EX" if example else ".EE\n.PP")
      in_example = example
    if line.strip():
      parts.append(roff(line))
    elif not example:
      parts.append(".PP")
  if in_example:
    parts.append(".EE")
  return "\n".join(parts)


def roff_flag(flag):
  default = f" (default {flag['default']})" if flag["default"] else ""
  value = "" if flag["type"] == "bool" else f"=\\fI{flag['type'].upper()}\\fR"
  lines = flag["help"].replace("\n[", " [").split("\n")
  return f".TP\n\\fB\\-\\-{roff(flag['name'])}\\fR{value}{roff(default)}\n" + "\n.br\n".join(roff(line) for line in lines)


def man_page(program, help_of, version, others):
  flags = help_of.get("flags", [])
  main = [roff_flag(flag) for flag in flags if flag["group"] == "main"]
  other = [roff_flag(flag) for flag in flags if flag["group"] != "main"]
  arguments = " " + roff(help_of["arguments"]) if help_of.get("arguments") else ""
  sections = [
      f'.TH {program.upper()} 1 "" "CraftFleet {version}" "User Commands"',
      f".SH NAME\n{roff(program)} \\- {roff(help_of['summary'])}",
      f".SH SYNOPSIS\n.B {roff(help_of['program'])}\n" + (f"[\\fIFLAG\\fR...]{arguments}" if flags else f"{arguments.strip()} [\\fIARGUMENT\\fR...]"),
      f".SH DESCRIPTION\n{roff_paragraphs(help_of['usage'])}",
  ]
  if main:
    sections.append(".SH OPTIONS\n" + "\n".join(main))
  if other:
    sections.append(".SH MORE OPTIONS\n" + "\n".join(other))
  sections.append(".SH SEE ALSO\n" + ",\n".join(f"\\fB{roff(name)}\\fR(1)" for name in others))
  return "\n".join(sections) + "\n"


def bash_completion(programs, commands):
  def table(words):
    return "".join(f'  [{name}]="{" ".join(words(help_of))}"\n' for name, help_of in programs.items())
  bools = table(lambda help_of: [f"--{flag['name']}" for flag in help_of["flags"] if flag["type"] == "bool"])
  flags = table(lambda help_of: [f"--{flag['name']}" + ("" if flag["type"] == "bool" else "=") for flag in help_of["flags"]])
  return (BASH.replace("@FLAGS@", flags).replace("@BOOLS@", bools)
          .replace("@COMMANDS@", " ".join(commands)).replace("@FLEET@", " ".join(FLEET)))


def zsh_text(text):
  """The first line of a text, escaped for single quotes and brackets of _arguments."""
  line = text.split("\n")[0]
  for special in "\\[]:":
    line = line.replace(special, "\\" + special)
  return line.replace("'", "'\\''")


def zsh_completion(programs, commands):
  cases = []
  for name, help_of in programs.items():
    specs = []
    for flag in help_of["flags"]:
      takes, value = ("", "") if flag["type"] == "bool" else ("=-", ":value:_files")
      specs.append(f"        '--{flag['name']}{takes}[{zsh_text(flag['help'])}]{value}' \\\n")
    cases.append(f"    {name})\n      _arguments \\\n{''.join(specs)}        '*:file:_files'\n      ;;\n")
  described = "".join(f"        '{name}:{zsh_text(summary)}'\n" for name, summary in commands.items())
  return (ZSH.replace("@FLEET@", " ".join(FLEET)).replace("@CASES@", "".join(cases))
          .replace("@COMMANDS@", described))


def main():
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--bin", type=pathlib.Path, required=True, help="folder of the programs")
  parser.add_argument("--out", type=pathlib.Path, required=True, help="share folder to write into")
  parser.add_argument("--version", required=True, help="of CraftFleet")
  flags = parser.parse_args()

  whole = describe(flags.bin, "craftfleet")
  whole["usage"] = subprocess.run([flags.bin / "craftfleet", "--help"], capture_output=True, text=True, check=True).stdout
  commands = {command["name"]: command["summary"] for command in whole["commands"]}
  # A command is called like its man page: craftfleet-train.
  programs = {f"craftfleet-{name}": describe(flags.bin, "craftfleet", name) for name in commands}
  programs |= {name: describe(flags.bin, name) for name in FLEET if (flags.bin / name).exists()}
  programs = dict(sorted(programs.items()))

  for folder in ("man", "bash-completion", "zsh"):  # without those of commands that are gone
    shutil.rmtree(flags.out / folder, ignore_errors=True)
  man = flags.out / "man/man1"
  man.mkdir(parents=True)
  for name, help_of in {"craftfleet": whole, **programs}.items():
    others = [other for other in ["craftfleet", *programs] if other != name]
    (man / f"{name}.1").write_text(man_page(name, help_of, flags.version, others), encoding="utf-8")
  bash = flags.out / "bash-completion/completions"
  bash.mkdir(parents=True)
  (bash / "craftfleet").write_text(bash_completion(programs, commands), encoding="utf-8")
  for name in FLEET:  # bash looks for a file of the program's own name
    (bash / name).symlink_to("craftfleet")
  zsh = flags.out / "zsh/site-functions"
  zsh.mkdir(parents=True)
  (zsh / "_craftfleet").write_text(zsh_completion(programs, commands), encoding="utf-8")


if __name__ == "__main__":
  main()

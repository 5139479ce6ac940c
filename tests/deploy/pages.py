"""Extracts commands and links from the pages of this repository."""

import re

from tests.fakes.python_case import SOURCE

# The beginning of a code block line that is a command, in contrast to configuration or output.
COMMAND = re.compile(r"((build/|venv/)?bin/|deploy/|tests/|\.ci/run|craftfleet [a-z]+ -|(sudo|cmake|ninja|ctest|cd|cp|cmp|printf|git|tar|pip|"
                     r"python3|docker|kubectl|sbatch|prometheus|promtool|source)\b)")


def pages():
  """All pages but the generated report, by path below the repository."""
  skipped = ("build", "runs", ".git", ".cache", "deploy/experiments/report")
  found = sorted(path.relative_to(SOURCE).as_posix() for path in SOURCE.rglob("*.md"))
  return [path for path in found if not path.startswith(skipped)]


def text_of(page):
  return (SOURCE / page).read_text(encoding="utf-8")


def commands(page):
  """The commands in code blocks, in order, without comments. A line that ends with a backslash is joined with the next."""
  lines = re.sub(r" *\\\n +", " ", text_of(page)).splitlines()
  lines = [re.split(r"  +# ", line[4:])[0].strip() for line in lines if line.startswith("    ")]
  return [line for line in lines if COMMAND.match(line)]


def links(page):
  """The targets of links and pictures, as written."""
  text = re.sub(r"```.*?```", "", text_of(page), flags=re.DOTALL)
  return re.findall(r"\]\(([^()\s]+)\)", text) + re.findall(r'<img src="([^"]+)"', text)


def anchors(page):
  """The anchors that GitHub generates for its headings."""
  headings = re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE)
  return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}

"""Checks that the pages and sections cited in comments, pages and messages exist.

Two forms are checked: `SOMETHING.md, section 7`, whose page must have a heading that begins with that number, and
`SOMETHING.md#anchor`, whose page must have a heading with that anchor as GitHub makes it. A page is named by its path,
by a path relative to the citing file, or by its name alone where only one page has it. Pages that only some of our
readers have are not to be cited at all.
"""

import re
import unittest

from tests.fakes import python_case

CODE = {".h", ".cc", ".proto", ".py", ".sh", ".cmake", ".md", ".txt"}
SKIPPED_FOLDERS = {"build", ".git", ".cache", "data", "corpus", "results", "shared"}
CITATION = re.compile(r"(?P<page>[\w./-]*\w\.md)(?:`|\]\([^)]*\))?(?:#(?P<anchor>[\w-]+)|,\s+sections?\s+(?P<numbers>\d+(?:(?:,\s+|\s+and\s+|\s+to\s+)\d+)*))")
FOREIGN = re.compile(r"\b(determinism|protocol|agents|rules|PPO|spec) page\b|\"The agents\"", re.IGNORECASE)
LINE_START = re.compile(r"\n\s*(//|#|\*)?\s*")  # of a comment that is continued


def files():
  for path in sorted(python_case.SOURCE.rglob("*")):
    parts = path.relative_to(python_case.SOURCE).parts
    if path.suffix in CODE and path.is_file() and not any(p in SKIPPED_FOLDERS or p.startswith("build") for p in parts[:-1]):
      yield path


def headings(page):
  """Headings of a page, code blocks left out."""
  found = []
  in_code = False
  for line in page.read_text().splitlines():
    if line.startswith("```"):
      in_code = not in_code
    elif not in_code and line.startswith("#"):
      found.append(line.lstrip("#").strip())
  return found


def anchor_of(heading):
  """The anchor that GitHub generates: lower case, without punctuation, dashes for blanks."""
  text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)  # a link's text
  return re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")


def joined(text):
  """The text with multi-line comments joined into one line."""
  return LINE_START.sub(" ", text)


class Citations(unittest.TestCase):

  @classmethod
  def setUpClass(cls):
    cls.files = list(files())
    cls.pages = [path for path in cls.files if path.suffix == ".md"]

  def find(self, name, citing):
    """The page that `name` means in `citing`, or None."""
    for path in (citing.parent / name, python_case.SOURCE / name):
      if path.is_file():
        return path.resolve()
    same_name = [page for page in self.pages if page.name == name]
    return same_name[0] if len(same_name) == 1 else None

  def citations(self):
    for path in self.files:
      if path.name == "citations_test.py":
        continue
      for match in CITATION.finditer(joined(path.read_text(errors="replace"))):
        yield path, match

  def test_pages_and_sections_that_are_cited_exist(self):
    checked = 0
    wrong = []
    for path, match in self.citations():
      where = f"{path.relative_to(python_case.SOURCE)} cites {' '.join(match[0].split())}"
      page = self.find(match["page"], path)
      checked += 1
      if page is None:
        wrong.append(f"{where}: no such page")
        continue
      titles = headings(page)
      if match["anchor"] and match["anchor"] not in [anchor_of(title) for title in titles]:
        wrong.append(f"{where}: the page has no such heading")
      for number in re.findall(r"\d+", match["numbers"] or ""):
        if not any(re.match(rf"{number}\.? ", title) for title in titles):
          wrong.append(f"{where}: the page has no section {number}")
    self.assertEqual(wrong, [], "\n".join(wrong))
    self.assertGreater(checked, 20, "citations are no longer found")

  def test_no_page_is_cited_that_a_reader_does_not_have(self):
    wrong = [
        f"{path.relative_to(python_case.SOURCE)}: {match[0]}"
        for path in self.files if path.name != "citations_test.py"
        for match in FOREIGN.finditer(joined(path.read_text(errors="replace")))
    ]
    self.assertEqual(wrong, [], "\n".join(wrong))


if __name__ == "__main__":
  python_case.main()

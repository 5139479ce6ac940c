"""Checks every page: its commands run or are checked, its links are valid, and the log lines that it explains exist."""

import re
import shlex
import unittest

from tests.deploy import pages
from tests.deploy.flags import unknown_flags
from tests.deploy.page_runner import PageRunner
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

# Commands that are not run here, with the reason. Their files and flags are checked nevertheless.
NOT_RUN = [
    (r"deploy/(quickstart|test)\.sh", "takes half an hour; deploy/try-distro.sh runs it in a bare root"),
    (r"deploy/(install-deps|build|bundle|try-distro)\.sh", "installs packages or builds; bundle_test.py makes a bundle"),
    (r"(cmake|ninja|ctest|tests/sanitizers\.sh|\.ci/run)\b", "builds, or runs these tests"),
    (r"git ls-files", "changes the sources"),
    (r"(docker|kubectl|deploy/k8s/tls-secrets\.sh) ", "needs Docker or a cluster; docker_test.py, k8s_test.py"),
    (r"build/bin/craftfleet top .*craftfleet-ops", "needs the cluster; k8s_test.py runs its fleet"),
    (r"(sbatch|(build/)?bin/craftfleet sweep .*--executor=slurm)", "needs Slurm; slurm_test.py starts one"),
    (r"sudo |deploy/make-certs\.sh certs learner=\$\(hostname", "needs root and systemd; systemd_test.py"),
    (r"(python3 -m venv|pip install|tar -xf craftfleet|cd craftfleet|craftfleet-[\d.]+-linux)",
     "needs a bundle and another LibTorch; bundle_test.py"),
    (r"venv/bin/", "needs packages; tests/deploy/python installs the package and runs the examples"),
    (r"(prometheus|promtool) ", "needs Prometheus; watch_test.py"),
    (r"build/bin/\w+_bench", "takes minutes"),
    (r"tests/fuzz/(fuzz|corpus)", "searches for hours, or writes files of the repository; corpus_test.py"),
    (r"tests/(bench|chaos|hostile)/", "the long forms, which take minutes to hours; their short forms are tests"),
    (r"build/bin/(replay_trace|craftfleet train --textures|craftfleet sweep .*--textures)", "needs the original's textures"),
    (r"python3 (envserver/textures|tests/model)/", "writes files of the repository"),
    (r"build/bin/craftfleet report deploy/experiments/results", "writes a page of the repository"),
    (r"(build/bin/craftfleet (eval --checkpoint=(deploy/|runs/small)|train --config=small)|build/bin/craftfleet watch "
     r"--(video=\S+ --size=360|strip=attention-strip)|python3 deploy/pictures/)",
     "makes a picture that is committed"),
    (r"build/bin/craftfleet sweep .*--experiment=(overlap_300k|reproduction|one_iteration|small)", "takes hours"),
    (r"build/bin/craftfleet report runs/overlap", "on deploy/TUNING.md: of that sweep's runs; README.md makes a report"),
    (r"build/bin/craftfleet-learner .*--metrics_listen=127.0.0.1:9464", "serves at a fixed port; watch_test.py"),
    (r"build/bin/craftfleet top --address=127\.0\.0\.1:50051$", "on deploy/cli/top/README.md: README.md and OPERATING.md run it"),
    (r"deploy/local-fleet\.sh", "on deploy/DEPLOYING.md: README.md runs it"),
    (r"deploy/make-certs\.sh certs craftfleet-ops$", "for the cluster; deploy/SECURING.md runs it"),
]
RUN_PAGES = {"README.md", "deploy/OPERATING.md", "deploy/SECURING.md", "deploy/LIVE_PAGE.md", "deploy/TUNING.md"}
ALWAYS_LEFT_OUT = NOT_RUN[:-3]  # also on pages whose commands are run


def reason(command, table):
  return next((why for pattern, why in table if re.match(pattern, command)), None)


def parts(command):
  """The words of each program in a command, without sudo."""
  found = [re.split(r"\s+", part.strip()) for part in re.split(r"&&|\||;", command)]
  return [[word for word in words if word not in ("sudo", "&")] for words in found]


class Pages(python_case.FolderCase):

  def all_commands(self):
    found = [(page, command) for page in pages.pages() for command in pages.commands(page) + pages.inline_commands(page)]
    self.assertGreater(len(found), 100)
    return found

  def run_page(self, page):
    runner = PageRunner(self, self.folder)
    commands = [command for command in pages.commands(page) if reason(command, ALWAYS_LEFT_OUT) is None]
    self.assertGreater(len(commands), 2)
    runner.run(commands)

  def test_commands_of_readme_run_from_a_clean_checkout(self):
    self.run_page("README.md")

  def test_commands_of_operating_run_from_a_clean_checkout(self):
    self.run_page("deploy/OPERATING.md")

  def test_commands_of_the_live_page_run_from_a_clean_checkout(self):
    self.run_page("deploy/LIVE_PAGE.md")

  def test_commands_of_securing_run_from_a_clean_checkout(self):
    self.run_page("deploy/SECURING.md")

  def test_commands_of_tuning_run_from_a_clean_checkout(self):
    self.run_page("deploy/TUNING.md")

  def test_every_other_command_has_a_reason_not_to_run(self):
    for page in pages.pages():
      for command in pages.commands(page):
        if page not in RUN_PAGES:
          self.assertIsNotNone(reason(command, NOT_RUN), f"{page}: {command}")
    everything = [command for _, command in self.all_commands()]
    for pattern, why in NOT_RUN:
      self.assertTrue(any(re.match(pattern, command) for command in everything), f"no page has a command for: {pattern} ({why})")

  def test_files_that_commands_name_are_there(self):
    for page, command in self.all_commands():
      for words in parts(command):
        for word in words:
          path = word.strip('"').removeprefix("$PWD/").partition("*")[0]
          if re.match(r"(deploy|tests|build/bin|envserver|\.ci)/", path):
            path = path.replace("build/bin", str(BIN), 1)
            found = (SOURCE / path).exists() or list((SOURCE / path).parent.glob((SOURCE / path).name + "*"))
            self.assertTrue(found, f"{page}: {command}")

  def test_recipes_of_contributing_name_files_and_what_is_in_them(self):
    recipes = re.findall(r"^## (Add .*)\n((?:(?!## ).*\n)*)", pages.text_of("CONTRIBUTING.md"), re.MULTILINE)
    self.assertGreater(len(recipes), 5)
    for title, recipe in recipes:
      quoted = [word for word in re.findall(r"`([^`]+)`", recipe) if "NAME" not in word]
      paths = [SOURCE / word for word in quoted if re.fullmatch(r"[\w./-]+(\.\w+|/)", word)]
      self.assertGreater(len(paths), 3, title)
      for path in paths:
        self.assertTrue(path.exists(), f"{title}: {path.relative_to(SOURCE)}")
      sources = "".join(path.read_text(encoding="utf-8") for path in paths if path.is_file())
      for name in quoted:
        if re.fullmatch(r"k[A-Z]\w+|[A-Z][a-z]\w*|[A-Z]+_[A-Z]+", name):
          self.assertTrue(re.search(rf"\b{name}\b", sources), f"{title}: none of the files that it names has {name}")

  def test_flags_of_commands_exist(self):
    checked = 0
    for page in pages.pages():
      for command in pages.commands(page):
        for part in re.split(r"&&|\| ", command):
          checked += self.check_flags(page, part.strip())
      for command in pages.inline_commands(page):  # in sentences flags need no value
        checked += self.check_flags(page, re.sub(r"(--[a-z_]+)(?= |$)", r"\1=x", command))
    self.assertGreater(checked, 100)

  def check_flags(self, page, command):
    """Checks the flags of a command; returns their number."""
    try:
      words = [word for word in shlex.split(command) if word != "sudo"]
    except ValueError:  # an unmatched quotation mark in a sentence
      words = command.split()
    if not words:
      return 0
    name = words[0].rpartition("/")[2]
    flags = [word for word in words[1:] if word.startswith("--")]
    if name == "craftfleet" and len(words) > 1 and not words[1].startswith("-"):
      name = f"craftfleet-{words[1]}"
    if name in ("craftfleet-COMMAND", "craftfleet-help"):
      return 0
    if name == "local-fleet.sh":
      flags = [flag for flag in flags if not re.match("--(learners|actors|envservers|bin)=", flag)]
    if name in ("local-fleet.sh", "sbatch"):
      name = "craftfleet-learner"
    if name.startswith("craftfleet-") and (BIN / name).exists():
      flags = [flag for flag in flags if not re.fullmatch(r"--(help|helpfull|help_json|version)(=x)?", flag)]
      self.assertEqual(unknown_flags(name, flags), [], f"{page}: {command}")
      return len(flags)
    if name.endswith((".sh", ".py")):
      script = (SOURCE / words[0]).read_text(encoding="utf-8")
      for flag in flags:
        self.assertIn(flag.partition("=")[0], script, f"{page}: {command}")
      return len(flags)
    return 0

  def test_links_are_valid(self):
    checked = 0
    for page in pages.pages():
      for link in pages.links(page):
        path, _, anchor = link.partition("#")
        if re.match(r"https?://", link):
          self.assertRegex(link, r"^https://[\w.-]+(/[\w./-]*)?$", page)
          continue
        target = (SOURCE / page).parent / path if path else SOURCE / page
        self.assertTrue(target.exists(), f"{page}: {link}")
        if anchor:
          self.assertIn(anchor, pages.anchors(target.resolve().relative_to(SOURCE).as_posix()), f"{page}: {link}")
        checked += 1
    self.assertGreater(checked, 60)

  def test_every_page_is_reached_from_the_readme(self):
    reached, pending = set(), ["README.md"]
    while pending:
      page = pending.pop()
      if page in reached or not page.endswith(".md"):
        continue
      reached.add(page)
      for link in pages.links(page):
        path = link.partition("#")[0]
        if path and not re.match(r"https?://", path):
          pending.append(((SOURCE / page).parent / path).resolve().relative_to(SOURCE).as_posix())
    ours = {page for page in pages.pages() if page.startswith("deploy/") or "/" not in page}
    self.assertEqual(ours - reached, set())

  def test_troubleshooting_explains_lines_that_programs_print(self):
    sources = [path.read_text(encoding="utf-8") for room in ("actor", "common", "deploy", "envserver", "learner")
               for path in [*(SOURCE / room).rglob("*.cc"), *(SOURCE / room).rglob("*.sh")]]
    # A string for each sequence of adjacent literals, without escapes; arguments of absl::StrCat are separate strings.
    source = re.sub(r'"\s*\n\s*"', "", "\n".join(sources)).replace("\\", "")
    symptoms = re.findall(r"^### `(.*)`$", pages.text_of("deploy/TROUBLESHOOTING.md"), re.MULTILINE)
    self.assertGreater(len(symptoms), 20)
    for symptom in symptoms:
      clauses = [clause.strip() for clause in re.split(r"<[^<>]+>", symptom)]
      self.assertTrue(any(len(clause) > 8 for clause in clauses), symptom)
      for clause in clauses:
        self.assertIn(clause, source, f"no program prints: {symptom}")
      self.assertEqual(len(set(symptoms)), len(symptoms))


python_case.main()

""".ci/includes.py: files that use a name without its header, which compile only where another library's header includes it."""

import subprocess
import sys

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE


class Includes(python_case.FolderCase):

  def check(self, text):
    """What the script says about a file with this text, and whether it accepts it."""
    path = self.folder / "sample.cc"
    path.write_text(text)
    ended = subprocess.run([sys.executable, SOURCE / ".ci/includes.py", path], capture_output=True, text=True, check=False)
    return ended.stdout.replace(f"{path}:", ""), ended.returncode == 0

  def test_a_name_without_its_header_is_found(self):
    said, passed = self.check('#include <string>\n// absl::Seconds\nstd::string S() { return absl::StrCat("absl::Now"); }\n')
    self.assertFalse(passed)
    self.assertEqual(said.splitlines()[:-1], ["3: absl::StrCat, want <absl/strings/str_cat.h>"])

  def test_a_header_of_ours_may_include_it(self):
    use = "const auto kPath = std::filesystem::path();\n"
    self.assertFalse(self.check(use)[1])
    self.assertTrue(self.check('#include "tests/fakes/temp_folder.h"\n' + use)[1])

  def test_macros_of_tests_need_their_header(self):
    use = "TEST(A, B) { EXPECT_THAT(1, 1); }\n"
    self.assertEqual(self.check("#include <gtest/gtest.h>\n" + use)[0].splitlines()[0], "2: EXPECT_THAT, want <gmock/gmock.h>")
    self.assertTrue(self.check("#include <gmock/gmock.h>\n#include <gtest/gtest.h>\n" + use)[1])

  def test_an_unknown_name_must_be_added_to_the_table(self):
    said, passed = self.check("int x = std::unheard_of;\n")
    self.assertIn("1: std::unheard_of is not in .ci/includes.txt", said)
    self.assertFalse(passed)


if __name__ == "__main__":
  python_case.main()

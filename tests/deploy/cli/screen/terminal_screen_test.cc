#include "deploy/cli/screen/terminal_screen.h"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::EndsWith;
using testing::HasSubstr;
using testing::SizeIs;

View Grey(int width, int height, std::vector<TextLine> lines) {
  return {width, height, std::string(size_t{3} * width * height, '\x40'), std::move(lines)};
}

constexpr char kGreyLine[] = "\x1b[38;2;64;64;64m\x1b[48;2;64;64;64m\u2580\u2580\x1b[0m";

TEST(PageRows, PutTextBesideThePictureAndBelowIt) {
  const auto rows = PageRows(Grey(2, 4, {{"one"}, {"two"}, {"three", TextLine::Style::kGood}}), 40, 4);
  ASSERT_THAT(rows, SizeIs(4));
  EXPECT_EQ(rows[0], std::string(kGreyLine) + "  one");
  EXPECT_EQ(rows[1], std::string(kGreyLine) + "  two");
  EXPECT_EQ(rows[2], "    \x1b[32mthree\x1b[0m");
  EXPECT_EQ(rows[3], "  ");
}

TEST(PageRows, CutWhatDoesNotFit) {
  const auto rows = PageRows(Grey(2, 8, {{"0123456789"}, {"b"}, {"c"}}), 8, 2);
  ASSERT_THAT(rows, SizeIs(2));
  EXPECT_THAT(rows[0], EndsWith("  0123"));
  EXPECT_THAT(PageRows(Grey(9, 2, {{"text"}}), 8, 1)[0], Not(HasSubstr("text")));
}

TEST(PageRows, ABarIsOfCharacters) {
  const View view = Grey(2, 2, {{"do", TextLine::Style::kPlain, 0.5}});
  EXPECT_THAT(PageRows(view, 80, 1)[0], EndsWith("  do                   ####      50%"));
}

// A screen in a terminal of its own, in place of standard input and output.
class TerminalKeys : public testing::Test {
 protected:
  TerminalKeys() : keyboard_(posix_openpt(O_RDWR | O_NOCTTY)) {
    grantpt(keyboard_);
    unlockpt(keyboard_);
    const int terminal = open(ptsname(keyboard_), O_RDWR | O_NOCTTY);
    for (const int stream : {STDIN_FILENO, STDOUT_FILENO}) dup2(terminal, stream);
    close(terminal);
    auto screen = TerminalScreen::Open();
    EXPECT_THAT(screen, IsOk());
    if (screen.ok()) screen_ = *std::move(screen);
  }
  ~TerminalKeys() override {
    screen_ = nullptr;
    for (const int stream : {STDIN_FILENO, STDOUT_FILENO}) dup2(before_[stream], stream);
    for (const int descriptor : {before_[0], before_[1], keyboard_}) close(descriptor);
  }

  void Type(const std::string& bytes) const {
    ASSERT_EQ(write(keyboard_, bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
  }

  const int before_[2] = {dup(STDIN_FILENO), dup(STDOUT_FILENO)};
  const int keyboard_;
  std::unique_ptr<Screen> screen_;
};

TEST_F(TerminalKeys, AHeldArrowIsNeverTheKeyEscape) {
  ASSERT_NE(screen_, nullptr);
  std::string bytes;
  for (int i = 0; i < 22; ++i) bytes += "\x1b[C";
  Type(bytes);
  for (int i = 0; i < 22; ++i) EXPECT_EQ(screen_->ReadKey(absl::Seconds(10)), kRightKey) << i;
  EXPECT_EQ(screen_->ReadKey(absl::ZeroDuration()), kNoKey);
}

TEST_F(TerminalKeys, EscapeAloneIsAKey) {
  ASSERT_NE(screen_, nullptr);
  Type("\x1b");
  EXPECT_EQ(screen_->ReadKey(absl::Seconds(10)), kEscapeKey);
  Type("q");
  EXPECT_EQ(screen_->ReadKey(absl::Seconds(10)), 'q');
}

// Other programs of a shell's job share its setting, and may have made it so.
TEST_F(TerminalKeys, ANonBlockingTerminalShowsAllOfAPage) {
  ASSERT_NE(screen_, nullptr);
  const winsize size = {100, 400, 0, 0};
  ASSERT_EQ(ioctl(keyboard_, TIOCSWINSZ, &size), 0);
  ASSERT_EQ(fcntl(STDOUT_FILENO, F_SETFL, fcntl(STDOUT_FILENO, F_GETFL) | O_NONBLOCK), 0);
  View view = Grey(300, 200, {});  // more than the terminal takes at once
  for (size_t i = 0; i < view.picture.size(); ++i) view.picture[i] = static_cast<char>(i * 37);
  view.lines.assign(100, {"text"});
  view.lines.back().text = "the end";
  std::atomic<bool> complete{false};
  std::thread reader([&] {
    std::string page;
    char bytes[4096];
    ssize_t count = 0;
    while (page.find("the end") == std::string::npos && (count = read(keyboard_, bytes, sizeof(bytes))) > 0) {
      page.append(bytes, static_cast<size_t>(count));
    }
    complete = true;
  });
  EXPECT_TRUE(WaitUntil([&] {
    EXPECT_THAT(screen_->Show(view), IsOk());
    return complete.load();
  }));
  [[maybe_unused]] const ssize_t written = write(STDOUT_FILENO, "the end", 7);  // so that the reader ends in any case
  reader.join();
}

}  // namespace
}  // namespace craftfleet

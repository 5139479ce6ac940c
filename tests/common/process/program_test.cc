#include "common/process/program.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/log.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

void Begin() {
  char name[] = "program";
  char* arguments[] = {name, nullptr};
  ParseFlags({"program", "what it is for"}, 1, arguments);
}

TEST(Program, RaisesTheFileLimitToTheHardLimit) {
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit low = before;
  low.rlim_cur = before.rlim_max / 2;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &low), 0);
  Begin();
  rlimit after = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &after), 0);
  EXPECT_EQ(after.rlim_cur, before.rlim_max);
}

// As with `2>&-`: the first file would have the number of standard error, and the log in it.
TEST(Program, NoFileHasTheNumberOfAClosedStandardStream) {
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    const int saved = dup(stream);
    close(stream);
    Begin();
    const int file = open("/dev/null", O_RDWR);
    char byte = 'x';
    const ssize_t done = stream == STDIN_FILENO ? read(stream, &byte, 1) : write(stream, &byte, 1);
    close(file);
    if (saved >= 0) dup2(saved, stream);
    close(saved);
    EXPECT_NE(file, stream);
    EXPECT_EQ(done, -1) << stream;
  }
}

// Peers could fill a disk with it.
TEST(Program, WhatProtobufSaysOfMessagesIsAWarningAndLimited) {
  Begin();
  const LogCounts before = CountLogged();
  testing::internal::CaptureStderr();
  for (int i = 0; i < 5; ++i) {
    v1::RunConfig config;
    EXPECT_FALSE(config.ParseFromString("\x0a\x01\xff")) << "agent, not in UTF-8";
  }
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr("warning: protobuf: "));
  EXPECT_THAT(log, Not(HasSubstr("[libprotobuf")));
  EXPECT_EQ(CountLogged().warnings, before.warnings + 1);
}

}  // namespace
}  // namespace craftfleet

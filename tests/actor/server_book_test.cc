#include "actor/server_book.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

std::vector<std::string> Addresses(const std::vector<v1::Peer>& peers) {
  std::vector<std::string> addresses;
  for (const v1::Peer& peer : peers) addresses.push_back(peer.address());
  return addresses;
}

TEST(ServerBook, PutsTogetherWhatLoopsSee) {
  ServerBook book;
  v1::ProcessSummary summary;
  summary.set_memory_bytes(77);
  book.Update(0, {{"b:1", true, 3, summary, ""}, {"a:1", false, 0, {}, ""}});
  book.Update(1, {{"b:1", true, 4, summary, ""}, {"a:1", false, 0, {}, ""}, {"c:1", false, 0, {}, ""}});
  book.Update(1, {{"b:1", false, 4, {}, ""}, {"a:1", false, 0, {}, ""}});
  const std::vector<v1::Peer> all = book.All();
  ASSERT_EQ(all.size(), 2);
  EXPECT_EQ(all[0].address(), "a:1");
  EXPECT_EQ(all[0].health(), v1::Peer::LOST);
  EXPECT_FALSE(all[0].has_summary());
  EXPECT_EQ(all[1].address(), "b:1");
  EXPECT_EQ(all[1].health(), v1::Peer::OK);
  EXPECT_EQ(all[1].state(), "7 lanes");
  EXPECT_EQ(all[1].summary().memory_bytes(), 77);
}

TEST(ServerBook, WhatAServerWithoutGamesSaidIsOld) {
  ServerBook book;
  v1::ProcessSummary summary;
  summary.set_memory_bytes(77);
  book.Update(0, {{"a:1", true, 0, summary, ""}, {"b:1", true, 1, summary, ""}});
  EXPECT_FALSE(book.All()[0].has_summary());
  EXPECT_TRUE(book.All()[1].has_summary());
}

TEST(ServerBook, OneThatDoesNotAnswerIsShownAsSuch) {
  ServerBook book;
  book.Update(0, {{"a:1", true, 2, {}, "no answer within 10s"}, {"b:1", true, 1, {}, ""}});
  book.Update(1, {{"a:1", true, 1, {}, ""}, {"b:1", true, 1, {}, ""}});
  EXPECT_EQ(book.All()[0].health(), v1::Peer::NOT_ANSWERING);
  EXPECT_EQ(book.All()[0].state(), "not answering");
  EXPECT_EQ(book.All()[1].health(), v1::Peer::OK);
  EXPECT_THAT(Addresses(book.NextNotAnswering(8)), ElementsAre("a:1"));
}

TEST(ServerBook, NextGoesRoundAllOfThem) {
  ServerBook book;
  book.Update(0, {{"a", true, 1, {}, ""}, {"b", true, 1, {}, ""}, {"c", true, 1, {}, ""}});
  EXPECT_THAT(Addresses(book.Next(2)), ElementsAre("a", "b"));
  EXPECT_THAT(Addresses(book.Next(2)), ElementsAre("c", "a"));
  EXPECT_THAT(Addresses(book.Next(2)), ElementsAre("b", "c"));
  EXPECT_THAT(Addresses(book.Next(9)), ElementsAre("a", "b", "c"));
  book.Update(0, {});
  EXPECT_THAT(book.Next(2), ElementsAre());
}

}  // namespace
}  // namespace craftfleet

// The page of `craftfleet top`.

#ifndef CRAFTFLEET_DEPLOY_TOP_TOP_VIEW_H_
#define CRAFTFLEET_DEPLOY_TOP_TOP_VIEW_H_

#include <string>
#include <vector>

#include "craftfleet/v1/status.pb.h"
#include "deploy/top/top_state.h"

namespace craftfleet {

struct TopLine {
  enum class Style { kPlain, kTitle, kHeader, kGood, kBad };
  std::string text;  // printable ASCII, at most as wide as the page
  Style style = Style::kPlain;
};

struct TopPage {
  int width = 80;   // columns, at least 40
  int height = 24;  // lines; 0: as many as there are
  std::string address;
  std::string trouble;  // why the status is old; empty: it is not
};

// How many workers a page of `height` lines shows.
int WorkersOnPage(int height);

// Draws what a learner says of its fleet. Depends on nothing else.
std::vector<TopLine> DrawTop(const v1::StatusReply& status, const TopState& state, const TopPage& page);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_TOP_TOP_VIEW_H_

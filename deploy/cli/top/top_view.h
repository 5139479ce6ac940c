// The page of `craftfleet top`.

#ifndef CRAFTFLEET_DEPLOY_CLI_TOP_TOP_VIEW_H_
#define CRAFTFLEET_DEPLOY_CLI_TOP_TOP_VIEW_H_

#include <string>
#include <vector>

#include "craftfleet/v1/status.pb.h"
#include "deploy/cli/screen/text_line.h"
#include "deploy/cli/top/top_state.h"

namespace craftfleet {

struct TopPage {
  int width = 80;   // columns, at least 40
  int height = 24;  // lines; 0: no limit
  std::string address;
  std::string problem;  // why the status is outdated; empty if it is current
};

// The number of workers that fit on a page of `height` lines.
int WorkersOnPage(int height);

// Draws the fleet as the learner's status describes it, in lines at most as wide as the page. A pure function.
std::vector<TextLine> DrawTop(const v1::StatusReply& status, const TopState& state, const TopPage& page);

// The page with ANSI escapes for its styles, to be drawn over the previous one.
std::string RenderAnsi(const std::vector<TextLine>& lines);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_TOP_TOP_VIEW_H_

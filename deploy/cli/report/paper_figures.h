// Numbers of published tables, for comparison with ours.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_PAPER_FIGURES_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_PAPER_FIGURES_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

struct PaperFigure {
  std::string table;    // an experiment's name; "scale": other players and agents, for comparison
  std::string cell;     // a cell's name
  std::string measure;  // a Measure's name
  int64_t at = 0;       // environment steps, if the table has several; 0: at the end
  double mean = 0;
  std::optional<double> deviation;
  std::string source;  // "Hafner 2021"
};

class PaperFigures {
 public:
  // Comma-separated values: the line table,cell,measure,at,mean,std,source, then one figure per line; `at` and `std`
  // may be empty. Lines that begin with # are comments.
  //   InvalidArgument: "<filename>:<line>: ...".
  static absl::StatusOr<PaperFigures> Parse(absl::string_view text, absl::string_view filename);

  // nullptr: not found.
  const PaperFigure* Find(absl::string_view table, absl::string_view cell, absl::string_view measure,
                          int64_t at = 0) const;
  const std::vector<PaperFigure>& all() const { return figures_; }

 private:
  std::vector<PaperFigure> figures_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_PAPER_FIGURES_H_

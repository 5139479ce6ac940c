#include "deploy/cli/report/paper_figures.h"

#include <algorithm>
#include <utility>

#include <absl/strings/ascii.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kHeader = "table,cell,measure,at,mean,std,source";
constexpr size_t kColumns = 7;

absl::StatusOr<PaperFigure> ParseFigure(absl::string_view line) {
  const std::vector<absl::string_view> cells = absl::StrSplit(line, ',');
  if (cells.size() != kColumns) {
    return absl::InvalidArgumentError(absl::StrCat(cells.size(), " columns, want ", kColumns, ": ", kHeader));
  }
  PaperFigure figure;
  figure.table = std::string(cells[0]);
  figure.cell = std::string(cells[1]);
  figure.measure = std::string(cells[2]);
  figure.source = std::string(cells[6]);
  if (!cells[3].empty() && !absl::SimpleAtoi(cells[3], &figure.at)) {
    return absl::InvalidArgumentError(absl::StrCat("at is \"", cells[3], "\", want a whole number or nothing"));
  }
  if (!absl::SimpleAtod(cells[4], &figure.mean)) {
    return absl::InvalidArgumentError(absl::StrCat("mean is \"", cells[4], "\", want a number"));
  }
  double deviation = 0;
  if (!cells[5].empty() && !absl::SimpleAtod(cells[5], &deviation)) {
    return absl::InvalidArgumentError(absl::StrCat("std is \"", cells[5], "\", want a number or nothing"));
  }
  if (!cells[5].empty()) figure.deviation = deviation;
  return figure;
}

}  // namespace

absl::StatusOr<PaperFigures> PaperFigures::Parse(absl::string_view text, absl::string_view filename) {
  PaperFigures figures;
  bool header = false;
  int number = 0;
  for (const absl::string_view raw : absl::StrSplit(text, '\n')) {
    ++number;
    const absl::string_view line = absl::StripAsciiWhitespace(raw);
    if (line.empty() || line[0] == '#') continue;
    const auto at_line = [&](absl::string_view message) {
      return absl::InvalidArgumentError(absl::StrCat(filename, ":", number, ": ", message));
    };
    if (!std::exchange(header, true)) {
      if (line != kHeader) return at_line(absl::StrCat("want the columns' names, ", kHeader));
      continue;
    }
    absl::StatusOr<PaperFigure> figure = ParseFigure(line);
    if (!figure.ok()) return at_line(figure.status().message());
    if (figures.Find(figure->table, figure->cell, figure->measure, figure->at) != nullptr) {
      return at_line(absl::StrCat(figure->table, " ", figure->cell, " ", figure->measure, " occurs twice"));
    }
    figures.figures_.push_back(*std::move(figure));
  }
  if (!header) return absl::InvalidArgumentError(absl::StrCat(filename, ": empty, want ", kHeader));
  return figures;
}

const PaperFigure* PaperFigures::Find(absl::string_view table, absl::string_view cell, absl::string_view measure,
                                      int64_t at) const {
  const auto found = std::find_if(figures_.begin(), figures_.end(), [&](const PaperFigure& figure) {
    return figure.table == table && figure.cell == cell && figure.measure == measure && figure.at == at;
  });
  return found == figures_.end() ? nullptr : &*found;
}

}  // namespace craftfleet

#include "envserver/render/picture_layout.h"

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kMaxSize = 2048;
constexpr int kMinCellSize = 2;  // below it, an icon would have no pixel

absl::Status CheckSize(absl::string_view field, int size, int view) {
  if (size >= kMinCellSize * view && size <= kMaxSize) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("picture ", field, " ", size, ", want ", kMinCellSize * view, "..",
                                                 kMaxSize, " pixels for a view of ", view, " cells"));
}

}  // namespace

absl::Status RenderOptions::Validate(const WorldOptions& world) const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckSize("width", width, world.view_width));
  return CheckSize("height", height, world.view_height);
}

PictureLayout::PictureLayout(const WorldOptions& world, const RenderOptions& options)
    : width(options.width),
      height(options.height),
      cell_width(options.width / world.view_width),
      cell_height(options.height / world.view_height),
      columns(world.view_width),
      map_rows(world.view_height - world.inventory_rows()),
      border_left((options.width - cell_width * world.view_width) / 2),
      border_top((options.height - cell_height * world.view_height) / 2) {}

}  // namespace craftfleet

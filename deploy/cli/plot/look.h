// The common style of all charts.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_LOOK_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_LOOK_H_

#include <array>
#include <cstddef>

#include "deploy/cli/plot/canvas.h"

namespace craftfleet {

inline constexpr Color kTextColor = {40, 40, 40};
inline constexpr Color kGridColor = {228, 228, 228};
inline constexpr Color kFrameColor = {130, 130, 130};

// Pixels.
inline constexpr double kTitleSize = 12;
inline constexpr double kTextSize = 10;

// Colours that people with any colour vision can distinguish (Okabe and Ito 2008).
inline constexpr std::array<Color, 7> kSeriesColors = {
    {{0, 114, 178}, {213, 94, 0}, {0, 158, 115}, {204, 121, 167}, {86, 180, 233}, {230, 159, 0}, {0, 0, 0}}};

// The colour of the series with that number, from 0; colours repeat.
inline Color SeriesColor(size_t number) { return kSeriesColors[number % kSeriesColors.size()]; }

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_LOOK_H_

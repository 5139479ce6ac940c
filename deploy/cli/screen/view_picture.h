// A view as one picture, for windows and videos.

#pragma once

#include <opencv2/core/mat.hpp>

#include "deploy/cli/screen/screen.h"

namespace craftfleet {

// The picture in the upper left corner, and the text in a column to the right of `room`: uint8[height,width,3] in
// OpenCV's order of channels. The size, of even numbers, depends only on `room`; what is larger is cut off.
//   throws cv::Exception: no memory.
cv::Mat DrawView(const View& view, const PictureRoom& room);

}  // namespace craftfleet

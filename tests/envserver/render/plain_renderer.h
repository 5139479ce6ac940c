// The picture of a world drawn the plain way, pixel by pixel, from the determinism page: what the fast renderer is
// checked against.

#ifndef CRAFTFLEET_TESTS_ENVSERVER_RENDER_PLAIN_RENDERER_H_
#define CRAFTFLEET_TESTS_ENVSERVER_RENDER_PLAIN_RENDERER_H_

#include <cstdint>
#include <vector>

#include "envserver/render/picture_layout.h"
#include "envserver/render/textures.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/world.h"

namespace craftfleet {

// uint8[height][width][3]. Draws from `random` as Renderer::Render() does.
std::vector<uint8_t> PlainPicture(const Textures& textures, const World& world, const RenderOptions& options,
                                  RandomStream* random);

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_ENVSERVER_RENDER_PLAIN_RENDERER_H_

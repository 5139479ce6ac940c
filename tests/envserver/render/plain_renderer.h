// A plain renderer, pixel by pixel from RULES.md, sections 12 and 13: the reference for the fast one in property
// tests.

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

// Generates the world of a new episode.
//
// U() is a uniform draw, R(n) an integer draw in 0..n-1; a draw after a condition that fails is not made. The noise
// seed is R(2^31 - 1). n(x, y, z, s) is the noise (simplex_noise.h) at (x / s, y / s, z). For every cell, x in the
// outer loop and y in the inner one, with d the Euclidean distance to the player:
//
//   start    = 1 / (1 + exp(-(4 - d + 2 * n(x, y, 8, 3))))
//   water    = n(x, y, 3, 15) + 0.15 * n(x, y, 3, 5) + 0.1 - 2 * start
//   mountain = (n(x, y, 0, 15) + 0.3 * n(x, y, 0, 5)) / 1.3 - (4 * start + 0.3 * water)
//
// The cell becomes the first of these that applies:
//   start > 0.5: grass
//   mountain > 0.15, and within it the first of:
//     mountain > 0.3 and n(x, y, 6, 7) > 0.15: path (a cave)
//     n(2x, y / 5, 7, 3) > 0.4: path, and a tunnel     (the coordinates are (x * 2) / 3 and (y / 5) / 3)
//     n(x / 5, 2y, 7, 3) > 0.4: path, and a tunnel
//     n(x, y, 1, 8) > 0 and U() > 0.85: coal
//     n(x, y, 2, 6) > 0.4 and U() > 0.75: iron
//     mountain > 0.18 and U() > 0.994: diamond
//     mountain > 0.3 and n(x, y, 6, 5) > 0.35: lava
//     otherwise: stone
//   0.25 < water <= 0.35 and n(x, y, 4, 9) > -0.2: sand
//   water > 0.3: water
//   n(x, y, 5, 7) > 0 and U() > 0.8: tree
//   grass
// After a cell's own draws its variant is drawn (appearance.h).
//
// Then all cells are visited again in the same order. On a cell whose material creatures walk on, the first that
// applies:
//   d > 3, grass, and U() > 0.985: cow
//   d > 10 and U() > 0.993: zombie
//   the cell is a tunnel and U() > 0.95: skeleton
// The number settings of CrafterOOD (RULES.md, section 14) replace the thresholds of tree, coal, cow, zombie and
// skeleton.

#pragma once

#include "envserver/world/state.h"

namespace craftfleet {

// Fills a cleared board that contains only the player. Draws the noise's seed first.
void GenerateWorld(WorldState* state);

}  // namespace craftfleet

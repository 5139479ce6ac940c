#!/usr/bin/env python3
"""Makes the project's textures: 16x16 PNG files, the same bytes on every machine.

  make_textures.py [--out DIR] [--sheet FILE] [--distances]

--out: folder for the PNG files (default: beside this file). --sheet: also write a picture of all textures, as drawn and
as agents see them. --distances: also print the most similar textures as agents see them. Needs only the standard
library.
"""
import argparse
import pathlib

import item_maps as items
import png
import sheet
import world_maps as maps

SIZE = 16

# ---- Images: rows of (r, g, b) or (r, g, b, a) ----


def image(drawing):
    """The RGBA image of a (colours, rows) drawing."""
    colours, text = drawing
    rows = text.split()
    assert len({len(row) for row in rows}) == 1, text
    rgba = {key: colour if len(colour) == 4 else colour + (255,) for key, colour in colours.items()}
    rgba['.'] = maps.CLEAR
    return [[rgba[key] for key in row] for row in rows]


def over(base, top, x0=0, y0=0):
    """`top` drawn over `base` with its upper left corner at (x0, y0); a translucent pixel darkens opaque ground."""
    out = [list(row) for row in base]
    for y, row in enumerate(top):
        for x, colour in enumerate(row):
            ground = out[y0 + y][x0 + x]
            if colour[3] == 255 or ground[3:] == (0,):
                out[y0 + y][x0 + x] = colour
            elif colour[3] > 0:
                out[y0 + y][x0 + x] = mix(ground, colour, colour[3]) + ground[3:]
    return out


def mirrored(rows):
    return [row[::-1] for row in rows]


def turned(rows):
    """Turned by 90 degrees clockwise."""
    return [list(column) for column in zip(*rows[::-1])]


def opaque(rows):
    return [[colour[:3] for colour in row] for row in rows]


def mix(a, b, part):
    """Colour `a` with part/255 of `b`, RGB."""
    return tuple((a[i] * (255 - part) + b[i] * part) // 255 for i in range(3))


def flat(colours, keys, hue):
    """`colours` with those of `keys` replaced by `hue`, a little of their light and shade kept."""
    light = {key: sum(colours[key][:3]) // 3 for key in keys}
    middle = sum(light.values()) // len(keys)
    shade = {key: max(-24, min(24, (light[key] - middle) // 3)) for key in keys}
    return dict(colours, **{key: tuple(max(0, min(255, c + shade[key])) for c in hue) for key in keys})


# ---- Noise for materials ----


def noise(seed, reach_x, reach_y):
    """16x16 ranks 0..255 of a noise that repeats at the edges, smooth over the reaches. Drawn from Knuth's MMIX LCG."""
    state, field = seed, []
    for _ in range(SIZE * SIZE):
        state = (state * 6364136223846793005 + 1442695040888963407) % 2**64
        field.append(state >> 48)

    def around(x, y):
        return sum(field[(y + dy) % SIZE * SIZE + (x + dx) % SIZE]
                   for dy in range(-reach_y, reach_y + 1) for dx in range(-reach_x, reach_x + 1))

    smooth = [around(i % SIZE, i // SIZE) for i in range(SIZE * SIZE)]
    order = sorted(range(SIZE * SIZE), key=lambda i: (smooth[i], i))
    ranks = [0] * (SIZE * SIZE)
    for rank, i in enumerate(order):
        ranks[i] = rank
    return [ranks[y * SIZE:(y + 1) * SIZE] for y in range(SIZE)]


def shaded(ranks, shades):
    """The RGBA image of `ranks` in the given (colour, how many of the 256 pixels)."""
    scale = [colour + (255,) for colour, count in shades for _ in range(count)]
    assert len(scale) == SIZE * SIZE
    return [[scale[rank] for rank in row] for row in ranks]


def stamped(base, drawing, places):
    """`drawing` on `base` at every place (x, y), around the edges."""
    out = [list(row) for row in base]
    for x0, y0 in places:
        for y, row in enumerate(image(drawing)):
            for x, colour in enumerate(row):
                if colour[3]:
                    out[(y0 + y) % SIZE][(x0 + x) % SIZE] = colour
    return out


def grass():
    base = shaded(noise(11, 0, 1), [((40, 136, 42), 56), ((46, 146, 46), 96), ((54, 156, 50), 68), ((62, 166, 56), 36)])
    return stamped(base, maps.TUFT, [(1, 2), (9, 0), (5, 6), (12, 7), (1, 11), (8, 12)])


def water():
    base = shaded(noise(27, 2, 0), [((24, 84, 182), 70), ((36, 104, 206), 116), ((50, 122, 222), 70)])
    return stamped(base, maps.WAVE, [(1, 1), (9, 4), (3, 8), (11, 11), (5, 14)])


def sand():
    shades = [((208, 190, 128), 40), ((222, 206, 146), 110), ((232, 217, 160), 80), ((240, 228, 178), 26)]
    base = shaded(noise(35, 2, 0), shades)
    return stamped(base, maps.PEBBLE_OF_SAND, [(3, 4), (11, 2), (7, 10), (13, 13), (1, 13)])


def path():
    base = shaded(noise(43, 1, 1), [((104, 84, 56), 60), ((120, 98, 66), 110), ((134, 112, 78), 86)])
    return stamped(base, maps.PEBBLE_OF_PATH, [(2, 1), (10, 3), (5, 7), (13, 9), (1, 12), (8, 13)])


def stone():
    base = shaded(noise(51, 1, 0), [((104, 104, 106), 64), ((120, 120, 122), 112), ((136, 136, 138), 80)])
    return stamped(base, maps.CRACK, [(1, 2), (9, 7), (4, 11)])


def lava():
    crust = [((196, 48, 8), 36), ((232, 84, 10), 70)]
    glow = [((250, 120, 14), 84), ((255, 164, 34), 46), ((255, 214, 90), 20)]
    return shaded(noise(67, 1, 1), crust + glow)


def leaves():
    return shaded(noise(75, 1, 0), [((26, 84, 24), 60), ((44, 112, 34), 90), ((66, 140, 46), 70), ((98, 172, 66), 36)])


def log():
    return shaded(noise(83, 0, 2), [((74, 46, 22), 60), ((96, 62, 30), 90), ((118, 80, 42), 76), ((140, 98, 54), 30)])


def patched_stone(hue):
    """Stone with patches of another colour over three fifths of it."""
    ranks, patches, ground = noise(51, 1, 0), noise(99, 1, 1), stone()
    tones = [mix(hue, (0, 0, 0), 48), hue, mix(hue, (255, 255, 255), 40)]
    return [[tones[ranks[y][x] * 3 // 256] + (255,) if patches[y][x] >= 102 else ground[y][x] for x in range(SIZE)]
            for y in range(SIZE)]


# ---- All textures by name ----


def material_textures():
    """Opaque textures: RGB."""
    ground, rock = grass(), stone()
    out = {
        'grass': ground, 'water': water(), 'sand': sand(), 'path': path(), 'stone': rock, 'lava': lava(),
        'leaves': leaves(), 'log': log(), 'table': image(maps.TABLE), 'furnace': image(maps.FURNACE),
        'iron': over(rock, image(maps.IRON)), 'diamond': over(rock, image(maps.DIAMOND)),
        'coal': over(rock, image(maps.COAL)), 'tree': over(ground, image(maps.TREE)),
    }
    for k, hue in enumerate([(104, 196, 92), (40, 226, 232), (246, 166, 30)], 1):
        out[f'tree{k}'] = over(ground, image((flat(maps.TREE_COLOURS, maps.TREE_CROWN_KEYS, hue), maps.TREE[1])))
    for k, hue in enumerate([(24, 236, 220), (250, 234, 24), (246, 30, 200)], 1):
        tinted = [[mix(colour, hue, 48) + (255,) for colour in row] for row in rock]
        out[f'coal{k}'] = over(tinted, image((flat(maps.COAL_COLOURS, maps.COAL_LUMP_KEYS, hue), maps.COAL[1])))
    for k, hue in enumerate([(50, 46, 236), (234, 28, 34), (92, 232, 24)], 1):
        out[f'stone{k}'] = patched_stone(hue)
    for name in ('tree', 'coal', 'stone', 'iron', 'water'):
        out[f'{name}0'] = out[name]
    return {name: opaque(rows) for name, rows in out.items()}


def player_textures():
    front, back, side = image(maps.PLAYER_FRONT), image(maps.PLAYER_BACK), image(maps.PLAYER_SIDE)
    tall, wide = image(maps.LAMP_TALL), image(maps.LAMP_WIDE)
    left = over(side, tall, 0, 3)
    out = {
        'player': front, 'player-down': over(front, wide, 5, 11), 'player-up': over(back, wide, 5, 0),
        'player-left': left, 'player-right': mirrored(left), 'player-sleep': image(maps.PLAYER_SLEEP),
    }
    out.update({f'{name}0': rows for name, rows in out.items()})
    for k, hue in enumerate([(240, 30, 196), (232, 30, 36), (90, 226, 30)], 1):
        out[f'player{k}'] = image((flat(maps.PLAYER_COLOURS, 'tTs', hue), maps.PLAYER_FRONT[1]))
    return out


def creature_textures():
    out = {}
    kinds = {
        'cow': (maps.COW, 'wWbBpkh', [(160, 154, 56), (86, 184, 178), (194, 84, 98)]),
        'zombie': (maps.ZOMBIE, 'gGDderk', [(184, 120, 76), (108, 78, 194), (222, 212, 76)]),
        'skeleton': (maps.SKELETON, maps.SKELETON_BODY_KEYS,
                     [(250, 20, 220), (52, 28, 250), (30, 246, 60), (244, 236, 28), (244, 26, 28), (18, 18, 18)]),
    }
    for name, ((colours, rows), keys, hues) in kinds.items():
        out[name] = out[f'{name}0'] = image((colours, rows))
        for k, hue in enumerate(hues, 1):
            out[f'{name}{k}'] = image((flat(colours, keys, hue), rows))
    return out


def thing_textures():
    arrow = image(maps.ARROW_RIGHT)
    plant = image(maps.PLANT)
    ripe = plant
    for x, y in maps.FRUIT_PLACES:
        ripe = over(ripe, image(maps.FRUIT), x, y)
    return {
        'arrow-right': arrow, 'arrow-down': turned(arrow), 'arrow-left': mirrored(arrow),
        'arrow-up': turned(mirrored(arrow)),
        'plant': plant, 'plant-ripe': ripe, 'plant-young': image(maps.PLANT_YOUNG), 'fence': image(maps.FENCE),
    }


def item_textures():
    out = {
        'health': image(items.HEALTH), 'food': image(items.FOOD), 'drink': image(items.DRINK),
        'energy': image(items.ENERGY), 'sapling': image(items.SAPLING), 'wood': image(items.WOOD),
    }
    for kind, colours in items.TOOL_COLOURS.items():
        out[f'{kind}_pickaxe'] = image(({**items.HANDLE_COLOURS, **colours}, items.PICKAXE))
        out[f'{kind}_sword'] = image(({**items.HANDLE_COLOURS, **colours}, items.SWORD))
    out.update({name: image((items.WHITE, text)) for name, text in items.DIGITS.items()})
    return out


def all_textures():
    parts = (material_textures(), player_textures(), creature_textures(), thing_textures(), item_textures())
    textures = {name: rows for part in parts for name, rows in part.items()}
    for name, rows in textures.items():
        assert len(rows) == SIZE and all(len(row) == SIZE for row in rows), name
    return dict(sorted(textures.items()))


def main():
    parser = argparse.ArgumentParser(description='Makes the textures.')
    parser.add_argument('--out', type=pathlib.Path, default=pathlib.Path(__file__).resolve().parent)
    parser.add_argument('--sheet', type=pathlib.Path)
    parser.add_argument('--distances', action='store_true')
    args = parser.parse_args()
    textures = all_textures()
    args.out.mkdir(parents=True, exist_ok=True)
    for name, rows in textures.items():
        (args.out / f'{name}.png').write_bytes(png.encode(rows))
    if args.sheet:
        args.sheet.write_bytes(png.encode(sheet.contact_sheet(textures)))
    if args.distances:
        sheet.print_distances(textures)


if __name__ == '__main__':
    main()

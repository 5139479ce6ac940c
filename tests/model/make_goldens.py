#!/usr/bin/env python3
"""Makes the golden data with our own textures: python3 tests/model/make_goldens.py --out tests/data/own

Takes about half a minute.

JSON Lines, compact, fixed key order. Doubles are printed with Python's repr: strtod gives the exact value back. Every
hash is zlib's crc32 (polynomial 0xEDB88320) as 8 lower-case hex digits. Ids of materials, objects and items, and
facing as (dx, dy), are those of the rules.

worlds.jsonl: one row per generated world
  seed, ep, eseed: base seed, episode (from 1), seed of the episode's stream
  area: [width, height]
  numbers: five letters of q h s d f for tree, coal, cow, zombie, skeleton; sssss is the default
  letters, percentages: appearance: the letters whose things have variants (empty: no variants and no draws for them),
    and the four percentages
  size, view: of the picture, [w, h] each
  nobj: objects, the player included
  mat: crc of the material map, uint8 [x][y], y fastest
  obj: crc of the objects in order of creation: u8 type, i16 x, i16 y, i16 health, little endian, packed (7 bytes)
  mvar: crc of uint8 [x][y]: 0 for no variant, k + 1 for variant k (without letters all 0)
  ovar: crc of one byte per object in order: 0 for no variant, k + 1 for variant k
  rng: crc of the next 8 doubles (little-endian float64) that a copy of the stream would give after world generation
  mtp: words used of the stream's 624, 0..624, at the same moment
  img: crc of the first observation (step 0, so nothing is drawn from the stream), uint8, rows y, columns x, RGB
Healths at the start: player 9, cow 3, zombie 5, skeleton 3. The player stands in the middle, facing (0, 1).

frames.jsonl: one row per picture of a staged situation
  name: what the picture is about; unique
  world: row of worlds.jsonl (from 0) that the material map and its variants come from (its objects do not)
  mat: [[x, y, id, variant], ...] written over that map; variant -1 is none
  size, view: of the picture, [w, h] each
  step, day: step counter and the daylight that follows from it
  sleeping: 0 or 1
  objs: [[type, x, y, dx, dy, variant, health, aux], ...] in order of creation; the first is the player and the
    picture's centre. aux: a plant's grown (ripe above 300), otherwise 0. Facing matters for player and arrow
  inv: 16 amounts, item order of the rules (health first)
  inventory: 1; or 0: the "no inventory" mode
  stream: [seed, words]: the stream before the picture is the one seeded with seed after words 32-bit words were drawn
    (Below(2) draws exactly one)
  rng, mtp: of the stream after the picture, as above
  crc: of the picture, uint8, rows y, columns x, RGB
  off: where its w * h * 3 bytes begin in the unpacked frames.bin.gz; null: only the crc is kept
"""
import argparse
import copy
import gzip
import json
import pathlib
import struct
import zlib

import crafter_model as model
import crafter_picture as picture
from situations import RANDOM_AREAS, SITUATIONS

TEXTURES = pathlib.Path(__file__).resolve().parents[2] / 'envserver' / 'textures'

MATERIALS = ('none', 'water', 'grass', 'stone', 'path', 'sand', 'tree', 'lava', 'coal', 'iron', 'diamond', 'table',
             'furnace')
ITEMS = ('health', 'food', 'drink', 'energy', 'sapling', 'wood', 'stone', 'coal', 'iron', 'diamond', 'wood_pickaxe',
         'stone_pickaxe', 'iron_pickaxe', 'wood_sword', 'stone_sword', 'iron_sword')
PLAYER, COW, ZOMBIE, SKELETON, ARROW, PLANT = range(1, 7)
CREATURES = {COW: 'cow', ZOMBIE: 'zombie', SKELETON: 'skeleton'}
TYPES = {'Player': PLAYER, 'Cow': COW, 'Zombie': ZOMBIE, 'Skeleton': SKELETON}
START_HEALTH = {PLAYER: 9, COW: 3, ZOMBIE: 5, SKELETON: 3}
DIRECTIONS = {(-1, 0): 'left', (1, 0): 'right', (0, -1): 'up', (0, 1): 'down'}
RIPE = 300  # a plant's `grown` above this

# World generation places a tree, coal, cow, zombie or skeleton where a draw exceeds the threshold of its letter.
THRESHOLDS = {
    'q': (.945, .963, .9968, .998, .99), 'h': (.9, .92, .993, .9968, .977), 's': (.8, .85, .985, .993, .95),
    'd': (.6, .7, .97, .985, .9), 'f': (.2, .4, .91, .96, .8),
}
NORMAL = 'sssss'
PLAIN = ('', (100, 0, 0, 0))
START_INVENTORY = [9, 9, 9, 9] + [0] * 12


def world_settings():
    """(seed, episode, area, numbers, (letters, percentages), size) of every row of worlds.jsonl. Only append rows."""

    def row(seed, ep=1, area=(64, 64), numbers=NORMAL, look=PLAIN, size=(64, 64)):
        return seed, ep, area, numbers, look, size

    even, new, old, mixed = (
        ('tczsuk', shares) for shares in ((25, 25, 25, 25), (0, 33, 33, 34), (100, 0, 0, 0), (52, 16, 16, 16)))
    rows = [row(seed) for seed in range(100, 130)]
    rows += [row(seed, ep) for seed, ep in ((100, 2), (101, 2), (102, 3), (103, 17), (104, 10000))]
    rows += [row(0), row(-1), row(-7, 2), row(2**40 + 7), row(2**63 - 1, 2)]
    rows += [row(seed, look=even) for seed in range(140, 144)]
    rows += [row(seed, look=new) for seed in range(144, 148)]
    rows += [row(seed, look=old) for seed in range(148, 151)]
    rows += [row(151, look=mixed), row(152, 2, look=mixed), row(153, look=('ptwzsukci', (100, 0, 0, 0)))]
    codes = ('dddhh', 'fffqq', 'fffff', 'hhhdd', 'qqqff', 'qhsdf')
    rows += [row(160 + i, numbers=code) for i, code in enumerate(codes)]
    rows += [row(166, numbers='fffff', look=even), row(167, 2, numbers='hhhdd', look=new)]
    rows += [row(170, size=(72, 72)), row(171, size=(72, 72)), row(172, look=even, size=(72, 72))]
    rows += [row(173, size=(96, 80))]
    rows += [row(180, area=(32, 32)), row(181, area=(48, 40))]
    rows += [row(182, area=(20, 90), size=(84, 84)), row(183, area=(5, 4))]
    rows += [row(200 + i, area=area, look=(PLAIN, even)[i % 2]) for i, area in enumerate(RANDOM_AREAS)]
    return rows


def crc(data):
    return f'{zlib.crc32(data):08x}'


def stream_fields(stream):
    """`rng` and `mtp` of a stream, which is not advanced."""
    ahead = copy.deepcopy(stream)
    return {'rng': crc(struct.pack('<8d', *(ahead.double() for _ in range(8)))), 'mtp': stream.pos}


class World:
    """A generated map, its objects as [type, x, y, dx, dy, variant, health, aux], the stream after generation."""

    def __init__(self, seed, ep, area, numbers, look):
        self.area = area
        self.eseed = model.episode_seed(seed, ep)
        thresholds = [THRESHOLDS[letter][i] for i, letter in enumerate(numbers)]
        variants = []
        self.materials, objects, self.stream = model.worldgen(self.eseed, area, thresholds, look[0], look[1], variants)
        self.variants, object_variants = variants
        self.objects = []
        for (name, x, y), variant in zip(objects, object_variants):
            kind = TYPES[name]
            self.objects.append([kind, x, y, 0, 1, variant, START_HEALTH[kind], 0])

    def texture(self, x, y):
        variant = self.variants[x][y]
        return MATERIALS[self.materials[x][y]] + (str(variant) if variant >= 0 else '')


def object_texture(thing, sleeping):
    kind, _, _, dx, dy, variant, _, aux = thing
    if kind == PLAYER:
        name = 'player-sleep' if sleeping else 'player-' + DIRECTIONS[dx, dy]
    elif kind == ARROW:
        name = 'arrow-' + DIRECTIONS[dx, dy]
    elif kind == PLANT:
        name = 'plant-ripe' if aux > RIPE else 'plant'
    else:
        name = CREATURES[kind]
    return name + (str(variant) if variant >= 0 else '')


def render(store, world, stream, objects, inventory, day, sleeping, size, view, show_items=True):
    named = [(object_texture(thing, sleeping), thing[1], thing[2]) for thing in objects]
    return picture.render(store, stream, world.texture, world.area, objects[0][1:3], named, list(zip(ITEMS, inventory)),
                          day, sleeping, size, view, show_items)


def world_row(store, settings):
    seed, ep, area, numbers, look, size = settings
    world = World(seed, ep, area, numbers, look)
    cells = [(x, y) for x in range(area[0]) for y in range(area[1])]
    packed = b''.join(struct.pack('<Bhhh', *thing[:3], thing[6]) for thing in world.objects)
    image = render(store, world, copy.deepcopy(world.stream), world.objects, START_INVENTORY, picture.daylight(0),
                   False, size, (9, 9))
    row = {
        'seed': seed, 'ep': ep, 'eseed': world.eseed, 'area': area, 'numbers': numbers, 'letters': look[0],
        'percentages': look[1], 'size': size, 'view': (9, 9), 'nobj': len(world.objects),
        'mat': crc(bytes(world.materials[x][y] for x, y in cells)), 'obj': crc(packed),
        'mvar': crc(bytes(world.variants[x][y] + 1 for x, y in cells)),
        'ovar': crc(bytes(thing[5] + 1 for thing in world.objects)),
        **stream_fields(world.stream), 'img': crc(image),
    }
    return world, row


def frame_row(store, worlds, situation, offset):
    """-> (row, bytes of the picture to keep)."""
    world = copy.deepcopy(worlds[situation.world])
    for x, y, material, variant in situation.mat:
        world.materials[x][y], world.variants[x][y] = material, variant
    cells = [tuple(thing[1:3]) for thing in situation.objs]
    assert len(set(cells)) == len(cells), situation.name
    assert all(0 <= x < world.area[0] and 0 <= y < world.area[1] for x, y in cells), situation.name
    stream = model.MT(situation.stream[0])
    for _ in range(situation.stream[1]):
        stream.u32()
    day = picture.daylight(situation.step)
    image = render(store, world, stream, situation.objs, situation.inv, day, situation.sleeping, situation.size,
                   situation.view, situation.inventory)
    row = {
        'name': situation.name, 'world': situation.world, 'mat': situation.mat, 'size': situation.size,
        'view': situation.view, 'step': situation.step, 'day': day, 'sleeping': int(situation.sleeping),
        'objs': situation.objs, 'inv': situation.inv, 'inventory': int(situation.inventory), 'stream': situation.stream,
        **stream_fields(stream), 'crc': crc(image), 'off': offset if situation.keep else None,
    }
    return row, image if situation.keep else b''


def write_rows(path, rows):
    path.write_text(''.join(json.dumps(row, separators=(',', ':')) + '\n' for row in rows))


def main():
    parser = argparse.ArgumentParser(description='Makes the golden data with our own textures.')
    parser.add_argument('--out', type=pathlib.Path, required=True)
    out = parser.parse_args().out
    store = picture.TextureStore(TEXTURES)
    worlds, world_rows = zip(*(world_row(store, settings) for settings in world_settings()))
    write_rows(out / 'worlds.jsonl', world_rows)
    frame_rows, pictures = [], b''
    for situation in SITUATIONS:
        row, image = frame_row(store, worlds, situation, len(pictures))
        frame_rows.append(row)
        pictures += image
    names = [row['name'] for row in frame_rows]
    assert len(set(names)) == len(names)
    write_rows(out / 'frames.jsonl', frame_rows)
    (out / 'frames.bin.gz').write_bytes(gzip.compress(pictures, 9, mtime=0))


if __name__ == '__main__':
    main()

"""The situations in the golden pictures: tests/data/own/frames.jsonl has one row for each."""
import dataclasses
import random

PLAYER, COW, ZOMBIE, SKELETON, ARROW, PLANT = range(1, 7)
WATER, GRASS, STONE, PATH, SAND, TREE, LAVA, COAL, IRON, DIAMOND, TABLE, FURNACE = range(1, 13)
LEFT, RIGHT, UP, DOWN = (-1, 0), (1, 0), (0, -1), (0, 1)
START = [9, 9, 9, 9] + [0] * 12
FULL = [9, 8, 7, 6, 5, 4, 3, 2, 1, 9, 8, 7, 6, 5, 4, 3]
NOON, DUSK, MIDNIGHT = 60, 165, 210  # steps: daylight 1, 0.31 and 0
EVEN_WORLD = 40  # the first row of worlds.jsonl with variants
TALL_WORLD, TINY_WORLD = 68, 69  # 20x90 and 5x4 cells
RANDOM_WORLD, RANDOM_AREAS = 70, [(4, 40), (7, 5), (13, 9), (40, 4), (29, 31), (40, 40), (18, 23), (9, 36)]


def player(x=32, y=32, facing=DOWN):
    return (PLAYER, x, y, *facing, -1, 9, 0)


def creature(kind, x, y, variant=-1, health=3):
    return (kind, x, y, 0, 1, variant, health, 0)


def arrow(x, y, facing):
    return (ARROW, x, y, *facing, -1, 0, 0)


def plant(x, y, grown, health=1):
    return (PLANT, x, y, 0, 1, -1, health, grown)


@dataclasses.dataclass
class Situation:
    """Fields as in make_goldens.py; `keep`: whether to store the picture's bytes besides their crc."""
    name: str
    world: int = 0
    mat: list = dataclasses.field(default_factory=list)
    size: tuple = (64, 64)
    view: tuple = (9, 9)
    step: int = 0
    sleeping: bool = False
    objs: list = dataclasses.field(default_factory=lambda: [player()])
    inv: list = dataclasses.field(default_factory=lambda: START)
    inventory: bool = True
    stream: tuple = (1, 0)
    keep: bool = True


def all_materials():
    """Every material and every variant in the 9x7 cells around (32, 32)."""
    cells = [(material, -1) for material in range(WATER, FURNACE + 1)]
    cells += [(material, variant) for material in (TREE, STONE, COAL) for variant in range(4)]
    cells += [(WATER, 0), (IRON, 0)]
    return [(28 + i % 9, 29 + i // 9, *cell) for i, cell in enumerate(cells)]


def all_objects():
    """Every kind of object and every variant around the player at (32, 32), some outside the view, some with health 0."""
    things = [(kind, variant) for kind in (COW, ZOMBIE, SKELETON) for variant in range(-1, 4)]
    out = [player(32, 32, LEFT)]
    out += [creature(kind, 28 + i % 9, 29 + i // 9, variant, i % 4) for i, (kind, variant) in enumerate(things)]
    out += [arrow(28 + i, 33, facing) for i, facing in enumerate((LEFT, RIGHT, UP, DOWN))]
    out += [plant(33 + i, 33, grown, i % 2) for i, grown in enumerate((0, 1, 300, 301))]
    outside = [creature(COW, 27, 32), creature(ZOMBIE, 37, 32), creature(SKELETON, 32, 28), arrow(32, 36, UP)]
    return out + outside + [plant(28, 36, 500)]


def crowd(x, y):
    """A few objects around a player at (x, y) that faces left."""
    creatures = [creature(ZOMBIE, x - 1, y), creature(COW, x + 2, y - 1), creature(SKELETON, x + 1, y + 2)]
    return [player(x, y, LEFT), *creatures, arrow(x - 2, y + 1, RIGHT), plant(x, y + 1, 301), plant(x + 1, y - 2, 12)]


def random_situation(number):
    """Of any view and size, in a world of any area."""
    draw = random.Random(number)
    place = number % len(RANDOM_AREAS)
    width, height = RANDOM_AREAS[place]
    cells = [(x, y) for x in range(width) for y in range(height)]
    taken = draw.sample(cells, min(len(cells), 13))
    things = [lambda x, y: creature(draw.choice((COW, ZOMBIE, SKELETON)), x, y, draw.randint(-1, 3)),
              lambda x, y: arrow(x, y, draw.choice((LEFT, RIGHT, UP, DOWN))), lambda x, y: plant(x, y, draw.randint(298, 303))]
    columns = draw.randint(1, 17)
    rows = -(-16 // columns) + draw.randint(1, 9)
    return Situation(
        f'random {number}', RANDOM_WORLD + place,
        [(*cell, draw.randint(WATER, FURNACE), -1) for cell in draw.sample(cells, min(len(cells), 30))],
        (columns * draw.randint(2, 34) + draw.randint(0, 3), rows * draw.randint(2, 20) + draw.randint(0, 3)),
        (columns, rows), draw.choice((NOON, DUSK, MIDNIGHT, draw.randrange(10000))), draw.randrange(3) == 0,
        [player(*taken[0], draw.choice((LEFT, RIGHT, UP, DOWN)))] + [draw.choice(things)(x, y) for x, y in taken[1:]],
        [draw.randint(0, 9) for _ in range(16)], draw.randrange(4) != 0, (number, draw.randrange(700)), keep=False)


ONE_OF_EACH = [1] * 16
NOTHING = [0] * 16

SITUATIONS = [
    # By day.
    Situation('start'),
    *(Situation(f'facing {name}', 1, step=30 + i, objs=[player(facing=facing)], stream=(2, i))
      for i, (name, facing) in enumerate((('left', LEFT), ('right', RIGHT), ('up', UP), ('down', DOWN)))),
    Situation('all materials', 2, all_materials(), step=NOON),
    Situation('all materials in the evening', 2, all_materials(), step=140),
    Situation('all objects', 3, step=NOON, objs=all_objects()),
    Situation('all objects on all materials', 3, all_materials(), step=100, objs=all_objects(), inv=FULL),
    Situation('variants of a generated world', EVEN_WORLD, step=20, objs=crowd(32, 32)),
    Situation('variants elsewhere', EVEN_WORLD + 5, step=20, objs=crowd(20, 44)),
    # Inventory.
    Situation('every amount', 4, step=NOON, inv=FULL),
    Situation('every amount, the other way round', 4, step=NOON, inv=[1, 2, 3, 4, 5, 6, 7, 8, 9, 1, 2, 3, 4, 5, 6, 7]),
    Situation('one of each', 4, step=NOON, inv=ONE_OF_EACH),
    Situation('empty hands and dead', 4, step=NOON, inv=NOTHING),
    Situation('inventory not shown', 5, step=NOON, inv=FULL, inventory=False),
    Situation('inventory not shown at night', 5, step=MIDNIGHT, inv=FULL, inventory=False, stream=(5, 3)),
    # By night: noise is drawn in steps 148 to 272 of a day, where the light is below a half.
    *(Situation(f'night, step {step}', 6 + i, step=step, objs=crowd(32 + i, 30), stream=(100 + i, words))
      for i, (step, words) in enumerate(((147, 0), (148, 1), (DUSK, 2), (190, 617), (MIDNIGHT, 623), (211, 624),
                                         (240, 625), (272, 1247), (273, 1248), (9799, 5000)))),
    Situation('all materials at night', 2, all_materials(), step=DUSK, stream=(7, 0)),
    Situation('all objects at night', 3, all_materials(), step=200, objs=all_objects(), inv=FULL, stream=(8, 11)),
    # Asleep.
    Situation('asleep by day', 7, step=10, sleeping=True, objs=crowd(30, 31)),
    Situation('asleep in the evening', 7, step=160, sleeping=True, objs=crowd(30, 31), stream=(9, 0)),
    Situation('asleep at midnight', 7, all_materials(), step=MIDNIGHT, sleeping=True, objs=all_objects(),
              stream=(9, 1)),
    # The edges of the world.
    *(Situation(f'corner {x} {y}', 8 + i, step=step, objs=[player(x, y, UP), creature(COW, abs(x - 1), y)],
                stream=(20 + i, 50))
      for i, (x, y, step) in enumerate(((0, 0, NOON), (63, 0, DUSK), (0, 63, MIDNIGHT), (63, 63, 145)))),
    Situation('the world is smaller than the view', TINY_WORLD, step=DUSK,
              objs=[player(2, 1, UP), creature(ZOMBIE, 0, 0), plant(4, 3, 301)], stream=(30, 0)),
    Situation('the world is taller than wide', TALL_WORLD, step=NOON, objs=crowd(17, 87)),
    # Other sizes and views.
    Situation('72x72', 3, all_materials(), (72, 72), step=NOON, objs=all_objects(), inv=FULL),
    Situation('72x72 at night', 3, all_materials(), (72, 72), step=200, objs=all_objects(), inv=FULL, stream=(40, 1)),
    Situation('84x84', 3, all_materials(), (84, 84), step=NOON, objs=all_objects(), inv=FULL),
    Situation('84x84 asleep', 3, all_materials(), (84, 84), step=220, sleeping=True, objs=all_objects(),
              stream=(41, 0)),
    Situation('45x45', 9, size=(45, 45), step=NOON, objs=crowd(32, 32), inv=FULL),
    Situation('100x90, a border', 9, size=(100, 90), step=DUSK, objs=crowd(32, 32), inv=FULL, stream=(42, 0)),
    Situation('view 7x9', 10, size=(70, 90), view=(7, 9), step=NOON, objs=crowd(32, 32), inv=FULL),
    Situation('view 7x9 at night', 10, size=(64, 64), view=(7, 9), step=DUSK, objs=crowd(2, 61), inv=FULL,
              stream=(43, 7)),
    Situation('view 11x7', 10, size=(90, 64), view=(11, 7), step=MIDNIGHT, objs=crowd(32, 32), inv=FULL,
              stream=(44, 0)),
    Situation('512x512', 3, all_materials(), (512, 512), step=NOON, objs=all_objects(), inv=FULL),
    Situation('512x512 at night', 3, all_materials(), (512, 512), step=200, objs=all_objects(), inv=FULL,
              stream=(45, 0), keep=False),
    *(random_situation(number) for number in range(40)),
]

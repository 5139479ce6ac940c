"""How the textures look to agents: a contact sheet and the distances between them."""

SAMPLES = {7: (1, 3, 5, 7, 10, 12, 14), 5: (1, 4, 8, 11, 14), 4: (2, 6, 10, 14)}  # nearest sampling of 16 pixels
DIGITS = tuple('123456789') + ('unknown',)
TOOLS = tuple(f'{kind}_{tool}' for kind in ('wood', 'stone', 'iron') for tool in ('pickaxe', 'sword'))
ITEMS_ONLY = ('health', 'food', 'drink', 'energy', 'sapling', 'wood') + TOOLS
ITEMS = ITEMS_ONLY + ('stone', 'coal', 'iron', 'diamond')


def composited(rows, ground):
    """RGB rows of `rows` on `ground`, RGB rows of the same size."""
    return [[colour[:3] if len(colour) == 3 else
             tuple((colour[i] * colour[3] + under[i] * (255 - colour[3])) // 255 for i in range(3))
             for colour, under in zip(row, below)] for row, below in zip(rows, ground)]


def sampled(rows, size):
    return [[rows[y][x] for x in SAMPLES[size]] for y in SAMPLES[size]]


def enlarged(rows, factor):
    return [[colour for colour in row for _ in range(factor)] for row in rows for _ in range(factor)]


def contact_sheet(textures, columns=8):
    """Each texture as drawn and at 7x7 on its ground, and at 5x5 and 4x4 on black, in order of name."""
    black = [[(0, 0, 0)] * 16] * 16
    width, height = 64 + 56 + 20 + 16 + 16, 72
    lines = -(-len(textures) // columns)
    out = [[(60, 60, 60)] * (columns * width) for _ in range(lines * height)]
    for i, (name, rows) in enumerate(textures.items()):
        ground = black if name in DIGITS + ITEMS_ONLY else textures['path' if 'skeleton' in name else 'grass']
        on_ground, on_black = composited(rows, ground), composited(rows, black)
        x0, y0 = i % columns * width + 4, i // columns * height + 4
        for part, x in ((enlarged(on_ground, 4), 0), (enlarged(sampled(on_ground, 7), 8), 66),
                        (enlarged(sampled(on_black, 5), 4), 124), (enlarged(sampled(on_black, 4), 4), 146)):
            for y, row in enumerate(part):
                out[y0 + y][x0 + x:x0 + x + len(row)] = row
    return out


def distance(a, b):
    """Mean distance between the colours of two pictures, 0..441."""
    pairs = [(p, q) for row, other in zip(a, b) for p, q in zip(row, other)]
    return sum(sum((p[i] - q[i])**2 for i in range(3))**0.5 for p, q in pairs) / len(pairs)


def closest(textures, names, ground, size, count):
    """The `count` least distances among `names` at `size`; variant 0, which equals the plain texture, is left out."""
    seen = {name: sampled(composited(textures[name], ground), size) for name in names}
    pairs = [(distance(seen[a], seen[b]), a, b) for i, a in enumerate(names) for b in names[i + 1:]]
    return sorted(pair for pair in pairs if pair[0] > 0)[:count]


def print_distances(textures):
    black = [[(0, 0, 0)] * 16] * 16
    world = [name for name in textures if name not in DIGITS + ITEMS_ONLY]
    scenes = (('map, 7x7 on grass', world, textures['grass'], 7), ('items, 5x5 on black', ITEMS, black, 5),
              ('digits, 4x4 on black', DIGITS, black, 4))
    for title, names, ground, size in scenes:
        print(title)
        for value, a, b in closest(textures, names, ground, size, 12):
            print(f'  {value:6.1f}  {a}  {b}')

"""A plain, slow model of Crafter's random stream, episode seeds, noise and world generation: no numpy, no opensimplex.

Verified against the real libraries on thousands of random cases. Uses only ints and Python floats (IEEE doubles).
crafter_picture.py is the model of the picture.
"""
import math

M32 = 0xFFFFFFFF
M64 = 0xFFFFFFFFFFFFFFFF


# ------------------------------------------------------------------ RNG ----
class MT:
  """MT19937 as used by the legacy numpy RandomState(seed: int)."""

  def __init__(self, seed):
    assert 0 <= seed <= M32
    key = [seed & M32]
    for i in range(1, 624):
      key.append((1812433253 * (key[-1] ^ (key[-1] >> 30)) + i) & M32)
    self.key, self.pos = key, 624
    self.draws = 0  # 32-bit words consumed

  def _twist(self):
    k = self.key
    for i in range(624):
      y = (k[i] & 0x80000000) | (k[(i + 1) % 624] & 0x7FFFFFFF)
      k[i] = k[(i + 397) % 624] ^ (y >> 1) ^ (0x9908B0DF if y & 1 else 0)
    self.pos = 0

  def u32(self):
    if self.pos == 624:
      self._twist()
    y = self.key[self.pos]
    self.pos += 1
    self.draws += 1
    y ^= y >> 11
    y ^= (y << 7) & 0x9D2C5680
    y ^= (y << 15) & 0xEFC60000
    return y ^ (y >> 18)

  def double(self):
    a = self.u32() >> 5
    b = self.u32() >> 6
    return (a * 67108864.0 + b) / 9007199254740992.0

  def uniform(self, lo=0.0, hi=1.0):
    return lo + (hi - lo) * self.double()

  def randint(self, lo, hi):
    """RandomState.randint(lo, hi) with the default dtype (int64), scalar."""
    rng = hi - 1 - lo
    assert 0 <= rng < M32
    if rng == 0:
      return lo  # consumes nothing
    mask = (1 << rng.bit_length()) - 1
    while True:
      v = self.u32() & mask
      if v <= rng:
        return lo + v


# ----------------------------------------------------------- tuple hash ----
def int_hash(n):
  """CPython hash of an int, as unsigned 64-bit lane."""
  h = abs(n) % ((1 << 61) - 1)
  if n < 0:
    h = -h
  if h == -1:
    h = -2
  return h & M64


def tuple_hash(ints):
  P1, P2, P5 = 11400714785074694791, 14029467366897019727, 2870177450012600261
  acc = P5
  for n in ints:
    acc = (acc + int_hash(n) * P2) & M64
    acc = ((acc << 31) | (acc >> 33)) & M64
    acc = (acc * P1) & M64
  acc = (acc + (len(ints) ^ (P5 ^ 3527539))) & M64
  if acc == M64:
    acc = 1546275796
  return acc - (1 << 64) if acc >> 63 else acc  # signed


def episode_seed(seed, episode):
  return tuple_hash((seed, episode)) % (2 ** 31 - 1)  # floor modulo: 0..2^31-2


# -------------------------------------------------------------- simplex ----
class Simplex:
  GRAD = [c for sx, sy, sz in
          [(-1, 1, 1), (1, 1, 1), (-1, -1, 1), (1, -1, 1),
           (-1, 1, -1), (1, 1, -1), (-1, -1, -1), (1, -1, -1)]
          for c in [(sx * 11, sy * 4, sz * 4), (sx * 4, sy * 11, sz * 4),
                    (sx * 4, sy * 4, sz * 11)]]  # 24 vectors
  ST, SQ = -1.0 / 6, 1.0 / 3

  def __init__(self, seed):
    def lcg(s):
      s = (s * 6364136223846793005 + 1442695040888963407) & M64
      return s - (1 << 64) if s >> 63 else s
    s = lcg(lcg(lcg(seed)))
    src = list(range(256))
    self.p = [0] * 256
    for i in range(255, -1, -1):
      s = lcg(s)
      r = (s + 31) % (i + 1)  # exact (no wrap of s+31), floored modulo
      self.p[i] = src[r]
      src[r] = src[i]

  def _con(self, base, ijk, d):
    """Contribution of lattice point base+ijk at displacement d."""
    a = 2 - d[0] * d[0] - d[1] * d[1] - d[2] * d[2]
    if a <= 0:
      return None
    a *= a
    p = self.p
    h = p[(base[0] + ijk[0]) & 255]
    h = p[(h + base[1] + ijk[1]) & 255]
    g = self.GRAD[p[(h + base[2] + ijk[2]) & 255] % 24]
    return a * a * (g[0] * d[0] + g[1] * d[1] + g[2] * d[2])

  def noise3(self, x, y, z):
    SQ = self.SQ
    st = (x + y + z) * self.ST
    s = (x + st, y + st, z + st)
    b = tuple(math.floor(v) for v in s)
    sq = (b[0] + b[1] + b[2]) * SQ
    f = tuple(s[i] - b[i] for i in range(3))
    t = f[0] + f[1] + f[2]
    d0 = (x - (b[0] + sq), y - (b[1] + sq), z - (b[2] + sq))

    def disp(ijk, n):  # (d0 - i) - n*SQ
      q = n * SQ
      return [d0[a] - ijk[a] - q for a in range(3)]

    def unit(mask):  # bit mask -> 0/1 triple
      return [mask >> a & 1 for a in range(3)]

    if t <= 1:
      verts = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
      ap, bp, A, B = 1, 2, f[0], f[1]
      if A >= B and f[2] > B:
        B, bp = f[2], 4
      elif A < B and f[2] > A:
        A, ap = f[2], 4
      w = 1 - t
      if w > A or w > B:
        c = bp if B > A else ap
        # the one chosen axis is +1; the other two axes get a -1, one of them
        # in e0 and the other in e1
        e0, e1 = {1: ([1, -1, 0], [1, 0, -1]),
                  2: ([-1, 1, 0], [0, 1, -1]),
                  4: ([-1, 0, 1], [0, -1, 1])}[c]
        x0, x1 = disp(e0, 0), disp(e1, 0)
      else:
        c = ap | bp
        e0 = unit(c)
        e1 = [1 if v else -1 for v in e0]
        x0, x1 = disp(e0, 2), disp(e1, 1)
    elif t >= 2:
      verts = [(1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)]
      ap, bp, A, B = 6, 5, f[0], f[1]
      if A <= B and f[2] < B:
        B, bp = f[2], 3
      elif A > B and f[2] < A:
        A, ap = f[2], 3
      w = 3 - t
      if w < A or w < B:
        c = bp if B < A else ap
        e0, e1 = {3: ([2, 1, 0], [1, 2, 0]),
                  5: ([2, 0, 1], [1, 0, 2]),
                  6: ([0, 2, 1], [0, 1, 2])}[c]
        x0, x1 = disp(e0, 3), disp(e1, 3)
        # quirk: a y offset of 2 is formed as ((d-1)-3SQ)-1, not (d-2)-3SQ
        if e0[1] == 2:
          x0[1] = d0[1] - 1 - 3 * SQ - 1
        if e1[1] == 2:
          x1[1] = d0[1] - 1 - 3 * SQ - 1
      else:
        e0 = unit(ap & bp)
        e1 = [2 * v for v in e0]
        x0, x1 = disp(e0, 1), disp(e1, 2)
    else:
      verts = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)]
      p1, p2, p3 = f[0] + f[1], f[0] + f[2], f[1] + f[2]
      A, ap, af = (p1 - 1, 3, True) if p1 > 1 else (1 - p1, 4, False)
      B, bp, bf = (p2 - 1, 5, True) if p2 > 1 else (1 - p2, 2, False)
      S, sp, sf = (p3 - 1, 6, True) if p3 > 1 else (1 - p3, 1, False)
      if A <= B and A < S:
        ap, af = sp, sf
      elif A > B and B < S:
        bp, bf = sp, sf

      def perm11m1(mask):  # axis missing from mask (x first, then y, else z)
        m = 0 if not mask & 1 else 1 if not mask & 2 else 2
        return [-1 if a == m else 1 for a in range(3)]

      def first_set(mask):
        return 0 if mask & 1 else 1 if mask & 2 else 2

      if af == bf:
        if af:
          e0 = [1, 1, 1]
          x0 = disp(e0, 3)
          e1 = [0, 0, 0]
          e1[first_set(ap & bp)] = 2
          x1 = disp(e1, 2)
        else:
          e0 = [0, 0, 0]
          x0 = disp(e0, 0)
          e1 = perm11m1(ap | bp)
          x1 = disp(e1, 1)
      else:
        c1, c2 = (ap, bp) if af else (bp, ap)
        e0 = perm11m1(c1)
        x0 = disp(e0, 1)
        x1 = disp([0, 0, 0], 2)
        e1 = [0, 0, 0]
        k = first_set(c2)
        e1[k] = 2
        x1[k] -= 2  # quirk: (d - 2SQ) - 2
    value = 0.0
    for v in verts:
      c = self._con(b, v, disp(v, sum(v)))
      if c is not None:
        value += c
    for e, xd in ((e0, x0), (e1, x1)):
      c = self._con(b, e, xd)
      if c is not None:
        value += c
    return value / 103


def fractal(sx, x, y, z, sizes, normalize=True):
  """sizes: list of (size, weight) in order."""
  v = 0
  for size, w in sizes:
    v += w * sx.noise3(x / size, y / size, z)
  return v / sum(w for _, w in sizes) if normalize else v


# ---------------------------------------------------------- world gen -------
(WATER, GRASS, STONE, PATH, SAND, TREE, LAVA, COAL, IRON, DIAMOND, TABLE,
 FURNACE) = range(1, 13)


def worldgen(seed, area=(64, 64), freq=(0.8, 0.85, 0.985, 0.993, 0.95),
             el_vars='', el_freq=(100, 0, 0, 0), variants=None):
  """-> (mat[x][y], objects [(type, x, y)], MT).  freq = tree, coal, cow,
  zombie, skeleton thresholds (defaults = original Crafter).  Crafter-OOD:
  el_vars / el_freq; pass a list as `variants` to receive
  [material variant map, object variants]; -1 = none."""
  f_tree, f_coal, f_cow, f_zombie, f_skel = freq
  rng = MT(seed)

  def variant(letter):
    if letter is None or letter not in el_vars:
      return -1
    sample, cum = rng.uniform() * 100, 0
    for i, v in enumerate(el_freq):
      cum += v
      if sample <= cum:
        return i
    raise StopIteration  # the reference crashes here (frequencies sum < 100)
  letters = {TREE: 't', WATER: 'w', STONE: 's', COAL: 'u', IRON: 'i'}
  ovar = [variant('p')]  # the player is built before the simplex seed draw
  mvar = [[-1] * area[1] for _ in range(area[0])]
  sx = Simplex(rng.randint(0, 2 ** 31 - 1))
  W, H = area
  px, py = W // 2, H // 2
  mat = [[0] * H for _ in range(W)]
  tun = [[False] * H for _ in range(W)]

  def n(x, y, z, s):
    return fractal(sx, x, y, z, [(s, 1)])

  for x in range(W):
    for y in range(H):
      start = 4 - math.sqrt((x - px) ** 2 + (y - py) ** 2)
      start += 2 * n(x, y, 8, 3)
      start = 1 / (1 + math.exp(-start))
      water = fractal(sx, x, y, 3, [(15, 1), (5, 0.15)], False) + 0.1
      water -= 2 * start
      mount = fractal(sx, x, y, 0, [(15, 1), (5, 0.3)])
      mount -= 4 * start + 0.3 * water
      if start > 0.5:
        m = GRASS
      elif mount > 0.15:
        if n(x, y, 6, 7) > 0.15 and mount > 0.3:
          m = PATH
        elif n(2 * x, y / 5, 7, 3) > 0.4:
          m = PATH
          tun[x][y] = True
        elif n(x / 5, 2 * y, 7, 3) > 0.4:
          m = PATH
          tun[x][y] = True
        elif n(x, y, 1, 8) > 0 and rng.uniform() > f_coal:
          m = COAL
        elif n(x, y, 2, 6) > 0.4 and rng.uniform() > 0.75:
          m = IRON
        elif mount > 0.18 and rng.uniform() > 0.994:
          m = DIAMOND
        elif mount > 0.3 and n(x, y, 6, 5) > 0.35:
          m = LAVA
        else:
          m = STONE
      elif 0.25 < water <= 0.35 and n(x, y, 4, 9) > -0.2:
        m = SAND
      elif 0.3 < water:
        m = WATER
      elif n(x, y, 5, 7) > 0 and rng.uniform() > f_tree:
        m = TREE
      else:
        m = GRASS
      mat[x][y] = m
      mvar[x][y] = variant(letters.get(m))  # right after the cell is set
  objs = [('Player', px, py)]
  for x in range(W):
    for y in range(H):
      dist = math.sqrt((x - px) ** 2 + (y - py) ** 2)
      m = mat[x][y]
      if m not in (GRASS, PATH, SAND):
        continue
      if dist > 3 and m == GRASS and rng.uniform() > f_cow:
        objs.append(('Cow', x, y))
        ovar.append(variant('c'))
      elif dist > 10 and rng.uniform() > f_zombie:
        objs.append(('Zombie', x, y))
        ovar.append(variant('z'))
      elif m == PATH and tun[x][y] and rng.uniform() > f_skel:
        objs.append(('Skeleton', x, y))
        ovar.append(variant('k'))
  if variants is not None:
    variants[:] = [mvar, ovar]
  return mat, objs, rng

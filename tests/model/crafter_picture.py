"""A plain, slow model of Crafter's daylight and picture: no numpy, no PIL. The other half of crafter_model.py.

Verified against the real libraries on hundreds of random pictures. Uses only Python floats (IEEE doubles) and explicit
rounding to float32.
"""
import math
import struct
import zlib


# ------------------------------------------------------------- daylight ----
def daylight(step):
  return 1 - abs(math.cos(math.pi * ((step / 300) % 1 + 0.3))) ** 3


# ------------------------------------------------------------ rendering ----
def f32(v):
  return struct.unpack('<f', struct.pack('<f', v))[0]


def read_png(path):
  """8-bit RGB / RGBA, non-interlaced -> (w, h, channels, [row-major bytes])"""
  data = open(path, 'rb').read()
  assert data[:8] == b'\x89PNG\r\n\x1a\n'
  i, idat = 8, b''
  while i < len(data):
    n = int.from_bytes(data[i:i + 4], 'big')
    kind, body = data[i + 4:i + 8], data[i + 8:i + 8 + n]
    if kind == b'IHDR':
      w, h, depth, ctype, _, _, inter = struct.unpack('>IIBBBBB', body)
      assert depth == 8 and ctype in (2, 6) and inter == 0, path
      ch = {2: 3, 6: 4}[ctype]
    elif kind == b'tRNS':
      raise AssertionError('tRNS ' + path)
    elif kind == b'IDAT':
      idat += body
    i += 12 + n
  raw, out, prev, p = zlib.decompress(idat), [], [0] * (w * ch), 0
  for _ in range(h):
    ft, line = raw[p], list(raw[p + 1:p + 1 + w * ch])
    p += 1 + w * ch
    for k in range(w * ch):
      a = line[k - ch] if k >= ch else 0
      u = prev[k]
      c = prev[k - ch] if k >= ch else 0
      if ft == 1:
        line[k] += a
      elif ft == 2:
        line[k] += u
      elif ft == 3:
        line[k] += (a + u) >> 1
      elif ft == 4:
        e = a + u - c
        pa, pb, pc = abs(e - a), abs(e - u), abs(e - c)
        line[k] += a if pa <= pb and pa <= pc else u if pb <= pc else c
      line[k] &= 255
    out.append(line)
    prev = line
  return w, h, ch, out


def nearest_index(src, dst):
  """PIL NEAREST: source index of each destination pixel (accumulated)."""
  step = src / dst
  pos, idx = step * 0.5, []
  for _ in range(dst):
    idx.append(int(pos))
    pos += step
  return idx


class TextureStore:

  def __init__(self, directory):
    self.dir, self.orig, self.cache = directory, {}, {}

  def get(self, name, w, h):
    """-> (channels, tex[x][y] -> tuple)"""
    name = 'unknown' if name is None else name
    key = (name, w, h)
    if key not in self.cache:
      if name not in self.orig:
        self.orig[name] = read_png(f'{self.dir}/{name}.png')
      ow, oh, ch, rows = self.orig[name]
      ix = range(ow) if (ow, oh) == (w, h) else nearest_index(ow, w)
      iy = range(oh) if (ow, oh) == (w, h) else nearest_index(oh, h)
      self.cache[key] = ch, [[tuple(rows[b][a * ch:a * ch + ch]) for b in iy]
                             for a in ix]
    return self.cache[key]


def draw(canvas, x0, y0, tex):
  ch, px = tex
  for i, col in enumerate(px):
    for j, p in enumerate(col):
      canvas[x0 + i][y0 + j] = list(p[:3])


def draw_alpha(canvas, x0, y0, tex):
  ch, px = tex
  if ch == 3:
    return draw(canvas, x0, y0, tex)
  for i, col in enumerate(px):
    for j, p in enumerate(col):
      a = f32(p[3] / 255)
      ia = f32(1 - a)
      c = canvas[x0 + i][y0 + j]
      for k in range(3):
        t, u = f32(p[k] / 255), f32(c[k] / 255)
        v = f32(f32(a * t) + f32(ia * u))
        c[k] = int(f32(255 * v))


def luma(r, g, b):
  return (19595 * r + 38470 * g + 7471 * b + 32768) >> 16


ALPHA04 = f32(0.4)


def saturate04(c):
  """ImageEnhance.Color(...).enhance(0.4) of one uint8 pixel."""
  l = luma(*c)
  return [int(f32(l + f32(ALPHA04 * (v - l)))) for v in c]


def linspace(n):
  step = 2.0 / (n - 1)
  xs = [i * step + -1.0 for i in range(n)]
  xs[-1] = 1.0
  return xs


_vig = {}


def vignette(w, h):
  if (w, h) not in _vig:
    xs, ys = linspace(w), linspace(h)
    _vig[w, h] = [[1 - math.exp(-0.5 * (x * x + y * y) / 0.25) for y in ys]
                  for x in xs]
  return _vig[w, h]


def render(store, rng, mats, area, center, objs, inv, day, sleeping,
           size=(64, 64), view=(9, 9), show_items=True):
  """mats(x, y) -> texture name; objs: [(texture, x, y)] in object order;
  inv: [(item, amount)] in data.yaml order.  Consumes rng iff day < 0.5.
  -> bytes, row-major (y, x, c)."""
  ux, uy = size[0] // view[0], size[1] // view[1]
  rows = -(-len(inv) // view[0])
  gx, gy = view[0], view[1] - rows
  W, H = gx * ux, gy * uy
  cv = [[[127, 127, 127] for _ in range(H)] for _ in range(W)]
  ox, oy = gx // 2, gy // 2
  for x in range(gx):
    for y in range(gy):
      mx, my = center[0] + x - ox, center[1] + y - oy
      if 0 <= mx < area[0] and 0 <= my < area[1]:
        draw(cv, x * ux, y * uy, store.get(mats(mx, my), ux, uy))
  for name, x, y in objs:
    x, y = x - center[0] + ox, y - center[1] + oy
    if 0 <= x < gx and 0 <= y < gy:
      draw_alpha(cv, x * ux, y * uy, store.get(name, ux, uy))
  noisy = day < 0.5
  if noisy:
    amount, vig = 2 * (0.5 - day), vignette(W, H)
  inv_day = 1 - day
  for x in range(W):
    for y in range(H):
      c = cv[x][y]
      if noisy:
        z = rng.uniform(32, 127)
        m = amount * vig[x][y]
        n = [int((1 - m) * v + m * z) for v in c]
      else:
        n = c
      n = saturate04(n)
      n = [0.5 * n[0] + 0.0, 0.5 * n[1] + 8.0, 0.5 * n[2] + 32.0]
      o = [day * c[k] + inv_day * n[k] for k in range(3)]
      if sleeping:
        l = luma(*[int(v) for v in o])
        o = [0.5 * l + 0.0, 0.5 * l + 0.0, 0.5 * l + 8.0]
      cv[x][y] = [int(v) for v in o]
  IH = rows * uy
  it = [[[0, 0, 0] for _ in range(IH)] for _ in range(W)]
  for i, (name, amount) in enumerate(inv):
    if amount < 1 or not show_items:
      continue
    cx, cy = i % gx, i // gx
    draw_alpha(it, int(cx * ux + 0.1 * ux), int(cy * uy + 0.1 * uy),
               store.get(name, int(0.8 * ux), int(0.8 * uy)))
    text = str(amount) if amount <= 9 else 'unknown'
    draw_alpha(it, int(cx * ux + 0.4 * ux), int(cy * uy + 0.4 * uy),
               store.get(text, int(0.6 * ux), int(0.6 * uy)))
  bx, by = (size[0] - ux * view[0]) // 2, (size[1] - uy * view[1]) // 2
  out = bytearray(size[0] * size[1] * 3)
  for x in range(W):
    for y in range(H + IH):
      p = cv[x][y] if y < H else it[x][y - H]
      o = ((by + y) * size[0] + bx + x) * 3
      out[o:o + 3] = bytes(p)
  return bytes(out)

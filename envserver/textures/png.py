"""A minimal PNG encoder: 8 bits, RGB or RGBA, not interlaced."""
import struct
import zlib


def _chunk(kind, body):
    return struct.pack('>I', len(body)) + kind + body + struct.pack('>I', zlib.crc32(kind + body))


def _stored(data):
    """A zlib stream without compression, so that the bytes do not depend on the version of zlib."""
    out = b'\x78\x01'
    for i in range(0, len(data), 65535):
        block = data[i:i + 65535]
        out += struct.pack('<BHH', i + 65535 >= len(data), len(block), len(block) ^ 0xFFFF) + block
    return out + struct.pack('>I', zlib.adler32(data))


def encode(rows):
    """The PNG file of rows of (r, g, b) or (r, g, b, a)."""
    height, width, channels = len(rows), len(rows[0]), len(rows[0][0])
    header = struct.pack('>IIBBBBB', width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    raw = b''.join(b'\0' + bytes(value for colour in row for value in colour) for row in rows)
    return b'\x89PNG\r\n\x1a\n' + _chunk(b'IHDR', header) + _chunk(b'IDAT', _stored(raw)) + _chunk(b'IEND', b'')

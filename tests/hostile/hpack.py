"""Header blocks of HTTP/2 (RFC 7541): enough to talk to gRPC, without compressing anything."""

# The static table; an index of 1 is its first entry.
STATIC = [
    (":authority", ""), (":method", "GET"), (":method", "POST"), (":path", "/"), (":path", "/index.html"),
    (":scheme", "http"), (":scheme", "https"), (":status", "200"), (":status", "204"), (":status", "206"),
    (":status", "304"), (":status", "400"), (":status", "404"), (":status", "500"), ("accept-charset", ""),
    ("accept-encoding", "gzip, deflate"), ("accept-language", ""), ("accept-ranges", ""), ("accept", ""),
    ("access-control-allow-origin", ""), ("age", ""), ("allow", ""), ("authorization", ""), ("cache-control", ""),
    ("content-disposition", ""), ("content-encoding", ""), ("content-language", ""), ("content-length", ""),
    ("content-location", ""), ("content-range", ""), ("content-type", ""), ("cookie", ""), ("date", ""), ("etag", ""),
    ("expect", ""), ("expires", ""), ("from", ""), ("host", ""), ("if-match", ""), ("if-modified-since", ""),
    ("if-none-match", ""), ("if-range", ""), ("if-unmodified-since", ""), ("last-modified", ""), ("link", ""),
    ("location", ""), ("max-forwards", ""), ("proxy-authenticate", ""), ("proxy-authorization", ""), ("range", ""),
    ("referer", ""), ("refresh", ""), ("retry-after", ""), ("server", ""), ("set-cookie", ""),
    ("strict-transport-security", ""), ("transfer-encoding", ""), ("user-agent", ""), ("vary", ""), ("via", ""),
    ("www-authenticate", "")]


def integer(value, prefix_bits, first=0):
    """An integer whose first byte has `first` in the bits before the prefix."""
    limit = (1 << prefix_bits) - 1
    if value < limit:
        return bytes([first | value])
    out = bytearray([first | limit])
    value -= limit
    while value >= 128:
        out.append(value % 128 | 128)
        value //= 128
    out.append(value)
    return bytes(out)


def _bytes(text):
    return text if isinstance(text, bytes) else text.encode()


def encode(headers):
    """Encodes (name, value) pairs of str or bytes as literals without indexing and without Huffman coding."""
    block = b""
    for name, value in headers:
        name, value = _bytes(name), _bytes(value)
        block += b"\x00" + integer(len(name), 7) + name + integer(len(value), 7) + value
    return block


class Decoder:
    """Decodes the blocks of one direction of a connection, in order. Huffman-coded text, which gRPC's C++ library does not
    send, becomes "huffman:" and its bytes in hexadecimal."""

    def __init__(self, table_bytes=4096):
        self.dynamic, self.size, self.limit = [], 0, table_bytes

    def decode(self, block):
        self.block, self.at = block, 0
        headers = []
        while self.at < len(block):
            first = block[self.at]
            if first & 0x80:
                headers.append(self._entry(self._integer(7)))
            elif first & 0xe0 == 0x20:
                self.limit = self._integer(5)
                self._evict()
            else:
                index = self._integer(6 if first & 0x40 else 4)
                name = self._entry(index)[0] if index else self._text()
                headers.append((name, self._text()))
                if first & 0x40:
                    self._add(headers[-1])
        return headers

    def _integer(self, prefix_bits):
        limit = (1 << prefix_bits) - 1
        value = self.block[self.at] & limit
        self.at += 1
        shift = 0
        while value >= limit:
            byte = self.block[self.at]
            self.at += 1
            value += (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        return value

    def _text(self):
        huffman = self.block[self.at] & 0x80
        length = self._integer(7)
        text = self.block[self.at:self.at + length]
        self.at += length
        return "huffman:" + text.hex() if huffman else text.decode("latin-1")

    def _entry(self, index):
        return STATIC[index - 1] if index <= len(STATIC) else self.dynamic[index - len(STATIC) - 1]

    def _add(self, header):
        self.dynamic.insert(0, header)
        self.size += 32 + len(header[0]) + len(header[1])
        self._evict()

    def _evict(self):
        while self.dynamic and self.size > self.limit:
            name, value = self.dynamic.pop()
            self.size -= 32 + len(name) + len(value)

#!/usr/bin/env python3
"""HTTP/2 and gRPC with control over every byte, for misbehaving peers. Uses only the standard library.

As a client:
  with Client("127.0.0.1:50061") as client:
      reply = client.call("/grpc.health.v1.Health/Check", b"", timeout=10)
      stream = client.start("/craftfleet.v1.EnvironmentService/Play")     # headers alone
      client.send_message(stream, request_bytes)                          # flag and length before it
      client.send_data(stream, any_bytes)                                 # or not
      reply = client.read_reply(stream, timeout=10, messages=1)

As a server: SilentServer sends the required HTTP/2 frames and answers no request. A subclass that overrides `on_headers` or
`on_message` can send invalid replies, or one byte per second.

  tests/hostile/raw_http2.py silent --listen=127.0.0.1:0                  prints "listening on 127.0.0.1:PORT" to stderr
"""

import argparse
import pathlib
import socket
import ssl
import struct
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).parent))  # scripts elsewhere may import this one
import hpack

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
DATA, HEADERS, PRIORITY, RST_STREAM, SETTINGS, PUSH_PROMISE, PING, GOAWAY, WINDOW_UPDATE, CONTINUATION = range(10)
END_STREAM = ACK = 0x1
END_HEADERS = 0x4
PADDED = 0x8
WITH_PRIORITY = 0x20
HEADER_TABLE_SIZE, ENABLE_PUSH, MAX_CONCURRENT_STREAMS, INITIAL_WINDOW_SIZE, MAX_FRAME_SIZE = range(1, 6)
FIRST_WINDOW = 65535
FRAME_BYTES = 16384  # every peer takes such frames


def frame(kind, flags=0, stream=0, payload=b""):
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def message(payload, compressed=False):
    """A gRPC message: flag, length, bytes."""
    return struct.pack(">BI", 1 if compressed else 0, len(payload)) + payload


def connect_socket(address, timeout=10, tls=None, server_name=None, source=None):
    """A socket to HOST:PORT, from the host `source`, or to unix:PATH; `tls` is an ssl.SSLContext of a client."""
    if address.startswith("unix:"):
        plain = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        plain.settimeout(timeout)
        plain.connect(address[5:])
    else:
        host, port = address.rsplit(":", 1)
        plain = socket.create_connection((host.strip("[]"), int(port)), timeout, source and (source, 0))
        plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if tls is None:
        return plain
    tls.set_alpn_protocols(["h2"])
    return tls.wrap_socket(plain, server_hostname=server_name or address.rsplit(":", 1)[0])


class Closed(Exception):
    """The peer closed the connection."""


class Reply:
    """The data received on a stream so far."""

    def __init__(self):
        self.headers, self.trailers = [], []
        self.messages = []       # bytes each
        self.compressed = []     # their flags
        self.ended = False
        self.reset = None        # HTTP/2's error code
        self.rest = b""          # the beginning of an incomplete message
        self.data_bytes = 0

    def header(self, name):
        return next((value for key, value in self.trailers + self.headers if key == name), None)

    @property
    def status(self):
        """The gRPC status code; None if there is none."""
        code = self.header("grpc-status")
        return None if code is None else int(code)

    @property
    def error(self):
        return self.header("grpc-message") or ""

    def add_data(self, payload):
        self.data_bytes += len(payload)
        self.rest += payload
        while len(self.rest) >= 5:
            flag, length = struct.unpack(">BI", self.rest[:5])
            if len(self.rest) < 5 + length:
                break
            self.messages.append(self.rest[5:5 + length])
            self.compressed.append(flag)
            self.rest = self.rest[5 + length:]


class Connection:
    """Sends and receives frames. It answers SETTINGS and PING itself and maintains the flow-control windows. One thread at a
    time may read; any thread may write."""

    def __init__(self, sock, settings=None, grants=True):
        self.sock = sock
        self.grants = grants  # False: grants nothing beyond the initial window
        self.buffer = b""
        self.decoder = hpack.Decoder()
        self.replies = {}     # stream -> Reply
        self.goaway = None    # (error code, text)
        self.pings = 0
        self.window = FIRST_WINDOW
        self.stream_window = FIRST_WINDOW
        self.windows = {}
        self.writing = threading.Lock()
        self.block = None     # (stream, flags, bytes) of unfinished headers
        self.settings = settings or {}
        self.news = []        # (method, arguments...) of callbacks that are still to be made
        self.telling = False

    def write(self, data):
        with self.writing:
            self.sock.sendall(data)

    def send_frame(self, kind, flags=0, stream=0, payload=b""):
        self.write(frame(kind, flags, stream, payload))

    def send_settings(self):
        self.send_frame(SETTINGS, payload=b"".join(struct.pack(">HI", key, value)
                                                   for key, value in self.settings.items()))

    def send_headers(self, stream, headers, end=False):
        """Splits the data into as many frames as necessary."""
        block = hpack.encode(headers)
        parts = [block[i:i + FRAME_BYTES] for i in range(0, len(block), FRAME_BYTES)] or [b""]
        data = b""
        for i, part in enumerate(parts):
            flags = (END_HEADERS if i == len(parts) - 1 else 0) | (END_STREAM if end and i == 0 else 0)
            data += frame(HEADERS if i == 0 else CONTINUATION, flags, stream, part)
        self.write(data)

    def send_data(self, stream, data, end=False, timeout=30):
        """Sends as much as the peer's windows allow; reads frames while they are full."""
        limit = time.monotonic() + timeout
        while data or end:
            room = min(self.window, self.windows.setdefault(stream, self.stream_window), FRAME_BYTES)
            if data and room <= 0:
                reply = self._reply(stream)
                if reply.reset is not None or reply.ended and self.is_client():
                    return  # the peer has reset the stream
                if not self.read_frame(limit - time.monotonic()):
                    raise TimeoutError(f"the other side takes no data, {len(data)} bytes are left")
                continue
            part, data = data[:room], data[room:]
            last = end and not data
            self.window -= len(part)
            self.windows[stream] -= len(part)
            self.send_frame(DATA, END_STREAM if last else 0, stream, part)
            end = end and not last

    def send_message(self, stream, payload, compressed=False, end=False):
        self.send_data(stream, message(payload, compressed), end)

    def reset(self, stream, code=8):
        self.send_frame(RST_STREAM, stream=stream, payload=struct.pack(">I", code))

    def read_frame(self, timeout=10):
        """Receives and handles a frame (kind, flags, stream, payload). None: timeout.  Closed: the connection has ended."""
        limit = time.monotonic() + max(timeout, 0)
        got = self._take(limit)
        if got is None:
            return None
        self._handle(*got)
        if not self.telling:  # a callback may itself read more frames
            self.telling = True
            try:
                while self.news:
                    tell, *what = self.news.pop(0)
                    tell(*what)
            finally:
                self.telling = False
        return got

    def _take(self, limit):
        while True:
            if len(self.buffer) >= 9:
                length = int.from_bytes(self.buffer[:3], "big")
                if len(self.buffer) >= 9 + length:
                    kind, flags, stream = struct.unpack(">BBI", self.buffer[3:9])
                    payload, self.buffer = self.buffer[9:9 + length], self.buffer[9 + length:]
                    return kind, flags, stream & 0x7fffffff, payload
            left = limit - time.monotonic()
            if left <= 0 and not self._pending():
                return None
            self.sock.settimeout(max(left, 0.001))
            try:
                more = self.sock.recv(1 << 16)
            except (TimeoutError, ssl.SSLWantReadError):
                return None
            except OSError as error:
                raise Closed(str(error)) from error
            if not more:
                raise Closed("end of connection")
            self.buffer += more

    def _pending(self):
        return isinstance(self.sock, ssl.SSLSocket) and self.sock.pending() > 0

    def _handle(self, kind, flags, stream, payload):
        if kind == SETTINGS and not flags & ACK:
            self._take_settings(payload)
            self.send_frame(SETTINGS, ACK)
        elif kind == PING and not flags & ACK:
            self.pings += 1
            self.send_frame(PING, ACK, payload=payload)
        elif kind == WINDOW_UPDATE:
            more = struct.unpack(">I", payload)[0]
            if stream == 0:
                self.window += more
            else:
                self.windows[stream] = self.windows.get(stream, self.stream_window) + more
        elif kind == GOAWAY:
            self.goaway = (struct.unpack(">I", payload[4:8])[0], payload[8:].decode("latin-1"))
        elif kind == RST_STREAM:
            self._reply(stream).reset = struct.unpack(">I", payload)[0]
            self._reply(stream).ended = True
        elif kind in (HEADERS, CONTINUATION):
            self._take_headers(kind, flags, stream, payload)
        elif kind == DATA:
            self._take_data(flags, stream, payload)

    def _take_settings(self, payload):
        for at in range(0, len(payload) - 5, 6):
            key, value = struct.unpack(">HI", payload[at:at + 6])
            if key == INITIAL_WINDOW_SIZE:
                for open_stream in self.windows:
                    self.windows[open_stream] += value - self.stream_window
                self.stream_window = value

    def _reply(self, stream):
        return self.replies.setdefault(stream, Reply())

    def _take_headers(self, kind, flags, stream, payload):
        if kind == HEADERS:
            if flags & PADDED:
                payload = payload[1:len(payload) - payload[0]]
            if flags & WITH_PRIORITY:
                payload = payload[5:]
            self.block = (stream, flags, payload)
        else:
            self.block = (stream, self.block[1], self.block[2] + payload)
        if not flags & END_HEADERS:
            return
        headers = self.decoder.decode(self.block[2])
        reply = self._reply(stream)
        ended = bool(self.block[1] & END_STREAM)
        if reply.headers or ended and self.is_client():
            reply.trailers = headers
        else:
            reply.headers = headers
        reply.ended |= ended
        self.news.append((self.on_headers, stream, headers, ended))

    def _take_data(self, flags, stream, payload):
        taken = len(payload)
        if flags & PADDED:
            payload = payload[1:len(payload) - payload[0]]
        if taken and self.grants:
            grant = struct.pack(">I", taken)
            self.write(frame(WINDOW_UPDATE, 0, 0, grant) + frame(WINDOW_UPDATE, 0, stream, grant))
        reply = self._reply(stream)
        known = len(reply.messages)
        reply.add_data(payload)
        reply.ended |= bool(flags & END_STREAM)
        for got in reply.messages[known:]:
            self.news.append((self.on_message, stream, got))
        if flags & END_STREAM:
            self.news.append((self.on_end, stream))

    def is_client(self):
        return True

    def on_headers(self, stream, headers, ended):
        """For servers."""

    def on_message(self, stream, payload):
        """For servers."""

    def on_end(self, stream):
        """For servers: the client has sent its last message."""

    def close(self):
        self.sock.close()


class Client(Connection):
    """A client's connection, after the HTTP/2 preface."""

    def __init__(self, address, timeout=10, tls=None, server_name=None, source=None, settings=None, grants=True):
        super().__init__(connect_socket(address, timeout, tls, server_name, source), settings, grants)
        self.scheme = "https" if tls else "http"
        self.next_stream = 1
        self.write(PREFACE)
        self.send_settings()

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.close()

    def start(self, path, metadata=(), end=False, encoding=None):
        """Begins a call; `encoding` is the declared compression of its messages: gzip, deflate. Returns the stream."""
        stream, self.next_stream = self.next_stream, self.next_stream + 2
        headers = [(":method", "POST"), (":scheme", self.scheme), (":path", path), (":authority", "localhost"),
                   ("te", "trailers"), ("content-type", "application/grpc"), ("user-agent", "hostile")]
        if encoding:
            headers.append(("grpc-encoding", encoding))
        self.send_headers(stream, headers + list(metadata), end)
        return stream

    def read_reply(self, stream, timeout=10, messages=None):
        """Reads until the stream has ended, or has `messages` messages, or `timeout` seconds are over."""
        limit = time.monotonic() + timeout
        reply = self._reply(stream)
        while not reply.ended and (messages is None or len(reply.messages) < messages):
            if self.read_frame(limit - time.monotonic()) is None and time.monotonic() >= limit:
                break
        return reply

    def call(self, path, payload, timeout=10, metadata=(), compressed=False, encoding=None):
        """Sends one message and returns the whole reply."""
        stream = self.start(path, metadata, encoding=encoding)
        self.send_message(stream, payload, compressed, end=True)
        return self.read_reply(stream, timeout)


class ServerConnection(Connection):
    """The server side of a client's connection."""

    def __init__(self, sock, server):
        super().__init__(sock, {MAX_CONCURRENT_STREAMS: 1000})
        self.server = server
        self.answered = set()  # streams

    def is_client(self):
        return False

    def run(self):
        self.sock.settimeout(10)
        got = b""
        while len(got) < len(PREFACE):
            more = self.sock.recv(len(PREFACE) - len(got))
            if not more:
                return
            got += more
        if got != PREFACE:
            return
        self.send_settings()
        while not self.server.stopping:
            self.read_frame(0.5)

    def on_headers(self, stream, headers, ended):
        self.server.paths.append(dict(headers).get(":path", ""))
        self.server.on_headers(self, stream, headers)

    def on_message(self, stream, payload):
        self.server.on_message(self, stream, payload)

    def on_end(self, stream):
        self.server.on_end(self, stream)

    def answer(self, stream, payload, compressed=False, encoding=None):
        """Sends the first or a later message of a call; a message that is declared compressed must be so already."""
        if stream not in self.answered:
            self.answered.add(stream)
            headers = [(":status", "200"), ("content-type", "application/grpc")]
            self.send_headers(stream, headers + ([("grpc-encoding", encoding)] if encoding else []))
        self.send_message(stream, payload, compressed)

    def finish(self, stream, status=0, text=""):
        """Ends a call."""
        headers = [("grpc-status", str(status)), ("grpc-message", text)]
        if stream not in self.answered:
            headers = [(":status", "200"), ("content-type", "application/grpc")] + headers
        self.send_headers(stream, headers, end=True)


class SilentServer:
    """Accepts connections and requests, answers SETTINGS and PING, but no request. Subclasses may override
    on_headers, on_message and on_end, which are called on the connection's thread; connection.answer and
    connection.finish then reply."""

    def __init__(self, listen="127.0.0.1:0", tls=None):
        self.tls = tls           # an ssl.SSLContext of a server
        self.stopping = False
        self.paths = []          # of the requests
        self.connections = []    # all connections so far
        self.threads = []
        if listen.startswith("unix:"):
            self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self.listener.bind(listen[5:])
            self.address = listen
        else:
            host, port = listen.rsplit(":", 1)
            self.listener = socket.create_server((host, int(port)))
            self.address = f"{host}:{self.listener.getsockname()[1]}"
        self.listener.listen(128)
        self.listener.settimeout(0.2)
        self.accepting = threading.Thread(target=self._accept, daemon=True)
        self.accepting.start()

    def on_headers(self, connection, stream, headers):
        """Called when a call begins."""

    def on_message(self, connection, stream, payload):
        """Called for each message of a call."""

    def on_end(self, connection, stream):
        """Called when the client has sent its last message."""

    def _accept(self):
        while not self.stopping:
            try:
                sock, _ = self.listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            thread = threading.Thread(target=self._serve, args=[sock], daemon=True)
            self.threads.append(thread)
            thread.start()

    def _serve(self, sock):
        try:
            if self.tls is not None:
                self.tls.set_alpn_protocols(["h2"])
                sock.settimeout(10)
                sock = self.tls.wrap_socket(sock, server_side=True)
            connection = ServerConnection(sock, self)
            self.connections.append(connection)
            connection.run()
        except (Closed, OSError):
            pass  # clients may disconnect
        finally:
            sock.close()

    def stop(self):
        self.stopping = True
        self.listener.close()
        self.accepting.join()
        for thread in self.threads:
            thread.join(timeout=5)

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.stop()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["silent"])
    parser.add_argument("--listen", default="127.0.0.1:0", help="HOST:PORT or unix:PATH")
    flags = parser.parse_args()
    with SilentServer(flags.listen) as server:
        print(f"listening on {server.address}", file=sys.stderr, flush=True)
        try:
            while True:
                time.sleep(3600)
        except KeyboardInterrupt:
            pass


if __name__ == "__main__":
    main()

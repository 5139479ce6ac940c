#!/usr/bin/env python3
"""A TCP proxy with the faults of bad networks: delays, stalls, cuts, resets.

  proxy.py --map=10.77.0.2:7000=10.77.0.2:6000 --delay_ms=50 --stall_share=0.01 --stall_ms=1000

Bytes that arrive without a pause of 10 ms count as one message. Each message is delayed; some are stalled, with those behind
them. The proxy reads commands from standard input and ends at its end:
  cut ADDRESS    forwards nothing from or to this client, but keeps its connections open; * cuts all clients
  heal ADDRESS   forwards data of this client again
  reset          resets a random connection
  report         prints a line of JSON: connections, messages, bytes, stalls, resets
"""

import argparse
import asyncio
import json
import random
import socket
import struct
import sys

PAUSE_S = 0.01  # between two messages
READ_BYTES = 64 << 10
QUEUED_READS = 256  # most reads in transit in one direction of a connection


class Proxy:
    """Accepts connections and forwards their bytes."""

    def __init__(self, options):
        self.options, self.random = options, random.Random(options.seed)
        self.counts = {"connections": 0, "messages": 0, "bytes": 0, "stalls": 0, "resets": 0}
        self.open = {}  # writers of both ends, by connection
        self.cut, self.healed = set(), asyncio.Condition()

    async def serve(self, listen, target):
        host, port = listen.rsplit(":", 1)
        await asyncio.start_server(lambda reader, writer: self.connect(reader, writer, target), host, int(port))

    async def connect(self, client_reader, client_writer, target):
        host, port = target.rsplit(":", 1)
        client = client_writer.get_extra_info("peername")[0]
        try:
            server_reader, server_writer = await asyncio.open_connection(host, int(port))
        except OSError:
            client_writer.transport.abort()
            return
        self.counts["connections"] += 1
        number = self.counts["connections"]
        self.open[number] = (client_writer, server_writer)
        try:
            async with asyncio.TaskGroup() as directions:
                for reader, writer in [(client_reader, server_writer), (server_reader, client_writer)]:
                    on_the_way = asyncio.Queue(QUEUED_READS)
                    directions.create_task(self.receive(reader, on_the_way))
                    directions.create_task(self.send(client, on_the_way, writer))
        except* OSError:
            pass  # one end has closed, so the other is closed too
        finally:
            del self.open[number]
            for writer in (client_writer, server_writer):
                writer.transport.abort()

    async def receive(self, reader, on_the_way):
        data, last = b"something", 0
        while data:
            try:
                data = await reader.read(READ_BYTES)
            except OSError:
                data = b""  # the end of the connection is delayed like its data
            now = asyncio.get_running_loop().time()
            due = now + self.options.delay_ms / 1000
            if now - last > PAUSE_S:
                self.counts["messages"] += 1
                if self.random.random() < self.options.stall_share:
                    self.counts["stalls"] += 1
                    due += self.options.stall_ms / 1000
            last = now
            await on_the_way.put((due, data))

    async def send(self, client, on_the_way, writer):
        data = b"something"
        while data:
            due, data = await on_the_way.get()
            await asyncio.sleep(due - asyncio.get_running_loop().time())
            async with self.healed:
                await self.healed.wait_for(lambda: not self.cut & {client, "*"})
            self.counts["bytes"] += len(data)
            writer.write(data)
            await writer.drain()
        writer.write_eof()

    def reset(self):
        whole = [ends for ends in self.open.values() if not any(end.transport.is_closing() for end in ends)]
        if not whole:
            return
        self.counts["resets"] += 1
        for writer in self.random.choice(whole):
            no_goodbye = struct.pack("ii", 1, 0)
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, no_goodbye)
            writer.transport.abort()

    async def obey(self, command):
        match command.split():
            case ["cut", address]:
                self.cut.add(address)
            case ["heal", address]:
                async with self.healed:
                    self.cut.discard(address)
                    self.healed.notify_all()
            case ["reset"]:
                self.reset()
            case ["report"]:
                print(json.dumps(self.counts), flush=True)
            case _:
                print(f"proxy.py: unknown command {command!r}", file=sys.stderr, flush=True)


async def run(options):
    proxy = Proxy(options)
    for pair in options.map:
        await proxy.serve(*pair.split("=", 1))
    commands = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(commands), sys.stdin)
    print("ready", flush=True)
    async for line in commands:
        await proxy.obey(line.decode())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", action="append", required=True, metavar="LISTEN=TARGET", help="may be repeated")
    parser.add_argument("--delay_ms", type=float, default=0, help="delay of each message, in either direction")
    parser.add_argument("--stall_share", type=float, default=0, help="share of messages that wait longer")
    parser.add_argument("--stall_ms", type=float, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    main()

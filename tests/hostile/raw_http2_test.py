"""Tests of raw_http2.py, with its own server and with a server of the gRPC library."""

import subprocess

import hpack
import raw_http2
from tests.fakes import python_case
from tests.fakes.python_case import BIN, built


class Echo(raw_http2.SilentServer):
    """Answers each message with itself."""

    def on_message(self, connection, stream, payload):
        connection.answer(stream, payload)

    def on_end(self, connection, stream):
        connection.finish(stream, 7, "no more")


class RawHttp2(python_case.FolderCase):

    def envserver(self):
        """Starts a server that ends with the test; returns its address."""
        log = (self.folder / "log").open("w+")
        self.addCleanup(log.close)
        server = subprocess.Popen([BIN / "craftfleet-envserver", "--listen=127.0.0.1:0"], stderr=log)
        self.addCleanup(server.wait)
        self.addCleanup(server.kill)
        told = "listening on "
        text = python_case.wait_until(lambda: (self.folder / "log").read_text().partition(told)[2].partition("\n")[0],
                                      "the server listens")
        return text.split()[0]

    def test_decoding_inverts_encoding_of_headers(self):
        headers = [(":path", "/a/b"), ("x", "1" * 5000), ("empty", "")]
        self.assertEqual(hpack.Decoder().decode(hpack.encode(headers)), headers)
        # RFC 7541, C.3: requests without Huffman coding that fill the table and use it.
        decoder = hpack.Decoder()
        first = bytes.fromhex("828684410f7777772e6578616d706c652e636f6d")
        second = bytes.fromhex("828684be58086e6f2d6361636865")
        self.assertEqual(decoder.decode(first)[3], (":authority", "www.example.com"))
        self.assertEqual(decoder.decode(second)[3:], [(":authority", "www.example.com"), ("cache-control", "no-cache")])

    def test_a_call_of_its_own_server(self):
        with Echo("unix:" + str(self.folder / "s")) as server, raw_http2.Client(server.address) as client:
            payload = bytes(range(256)) * 2000  # beyond the first window
            reply = client.call("/x/Y", payload)
            self.assertTrue(reply.messages == [payload], [len(got) for got in reply.messages])
            self.assertEqual((reply.status, reply.error), (7, "no more"))
            self.assertEqual(server.paths, ["/x/Y"])

    def test_a_call_of_a_grpc_server(self):
        with raw_http2.Client(self.envserver()) as client:
            reply = client.call("/grpc.health.v1.Health/Check", b"")
            self.assertEqual((reply.status, reply.messages), (0, [b"\x08\x01"]))
            self.assertEqual(client.call("/no/Such", b"").status, 12)

    def test_a_silent_server_keeps_the_connection_and_answers_nothing(self):
        with raw_http2.SilentServer() as server:
            ended = subprocess.run([*built("craftfleet status"), f"--address={server.address}"], capture_output=True,
                                   text=True, timeout=60, check=False)
            self.assertEqual(ended.returncode, 1)
            self.assertIn("craftfleet.v1.StatusService", server.paths[0])
            with raw_http2.Client(server.address) as client:
                reply = client.call("/x/Y", b"z", timeout=1)
                self.assertFalse(reply.ended)
                client.send_frame(raw_http2.PING, payload=b"12345678")
                got = [client.read_frame(5)]
                while got[-1] is not None and got[-1][0] != raw_http2.PING:
                    got.append(client.read_frame(5))
                self.assertEqual(got[-1], (raw_http2.PING, raw_http2.ACK, 0, b"12345678"))


if __name__ == "__main__":
    python_case.main()

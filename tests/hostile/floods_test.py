"""Clients of an environment server that request too much, send nothing, read nothing or disconnect."""

import itertools
import threading
import time

import hpack
import messages
import raw_http2
import server_case
from tests.fakes import python_case

PLAYED = [messages.OK, messages.RESOURCE_EXHAUSTED]


class Floods(server_case.ServerCase):

    def ask(self, session, request, timeout=server_case.PATIENCE_S):
        """The reply to one more request."""
        client, stream = session
        known = len(client.read_reply(stream, 0).messages)
        client.send_message(stream, request)
        return client.read_reply(stream, timeout, messages=known + 1)

    def expect_refused(self, reply, *words):
        self.assertEqual(reply.status, messages.RESOURCE_EXHAUSTED, reply.error)
        for word in words:
            self.assertIn(word, reply.error)

    def test_large_pictures_for_many_lanes_are_refused_before_they_cost_memory(self):
        server = self.envserver()
        before = server.memory_mb()
        for lanes, _ in [(120, 2048), (4096, 2048)]:
            reply = self.ask(self.session(server.address, frame_size=2048), messages.open_lanes(range(lanes)))
            self.expect_refused(reply, "MiB for one session's games", "--max_session_mb", "at most 512")
        self.assertLess(server.memory_mb() - before, 400)
        self.ask(self.session(server.address), messages.open_lanes(range(16)))

    def test_games_are_counted_by_session_and_by_process(self):
        server = self.envserver("--max_session_games=10", "--max_games=15", "--max_client_percent=100")
        first = self.session(server.address)
        self.assertEqual(self.ask(first, messages.open_lanes(range(10))).ended, False)
        # Restarting open lanes needs additional memory only for a moment.
        second = self.session(server.address)
        self.expect_refused(self.ask(second, messages.open_lanes(range(11))), "games of one session: 11 requested",
                            "at most 10", "--max_session_games")
        third = self.session(server.address)
        self.expect_refused(self.ask(third, messages.open_lanes(range(6))), "games of all sessions: 16 requested",
                            "at most 15", "--max_games")
        # The memory of a session is released when it ends.
        first[0].close()
        def room():
            return not self.ask(self.session(server.address), messages.open_lanes(range(10))).ended
        python_case.wait_until(room, "room for others", server_case.PATIENCE_S)

    def test_one_client_leaves_room_for_others(self):
        server = self.envserver("--max_session_games=10", "--max_games=40")
        for _ in range(2):
            self.assertFalse(self.ask(self.session(server.address), messages.open_lanes(range(10))).ended)
        self.expect_refused(self.ask(self.session(server.address), messages.open_lanes([0])),
                            "games of one client: 21 requested", "at most 20", "--max_client_percent")
        for _ in range(2):
            other = self.session(server.address, source="127.0.0.2")
            self.assertFalse(self.ask(other, messages.open_lanes(range(10))).ended)

    def test_a_hello_alone_is_counted(self):
        server = self.envserver("--max_session_mb=150", "--max_games_mb=150", "--max_client_percent=100")
        sessions = [self.session(server.address, frame_size=2048)]
        client = self.client(server.address)
        stream = client.start(messages.PLAY)
        client.send_message(stream, messages.hello(frame_size=2048))
        self.expect_refused(client.read_reply(stream, server_case.PATIENCE_S), "--max_games_mb")
        self.assertFalse(sessions[0][0].read_reply(sessions[0][1], 0).ended)

    def test_streams_without_a_hello_are_counted(self):
        server = self.envserver("--max_session_mb=4", "--max_games_mb=10", "--max_client_percent=100")
        client = self.client(server.address)
        streams = [client.start(messages.PLAY) for _ in range(41)]  # 0.25 MiB each
        def refused():
            return [reply for reply in (client.read_reply(stream, 0.01) for stream in streams) if reply.ended]
        python_case.wait_until(refused, "one is refused", server_case.PATIENCE_S)
        self.assertEqual(len(refused()), 1)
        self.expect_refused(refused()[0], "--max_games_mb")

    def test_a_waiting_session_keeps_nothing_of_its_last_request(self):
        server = self.envserver()
        before = server.memory_mb()
        client = self.client(server.address)
        lane = messages.field(1, 0) + messages.field(4, bytes(3 << 20))  # its snapshot, which is refused
        for _ in range(100):
            stream = client.start(messages.PLAY)
            client.send_message(stream, messages.hello())
            client.read_reply(stream, server_case.PATIENCE_S, messages=1)
            reply = self.ask((client, stream), messages.field(2, messages.field(1, lane)))
            self.assertFalse(reply.ended, reply.error)
        self.assertLess(server.memory_mb() - before, 200)

    def test_late_episodes_open_at_once(self):
        server = self.envserver()
        session = self.session(server.address)
        for episode in [10_001, 5_000_000, 1 << 50]:
            reply = self.ask(session, messages.open_lanes(range(64), episode))
            self.assertFalse(reply.ended, reply.error)
        self.assertLess(server.cpu_s(), 20)
        reply = self.ask(session, messages.open_lanes([0], (1 << 50) + 1))
        self.assertEqual(reply.status, messages.INVALID_ARGUMENT)

    def test_work_for_a_client_that_left_ends(self):
        server = self.envserver()
        client, stream = self.session(server.address)
        client.send_message(stream, messages.open_lanes(range(4096)))
        client.close()
        def still():
            before = server.cpu_s()
            time.sleep(1)
            return server.cpu_s() - before < 0.2
        python_case.wait_until(still, "the server rests", server_case.PATIENCE_S)
        self.assertTrue(self.healthy(server.address))

    def test_sigterm_ends_a_server_that_is_busy_for_many(self):
        server = self.envserver()
        for _ in range(4):
            client, stream = self.session(server.address)
            client.send_message(stream, messages.open_lanes(range(4096)))
        time.sleep(0.3)
        server.terminate(10)

    def test_silent_sessions_end_and_say_why(self):
        server = self.envserver("--hello_timeout=1s", "--idle_timeout=2s")
        client = self.client(server.address)
        reply = client.read_reply(client.start(messages.PLAY), server_case.PATIENCE_S)
        self.assertEqual(reply.status, messages.DEADLINE_EXCEEDED)
        self.assertEqual(reply.error, "waited 1s for a hello (--hello_timeout)")
        client, stream = self.session(server.address)
        reply = client.read_reply(stream, server_case.PATIENCE_S)
        self.assertEqual(reply.status, messages.DEADLINE_EXCEEDED)
        self.assertEqual(reply.error, "waited 2s for the next request (--idle_timeout)")
        python_case.wait_until(lambda: "waited 1s for a hello" in server.text(), "it is in the log")

    def test_a_client_that_reads_no_replies_is_disconnected(self):
        server = self.envserver("--reply_timeout=1s")
        client = self.client(server.address, grants=False)
        stream = client.start(messages.PLAY)
        client.send_message(stream, messages.hello())
        client.send_message(stream, messages.open_lanes(range(64)))
        reply = client.read_reply(stream, server_case.PATIENCE_S)
        self.assertTrue(reply.ended)
        self.assertEqual(reply.status, messages.DEADLINE_EXCEEDED, reply.error)
        self.assertIn("--reply_timeout", reply.error)
        self.assertLess(reply.data_bytes, 1 << 17)

    def test_wrong_limits_are_refused_by_name(self):
        for flag in ["--max_session_games=0", "--max_session_games=5000", "--max_games=7", "--max_session_mb=0",
                     "--max_games_mb=100", "--max_client_percent=0", "--max_client_percent=101", "--hello_timeout=0s", "--idle_timeout=25h", "--reply_timeout=10ms"]:
            ended = self.run_program("craftfleet-envserver", "--listen=127.0.0.1:0", flag, code=1)
            self.assertIn(flag.partition("=")[0] + "=", ended.stderr)


class Squatters(server_case.ServerCase):

    def test_an_idle_session_of_another_run_keeps_nobody_out_of_a_registered_server(self):
        learner = self.learner()
        server = self.envserver(f"--learner={learner.address}")
        squatter = self.client(server.address)
        stream = squatter.start(messages.PLAY)
        squatter.send_message(stream, messages.hello(run_id="another"))
        server.told("registered with learner")
        server_case.Program(self, "craftfleet-actor", f"--learner={learner.address}", f"--envservers={server.address}",
                            listens="status on")
        self.assertEqual(learner.process.wait(server_case.PATIENCE_S), 0, learner.text())


    def answer_pings(self, client):
        try:
            while True:
                client.read_frame(1)
        except (OSError, raw_http2.Closed):
            pass  # the server has ended it, or the test

    def test_idle_games_make_room_for_others(self):
        server = self.envserver("--max_session_games=64", "--max_games=64")
        hog, stream = self.session(server.address, run_id="")
        hog.send_message(stream, messages.open_lanes(range(64)))
        threading.Thread(target=self.answer_pings, args=[hog], daemon=True).start()
        learner = self.learner()
        server_case.Program(self, "craftfleet-actor", f"--learner={learner.address}", f"--envservers={server.address}",
                            listens="status on")
        self.assertEqual(learner.process.wait(server_case.PATIENCE_S), 0, learner.text())
        self.assertIn("while others need room for games", server.text())


class LearnersStreams(server_case.ServerCase):

    def test_a_waiting_stream_keeps_nothing_of_its_last_fragment(self):
        learner = self.learner()
        before = learner.memory_mb()
        client = self.client(learner.address)
        for i in range(100):
            stream = client.start(messages.LEARNER_PLAY)
            client.send_message(stream, messages.fragment(epoch=99, frame_bytes=3 << 20))  # of an unknown epoch
            reply = client.read_reply(stream, server_case.PATIENCE_S, messages=1)
            self.assertEqual(len(reply.messages), 1, (i, reply.error))
        self.assertLess(learner.memory_mb() - before, 150)

    def test_downloads_that_nobody_reads_take_little_memory(self):
        learner = self.learner()
        python_case.wait_until(lambda: self.weights_mb(learner) > 1, "it publishes weights", server_case.PATIENCE_S)
        before = learner.memory_mb()
        client = self.client(learner.address, grants=False, settings={raw_http2.INITIAL_WINDOW_SIZE: 0})
        for _ in range(120):
            client.send_message(client.start(messages.GET_WEIGHTS), b"", end=True)
        time.sleep(3)
        self.assertTrue(self.healthy(learner.address))
        self.assertLess(learner.memory_mb() - before, 150)

    def weights_mb(self, learner):
        with raw_http2.Client(learner.address) as client:
            reply = client.call(messages.GET_WEIGHTS, b"", timeout=server_case.PATIENCE_S)
        return sum(map(len, reply.messages)) / 1e6

    def test_refused_calls_do_not_fill_the_log(self):
        learner = self.learner()
        before = len(learner.text().splitlines())
        fragment = messages.fragment(epoch=1, lane=7)  # of a lane that does not exist
        with raw_http2.Client(learner.address) as client:
            for i in range(500):
                reply = client.call(messages.JOIN, messages.field(1, 99) + messages.field(3, "host-1-a"))
                self.assertEqual(reply.status, messages.FAILED_PRECONDITION, (i, reply.error))
                reply = client.call(messages.LEARNER_PLAY, fragment)
                self.assertIn(b"lane 7, want 0..", b"".join(reply.messages), (i, reply.error))
        self.assertLess(len(learner.text().splitlines()) - before, 20)


class HealthPort(server_case.ServerCase):

    def setUp(self):
        super().setUp()
        self.server = self.envserver("--health_listen=127.0.0.1:0")
        self.health = self.server.told("health on")

    def test_it_serves_health_and_nothing_else(self):
        with raw_http2.Client(self.health) as client:
            self.assertEqual(client.call(messages.HEALTH, b"").messages, [b"\x08\x01"])
            for path in [messages.PLAY, messages.GET_STATUS, messages.WATCH_STATUS, messages.REFLECTION]:
                self.assertEqual(client.call(path, b"").status, messages.UNIMPLEMENTED, path)

    def test_its_number_of_threads_is_bounded(self):
        before = self.server.threads()
        clients = []
        for i in range(40):
            try:
                client = self.client(self.health, timeout=5)
                for path in [messages.REFLECTION, messages.WATCH_HEALTH, messages.PLAY, messages.HEALTH]:
                    client.start(path)
                clients.append(client)
            except (OSError, raw_http2.Closed):
                pass  # beyond the limit
        self.assertGreater(len(clients), 3)
        time.sleep(1)
        self.assertLess(self.server.threads() - before, 20)
        self.assertIn("a health port", self.server.text())  # it refused some connections
        for client in clients:
            client.close()
        python_case.wait_until(lambda: self.healthy(self.health), "it answers again", server_case.PATIENCE_S)

    def test_slow_clients_are_disconnected(self):
        half = raw_http2.connect_socket(self.health)
        self.addCleanup(half.close)
        half.sendall(raw_http2.PREFACE[:10])
        unfinished = self.client(self.health)  # headers that never end
        unfinished.send_frame(raw_http2.HEADERS, 0, 1, b"\x00")
        for sock in [half, unfinished.sock]:
            sock.settimeout(server_case.PATIENCE_S)
            while sock.recv(1 << 16):
                pass  # until the server closes the connection


class Http2Floods(server_case.ServerCase):
    """Of clients that do not acknowledge the server's settings, without which gRPC applies none of its limits."""

    ROOM_MB = 900  # with the 100 MB of a server, less than a server may have
    HEADERS = [(":method", "POST"), (":scheme", "http"), (":path", messages.GET_STATUS), (":authority", "localhost"),
               ("te", "trailers"), ("content-type", "application/grpc")]

    def flood(self, server, address, frames, seconds=4):
        """Sends the frames of `frames()` on four connections. Returns how many the server has not ended."""
        before = server.memory_mb()
        clients = [(self.client(address), frames()) for _ in range(4)]
        end = time.monotonic() + seconds
        while clients and time.monotonic() < end:
            for entry in list(clients):
                client, pieces = entry
                try:
                    client.sock.settimeout(0.1)
                    client.write(next(pieces))
                except TimeoutError:
                    pass
                except OSError:
                    clients.remove(entry)
        self.assertLess(server.memory_mb() - before, self.ROOM_MB)
        self.assertIn("ended a connection from 127.0.0.1", server.text())
        for client, _ in clients:
            client.close()
        python_case.wait_until(lambda: self.healthy(address), "it answers others")
        return len(clients)

    def streams(self, resets=False):
        block = hpack.encode(self.HEADERS)
        for first in range(1, 1 << 24, 1000):
            ids = range(first, first + 1000, 2)
            yield b"".join(raw_http2.frame(raw_http2.HEADERS, raw_http2.END_HEADERS, stream, block) +
                           (raw_http2.frame(raw_http2.RST_STREAM, 0, stream, bytes(4)) if resets else b"")
                           for stream in ids)

    def headers_without_end(self):
        yield raw_http2.frame(raw_http2.HEADERS, 0, 1, hpack.encode(self.HEADERS))
        while True:
            yield raw_http2.frame(raw_http2.CONTINUATION, 0, 1, (b"\x40\x01x\x7e" + b"v" * 126) * 100)

    def test_of_streams(self):
        server = self.envserver()
        self.assertEqual(self.flood(server, server.address, self.streams), 0)

    def test_of_streams_over_tls(self):
        server = self.envserver(*self.tls_flags())
        client = self.client(server.address, tls=self.tls_client())
        with self.assertRaises(OSError):
            for frames in itertools.islice(self.streams(), 200):
                client.write(frames)
        self.assertLess(server.memory_mb(), self.ROOM_MB)

    def test_of_streams_that_are_reset(self):
        """A connection that gRPC keeps up with may go on."""
        server = self.envserver()
        self.flood(server, server.address, lambda: self.streams(resets=True), seconds=10)

    def test_of_streams_beside_many_connections(self):
        """The more connections there are, the longer a look at them takes."""
        server = self.envserver()
        before = server.memory_mb()
        for _ in range(900):
            self.client(server.address)
        for _ in range(5):
            self.flood(server, server.address, self.streams)
        self.assertLess(server.memory_mb() - before, self.ROOM_MB)

    def test_of_headers(self):
        for server in (self.learner(), self.envserver()):
            with self.subTest(server.address):
                self.flood(server, server.address, self.headers_without_end, seconds=6)

    def test_of_connections_with_a_few_streams_each(self):
        """None of them is beyond its own limit."""
        server = self.envserver()
        before = server.memory_mb()
        clients = [self.client(server.address) for _ in range(100)]
        for client in clients:
            client.write(next(self.streams())[:100 * (9 + len(hpack.encode(self.HEADERS)))])
        def ended():
            count = 0
            for client in clients:
                try:
                    while client.read_frame(0.001):
                        pass
                except (OSError, raw_http2.Closed):
                    count += 1
            return count
        python_case.wait_until(lambda: ended() >= 60, "some are ended", server_case.PATIENCE_S)
        self.assertLess(ended(), 100)
        self.assertLess(server.memory_mb() - before, self.ROOM_MB)


class Streams(server_case.ServerCase):

    def test_watchers_that_do_not_read_make_room(self):
        """Each takes one of 32 slots, which it would keep without a limit."""
        server = self.envserver()
        clients = [self.client(server.address, grants=False, settings={raw_http2.INITIAL_WINDOW_SIZE: 0})
                   for _ in range(32)]
        for client in clients:
            client.send_message(client.start(messages.WATCH_STATUS), messages.field(1, 100), end=True)
        def status(timeout=5):
            with raw_http2.Client(server.address) as client:
                stream = client.start(messages.WATCH_STATUS)
                client.send_message(stream, b"", end=True)
                return client.read_reply(stream, timeout, messages=1)
        python_case.wait_until(lambda: status().status == messages.RESOURCE_EXHAUSTED, "all places are taken")
        python_case.wait_until(lambda: self.read_pings(clients) or status().messages, "a place is free", 150)

    def ended(self, clients_and_streams):
        """How many of the streams have ended."""
        for client in {client for client, _ in clients_and_streams}:
            try:
                while client.read_frame(0.001):
                    pass
            except raw_http2.Closed:
                pass
        return sum(client.read_reply(stream, 0).ended for client, stream in clients_and_streams)

    def test_reflection_streams_are_few_and_short(self):
        """Each holds a thread; 4096 of them would hold all."""
        server = self.envserver()
        before = server.threads()
        streams = []
        for _ in range(3):
            client = self.client(server.address)
            streams += [(client, client.start(messages.REFLECTION)) for _ in range(100)]
        python_case.wait_until(lambda: self.ended(streams) >= 300 - 16, "all but some are refused", server_case.PATIENCE_S)
        self.assertLess(server.threads() - before, 100)
        python_case.wait_until(lambda: self.ended(streams) == 300, "the others end", server_case.PATIENCE_S)
        statuses = {client.read_reply(stream, 0).status for client, stream in streams}
        self.assertEqual(statuses, {messages.RESOURCE_EXHAUSTED, messages.DEADLINE_EXCEEDED})

    def test_health_watchers_of_one_client_are_limited(self):
        server = self.envserver()
        streams = []
        for _ in range(4):
            client = self.client(server.address)
            for _ in range(100):
                streams.append((client, client.start(messages.WATCH_HEALTH)))
                client.send_message(streams[-1][1], b"", end=True)
        python_case.wait_until(lambda: self.ended(streams) == 400 - 256, "those beyond are refused", server_case.PATIENCE_S)
        self.assertTrue(self.healthy(server.address))

    def read_pings(self, clients):
        """Reads frames, so that the connections stay alive for HTTP/2."""
        for client in clients:
            try:
                while client.read_frame(0.001):
                    pass
            except raw_http2.Closed:
                pass


if __name__ == "__main__":
    python_case.main()

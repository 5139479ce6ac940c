"""Clients of a server that request too much, send nothing, read nothing or disconnect."""

import re
import time

import server_case
from server_case import error_of
from tests.fakes import python_case

import grpc
import messages

Code = grpc.StatusCode


class Floods(server_case.ServerCase):

    def expect_refused(self, call, request, *words):
        error = error_of(lambda: call.ask(request))
        self.assertIsNotNone(error)
        self.assertEqual(error.code(), Code.RESOURCE_EXHAUSTED, error.details())
        for word in words:
            self.assertIn(word, error.details())

    def test_large_pictures_for_many_lanes_are_refused_before_they_cost_memory(self):
        server = self.envserver()
        before = server.memory_mb()
        for lanes in (120, 4096):
            self.expect_refused(self.session(server.address, frame_size=2048), messages.open_lanes(range(lanes)),
                                "MiB for one session's games", "--max_session_mb", "at most 512")
        self.assertLess(server.memory_mb() - before, 400)
        self.session(server.address).ask(messages.open_lanes(range(16)))

    def test_games_are_limited_by_flags_and_idle_ones_make_room(self):
        server = self.envserver("--max_session_games=10", "--max_games=15", "--max_client_percent=100")
        self.expect_refused(self.session(server.address), messages.open_lanes(range(11)), "at most 10", "--max_session_games")
        self.session(server.address).ask(messages.open_lanes(range(10)))
        self.expect_refused(self.session(server.address), messages.open_lanes(range(6)), "at most 15", "--max_games")
        def room():
            return error_of(lambda: self.session(server.address).ask(messages.open_lanes(range(10)))) is None
        python_case.wait_until(room, "room for others", server_case.PATIENCE_S)
        self.assertIn("while others need room for games", server.text())

    def test_a_registered_server_serves_the_run_of_its_learner_only(self):
        server = self.envserver(f"--learner={self.learner().address}")
        def refused():
            error = error_of(lambda: self.session(server.address, run_id="another"))
            return error is not None and error.code() == Code.FAILED_PRECONDITION
        python_case.wait_until(refused, "it refuses others", server_case.PATIENCE_S)

    def test_a_hello_alone_is_counted(self):
        server = self.envserver("--max_session_mb=150", "--max_games_mb=150", "--max_client_percent=100")
        first = self.session(server.address, frame_size=2048)
        self.expect_refused(self.start(self.channel(server.address), messages.PLAY), messages.hello(frame_size=2048),
                            "--max_games_mb")
        self.assertTrue(first.replies.is_active())

    def test_streams_without_a_hello_are_counted(self):
        server = self.envserver("--max_session_mb=4", "--max_games_mb=10", "--max_client_percent=100")
        channel = self.channel(server.address)
        calls = [self.start(channel, messages.PLAY) for _ in range(41)]  # 0.25 MiB each
        def refused():
            return [call for call in calls if not call.replies.is_active()]
        python_case.wait_until(refused, "one is refused", server_case.PATIENCE_S)
        self.assertEqual(len(refused()), 1)
        self.expect_refused(refused()[0], b"", "--max_games_mb")

    def test_a_waiting_session_keeps_nothing_of_its_last_request(self):
        server = self.envserver()
        before = server.memory_mb()
        channel = self.channel(server.address)
        lane = messages.field(1, 0) + messages.field(4, bytes(3 << 20))  # its snapshot, which is refused
        calls = [self.start(channel, messages.PLAY) for _ in range(100)]
        for call in calls:
            call.ask(messages.hello())
            call.ask(messages.field(2, messages.field(1, lane)))
        self.assertLess(server.memory_mb() - before, 200)

    def test_no_method_decodes_millions_of_fields(self):
        server = self.envserver()
        fields = messages.field(2, b"") * (3 << 20)
        for path in (messages.GET_STATUS, messages.PLAY, messages.HEALTH, messages.REFLECTION):
            before = server.memory_mb()
            for call in [self.start(self.channel(server.address), path, fields) for _ in range(4)]:
                call.end()
            self.assertLess(server.memory_mb() - before, 100, path)

    def test_work_for_a_client_that_left_ends(self):
        server = self.envserver()
        session = self.session(server.address)
        begin = server.cpu_s()
        session.requests.put(messages.open_lanes(range(4096)))
        python_case.wait_until(lambda: server.cpu_s() - begin > 0.1, "it works")
        session.replies.cancel()
        def still():
            before = server.cpu_s()
            time.sleep(1)
            return server.cpu_s() - before < 0.2
        python_case.wait_until(still, "the server rests", server_case.PATIENCE_S)
        self.assertTrue(self.healthy(server.address))

    def test_silent_sessions_end_and_say_why(self):
        server = self.envserver("--hello_timeout=1s", "--idle_timeout=2s")
        for call, reason in ((self.start(self.channel(server.address), messages.PLAY), "waited 1s for a hello (--hello_timeout)"),
                             (self.session(server.address), "waited 2s for the next request (--idle_timeout)")):
            error = error_of(lambda: next(call.replies))
            self.assertEqual((error.code(), error.details()), (Code.DEADLINE_EXCEEDED, reason))
        named = re.compile(r"session of ipv4:127\.0\.0\.1:\d+ ended: waited 1s for a hello")
        python_case.wait_until(lambda: named.search(server.text()), "it is in the log")

    def test_a_client_that_reads_no_replies_is_disconnected(self):
        server = self.envserver("--reply_timeout=1s")
        call = self.start(self.channel(server.address), messages.PLAY, messages.hello(), messages.open_lanes(range(64)))
        python_case.wait_until(lambda: "--reply_timeout" in server.text(), "it is ended", server_case.PATIENCE_S)
        error = call.end()
        self.assertEqual(error.code(), Code.DEADLINE_EXCEEDED, error.details())
        self.assertIn("--reply_timeout", error.details())

    def test_wrong_limits_are_refused_by_name(self):
        for flag in ["--max_session_games=0", "--max_session_games=5000", "--max_games=7", "--max_session_mb=0",
                     "--max_games_mb=100", "--max_client_percent=0", "--max_client_percent=101", "--hello_timeout=0s",
                     "--idle_timeout=25h", "--reply_timeout=10ms"]:
            ended = self.run_program("craftfleet-envserver", "--listen=127.0.0.1:0", flag, code=1)
            self.assertIn(flag.partition("=")[0] + "=", ended.stderr)


class Streams(server_case.ServerCase):

    def test_a_waiting_stream_keeps_nothing_of_its_last_fragment(self):
        learner = self.learner()
        before = learner.memory_mb()
        channel = self.channel(learner.address)
        calls = [self.start(channel, messages.LEARNER_PLAY) for _ in range(100)]
        for call in calls:
            call.ask(messages.fragment(epoch=99, frame_bytes=3 << 20))  # of an unknown epoch
        self.assertLess(learner.memory_mb() - before, 150)

    def test_downloads_that_nobody_reads_take_little_memory(self):
        learner = self.learner()
        channel = self.channel(learner.address)
        download = channel.unary_stream(messages.GET_WEIGHTS)
        weights = []
        def published():
            return error_of(lambda: weights.extend(download(b""))) is None
        python_case.wait_until(published, "it publishes weights", server_case.PATIENCE_S)
        self.assertGreater(sum(map(len, weights)), 1e6)
        before = learner.memory_mb()
        unread = [download(b"") for _ in range(120)]
        time.sleep(3)
        self.assertTrue(self.healthy(learner.address))
        self.assertLess(learner.memory_mb() - before, 150)
        self.assertTrue(all(call.is_active() for call in unread))

    def test_refused_calls_do_not_fill_the_log(self):
        learner = self.learner()
        before = len(learner.text().splitlines())
        channel = self.channel(learner.address)
        join = channel.unary_unary(messages.JOIN)
        for i in range(500):
            error = error_of(lambda: join(messages.field(1, 99) + messages.field(3, "host-1-a")))
            self.assertEqual(error.code(), Code.FAILED_PRECONDITION, (i, error.details()))
            play = self.start(channel, messages.LEARNER_PLAY)
            self.assertIn(b"lane 7, want 0..", play.ask(messages.fragment(epoch=1, lane=7)))  # which does not exist
            play.replies.cancel()
        self.assertLess(len(learner.text().splitlines()) - before, 20)


if __name__ == "__main__":
    python_case.main()

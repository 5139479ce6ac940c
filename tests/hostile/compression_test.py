"""Compressed messages: servers refuse a message that would inflate to a thousand times its size, without
inflating it. (The other direction: tests/common/wire/channel_test.cc.)"""

import server_case
from server_case import error_of
from tests.fakes import python_case

import grpc
import messages

ENCODINGS = {"gzip": grpc.Compression.Gzip, "deflate": grpc.Compression.Deflate}
INFLATED = bytes(120 << 20)
GROWTH_MB = 60  # far less than one inflated message


class Compression(server_case.ServerCase):

    def attack(self, program, paths, tls=False):
        before = program.memory_mb()
        for name, encoding in ENCODINGS.items():
            for path in paths:
                call = self.channel(program.address, tls).unary_unary(path)
                error = error_of(lambda: call(INFLATED, timeout=server_case.PATIENCE_S, compression=encoding))
                self.assertIsNotNone(error, (path, name))
                self.assertEqual(error.code(), grpc.StatusCode.UNIMPLEMENTED, (path, error.details()))
                self.assertIn(name, error.details())
        self.assertLess(program.memory_mb() - before, GROWTH_MB)

    def test_an_environment_server_inflates_nothing(self):
        server = self.envserver()
        self.attack(server, [messages.PLAY, messages.GET_STATUS, messages.HEALTH])
        self.session(server.address)

    def test_a_server_with_tls_inflates_nothing(self):
        self.attack(self.envserver(*self.tls_flags()), [messages.PLAY], tls=True)

    def test_a_learner_inflates_nothing(self):
        self.attack(self.learner(), [messages.JOIN])

    def test_an_actor_inflates_nothing(self):
        actor = self.actor()
        self.attack(actor, [messages.GET_STATUS])
        self.assertTrue(self.healthy(actor.address))


if __name__ == "__main__":
    python_case.main()

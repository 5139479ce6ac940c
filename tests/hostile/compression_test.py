"""Compressed messages: servers and clients refuse a megabyte that would inflate to a gigabyte, without inflating it."""

import functools
import os
import subprocess

import messages
import raw_http2
import server_case
from tests.fakes import python_case
from tests.fakes.python_case import BIN

ENCODINGS = ["gzip", "deflate"]
INFLATED_MB = 400
GROWTH_MB = 100  # far less than one inflated message


@functools.lru_cache
def bomb(encoding):
    return messages.bomb(encoding, INFLATED_MB)


class CompressedReplies(raw_http2.SilentServer):
    """Answers each call with a compressed message."""

    def __init__(self, encoding, told):
        super().__init__()
        self.encoding, self.told = encoding, told

    def on_end(self, connection, stream):
        connection.answer(stream, bomb(self.encoding), True, self.encoding if self.told else None)
        connection.finish(stream)


class Compression(server_case.ServerCase):

    def attack(self, program, address, paths, **options):
        before = program.memory_mb()
        for encoding in ENCODINGS:
            for path in paths:
                for said in [encoding, None, "snappy"]:
                    with raw_http2.Client(address, **options) as client:
                        reply = client.call(path, bomb(encoding), timeout=server_case.PATIENCE_S, compressed=True,
                                            encoding=said)
                    what = (path, encoding, said, reply.status, reply.error)
                    self.assertTrue(reply.ended, what)
                    if said == encoding:
                        self.assertEqual(reply.status, messages.UNIMPLEMENTED, what)
                        self.assertIn(encoding, reply.error)
                    else:
                        self.assertNotEqual(reply.status, messages.OK, what)
        self.assertLess(program.memory_mb() - before, GROWTH_MB)

    def test_an_environment_server_inflates_nothing(self):
        server = self.envserver()
        self.attack(server, server.address, [messages.PLAY, messages.GET_STATUS, messages.HEALTH])
        self.session(server.address)

    def test_a_health_port_inflates_nothing(self):
        server = self.envserver("--health_listen=127.0.0.1:0")
        health = server.told("health on")
        self.attack(server, health, [messages.HEALTH, messages.WATCH_HEALTH, messages.PLAY])
        self.assertTrue(self.healthy(health))

    def test_a_server_with_tls_inflates_nothing(self):
        server = self.envserver(*self.tls_flags())
        self.attack(server, server.address, [messages.PLAY, messages.HEALTH], tls=self.tls_client())

    def test_a_learner_inflates_nothing(self):
        learner = self.learner()
        self.attack(learner, learner.address, [messages.JOIN, messages.GET_STATUS])

    def test_a_learners_health_port_inflates_nothing(self):
        learner = self.learner("--health_listen=127.0.0.1:0")
        health = learner.told("health on")
        self.attack(learner, health, [messages.HEALTH, messages.WATCH_HEALTH, messages.JOIN, messages.LEARNER_PLAY])
        self.assertTrue(self.healthy(health))

    def test_an_actors_ports_inflate_nothing(self):
        actor = self.actor("--health_listen=127.0.0.1:0")
        self.attack(actor, actor.address, [messages.GET_STATUS, messages.WATCH_STATUS, messages.HEALTH])
        self.attack(actor, actor.told("health on"), [messages.HEALTH, messages.GET_STATUS])
        self.assertTrue(self.healthy(actor.address))

    def test_an_actor_of_a_hostile_learner_inflates_nothing(self):
        for encoding in ENCODINGS:
            for told in [True, False]:
                with CompressedReplies(encoding, told) as learner:
                    with (self.folder / "actor.err").open("wb") as log:
                        actor = subprocess.Popen([BIN / "craftfleet-actor", f"--learner={learner.address}",
                                                  "--envservers=127.0.0.1:1"], stderr=log)
                    self.addCleanup(actor.kill)
                    python_case.wait_until(lambda: messages.JOIN in learner.paths, "the actor joins",
                                           server_case.PATIENCE_S)
                    python_case.wait_until(lambda: b"learner" in (self.folder / "actor.err").read_bytes(),
                                           "the actor complains", server_case.PATIENCE_S)
                    actor.terminate()
                    most_mb = os.wait4(actor.pid, 0)[2].ru_maxrss / 1024
                    actor.returncode = 0  # os.wait4 has already reaped it
                    self.assertLess(most_mb, INFLATED_MB, (encoding, told))


if __name__ == "__main__":
    python_case.main()

"""No log line that an untrusted client causes is longer than 1 KiB, however long its names are, and however often it
calls, it causes few of them."""

import itertools
import subprocess
import time

import server_case
from server_case import error_of
from tests.fakes import python_case

import grpc
import messages

LONGEST = 1024
LINES_OF_A_CLIENT = 100  # 16 in ten seconds
LONG = "n" * 1_000_000
CONTROLS = "\x01\n\x7f" * 300_000


class LongLines(server_case.ServerCase):

    def expect_short_lines(self, program):
        lines = program.log.read_bytes().splitlines(keepends=True)
        self.assertLess(max(map(len, lines)), LONGEST + 1, [line[:200] for line in lines if len(line) > LONGEST])
        return lines

    def hello_with(self, server, **hello):
        error = error_of(lambda: self.session(server.address, **hello))
        self.assertLess(len(error.details()), 4 * LONGEST)  # escaped as headers are
        self.assertGreater(len(error.details()), 10)

    def test_of_an_environment_server(self):
        for log_format, name in itertools.product(["text", "json"], [LONG, CONTROLS]):
            server = self.envserver(f"--log_format={log_format}")
            self.hello_with(server, env=name)
            self.hello_with(server, client=name)
            self.hello_with(server, run_id=name)
            python_case.wait_until(lambda: b"session of" in server.log.read_bytes(), "the log has it")
            lines = self.expect_short_lines(server)
            self.assertTrue(any(b" bytes)" in line for line in lines), lines)

    def test_of_a_learner(self):
        learner = self.learner()
        name = "n" * 20000  # both fit into a request (message_bounds.h)
        request = messages.field(1, 99) + messages.field(2, name) + messages.field(3, name)
        self.assertIsNotNone(error_of(lambda: self.unary(learner.address, messages.JOIN, request)))
        python_case.wait_until(lambda: b"nnnnn" in learner.log.read_bytes(), "the log has it")
        self.expect_short_lines(learner)

    def test_of_methods_and_metadata(self):
        server = self.envserver(*self.tls_flags(), f"--access_file={self.access_file()}")
        for path, metadata in [("/" + "m" * 6000, []), ("/x/Y", [("user-agent", "u" * 6000)]),
                               ("/" + LONG, []), ("/x/Y", [("authorization", "Bearer " + "t" * 6000)]),
                               ("/x/Y", [("z" * 6000, "v")]), ("/x/Y", [("x", LONG)])]:
            agent = [("grpc.primary_user_agent", value) for name, value in metadata if name == "user-agent"]
            call = self.channel(server.address, tls=True, options=agent).unary_unary(path)
            self.assertIsNotNone(error_of(lambda: call(b"", metadata=[] if agent else metadata, timeout=10)))
        time.sleep(0.5)
        lines = self.expect_short_lines(server)
        self.assertTrue(any(b"refused" in line for line in lines), lines)

    def access_file(self):
        path = self.folder / "access.txt"
        path.write_text('client { name: "another" certificate: "another" right: WATCH }\n', encoding="utf-8")
        return path


class FewLines(server_case.ServerCase):

    def test_of_sessions_of_ever_new_runs(self):
        server = self.envserver()
        for i in range(100):
            self.session(server.address, run_id=f"run-{i}").end()
        self.assertIn("serves run run-", server.text())
        lines = server.text().count("serves run")
        self.assertLess(lines, 10, "at most one in ten seconds")

    def test_of_workers_that_ask_for_another_run(self):
        learner = self.learner()
        join = self.channel(learner.address).unary_unary(messages.JOIN)
        for i in range(1000):
            request = messages.field(1, messages.protocol_version()) + messages.field(2, f"run-{i}") + \
                messages.field(3, f"host-{i}")
            self.assertEqual(error_of(lambda: join(request)).code(), grpc.StatusCode.FAILED_PRECONDITION)
        python_case.wait_until(lambda: "this learner serves run" in learner.text(), "the log has it")
        self.assertLess(learner.text().count("this learner serves run"), LINES_OF_A_CLIENT)


class MetricsOff(server_case.ServerCase):

    def test_an_empty_address_means_none(self):
        server = self.envserver("--metrics_listen=")
        self.assertNotIn("metrics on", server.text())
        listens = subprocess.run(["ss", "-ltnpH"], capture_output=True, text=True, check=True).stdout
        self.assertEqual(listens.count(f"pid={server.pid},"), 1, listens)
        self.envserver().told("metrics on")
        python_case.wait_until(lambda: self.healthy(server.address), "it serves")


if __name__ == "__main__":
    python_case.main()

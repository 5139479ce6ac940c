"""Programs under attack by a hostile test: their addresses, memory, threads and logs."""

import functools
import os
import re
import ssl
import subprocess
import time

import messages
import raw_http2
from tests.fakes import python_case
from tests.fakes.python_case import SMALL_RUN, SOURCE, built

PATIENCE_S = 60  # for what takes a moment on a quiet machine


class Program:
    """A process that listens, killed with the test."""

    def __init__(self, case, name, *flags, listens="listening on"):
        self.log = case.folder / f"{name}-{len(list(case.folder.glob(name + '-*')))}.err"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen([*built(name), *flags], stderr=log, stdout=subprocess.DEVNULL)
        case.addCleanup(self.process.wait)
        case.addCleanup(self.process.kill)
        self.pid = self.process.pid
        self.address = self.told(listens)

    def text(self):
        return self.log.read_text(encoding="utf-8", errors="replace")

    def told(self, what):
        """The word after `what` in the log."""
        def look():
            if self.process.poll() is not None:
                raise AssertionError(self.text())
            return re.search(re.escape(what) + r" ([^\s\"]+)", self.text())
        return python_case.wait_until(look, f"{what} in the log", PATIENCE_S).group(1)

    def _status(self, key):
        text = open(f"/proc/{self.pid}/status", encoding="utf-8").read()
        return int(re.search(key + r":\s+(\d+)", text).group(1))

    def memory_mb(self):
        """The peak resident memory."""
        return self._status("VmHWM") / 1024

    def threads(self):
        return self._status("Threads")

    def cpu_s(self):
        fields = open(f"/proc/{self.pid}/stat", encoding="utf-8").read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def terminate(self, seconds):
        """Sends SIGTERM; returns the seconds until the process ended, and fails after `seconds`."""
        start = time.monotonic()
        self.process.terminate()
        try:
            code = self.process.wait(seconds)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"not ended {seconds} s after SIGTERM") from error
        assert code == 0, (code, self.text())
        return time.monotonic() - start


class ServerCase(python_case.FolderCase):

    def envserver(self, *flags):
        return Program(self, "craftfleet-envserver", "--listen=127.0.0.1:0", *flags)

    def learner(self, *flags):
        (self.folder / "run.cfg").write_text(SMALL_RUN, encoding="utf-8")
        return Program(self, "craftfleet-learner", "--listen=127.0.0.1:0", f"--config={self.folder / 'run.cfg'}",
                       f"--logdir={self.folder / 'run'}", *flags)

    def actor(self, *flags):
        """An actor that waits for its learner."""
        return Program(self, "craftfleet-actor", "--learner=127.0.0.1:1", "--envservers=127.0.0.1:1", *flags,
                       listens="status on")

    @functools.cached_property
    def certificates(self):
        """A folder with ca.pem, server.pem, server.key, client.pem and client.key."""
        folder = self.folder / "certs"
        subprocess.run([SOURCE / "deploy/make-certs.sh", folder, "server", "client"], check=True, capture_output=True)
        return folder

    def tls_flags(self):
        return [f"--tls_cert={self.certificates / 'server.pem'}", f"--tls_key={self.certificates / 'server.key'}",
                f"--tls_ca={self.certificates / 'ca.pem'}"]

    def tls_client(self):
        context = ssl.create_default_context(cafile=self.certificates / "ca.pem")
        context.load_cert_chain(self.certificates / "client.pem", self.certificates / "client.key")
        return context

    def client(self, address, **options):
        client = raw_http2.Client(address, **options)
        self.addCleanup(client.close)
        return client

    def session(self, address, source=None, **hello):
        """A client, which connects from the host `source`, and its stream, after the server's hello."""
        client = self.client(address, source=source)
        stream = client.start(messages.PLAY)
        client.send_message(stream, messages.hello(**hello))
        reply = client.read_reply(stream, PATIENCE_S, messages=1)
        self.assertEqual(len(reply.messages), 1, (reply.status, reply.error))
        return client, stream

    def healthy(self, address):
        """Whether the server answers an ordinary health probe."""
        try:
            with raw_http2.Client(address, timeout=5) as client:
                return client.call(messages.HEALTH, b"", timeout=5).messages == [b"\x08\x01"]
        except (OSError, raw_http2.Closed):
            return False

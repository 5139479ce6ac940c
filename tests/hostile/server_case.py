"""Programs under attack by a hostile test: their addresses, memory, threads and logs."""

import functools
import os
import queue
import re
import subprocess

# pylint: disable=wrong-import-position
from tests.deploy.python import package

package.enter()
package.need("grpc")

import grpc
import messages
from tests.fakes import python_case
from tests.fakes.python_case import SMALL_RUN, SOURCE, built

PATIENCE_S = 60  # for what takes a moment on a quiet machine
# Each channel has a connection of its own; the peer may send as much as a message that nobody reads may have.
CHANNEL = [("grpc.use_local_subchannel_pool", 1), ("grpc.http2.bdp_probe", 0), ("grpc.max_receive_message_length", -1)]


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

    def cpu_s(self):
        fields = open(f"/proc/{self.pid}/stat", encoding="utf-8").read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Call:
    """A stream of a client, which reads a reply only when it is asked to."""

    def __init__(self, channel, path, *requests):
        self.requests = queue.SimpleQueue()
        for request in requests:
            self.requests.put(request)
        self.replies = channel.stream_stream(path)(iter(self.requests.get, None), timeout=5 * PATIENCE_S)

    def ask(self, request):
        """The reply to one more request; RpcError: the server has ended the stream."""
        self.requests.put(request)
        return next(self.replies)

    def end(self):
        """Sends no more; returns the error of the stream, whose status may be OK."""
        self.requests.put(None)
        return error_of(lambda: list(self.replies)) or self.replies


def error_of(action):
    """The RpcError that `action` raises; None: none."""
    try:
        action()
    except grpc.RpcError as error:
        return error
    return None


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

    def channel(self, address, tls=False, options=()):
        """A client's connection, closed with the test."""
        options = [*CHANNEL, *options]
        if tls:
            ca, key, certificate = ((self.certificates / name).read_bytes() for name in ("ca.pem", "client.key", "client.pem"))
            channel = grpc.secure_channel(address, grpc.ssl_channel_credentials(ca, key, certificate), options)
        else:
            channel = grpc.insecure_channel(address, options)
        self.addCleanup(channel.close)
        return channel

    def start(self, channel, path, *requests):
        """A stream, cancelled with the test."""
        call = Call(channel, path, *requests)
        self.addCleanup(call.replies.cancel)  # grpcio cancels one that nobody refers to
        return call

    def session(self, address, **hello):
        """A session with an environment server on a connection of its own, after the server's hello."""
        call = self.start(self.channel(address), messages.PLAY)
        call.ask(messages.hello(**hello))
        return call

    def unary(self, address, path, request=b"", **options):
        """The reply of a unary call."""
        return self.channel(address, **options).unary_unary(path)(request, timeout=PATIENCE_S)

    def healthy(self, address):
        """Whether the server answers an ordinary health probe."""
        return error_of(lambda: self.unary(address, messages.HEALTH)) is None

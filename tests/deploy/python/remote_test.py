"""craftfleet.RemoteVectorEnv over real environment servers: the games of VectorEnv, TLS, and what goes wrong."""

import copy
import multiprocessing
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import warnings
from concurrent import futures
from unittest import mock

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

package.need("craftfleet", "grpc", "google.protobuf")
import craftfleet  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position

LANES = 5


def play(envs, count=20):
  """Observations and rewards of the games of seed 3, as bytes."""
  out = [envs.reset(seed=3)[0].tobytes()]
  for actions in np.random.default_rng(2).integers(17, size=(count, envs.num_envs)):
    observations, rewards, *_ = envs.step(actions)
    out.append((observations.tobytes(), rewards.tobytes()))
  return out


def play_at(address):
  envs = craftfleet.RemoteVectorEnv(address, LANES)
  try:
    return play(envs)
  finally:
    envs.close()


def send_what_a_fork_sees(writer, inherited, local):
  """Of a fork: the error of the environment that its parent has connected, and what a game of its own shows."""
  try:
    inherited.step(np.zeros(LANES, int))
    error = None
  except RuntimeError as raised:
    error = str(raised)
  inherited.close()
  writer.send((error, play(local)))


class ServerCase(python_case.FolderCase, package.PackageCase):

  def server(self, *flags, cwd=None):
    """A process of an environment server, and its address."""
    log = self.folder / f"server-{len(list(self.folder.glob('server-*')))}.log"
    with log.open("wb") as out:
      process = subprocess.Popen([BIN / "craftfleet-envserver", "--listen=127.0.0.1:0", *flags], stderr=out, cwd=cwd)
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    listening = python_case.wait_until(lambda: re.search(r"listening on (.+)", log.read_text()), f"an address in {log}")
    return process, listening[1]

  def connect(self, *arguments, **named):
    envs = craftfleet.RemoteVectorEnv(*arguments, **named)
    self.addCleanup(envs.close)
    return envs


class Remote(ServerCase):

  def compare(self, remote, local, steps):
    self.assertEqual(remote.reset(seed=3)[0].tobytes(), local.reset(seed=3)[0].tobytes())
    for actions in np.random.default_rng(1).integers(17, size=(steps, LANES)):
      found, expected = remote.step(actions), local.step(actions)
      self.assertEqual(found[0].tobytes(), expected[0].tobytes())
      self.assertEqual(found[1].tolist(), expected[1].tolist())
      for i in (2, 3):
        self.assertEqual(found[i].tolist(), expected[i].tolist())
      self.compare_infos(found, expected)

  def compare_infos(self, found, expected):
    mine, theirs = found[4], expected[4]
    for lane in range(LANES):
      if found[3][lane]:
        self.assertTrue(np.array_equal(mine["final_obs"][lane], theirs["final_obs"][lane]))
      over = found[2][lane] or found[3][lane]
      if over:
        mine_now, theirs_now = mine["final_info"], theirs["final_info"]
      else:
        mine_now, theirs_now = mine, theirs
      if "semantic" in mine_now:
        self.assertEqual(mine_now["semantic"][lane].tobytes(), theirs_now["semantic"][lane].tobytes())
        self.assertEqual(mine_now["player_pos"][lane].tolist(), theirs_now["player_pos"][lane].tolist())
        self.assertEqual(mine_now["inventory"]["food"][lane], theirs_now["inventory"]["food"][lane])
      if over:
        self.assertEqual(mine_now["achievements"]["wake_up"][lane], theirs_now["achievements"]["wake_up"][lane])

  def test_games_are_those_of_the_local_vector(self):
    addresses = [self.server()[1] for _ in range(2)]
    for details in (False, True):
      options = {"env": "crafter:numbers=hard-x4", "length": 12, "size": 72}
      remote = self.connect(addresses, LANES, details=details, **options)
      local = craftfleet.VectorEnv(LANES, autoreset_mode="SameStep", semantic=True, **options)
      self.compare(remote, local, 40)
      mask = np.array([True, False, False, False, True])
      self.assertEqual(remote.reset(options={"reset_mask": mask})[0].tobytes(), local.reset(options={"reset_mask": mask})[0].tobytes())
      self.assertEqual(remote.observation_space, local.observation_space)

  def test_replies_fit_a_message_even_if_all_large_games_end_at_once(self):
    envs = self.connect(self.server()[1], 300, size=256, length=1)
    envs.reset(seed=1)
    *_, truncated, infos = envs.step(np.zeros(300, int))
    self.assertTrue(truncated.all())
    self.assertEqual(infos["final_obs"][299].shape, (256, 256, 3))

  def test_a_certificate_admits_and_without_one_errors_say_so(self):
    (self.folder / "access.txt").write_text('client { name: "python"  certificate: "client"  right: PLAY }\n')
    certs = self.folder / "certs"
    subprocess.run([SOURCE / "deploy/make-certs.sh", certs, "server", "client", "other"], check=True, capture_output=True)
    _, address = self.server(
        f"--tls_ca={certs}/ca.pem", f"--tls_cert={certs}/server.pem", f"--tls_key={certs}/server.key",
        f"--access_file={self.folder / 'access.txt'}")
    tls, other = (craftfleet.Tls(certs / "ca.pem", certs / f"{name}.pem", certs / f"{name}.key") for name in ("client", "other"))
    envs = self.connect(address, 2, tls=tls)
    self.assertEqual(envs.reset(seed=1)[0].shape, (2, 64, 64, 3))
    self.assert_refused(PermissionError, address, craftfleet.RemoteVectorEnv, address, 2, tls=other)
    self.assert_refused(ConnectionError, address, craftfleet.RemoteVectorEnv, address, 2)
    self.assert_refused(TypeError, "'cert' and 'key'", craftfleet.Tls, certs / "ca.pem")

  def test_servers_that_are_missing_ended_or_stopped_are_named(self):
    self.assert_refused(ConnectionError, "127.0.0.1:1: ", craftfleet.RemoteVectorEnv, "127.0.0.1:1", 2)
    server, address = self.server()
    envs = self.connect(address, 2, timeout=1)
    envs.reset(seed=0)
    server.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, server.pid, os.WSTOPPED | os.WNOWAIT)
    try:
      self.assert_refused(TimeoutError, f"{address}: no answer within 1 s", envs.step, [0, 0])
    finally:
      server.send_signal(signal.SIGCONT)
    self.assert_refused(TimeoutError, "no answer", envs.step, [0, 0])
    envs = self.connect(address, 2)
    envs.reset(seed=0)
    server.kill()
    server.wait()
    self.assert_refused(ConnectionError, address, envs.step, [0, 0])

  def test_after_an_error_no_reply_is_taken_for_that_to_another_request(self):
    (ended, first), (_, second) = self.server(), self.server()
    envs = self.connect([first, second], 2)
    envs.reset(seed=0)
    ended.kill()
    ended.wait()
    of_the_second = {"reset_mask": np.array([False, True])}
    for call in (lambda: envs.step([0, 0]), lambda: envs.reset(options=of_the_second)):
      self.assert_refused(ConnectionError, first, call)

  def test_one_that_nobody_closes_ends_its_session(self):
    _, address = self.server()
    for _ in range(3):
      self.assertEqual(craftfleet.RemoteVectorEnv(address, LANES).reset(seed=1)[0].shape, (LANES, 64, 64, 3))
    python_case.wait_until(
        lambda: f"replies of {address}" not in {thread.name for thread in threading.enumerate()}, "the end of the sessions")

  def test_a_program_ends_that_closes_none(self):
    code = f"import craftfleet; envs = craftfleet.RemoteVectorEnv({self.server()[1]!r}, 2); envs.reset(seed=1)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, env={**os.environ, "PYTHONPATH": str(package.SITE)})

  def test_errors_are_those_of_the_local_vector(self):
    _, address = self.server()
    envs = self.connect(address, 2)
    self.assert_refused(RuntimeError, "lane 0: no game yet, want reset() first", envs.step, [0, 0])
    envs.reset(seed=[4, None])
    self.assert_refused(ValueError, "actions[1] 17, want 0..16", envs.step, [0, 17])
    for kind, text, where, named in (
        (ValueError, "address '127.0.0.1', want host:port", "127.0.0.1", {}),
        (ValueError, "address 'a:99999', want host:port", [address, "a:99999"], {}),
        (ValueError, "addresses [], want", [], {}),
        (TypeError, "addresses 5, want host:port", 5, {}),
        (TypeError, "env 3, want the name", address, {"env": 3}),
        (TypeError, "timeout 'x', want 0.1..", address, {"timeout": "x"}),
        (TypeError, "tls 'ca.pem', want a craftfleet.Tls", address, {"tls": "ca.pem"}),
    ):
      self.assert_refused(kind, text, craftfleet.RemoteVectorEnv, where, 2, **named)
    self.assert_refused(ValueError, "timeout 0, want 0.1..", craftfleet.RemoteVectorEnv, address, 2, timeout=0)
    self.assert_refused(ValueError, 'unknown game "doom"', craftfleet.RemoteVectorEnv, address, 2, env="doom")
    self.assert_refused(ValueError, "length 0, want 1..", craftfleet.RemoteVectorEnv, address, 2, length=0)

  def test_every_form_of_an_address_is_reached_or_refused_with_what_to_write(self):
    folder = self.folder / "größe 50%25 a"
    folder.mkdir()
    self.server("--listen=unix:socket", cwd=folder)
    here = os.getcwd()
    self.addCleanup(os.chdir, here)
    os.chdir(folder)
    for address in (f"unix:{folder}/socket", "unix:socket"):
        self.assertEqual(self.connect(address, 2).reset(seed=1)[0].shape, (2, 64, 64, 3))
    for address, text in (("http://127.0.0.1:5", "want host:port without http://"), ("127.0.0.1:5/", "want host:port"),
                          ("unix:/tmp/a,b", "want a path without commas")):
      self.assert_refused(ValueError, text, craftfleet.RemoteVectorEnv, address, 2)

  def test_the_proxy_for_web_pages_is_not_used(self):
    _, address = self.server()
    with mock.patch.dict(os.environ, {name: "http://127.0.0.1:9" for name in ("http_proxy", "https_proxy", "grpc_proxy")}):
      self.assertEqual(self.connect(address, 2).reset(seed=1)[0].shape, (2, 64, 64, 3))

  def test_it_works_from_a_folder_with_any_name(self):
    _, address = self.server()
    site = self.folder / "größe, 50%"
    site.mkdir()
    (site / "craftfleet").symlink_to(package.SITE / "craftfleet")
    code = f"import craftfleet; print(craftfleet.RemoteVectorEnv({address!r}, 2).reset(seed=1)[0].shape)"
    for locale in ("C", "C.UTF-8"):
      played = subprocess.run(
          [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False, cwd=site,
          env={**os.environ, "PYTHONPATH": str(site), "LC_ALL": locale})
      self.assertEqual((played.returncode, played.stdout), (0, "(2, 64, 64, 3)\n"), played.stderr)

  def test_a_reply_that_does_not_fit_is_refused(self):
    """A server that answers each request with what `change` makes of the right reply."""
    from craftfleet import remote  # pylint: disable=import-outside-toplevel
    grpc, messages = remote._grpc_and_messages()  # pylint: disable=protected-access
    frame = bytes(64 * 64 * 3)
    changes = {
        "frames": lambda reply: setattr(reply, "frames", frame),
        "cannot reshape": lambda reply: reply.rewards.append(0),
        "rewards [inf, 0.0]": lambda reply: reply.rewards.__setitem__(0, float("inf")),
        "rewards [nan, 0.0]": lambda reply: reply.rewards.__setitem__(0, float("nan")),
        "bytes of ends": lambda reply: setattr(reply, "ends", b""),
        "an end of 7": lambda reply: setattr(reply, "ends", b"\0\7"),
        "is shorter than": lambda reply: setattr(reply, "ends", b"\0\1"),
        "bytes of frames, want 0": lambda reply: setattr(reply, "last_frames", frame),
        "moments": lambda reply: reply.moments.add(),
    }
    changed = []

    def play_badly(requests, _):
      for request in requests:
        reply = messages.PlayReply()
        if request.WhichOneof("request") != "hello":
          reply.frames = 2 * frame
        if request.WhichOneof("request") == "step":
          reply.rewards.extend([0, 0])
          reply.ends = bytes(2)
          changed[-1](reply)
        yield reply

    server = grpc.server(futures.ThreadPoolExecutor(4))
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("craftfleet.v1.EnvironmentService", {
        "Play": grpc.stream_stream_rpc_method_handler(
            play_badly, messages.PlayRequest.FromString, messages.PlayReply.SerializeToString)}),))
    address = f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    server.start()
    self.addCleanup(server.stop, 0)
    for text, change in changes.items():
      with self.subTest(text):
        changed.append(change)
        envs = self.connect(address, 2)
        envs.reset(seed=1)
        self.assert_refused(ConnectionError, f"{address}: a reply that does not fit the request: ", envs.step, [0, 0])
        self.assert_refused(ConnectionError, text, envs.step, [0, 0])
        envs.close()

  def test_an_interrupted_call_closes_it(self):
    """Its reply is not taken for that of the next step. Handlers of other signals may raise anything."""
    from craftfleet import remote  # pylint: disable=import-outside-toplevel
    for raised in (KeyboardInterrupt(), TimeoutError("alarm")):
      envs = self.connect(self.server()[1], 2)
      envs.reset(seed=0)
      with mock.patch.object(remote._Session, "receive", side_effect=raised):  # pylint: disable=protected-access
        self.assert_refused(type(raised), str(raised), envs.step, [0, 0])
      self.assert_refused(RuntimeError, "is closed, want a new one", envs.step, [0, 0])

  def test_what_is_refused_before_it_is_sent_does_not_close_it_but_close_does(self):
    envs = self.connect(self.server()[1], 2)
    for call in (lambda: envs.step([0, 0]), lambda: envs.step([0, 17]), lambda: envs.reset(seed="a")):
      with self.assertRaises((RuntimeError, TypeError, ValueError)):
        call()
    self.assertEqual(envs.reset(seed=0)[0].shape, (2, 64, 64, 3))
    envs.close()
    self.assert_refused(RuntimeError, "is closed, want a new one", envs.step, [0, 0])


class Around(ServerCase):
  """Processes and threads."""

  def setUp(self):
    super().setUp()
    _, self.address = self.server()
    self.envs = self.connect(self.address, LANES)

  def test_a_forked_process_is_told_to_connect_itself_and_does_not_disturb_its_parent(self):
    expected = play(self.envs)
    local = craftfleet.VectorEnv(LANES, autoreset_mode="SameStep")
    warnings.simplefilter("ignore", DeprecationWarning)  # newer Pythons warn of a fork beside any thread
    reader, writer = multiprocessing.Pipe(duplex=False)
    fork = multiprocessing.get_context("fork").Process(target=send_what_a_fork_sees, args=(writer, self.envs, local))
    fork.start()
    self.assertTrue(reader.poll(60), "the fork hangs")
    error, played = reader.recv()
    fork.join(60)
    self.assertEqual(fork.exitcode, 0)
    self.assertRegex(error, "its connections are those of process [0-9]+, want a RemoteVectorEnv of this process's own")
    self.assertEqual(played[0], expected[0])
    self.assertEqual(play(self.envs), expected)

  def test_spawned_processes_play_the_same_games(self):
    expected = play(self.envs)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
      self.assertEqual(pool.map(play_at, [self.address] * 2), [expected] * 2)

  def test_copies_and_pickles_are_refused(self):
    for clone in (copy.copy, copy.deepcopy, pickle.dumps):
      self.assert_refused(TypeError, "cannot be copied or pickled", clone, self.envs)

  def test_threads_with_connections_of_their_own_do_not_disturb_each_other(self):
    expected = play(self.envs)
    found = []
    threads = [threading.Thread(target=lambda: found.append(play_at(self.address))) for _ in range(3)]
    for thread in threads:
      thread.start()
    for thread in threads:
      thread.join()
    self.assertEqual(found, [expected] * 3)

  def test_a_second_thread_is_refused_and_the_games_go_on(self):
    self.envs.reset(seed=0)
    refused = threading.Event()

    def step_until_refused():
      while not refused.is_set():
        try:
          self.envs.step(np.zeros(LANES, int))
        except RuntimeError as error:
          self.assertEqual(str(error), "another thread is in a call of this RemoteVectorEnv, want one at a time")
          refused.set()

    other = threading.Thread(target=step_until_refused)
    other.start()
    step_until_refused()
    other.join()
    self.assertEqual(play(self.envs), play(self.connect(self.address, LANES)))


if __name__ == "__main__":
  python_case.main()

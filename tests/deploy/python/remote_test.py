"""craftfleet.RemoteVectorEnv over real environment servers: the games of VectorEnv, TLS and tokens, and what goes wrong."""

import hashlib
import re
import signal
import subprocess

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

package.need("craftfleet", "grpc", "grpc_tools")
import craftfleet  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position

LANES = 5


class Remote(python_case.FolderCase, package.PackageCase):

  def server(self, *flags):
    """A process of an environment server, and its address."""
    log = self.folder / f"server-{len(list(self.folder.glob('server-*')))}.log"
    with log.open("wb") as out:
      process = subprocess.Popen([BIN / "craftfleet-envserver", "--listen=127.0.0.1:0", *flags], stderr=out)
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    listening = python_case.wait_until(lambda: re.search(r"listening on (\S+)", log.read_text()), f"an address in {log}")
    return process, listening[1]

  def connect(self, *arguments, **named):
    envs = craftfleet.RemoteVectorEnv(*arguments, **named)
    self.addCleanup(envs.close)
    return envs

  def compare(self, remote, local, steps):
    self.assertEqual(remote.reset(seed=3)[0].tobytes(), local.reset(seed=3)[0].tobytes())
    for actions in np.random.default_rng(1).integers(17, size=(steps, LANES)):
      found, expected = remote.step(actions), local.step(actions)
      self.assertEqual(found[0].tobytes(), expected[0].tobytes())
      self.assertTrue(np.array_equal(found[1], expected[1].astype(np.float32)))
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

  def test_tls_and_a_token_admit_and_without_them_errors_say_so(self):
    (self.folder / "token").write_text("a-token\n")
    digest = hashlib.sha256(b"a-token").hexdigest()
    (self.folder / "access.txt").write_text(f'client {{ name: "python"  token_sha256: "{digest}"  right: PLAY }}\n')
    certs = self.folder / "certs"
    subprocess.run([SOURCE / "deploy/make-certs.sh", certs, "server", "client"], check=True, capture_output=True)
    _, address = self.server(
        f"--tls_ca={certs}/ca.pem", f"--tls_cert={certs}/server.pem", f"--tls_key={certs}/server.key",
        f"--access_file={self.folder / 'access.txt'}")
    files = {"ca": certs / "ca.pem", "cert": certs / "client.pem", "key": certs / "client.key"}
    envs = self.connect(address, 2, tls=craftfleet.Tls(**files, token_file=self.folder / "token"))
    self.assertEqual(envs.reset(seed=1)[0].shape, (2, 64, 64, 3))
    self.assert_refused(PermissionError, address, craftfleet.RemoteVectorEnv, address, 2, tls=craftfleet.Tls(**files))
    self.assert_refused(ConnectionError, address, craftfleet.RemoteVectorEnv, address, 2)
    half = craftfleet.Tls(ca=files["ca"], cert=files["cert"])
    self.assert_refused(ValueError, "want both or neither", craftfleet.RemoteVectorEnv, address, 2, tls=half)

  def test_servers_that_are_missing_ended_or_stopped_are_named(self):
    self.assert_refused(ConnectionError, "127.0.0.1:1: ", craftfleet.RemoteVectorEnv, "127.0.0.1:1", 2)
    server, address = self.server()
    envs = self.connect(address, 2, timeout=1)
    envs.reset(seed=0)
    server.send_signal(signal.SIGSTOP)
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

  def test_errors_are_those_of_the_local_vector(self):
    _, address = self.server()
    envs = self.connect(address, 2)
    self.assert_refused(RuntimeError, "lane 0: no game yet, want reset() first", envs.step, [0, 0])
    envs.reset(seed=[4, None])
    self.assert_refused(ValueError, "actions[1] 17, want 0..16", envs.step, [0, 17])
    self.assert_refused(ValueError, "timeout 0, want 0.1..", craftfleet.RemoteVectorEnv, address, 2, timeout=0)
    self.assert_refused(ValueError, 'unknown game "doom"', craftfleet.RemoteVectorEnv, address, 2, env="doom")
    self.assert_refused(ValueError, "length 0, want 1..", craftfleet.RemoteVectorEnv, address, 2, length=0)

  def test_the_protocol_is_that_of_the_programs(self):
    header = (SOURCE / "common/wire/protocol.h").read_text()
    from craftfleet import remote  # pylint: disable=import-outside-toplevel
    self.assertIn(f"kProtocolVersion = {remote.PROTOCOL_VERSION};", header)
    self.assertIn(f"kMaxMessageBytes = {remote.MAX_MESSAGE_BYTES >> 20} << 20;", header)


if __name__ == "__main__":
  python_case.main()

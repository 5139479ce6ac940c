"""craftfleet.RemoteVectorEnv: games that environment servers of a fleet play (proto/craftfleet/v1/environment.proto)."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import numbers
import os
import pathlib
import queue
import re
import sys
import threading
import types
import urllib.parse
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from craftfleet import _arguments, _engine, _lanes

PROTOCOL_VERSION = 3
MAX_MESSAGE_BYTES = 96 << 20
MAX_LANES = 4096  # of one session
REST_OF_LANE = 8 << 10  # bytes: at least what a reply has for a lane besides pictures
MAX_PORT = 2**16 - 1
TERMINATED, TRUNCATED = 1, 2
# Rewards that a step can give, in tenths: a change of health, and 1 for an achievement. Replies have them as float32.
LEAST_REWARD, MOST_REWARD = -9, 19
REWARDS = np.array([tenths / 10.0 if tenths < 2 else (tenths - 10) / 10.0 + 1.0 for tenths in range(LEAST_REWARD, MOST_REWARD + 1)])


@dataclasses.dataclass(frozen=True)
class Tls:
  """Files that secure the connections: as the flags --tls_ca, --tls_cert, --tls_key and --tls_server_name."""

  ca: str | os.PathLike[str]
  cert: str | os.PathLike[str]
  key: str | os.PathLike[str]
  server_name: str | None = None


class RemoteVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
  """`num_envs` games on environment servers: `craftfleet.RemoteVectorEnv("host:50061", 64)`. Needs grpcio and protobuf.

  The interface is that of VectorEnv with autoreset_mode SAME_STEP, and lane i plays the same game. Observations are one array that
  each call overwrites. Servers don't send the picture of a death: final_obs has one only of truncated lanes, and of others with
  `details`. Use an object from one thread at a time: a call while another thread is in one raises RuntimeError. So does a call in a
  forked process, which has no connections of its own. An exception that a signal's handler raises during a call, such as Ctrl-C,
  closes the object.

  Args:
    addresses: "host:port" of a server, or several, which share the lanes.
    num_envs: number of games.
    env, size, reward: as of craftfleet.Env; a server's worlds have 64x64 cells, and pictures are square. length: at least 1.
    details: whether infos have inventory, achievements, semantic and player_pos, at 17 KB per lane and step. Lanes that have just
      ended have them in final_info alone.
    tls: files for TLS; None: none, for loopback and trusted networks.
    timeout: seconds that a server may take to answer, from 0.1.

  ConnectionError: a server cannot be reached or has ended; TimeoutError: it does not answer; PermissionError: it refuses this client;
  ValueError: it refuses a request; RuntimeError: it is full, or has another version of the protocol. After any of these, close() and
  make a new one.
  """

  def __init__(
      self, addresses: str | Sequence[str], num_envs: int, *, env: str = "crafter", size: int = 64, length: int = 10000,
      reward: bool = True, details: bool = False, tls: Tls | None = None, timeout: float = 30.0) -> None:
    self._owner, self._busy, self._asking = os.getpid(), threading.Lock(), False
    self._sessions: list[_Session] = []
    self.num_envs = _arguments.integer("num_envs", num_envs, 1, 1 << 20)
    pixels = _arguments.integer("size", size, 18, 1024)
    steps = _arguments.integer("length", length, 1, _arguments.MAX_INT)
    _arguments.check_env_name(env)
    if tls is not None and not isinstance(tls, Tls):
      raise TypeError(f"tls {tls!r}, want a craftfleet.Tls")
    if not isinstance(timeout, numbers.Real):
      raise TypeError(f"timeout {timeout!r}, want 0.1..1e6 seconds")
    if not 0.1 <= timeout <= 1e6:
      raise ValueError(f"timeout {timeout!r}, want 0.1..1e6 seconds")
    self._reward, self._details = bool(reward), bool(details)
    self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
    self.single_observation_space = gymnasium.spaces.Box(0, 255, (pixels, pixels, 3), np.uint8)
    self.single_action_space = gymnasium.spaces.Discrete(len(_engine.ACTIONS))
    self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)
    self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, self.num_envs)
    self._observations = np.zeros((self.num_envs, pixels, pixels, 3), np.uint8)
    self._seeds: list[int | None] = [None] * self.num_envs
    self._episodes = np.zeros(self.num_envs, np.int64)  # that each lane plays
    hosts = _hosts(addresses)
    bounds = np.linspace(0, self.num_envs, len(hosts) + 1).astype(int)
    most = _most_lanes(pixels, self._details)
    try:
      for host, first, end in zip(hosts, bounds, bounds[1:]):
        for lane in range(int(first), int(end), most):
          session = _Session(host, range(lane, min(lane + most, int(end))), tls, float(timeout))
          self._sessions.append(session)
          hello = session.request.hello
          hello.protocol_version, hello.client = PROTOCOL_VERSION, f"craftfleet-python-{os.getpid()}"
          hello.env.name, hello.env.frame_size, hello.env.length = env, pixels, steps
          if self._details:
            hello.recording.SetInParent()
      self._exchange()
    except BaseException:
      self.close()
      raise

  def reset(
      self, *, seed: int | Sequence[int | None] | None = None,
      options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
    """As VectorEnv.reset()."""
    with self._alone():
      return self._reset(seed, options)

  def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    """As VectorEnv.step() with SAME_STEP. final_info has the ended episode's length, reward and achievements."""
    with self._alone():
      return self._step(actions)

  def close_extras(self, **_: Any) -> None:
    """Ends the sessions; their games end with them."""
    if os.getpid() != self._owner:  # the sessions are those of the process that forked this one
      return
    for session in self._sessions:
      session.close()

  def __del__(self) -> None:
    # When Python ends, its threads have stopped, and closing would wait for them; the process takes its connections along.
    if hasattr(self, "_sessions") and not sys.is_finalizing():
      self.close()

  def __reduce__(self) -> Any:
    raise TypeError("a RemoteVectorEnv has connections and cannot be copied or pickled, want a new one with the same arguments")

  @contextlib.contextmanager
  def _alone(self) -> Iterator[None]:
    """Keeps other threads and forked processes out."""
    if self.closed:
      raise RuntimeError("this RemoteVectorEnv is closed, want a new one")
    if os.getpid() != self._owner:
      raise RuntimeError(f"its connections are those of process {self._owner}, want a RemoteVectorEnv of this process's own")
    if not self._busy.acquire(blocking=False):
      raise RuntimeError("another thread is in a call of this RemoteVectorEnv, want one at a time")
    try:
      yield
    except BaseException:
      # Ctrl-C, or what another signal's handler raised: a reply that comes later would be taken for that of the next request.
      if self._asking and not any(session.failed for session in self._sessions):
        self.close()
      raise
    finally:
      self._asking = False
      self._busy.release()

  def _reset(self, seed: Any, options: dict[str, Any] | None) -> tuple[np.ndarray, dict[str, Any]]:
    seeds, lanes = _lanes.seeds(seed, self.num_envs), _lanes.chosen(options, self.num_envs)
    if seed is not None and not hasattr(seed, "__len__"):
      super().reset(seed=int(seed))
    self._asking = True
    for lane in lanes:
      if seeds[lane] is None and self._seeds[lane] is None:
        seeds[lane] = int(self.np_random.integers(2**31 - 1))
      if seeds[lane] is not None:
        self._seeds[lane], self._episodes[lane] = seeds[lane], 0
      self._episodes[lane] += 1
    for session in self._sessions:
      for lane in lanes:
        if lane in session.lanes:
          session.request.open.lanes.add(lane=lane, seed=self._seeds[lane], episode=int(self._episodes[lane]))
    infos: dict[str, Any] = {}
    for session, reply in self._exchange():
      mine = [lane for lane in lanes if lane in session.lanes]
      with session.checks_reply():
        self._observations[mine] = self._frames(reply.frames, len(mine))
        moments = self._moments(reply, len(mine))
      for lane, moment in zip(mine, moments):
        self._add_info(infos, _details(moment), lane)
    return self._observations, infos

  def _step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    chosen = _lanes.actions(actions, self.num_envs)
    wrong = np.flatnonzero((chosen < 0) | (chosen >= len(_engine.ACTIONS)))
    if wrong.size:
      raise ValueError(f"actions[{wrong[0]}] {chosen[wrong[0]]}, want 0..{len(_engine.ACTIONS) - 1}")
    if None in self._seeds:
      raise RuntimeError(f"lane {self._seeds.index(None)}: no game yet, want reset() first")
    self._asking = True
    for session in self._sessions:
      session.request.step.lanes.extend(session.lanes)
      session.request.step.actions = chosen[session.rows].astype(np.uint8).tobytes()
    rewards, ends = np.zeros(self.num_envs), np.zeros(self.num_envs, np.uint8)
    infos: dict[str, Any] = {"reward": rewards, "_reward": np.ones(self.num_envs, np.bool_)}
    for session, reply in self._exchange():
      with session.checks_reply():
        self._observations[session.rows] = self._frames(reply.frames, len(session.lanes))
        rewards[session.rows] = _exact_rewards(reply.rewards, len(session.lanes))
        ends[session.rows] = _ends(reply.ends, len(session.lanes))
        self._add_infos(infos, session.lanes, ends, reply)
    self._episodes += ends != 0
    returned = rewards.copy() if self._reward else np.zeros(self.num_envs)
    return self._observations, returned, ends == TERMINATED, ends == TRUNCATED, infos

  def _exchange(self) -> list[tuple[_Session, Any]]:
    """Sends the requests that the sessions have, then awaits the replies."""
    for session in self._sessions:
      session.check()  # after an error, replies of the others may be to an earlier request
    asked = [session for session in self._sessions if session.send()]
    return [(session, session.receive()) for session in asked]

  def _frames(self, frames: bytes, count: int) -> np.ndarray:
    return _array(frames, "frames", count, self._observations.shape[1:])

  def _moments(self, reply: Any, count: int) -> Sequence[Any]:
    """Those of each lane with `details`; otherwise none."""
    if len(reply.moments) != (count if self._details else 0):
      raise ValueError(f"{len(reply.moments)} moments")
    return reply.moments

  def _add_infos(self, infos: dict[str, Any], lanes: range, ends: np.ndarray, reply: Any) -> None:
    """The details of each lane, and what Gymnasium's infos have of those that ended: their details belong to the end."""
    ended = ends[lanes.start:lanes.stop]
    episodes = dict(zip(np.flatnonzero(ended), reply.episodes, strict=True))
    last_frames = iter(self._frames(reply.last_frames, np.count_nonzero(ended == TRUNCATED)))
    moments = self._moments(reply, len(lanes))
    for row, lane in enumerate(lanes):
      moment = moments[row] if moments else None
      info = {} if moment is None else _details(moment)
      if ends[lane]:
        episode = episodes[row]
        info["episode"] = {"r": episode.reward, "l": episode.length}
        info["achievements"] = _by_name(_engine.ACHIEVEMENTS, episode.achievements)
        info = {"final_info": info}
        if ends[lane] == TRUNCATED:
          info["final_obs"] = next(last_frames)
        if moment is not None:
          info["final_obs"] = self._frames(moment.frame, 1)[0]
      if info:
        self._add_info(infos, info, lane)


def _most_lanes(pixels: int, details: bool) -> int:
  """The lanes of one session whose reply to a step fits a message, even if all games end in it."""
  frames = 3 if details else 2  # the next game's first, the last game's last, and the moment's
  return max(1, min(MAX_LANES, MAX_MESSAGE_BYTES // (frames * pixels**2 * 3 + REST_OF_LANE)))


def _hosts(addresses: Any) -> list[str]:
  if isinstance(addresses, str):
    addresses = [addresses]
  if not isinstance(addresses, Sequence):
    raise TypeError(f"addresses {addresses!r}, want host:port or a list of them")
  if not addresses:
    raise ValueError("addresses [], want at least one host:port")
  for address in addresses:
    scheme = re.match(r"\w+://", address)
    if scheme:
      raise ValueError(f"address {address!r}, want host:port without {scheme[0]}")
    if address.startswith("unix:") and "," in address:
      raise ValueError(f"address {address!r}, want a path without commas, at which gRPC divides it")
    parts = re.fullmatch(r"unix:.+|.+:(\d+)", address)
    if parts is None or int(parts[1] or 0) > MAX_PORT:
      raise ValueError(f"address {address!r}, want host:port")
  return list(addresses)


class _Session:
  """The stream to one server: a request, then its reply."""

  def __init__(self, address: str, lanes: range, tls: Tls | None, timeout: float) -> None:
    self.address, self.lanes, self.rows = address, lanes, slice(lanes.start, lanes.stop)
    self._grpc, self._messages = _grpc_and_messages()
    self._timeout = timeout
    self._error: Exception | None = None
    self._request: Any = None
    self._requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
    self._replies: queue.SimpleQueue[Any] = queue.SimpleQueue()
    self._channel = _channel(self._grpc, address, tls)
    play = self._channel.stream_stream(
        "/craftfleet.v1.EnvironmentService/Play", request_serializer=self._messages.PlayRequest.SerializeToString,
        response_deserializer=self._messages.PlayReply.FromString)
    self._call = play(iter(self._requests.get, None))
    threading.Thread(target=self._read, name=f"replies of {address}", daemon=True).start()

  @property
  def failed(self) -> bool:
    return self._error is not None

  @property
  def request(self) -> Any:
    """The request that send() will send."""
    if self._request is None:
      self._request = self._messages.PlayRequest()
    return self._request

  @contextlib.contextmanager
  def checks_reply(self) -> Iterator[None]:
    """What is wrong with a reply, as ValueError, becomes the session's error."""
    try:
      yield
    except ValueError as error:
      self._error = ConnectionError(f"{self.address}: a reply that does not fit the request: {error}")
      raise self._error from None

  def send(self) -> bool:
    """Whether there was a request to send."""
    if self._request is None:
      return False
    self._requests.put(self._request)
    self._request = None
    return True

  def receive(self) -> Any:
    try:
      reply = self._replies.get(timeout=self._timeout)
    except queue.Empty:
      self._call.cancel()
      reply = TimeoutError(f"{self.address}: no answer within {self._timeout:g} s")
    if isinstance(reply, Exception):
      self._error = reply
      raise reply
    return reply

  def check(self) -> None:
    """Raises the session's error, if it has one."""
    if self._error is not None:
      raise self._error

  def close(self) -> None:
    self._requests.put(None)
    self._call.cancel()
    self._channel.close()

  def _read(self) -> None:
    try:
      for reply in self._call:
        self._replies.put(reply)
      self._replies.put(ConnectionError(f"{self.address}: the server has ended the session"))
    except self._grpc.RpcError as error:
      self._replies.put(self._explained(error))

  def _explained(self, error: Any) -> Exception:
    codes = self._grpc.StatusCode
    kinds = {
        codes.UNAVAILABLE: ConnectionError, codes.CANCELLED: ConnectionError, codes.ABORTED: ConnectionError,
        codes.DEADLINE_EXCEEDED: TimeoutError, codes.UNAUTHENTICATED: PermissionError, codes.PERMISSION_DENIED: PermissionError,
        codes.INVALID_ARGUMENT: ValueError
    }
    return kinds.get(error.code(), RuntimeError)(f"{self.address}: {error.details()}")


def _details(moment: Any) -> dict[str, Any]:
  return {
      "inventory": _by_name(_engine.ITEMS, moment.inventory),
      "achievements": _by_name(_engine.ACHIEVEMENTS, moment.achievements),
      "semantic": _array(moment.semantic, "semantic", 64, (64,)),
      "player_pos": np.array([moment.player_x, moment.player_y]),
  }


def _array(data: bytes, what: str, count: int, shape: tuple[int, ...]) -> np.ndarray:
  """uint8[count, *shape]."""
  if len(data) != count * int(np.prod(shape)):
    raise ValueError(f"{len(data)} bytes of {what}, want {count * int(np.prod(shape))}")
  return np.frombuffer(data, np.uint8).reshape(count, *shape)


def _by_name(names: Sequence[str], counts: Sequence[int]) -> dict[str, int]:
  return dict(zip(names, counts, strict=True))


def _exact_rewards(rewards: Sequence[float], count: int) -> np.ndarray:
  """float64[count]: what the games gave, which the wire rounds to float32."""
  tenths = 10 * np.asarray(rewards, np.float64).reshape(count)
  if not np.all((tenths > LEAST_REWARD - 0.5) & (tenths < MOST_REWARD + 0.5)):
    raise ValueError(f"rewards {list(rewards)}, want each within {LEAST_REWARD / 10}..{MOST_REWARD / 10}")
  return REWARDS[np.rint(tenths).astype(int) - LEAST_REWARD]


def _ends(ends: bytes, count: int) -> np.ndarray:
  found = _array(ends, "ends", count, ())
  if count and found.max() > TRUNCATED:
    raise ValueError(f"an end of {found.max()}, want 0..{TRUNCATED}")
  return found


def _grpc_and_messages() -> tuple[Any, Any]:
  """grpc, and the messages of environment.proto."""
  try:
    import grpc  # optional, and slow to import
    return grpc, _messages()
  except ImportError as error:
    raise ImportError(f"RemoteVectorEnv: {error}, want: pip install grpcio protobuf") from None


@functools.cache
def _messages() -> Any:
  """From environment.binpb, which the package's build makes of the proto files."""
  from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
  content = (pathlib.Path(__file__).parent / "environment.binpb").read_bytes()
  pool = descriptor_pool.DescriptorPool()
  for file in descriptor_pb2.FileDescriptorSet.FromString(content).file:
    pool.Add(file)
  return types.SimpleNamespace(**{
      name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"craftfleet.v1.{name}"))
      for name in ("PlayRequest", "PlayReply")})


def _channel(grpc: Any, address: str, tls: Tls | None) -> Any:
  # The proxy of http_proxy is one for web pages.
  options = [("grpc.max_receive_message_length", MAX_MESSAGE_BYTES), ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
             ("grpc.enable_http_proxy", 0)]
  if address.startswith("unix:"):
    address = f"unix:{urllib.parse.quote(address[len('unix:'):])}"  # in a URI, a path may not have all characters
  if tls is None:
    return grpc.insecure_channel(address, options)
  if tls.server_name is not None:
    options.append(("grpc.ssl_target_name_override", tls.server_name))
  ca, key, cert = (pathlib.Path(file).read_bytes() for file in (tls.ca, tls.key, tls.cert))
  return grpc.secure_channel(address, grpc.ssl_channel_credentials(ca, key, cert), options)

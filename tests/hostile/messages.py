"""Messages of the fleet as protobuf bytes, for hostile tests. They can also be invalid, which generated code would not
allow."""

import re

from tests.fakes.python_case import SOURCE

PLAY = "/craftfleet.v1.EnvironmentService/Play"
GET_STATUS = "/craftfleet.v1.StatusService/GetStatus"
HEALTH = "/grpc.health.v1.Health/Check"
REFLECTION = "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo"
LEARNER_PLAY = "/craftfleet.v1.LearnerService/Play"
JOIN = "/craftfleet.v1.LearnerService/Join"
GET_WEIGHTS = "/craftfleet.v1.LearnerService/GetWeights"


def varint(value):
    out = bytearray()
    value &= (1 << 64) - 1
    while value >= 128:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number, value):
    """An integer, or text, bytes or a message with its length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    value = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(value)) + value


def protocol_version():
    text = (SOURCE / "common/wire/protocol.h").read_text(encoding="utf-8")
    return int(re.search(r"kProtocolVersion = (\d+);", text).group(1))


def hello(run_id="run", frame_size=64, client="hostile", env="crafter", picture_size=None):
    """The first message of a session with an environment server."""
    config = field(1, env) + field(2, frame_size)
    message = field(1, protocol_version()) + field(2, run_id) + field(4, config) + field(5, client)
    if picture_size is not None:
        message += field(6, field(1, picture_size))
    return field(1, message)


def open_lanes(lanes):
    return field(2, b"".join(field(1, field(1, lane) + field(2, lane + 1) + field(3, 1)) for lane in lanes))


def step(lanes, action=0):
    packed = b"".join(varint(lane) for lane in lanes)
    return field(3, field(1, packed) + field(2, bytes([action] * len(lanes))))


def fragment(epoch, lane=0, frame_bytes=0):
    """A message of an actor to a learner, which is no valid fragment."""
    message = field(1, "host-1-a") + field(2, epoch) + field(3, lane) + field(6, bytes(frame_bytes))
    return field(2, message)

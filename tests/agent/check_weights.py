"""Reads a safetensors file with only Python's standard library and compares every number with a golden's.

Usage: check_weights.py FILE.safetensors GOLDEN.json
Prints the number of tensors and values that agree; exit 1 and the first difference otherwise.
"""

import array
import json
import struct
import sys

MASK = (1 << 64) - 1


def read_safetensors(path):
    """{name: (shape, values)} of a file of float32 tensors."""
    with open(path, "rb") as file:
        data = file.read()
    (header_bytes,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8 : 8 + header_bytes])
    body = 8 + header_bytes
    tensors = {}
    for name, entry in header.items():
        if name == "__metadata__":
            continue
        if entry["dtype"] != "F32":
            sys.exit(f"{name} has type {entry['dtype']}, want F32")
        first, last = entry["data_offsets"]
        values = array.array("f")
        values.frombytes(data[body + first : body + last])
        if sys.byteorder == "big":
            values.byteswap()
        tensors[name] = (entry["shape"], values)
    return tensors


def golden_values(name, scale, count):
    """The goldens' formula for a parameter's values: tests/agent/golden_agent.cc has it too."""
    hashed = 0xCBF29CE484222325
    for byte in name.encode():
        hashed = ((hashed ^ byte) * 0x100000001B3) & MASK
    values = array.array("f")
    for i in range(count):
        z = (hashed + (i + 1) * 0x9E3779B97F4A7C15) & MASK
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        z ^= z >> 31
        values.append(scale * (((z >> 40) - (1 << 23)) / (1 << 23)))
    return values


def main(path, golden_path):
    tensors = read_safetensors(path)
    with open(golden_path, encoding="utf-8") as file:
        params = json.load(file)["params"]
    if sorted(tensors) != sorted(param["name"] for param in params):
        sys.exit(f"{path} has the tensors {sorted(tensors)}")
    total = 0
    for param in params:
        shape, values = tensors[param["name"]]
        if shape != param["shape"]:
            sys.exit(f"{param['name']} has shape {shape}, want {param['shape']}")
        wanted = golden_values(param["name"], param["scale"], len(values))
        for i, (value, want) in enumerate(zip(values, wanted)):
            if value != want:
                sys.exit(f"{param['name']}[{i}] is {value}, want {want}")
        total += len(values)
    print(f"{len(tensors)} tensors, {total} values agree")


if __name__ == "__main__":
    main(*sys.argv[1:])

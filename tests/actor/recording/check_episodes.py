#!/usr/bin/env python3
"""Reads episode files like numpy, using only the standard library, and checks them against a log of episodes.

Usage: check_episodes.py FOLDER STATS_JSONL FRAME_SIZE
Prints "<n> episodes agree", or the first error and exits with 1.
"""

import ast
import json
import math
import os
import re
import struct
import sys
import zipfile

ITEMS = ["health", "food", "drink", "energy", "sapling", "wood", "stone", "coal", "iron", "diamond", "wood_pickaxe",
         "stone_pickaxe", "iron_pickaxe", "wood_sword", "stone_sword", "iron_sword"]
CODES = {"|u1": "B", "|b1": "?", "<i8": "q", "<f8": "d"}


def check(condition, *what):
    if not condition:
        sys.exit(" ".join(str(w) for w in what))


def read_npy(data):
    """(dtype, shape, values in a flat tuple) of an npy file, format 1.0."""
    check(data[:8] == b"\x93NUMPY\x01\x00", "not an npy file:", data[:8])
    (length,) = struct.unpack("<H", data[8:10])
    check((10 + length) % 64 == 0 and data[10 + length - 1:10 + length] == b"\n", "npy header of", length, "bytes")
    header = ast.literal_eval(data[10:10 + length].decode("ascii"))
    check(sorted(header) == ["descr", "fortran_order", "shape"] and header["fortran_order"] is False, header)
    count = math.prod(header["shape"])
    return header["descr"], header["shape"], struct.unpack(f"<{count}{CODES[header['descr']]}", data[10 + length:])


def read_npz(path):
    with zipfile.ZipFile(path) as archive:
        check(archive.testzip() is None, path, "is damaged")
        for info in archive.infolist():
            check(info.compress_type == zipfile.ZIP_DEFLATED, info.filename, "is not compressed")
        return {name.removesuffix(".npy"): read_npy(archive.read(name)) for name in archive.namelist()}


def check_arrays(name, arrays, steps, achievements, size):
    rows = steps + 1
    wanted = {"image": ("|u1", (rows, size, size, 3)), "action": ("<i8", (rows,)), "reward": ("<f8", (rows,)),
              "done": ("|b1", (rows,)), "discount": ("<f8", (rows,)), "semantic": ("|u1", (rows, 64, 64)),
              "player_pos": ("<i8", (rows, 2))}
    wanted.update({key: ("<i8", (rows,)) for key in achievements})
    wanted.update({f"ainventory_{item}": ("<i8", (rows,)) for item in ITEMS})
    check({key: array[:2] for key, array in arrays.items()} == wanted, name, "has arrays",
          {key: array[:2] for key, array in arrays.items()}, "want", wanted)
    values = {key: array[2] for key, array in arrays.items()}
    check(any(values["image"][:size * size * 3]), name, "has no picture at the reset")
    for key, of_key in values.items():
        first = of_key[:len(of_key) // rows]
        check(key == "image" or not any(first), name, key, "is not zero at the reset:", first[:8])
    check(values["done"] == (False,) * steps + (True,), name, "is done at", values["done"].index(True), "of", steps)
    check(set(values["action"]) <= set(range(17)), name, "has actions", set(values["action"]))
    check(all(x == 1 for x in values["discount"][1:-1]), name, "has discounts", set(values["discount"][1:-1]))
    died = values["ainventory_health"][-1] == 0
    check(values["discount"][-1] == (0 if died else 1), name, "ends with discount", values["discount"][-1])
    for row in range(1, rows):
        x, y = values["player_pos"][2 * row:2 * row + 2]
        check(values["semantic"][row * 4096 + x * 64 + y] == 13, name, "has no player at", (x, y), "in row", row)
    return values


def check_episode(path, stats, size):
    name = os.path.basename(path)
    match = re.fullmatch(r"\d{8}T\d{6}-episode\d{4,}-ach(\d+)-len(\d+)\.npz", name)
    check(match, "a file is called", name)
    achievements = [key for key in stats if key.startswith("achievement_")]
    check(len(achievements) == 22, achievements)
    check(int(match[2]) == stats["length"], name, "want length", stats["length"])
    values = check_arrays(name, read_npz(path), stats["length"], achievements, size)
    check(round(math.fsum(values["reward"]), 1) == stats["reward"], name, "reward", math.fsum(values["reward"]))
    check(all(round(x, 1) == x for x in values["reward"]), name, "has rewards that are no tenths")
    for key in achievements:
        check(values[key][-1] == stats[key], name, key, values[key][-1], "want", stats[key])
    check(int(match[1]) == sum(stats[key] > 0 for key in achievements), name, "counts achievements wrongly")


def main():
    folder, log, size = sys.argv[1:]
    with open(log, encoding="utf-8") as lines:
        episodes = [json.loads(line) for line in lines]
    names = sorted(name for name in os.listdir(folder) if name.endswith(".npz"))
    check(len(names) == len(episodes), len(names), "files for", len(episodes), "episodes")
    for name, stats in zip(names, episodes):
        check_episode(os.path.join(folder, name), stats, int(size))
    print(len(names), "episodes agree")


if __name__ == "__main__":
    main()

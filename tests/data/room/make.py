#!/usr/bin/env python3
"""Makes the room beside this file: a room of `sgs synth`, without what its test does not read.

    sgs synth /tmp/room --views 10 --size 96x72 --seed 3
    python3 make.py /tmp/room

Keeps ground truth of test views, priors of training views, two of the relit sets, and every second point. Semantic features are
averaged over blocks of 2x1, which halves their files.
"""

import json
import struct
import sys
from pathlib import Path
from shutil import copyfile

HERE = Path(__file__).parent
RELIT = ["lamp_ceiling_off", "lamps_recolored_night"]
TRUTH = ["albedo", "normal", "depth", "roughness", "mask", "semantic"]
PRIORS = ["albedo", "normal", "roughness", "masks"]


def copy(source, name):
    (HERE / name).parent.mkdir(parents=True, exist_ok=True)
    copyfile(source / name, HERE / name)


def thin_features(source, name):
    """Averages pairs of columns of a map of float16 features."""
    data = (source / name).read_bytes()
    length = struct.unpack("<H", data[8:10])[0]
    header = data[10 : 10 + length].decode()
    height, width, dim = eval(header)["shape"]
    assert width % 2 == 0 and "'<f2'" in header
    values = struct.unpack(f"<{height * width * dim}e", data[10 + length :])
    out = []
    for cell in range(height * width // 2):
        at = 2 * cell * dim
        mean = [0.5 * (values[at + i] + values[at + dim + i]) for i in range(dim)]
        norm = sum(v * v for v in mean) ** 0.5
        out += [v / norm for v in mean]
    header = f"{{'descr': '<f2', 'fortran_order': False, 'shape': ({height}, {width // 2}, {dim}), }}"
    header += " " * (-(10 + len(header) + 1) % 64) + "\n"
    (HERE / name).parent.mkdir(parents=True, exist_ok=True)
    packed = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode()
    (HERE / name).write_bytes(packed + struct.pack(f"<{len(out)}e", *out))


def thin_points(source):
    """Keeps every second point of a binary PLY file."""
    header, body = (source / "points.ply").read_bytes().split(b"end_header\n", 1)
    count = int(header.split(b"element vertex ")[1].split()[0])
    size = len(body) // count
    thinned = [body[i * size : (i + 1) * size] for i in range(0, count, 2)]
    header = header.replace(f"element vertex {count}".encode(), f"element vertex {len(thinned)}".encode())
    (HERE / "points.ply").write_bytes(header + b"end_header\n" + b"".join(thinned))


def main():
    source = Path(sys.argv[1])
    split = json.loads((source / "split.json").read_text())
    for name in ["transforms.json", "split.json", "gt/lights.json", "gt/semantic/labels.json", "priors/priors.json"]:
        copy(source, name)
    for name in ["labels.json", "text_embeddings.npy"]:
        copy(source, f"priors/semantic/{name}")
    for stem in split["train"] + split["test"]:
        copy(source, f"images/{stem}.png")
    for stem in split["train"]:
        for kind in PRIORS:
            copy(source, f"priors/{kind}/{stem}.png")
        thin_features(source, f"priors/semantic/{stem}.npy")
    for stem in split["test"]:
        for kind in TRUTH:
            extension = "png" if kind in ["mask", "semantic"] else "exr"
            copy(source, f"gt/{kind}/{stem}.{extension}")
        for name in RELIT:
            copy(source, f"gt/relit/{name}/{stem}.exr")
    thin_points(source)


main()

"""Reading maps without any library: PNG (8 and 16 bits), OpenEXR (scan lines; none, RLE or ZIP), NumPy arrays of floats.

Enough for the ground truth that ``sgs synth`` writes. A map is ``(width, height, channels, numbers)`` with numbers row
by row, interleaved: PNG as stored, EXR as floats in the order R G B, else by name.
"""

import ast
import struct
import zlib


def read_png(path):
    """A PNG without interlacing and palette."""
    with open(path, "rb") as f:
        data = f.read()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError(f"{path} is no PNG")
    at, packed, head = 8, [], None
    while at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            head = struct.unpack(">IIBBBBB", body)
        elif kind == b"IDAT":
            packed.append(body)
        at += 12 + length
    width, height, depth, color, _, _, interlaced = head
    if depth not in (8, 16) or color == 3 or interlaced:
        raise ValueError(f"{path} has {depth} bits, color type {color}, interlacing {interlaced}; write it plainly")
    channels = {0: 1, 2: 3, 4: 2, 6: 4}[color]
    rows = _unfilter(zlib.decompress(b"".join(packed)), width * channels * depth // 8, height, channels * depth // 8)
    if depth == 16:
        return width, height, channels, list(struct.unpack(f">{len(rows) // 2}H", rows))
    return width, height, channels, rows


def read_npy(path):
    """An array of floats, height x width or height x width x channels."""
    with open(path, "rb") as f:
        data = f.read()
    (length,) = struct.unpack_from("<H", data, 8)
    head = ast.literal_eval(data[10:10 + length].decode("latin-1"))
    letter = {"<f4": "f", "<f2": "e"}.get(head["descr"])
    if data[:7] != b"\x93NUMPY\x01" or letter is None or head["fortran_order"]:
        raise ValueError(f"{path} is no plain array of float16 or float32")
    height, width, *channels = head["shape"]
    channels = channels[0] if channels else 1
    return width, height, channels, list(struct.unpack_from(f"<{height * width * channels}{letter}", data, 10 + length))


def _unfilter(raw, stride, height, step):
    out, above, at = bytearray(), bytearray(stride), 0
    for _ in range(height):
        kind, row = raw[at], bytearray(raw[at + 1:at + 1 + stride])
        at += 1 + stride
        if kind == 1:
            for i in range(step, stride):
                row[i] = (row[i] + row[i - step]) & 255
        elif kind == 2:
            for i in range(stride):
                row[i] = (row[i] + above[i]) & 255
        elif kind == 3:
            for i in range(stride):
                left = row[i - step] if i >= step else 0
                row[i] = (row[i] + (left + above[i]) // 2) & 255
        elif kind == 4:
            for i in range(stride):
                a, c = (row[i - step], above[i - step]) if i >= step else (0, 0)
                b = above[i]
                p = a + b - c
                pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
                row[i] = (row[i] + (a if pa <= pb and pa <= pc else b if pb <= pc else c)) & 255
        out += row
        above = row
    return out


def read_exr(path):
    """A scan-line EXR with half, float or whole channels."""
    with open(path, "rb") as f:
        data = f.read()
    magic, version = struct.unpack_from("<II", data)
    if magic != 20000630 or version & 0x1A00:
        raise ValueError(f"{path} is no single-part scan-line EXR")
    found, at = {}, 8
    while data[at]:
        name, at = _text(data, at)
        _, at = _text(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        found[name], at = data[at + 4:at + 4 + size], at + 4 + size
    at += 1
    x0, y0, x1, y1 = struct.unpack("<4i", found["dataWindow"])
    width, height, compression = x1 - x0 + 1, y1 - y0 + 1, found["compression"][0]
    if compression > 3:
        raise ValueError(f"{path} is compressed by method {compression}; only none, RLE and ZIP are read")
    names = _channels(found["channels"])
    wide = sum(size for _, _, size in names) * width
    lines = {0: 1, 1: 1, 2: 1, 3: 16}[compression]
    planes = {name: [0.0] * (width * height) for name, _, _ in names}
    for place in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        y, size = struct.unpack_from("<ii", data, place)
        rows = min(lines, y1 + 1 - y)
        body = data[place + 8:place + 8 + size]
        if compression and size < wide * rows:
            body = _restore(zlib.decompress(body) if compression > 1 else _runs(body))
        offset = 0
        for row in range(y - y0, y - y0 + rows):
            for name, letter, each in names:
                numbers = struct.unpack_from(f"<{width}{letter}", body, offset)
                planes[name][row * width:(row + 1) * width] = numbers
                offset += width * each
    order = [n for n in ("R", "G", "B", "A") if n in planes] + [n for n in planes if n not in "RGBA"]
    if len(order) == 1:
        return width, height, 1, planes[order[0]]
    return width, height, len(order), [v for pixel in zip(*(planes[n] for n in order)) for v in pixel]


def _text(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode("latin-1"), end + 1


def _channels(data):
    found, at = [], 0
    while data[at]:
        name, at = _text(data, at)
        letter, each = {0: ("I", 4), 1: ("e", 2), 2: ("f", 4)}[struct.unpack_from("<i", data, at)[0]]
        found.append((name, letter, each))
        at += 16
    return found


def _restore(data):
    """Differences summed up, then the two halves put together like a zipper."""
    sums, last = bytearray(len(data)), 128
    for i, byte in enumerate(data):
        last = (last + byte - 128) & 255
        sums[i] = last
    out, half = bytearray(len(data)), (len(data) + 1) // 2
    # The first difference is the byte itself.
    out[0::2], out[1::2] = sums[:half], sums[half:]
    return out


def _runs(data):
    out, at = bytearray(), 0
    while at < len(data):
        count = data[at] - 256 if data[at] > 127 else data[at]
        if count < 0:
            out += data[at + 1:at + 1 - count]
            at += 1 - count
        else:
            out += data[at + 1:at + 2] * (count + 1)
            at += 2
    return out

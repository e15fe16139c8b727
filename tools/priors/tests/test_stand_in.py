"""The stand-in on a tiny scene that is written here: files, frames, color spaces, noise, cameras."""

import json
import math
import os
import struct
import sys
import tempfile
import unittest
import zlib

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

from sgs_priors import files  # noqa: E402
from sgs_priors.protocol import pack  # noqa: E402
from sgs_priors.service import Question, Refusal  # noqa: E402
from sgs_priors.stand_in import StandIn  # noqa: E402


def write_png(path, width, height, channels, numbers, depth=8, kinds=(0,)):
    """A PNG whose rows go through these filters in turn."""
    step = channels * depth // 8
    flat = struct.pack(f">{len(numbers)}{'B' if depth == 8 else 'H'}", *numbers)
    stride, raw, above = width * step, b"", bytes(width * step)
    for y in range(height):
        row, kind = flat[y * stride:(y + 1) * stride], kinds[y % len(kinds)]
        left = bytes(step) + row[:-step]
        corner = bytes(step) + above[:-step]
        def paeth(a, b, c):
            p = a + b - c
            return min(((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c)))[2]
        guess = {0: lambda i: 0, 1: lambda i: left[i], 2: lambda i: above[i], 3: lambda i: (left[i] + above[i]) // 2,
                 4: lambda i: paeth(left[i], above[i], corner[i])}[kind]
        raw += bytes([kind]) + bytes((row[i] - guess(i)) & 255 for i in range(stride))
        above = row
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    color = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    head = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    with open(path, "wb") as f:
        f.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


def write_exr(path, width, height, planes, compression=3):
    """Half-precision scan lines; ``planes`` by channel name."""
    def text(s):
        return s.encode() + b"\0"
    def attribute(name, kind, body):
        return text(name) + text(kind) + struct.pack("<i", len(body)) + body
    names = sorted(planes)
    channels = b"".join(text(n) + struct.pack("<iiii", 1, 0, 1, 1) for n in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<II", 20000630, 2) + attribute("channels", "chlist", channels)
    head += attribute("compression", "compression", bytes([compression])) + attribute("dataWindow", "box2i", window) + b"\0"
    lines = 16 if compression == 3 else 1
    blocks = []
    for y in range(0, height, lines):
        rows = range(y, min(y + lines, height))
        body = b"".join(struct.pack(f"<{width}e", *planes[n][r * width:(r + 1) * width]) for r in rows for n in names)
        if compression > 1:
            mixed = body[0::2] + body[1::2]
            packed = zlib.compress(bytes([mixed[0]] + [(b - a + 128) & 255 for a, b in zip(mixed, mixed[1:])]))
            body = packed if len(packed) < len(body) else body
        blocks.append(struct.pack("<ii", y, len(body)) + body)
    at, table = len(head) + 8 * len(blocks), b""
    for block in blocks:
        table += struct.pack("<Q", at)
        at += len(block)
    with open(path, "wb") as f:
        f.write(head + table + b"".join(blocks))


class Files(unittest.TestCase):
    def test_png(self):
        with tempfile.TemporaryDirectory() as d:
            path = os.path.join(d, "a.png")
            for channels, depth in ((1, 8), (3, 8), (4, 8), (1, 16), (3, 16)):
                numbers = [(i * i * 37 + i) % (1 << depth) for i in range(7 * 6 * channels)]
                write_png(path, 7, 6, channels, numbers, depth, (0, 1, 2, 3, 4, 4))
                w, h, c, found = files.read_png(path)
                self.assertEqual((w, h, c, list(found)), (7, 6, channels, numbers))

    def test_exr(self):
        with tempfile.TemporaryDirectory() as d:
            path = os.path.join(d, "a.exr")
            planes = {n: [k + i / 8 for i in range(5 * 19)] for k, n in enumerate("RGB")}
            for compression in (0, 2, 3):
                write_exr(path, 5, 19, planes, compression)
                w, h, c, found = files.read_exr(path)
                self.assertEqual((w, h, c), (5, 19, 3))
                self.assertEqual(found[:6], [0, 1, 2, 0.125, 1.125, 2.125])
                self.assertEqual(found[0::3], planes["R"])
            write_exr(path, 5, 19, {"Y": planes["G"]})
            self.assertEqual(files.read_exr(path), (5, 19, 1, planes["G"]))
            self.assertEqual(files._runs(bytes([256 - 2, 7, 8, 2, 9])), bytes([7, 8, 9, 9, 9]))


class Answers(unittest.TestCase):
    """One flat wall at z = 2 in front of two cameras that differ by a step to the right."""

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = self.folder.name
        w, h = self.size = (16, 12)
        frames = []
        for kind in ("normal", "albedo", "depth", "semantic"):
            os.makedirs(os.path.join(self.root, "gt", kind))
        for view, step in (("000", 0.0), ("001", 0.5)):
            def place(kind, name=view):
                return os.path.join(self.root, "gt", kind, name)
            matrix = [[1, 0, 0, step], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
            frames.append({"file_path": f"images/{view}.png", "transform_matrix": matrix})
            # OpenGL cameras look along -z; the wall faces them.
            write_exr(place("normal") + ".exr", w, h, {"R": [0.6] * w * h, "G": [0.0] * w * h, "B": [0.8] * w * h})
            write_exr(place("albedo") + ".exr", w, h, {n: [0.25] * w * h for n in "RGB"})
            write_exr(place("depth") + ".exr", w, h, {"Y": [2.0] * w * h})
            # The left half of what the first camera sees is class 3. A step is 0.5 / 2 * 8 = 2 pixels.
            write_png(place("semantic") + ".png", w, h, 1, [3 if x + 16 * step / 4 < 8 else 1 for _ in range(h) for x in range(w)])
        with open(os.path.join(self.root, "transforms.json"), "w", encoding="utf-8") as f:
            json.dump({"w": w, "h": h, "fl_x": 8, "fl_y": 8, "cx": 8, "cy": 6, "frames": frames}, f)
        with open(os.path.join(self.root, "scene.json"), "w", encoding="utf-8") as f:
            json.dump({"classes": [{"id": i, "name": n} for i, n in enumerate(["none", "wall", "x", "sofa"])]}, f)

    def tearDown(self):
        self.folder.cleanup()

    def ask(self, service, name, views=({"name": "000"},), size=None, **more):
        w, h = size or self.size
        images = {f"image{i}": pack("U8", (h, w, 3), [0] * w * h * 3) for i in range(len(views))}
        text = {"question": name, "id": 1, "views": list(views), "seed": 42, **more}
        return service.answer(Question(text, images))

    def test_normals_in_every_frame(self):
        for frame, wanted in (("world", (0.6, 0, 0.8)), ("camera-opengl", (0.6, 0, 0.8)),
                              ("camera-opencv", (0.6, 0, -0.8)), ("camera-stablenormal", (-0.6, 0, 0.8))):
            text, arrays = self.ask(StandIn(self.root, 0, frame), "normals")
            self.assertEqual((text["frame"], arrays["normals"].shape), (frame, (12, 16, 3)))
            for a, b in zip(arrays["normals"].numbers(), wanted):
                self.assertAlmostEqual(a, b, delta=1e-3)
        noisy = self.ask(StandIn(self.root, 0.05), "normals")[1]["normals"]
        self.assertEqual(noisy, self.ask(StandIn(self.root, 0.05), "normals")[1]["normals"])
        numbers = noisy.numbers()
        off = [math.degrees(math.acos(min(1, -0.6 * numbers[i] + 0.8 * numbers[i + 2]))) for i in range(0, len(numbers), 3)]
        self.assertTrue(2 < sum(off) / len(off) < 6, sum(off) / len(off))

    def test_other_sizes_and_unknown_views(self):
        service = StandIn(self.root, 0)
        self.assertEqual(self.ask(service, "regions", size=(4, 3))[1]["regions"].shape, (3, 4))
        for views in ([{}], [{"name": "999"}]):
            with self.assertRaisesRegex(Refusal, "no ground truth of normal"):
                self.ask(service, "normals", views)
        with self.assertRaisesRegex(Refusal, "no ground truth of metallic"):
            self.ask(service, "materials", maps=["metallic"])
        self.assertEqual(service.offers["materials"], {"maps": ["albedo"]})

    def test_color_spaces(self):
        for color, value in (("linear", 0.25), ("srgb", 0.537099)):
            text, arrays = self.ask(StandIn(self.root, 0, color=color), "materials", maps=["albedo"])
            self.assertEqual(text["color"], color)
            self.assertAlmostEqual(arrays["albedo"].numbers()[5], value, delta=1e-5)

    def test_depth_of_every_meaning(self):
        self.assertNotIn("depth", StandIn(self.root, 0).offers)
        seen = {}
        for meaning in ("metric", "scale", "inverse-scale-shift"):
            service = StandIn(self.root, 0, meaning=meaning)
            self.assertEqual(service.offers["depth"], {})
            text, arrays = self.ask(service, "depth")
            self.assertEqual((text["meaning"], arrays["depth"].shape), (meaning, (12, 16)))
            self.assertEqual(set(arrays["confidence"].numbers()), {1.0})
            (seen[meaning],) = set(arrays["depth"].numbers())
            other = self.ask(service, "depth", ({"name": "001"},))[1]["depth"].numbers()[0]
            self.assertEqual(other == seen[meaning], meaning == "metric")
        self.assertEqual(seen["metric"], 2.0)
        self.assertNotEqual(seen["scale"], 2.0)

    def test_leak_puts_shading_into_albedo(self):
        w, h = self.size
        # The left half has four times the light of the right half; the light is red.
        light = [v for _ in range(h) for x in range(w) for v in ((0.4, 0.2, 0.2) if x < w // 2 else (0.1, 0.05, 0.05))]

        def albedo(leak, factor=1):
            service = StandIn(self.root, 0, color="linear", leak=leak)
            self.assertEqual(service.offers["materials"].get("image"), "linear" if leak else None)
            image = pack("F32", (h, w, 3), [factor * v for v in light])
            text = {"question": "materials", "id": 1, "views": [{"name": "000"}], "seed": 1, "maps": ["albedo"]}
            return list(service.answer(Question(text, {"image0": image}))[1]["albedo"].numbers())

        clean, half, whole = albedo(0), albedo(0.5), albedo(1)
        self.assertTrue(all(abs(v - 0.25) < 1e-6 for v in clean))
        for found, ratio in ((half, 2), (whole, 4)):
            self.assertAlmostEqual(found[0] / found[3 * (w - 1)], ratio, places=3)
            self.assertAlmostEqual(found[0] / found[1], ratio ** 0.5, places=3)
        # A gain of the light says nothing about materials.
        for a, b in zip(half, albedo(0.5, factor=3)):
            self.assertAlmostEqual(a, b, places=5)

    def test_features_are_those_of_the_text(self):
        service = StandIn(self.root, 0)
        names = self.ask(service, "classes", [])[0]["names"]
        vectors = self.ask(service, "text", [], names=names)[1]["embeddings"].numbers()
        features = self.ask(service, "semantics")[1]["features"]
        self.assertEqual(features.shape, (2, 2, 512))
        for a, b in zip(features.numbers()[:512], vectors[3 * 512:]):
            self.assertAlmostEqual(a, b, delta=1e-3)

    def test_masks_by_view_by_camera_and_by_color(self):
        service = StandIn(self.root, 0)
        cameras = service.truth.cameras
        both = [{"name": "000"}, {"name": "001"}, {"camera": {**cameras["001"]}}]
        marks = self.ask(service, "masks", both, point=[2.5, 3.5])[1]["masks"].numbers()
        w, h = self.size
        frames = [marks[i * w * h:(i + 1) * w * h] for i in range(3)]
        self.assertEqual([sum(f) for f in frames[:2]], [8 * h, 6 * h])
        # Moved from the nearest views, at most a column at the edge may differ.
        self.assertLessEqual(sum(a != b for a, b in zip(frames[1], frames[2])), h)
        colors = pack("U8", (1, 4, 3), [9, 9, 9, 200, 0, 0, 12, 9, 9, 0, 250, 0])
        text = {"question": "masks", "id": 1, "views": [{}, {}, {}], "point": [0.5, 0.5]}
        _, arrays = service.answer(Question(text, {f"image{i}": colors for i in range(3)}))
        self.assertEqual(list(arrays["masks"].data), [1, 0, 1, 0] * 3)


if __name__ == "__main__":
    unittest.main()

"""Ground truth of a scene, as the stand-in sees it: maps by view, cameras, and class numbers seen from any camera.

Standard library only. Layout: ``gt/KIND/STEM.{npy,exr,png}``, ``transforms.json``, ``scene.json`` for class names.
"""

import json
import os

from . import files


class Truth:
    """The ground truth of one scene directory; maps are read when they are first needed."""

    def __init__(self, root):
        self.root, self.maps = root, {}
        with open(os.path.join(root, "transforms.json"), encoding="utf-8") as f:
            self.cameras = _cameras(json.load(f))
        try:
            with open(os.path.join(root, "scene.json"), encoding="utf-8") as f:
                self.classes = [c["name"] for c in sorted(json.load(f)["classes"], key=lambda c: c["id"])]
        except (OSError, KeyError):
            self.classes = []

    def has(self, kind):
        """Whether there is any truth of a kind."""
        return os.path.isdir(os.path.join(self.root, "gt", kind))

    def map(self, kind, view):
        """A map of a view, or None. Values of PNG files stay whole numbers."""
        if (kind, view) not in self.maps:
            path = os.path.join(self.root, "gt", kind, view)
            readers = ((".npy", files.read_npy), (".exr", files.read_exr), (".png", files.read_png))
            self.maps[kind, view] = next((read(path + e) for e, read in readers if os.path.isfile(path + e)), None)
        return self.maps[kind, view]

    def sized(self, kind, view, width, height):
        """A map's pixels at another size, each from the pixel at its center; None where there is no map."""
        found = self.map(kind, view)
        if found is None:
            return None
        w, h, channels, numbers = found
        columns = [min(int((x + 0.5) * w / width + 1e-9), w - 1) * channels for x in range(width)]
        pixels = []
        for y in range(height):
            row = min(int((y + 0.5) * h / height + 1e-9), h - 1) * w * channels
            pixels.extend(tuple(numbers[row + x:row + x + channels]) for x in columns)
        return pixels

    def classes_from(self, camera, width, height, near=3):
        """Class numbers plus one (0 is none) as a camera sees them: the nearest views' pixels, moved through space."""
        eye = _center(camera["world_to_camera"])
        known = [v for v in self.cameras if self.map("depth", v) and self.map("semantic", v)]
        known.sort(key=lambda v: sum((a - b) ** 2 for a, b in zip(_center(self.cameras[v]["world_to_camera"]), eye)))
        ids, depths = [0] * (width * height), [float("inf")] * (width * height)
        sx, sy = width / camera["width"], height / camera["height"]
        for view in known[:near]:
            _splat(self, view, camera, (sx, sy), (width, height), ids, depths)
        return _filled(ids, width, height)


def _splat(truth, view, camera, scale, size, ids, depths):
    w, h, _, depth = truth.map("depth", view)
    classes = [p[0] for p in truth.sized("semantic", view, w, h)]
    own = truth.cameras[view]
    fx, fy = own["fx"] * w / own["width"], own["fy"] * h / own["height"]
    cx, cy = own["cx"] * w / own["width"], own["cy"] * h / own["height"]
    # From one camera to the other: X' = R' Rt (X - t) + t'.
    (r, t), (q, s) = _split(own["world_to_camera"]), _split(camera["world_to_camera"])
    m = [[sum(q[i][k] * r[j][k] for k in range(3)) for j in range(3)] for i in range(3)]
    o = [s[i] - sum(m[i][j] * t[j] for j in range(3)) for i in range(3)]
    gx, gy, ux, uy = camera["fx"] * scale[0], camera["fy"] * scale[1], camera["cx"] * scale[0], camera["cy"] * scale[1]
    width, height = size
    for at, z in enumerate(depth):
        if not 0 < z < 1e6:
            continue
        a, b = (at % w + 0.5 - cx) / fx * z, (at // w + 0.5 - cy) / fy * z
        d = m[2][0] * a + m[2][1] * b + m[2][2] * z + o[2]
        if d <= 1e-3:
            continue
        x = int(gx * (m[0][0] * a + m[0][1] * b + m[0][2] * z + o[0]) / d + ux)
        y = int(gy * (m[1][0] * a + m[1][1] * b + m[1][2] * z + o[1]) / d + uy)
        if 0 <= x < width and 0 <= y < height and d < depths[y * width + x]:
            depths[y * width + x], ids[y * width + x] = d, classes[at] + 1


def _filled(ids, width, height):
    """Single holes take the number of a neighbor."""
    out = list(ids)
    for at, one in enumerate(ids):
        if one == 0:
            x, y = at % width, at // width
            around = ((x > 0, at - 1), (x + 1 < width, at + 1), (y > 0, at - width), (y + 1 < height, at + width))
            out[at] = next((ids[n] for inside, n in around if inside and ids[n]), 0)
    return out


def _split(rows):
    return [row[:3] for row in rows], [row[3] for row in rows]


def _center(rows):
    r, t = _split(rows)
    return [-sum(r[k][i] * t[k] for k in range(3)) for i in range(3)]


def _cameras(transforms):
    """Cameras by stem, with OpenCV axes, world to camera."""
    found = {}
    for frame in transforms["frames"]:
        entry = {**transforms, **frame}
        m = entry["transform_matrix"]
        # OpenGL's y and z point the other way.
        axes = [[sign * m[k][i] for k in range(3)] for i, sign in ((0, 1), (1, -1), (2, -1))]
        place = [m[k][3] for k in range(3)]
        rows = [[*axis, -sum(a * p for a, p in zip(axis, place))] for axis in axes]
        stem = os.path.splitext(os.path.basename(entry["file_path"]))[0]
        found[stem] = {"width": entry["w"], "height": entry["h"], "fx": entry["fl_x"], "fy": entry.get("fl_y", entry["fl_x"]),
                       "cx": entry["cx"], "cy": entry["cy"], "world_to_camera": rows}
    return found

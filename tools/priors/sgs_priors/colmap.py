"""Writing cameras and points as COLMAP's text model, which scene readers take. Standard library only."""

import math
import os


def quaternion(r):
    """(w, x, y, z), with w not negative, of a rotation given as three rows."""
    trace = r[0][0] + r[1][1] + r[2][2]
    if trace > 0:
        s = 2 * math.sqrt(trace + 1)
        q = [s / 4, (r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s]
    else:
        i = max(range(3), key=lambda k: r[k][k])
        j, k = (i + 1) % 3, (i + 2) % 3
        s = 2 * math.sqrt(max(r[i][i] - r[j][j] - r[k][k] + 1, 1e-12))
        q = [(r[k][j] - r[j][k]) / s, 0, 0, 0]
        q[1 + i], q[1 + j], q[1 + k] = s / 4, (r[j][i] + r[i][j]) / s, (r[k][i] + r[i][k]) / s
    length = math.copysign(math.sqrt(sum(v * v for v in q)), q[0])
    return [v / length for v in q]


def write(scene, views, points):
    """Writes ``sparse/0``: ``views`` are dictionaries with name, width, height, fx, fy, cx, cy and world_to_camera (three
    rows of four, OpenCV axes), ``points`` are (x, y, z, red, green, blue). Files appear when they are whole."""
    cameras = ["# number, model, width, height, fx, fy, cx, cy"]
    images = ["# number, qw, qx, qy, qz, tx, ty, tz, camera, name; then an empty line of observations"]
    for number, v in enumerate(views, 1):
        inner = " ".join(repr(float(v[k])) for k in ("fx", "fy", "cx", "cy"))
        cameras.append(f"{number} PINHOLE {v['width']} {v['height']} {inner}")
        rows = v["world_to_camera"]
        pose = [*quaternion([row[:3] for row in rows]), *(row[3] for row in rows)]
        images.append(f"{number} {' '.join(repr(float(p)) for p in pose)} {number} {v['name']}\n")
    lines = ["# number, x, y, z, red, green, blue, error"]
    for number, (x, y, z, *color) in enumerate(points, 1):
        lines.append(f"{number} {float(x)!r} {float(y)!r} {float(z)!r} {' '.join(str(int(c)) for c in color)} 0")
    folder = os.path.join(scene, "sparse", "0")
    os.makedirs(folder, exist_ok=True)
    # Points first: a reader recognizes the scene by its cameras.
    for name, text in (("points3D.txt", lines), ("images.txt", images), ("cameras.txt", cameras)):
        part = os.path.join(folder, f".{name}.{os.getpid()}.tmp")
        with open(part, "w", encoding="utf-8") as f:
            f.write("\n".join(text) + "\n")
        os.replace(part, os.path.join(folder, name))

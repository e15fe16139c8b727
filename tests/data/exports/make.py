"""Writes the exports of tests/tests/command/photogrammetry.rs: one room of three cameras, as two programs export it.

    python make.py            # needs only Python

The test states the same cameras again, as centers and axes. It writes the photographs.
"""

import json
import struct
from pathlib import Path

# World-to-camera quaternion (w, x, y, z) and translation of each camera.
POSES = [
    ((0.5**0.5, 0.5**0.5, 0, 0), (-1, 1.5, 2)),
    ((0.05**0.5, 0.05**0.5, -(0.45**0.5), 0.45**0.5), (0, 1.25, 5)),
    ((0.2**0.5, 0.8**0.5, 0, 0), (-0.5, 1.8, 2.6)),
]
POINTS = [((0.25, 1.5, 1.125), (255, 0, 51)), ((-0.5, 2, 1), (102, 153, 204))]
HERE = Path(__file__).parent


def realityscan():
    """Text files beside the folder of images; a camera for each image, cropped to where its photograph reaches."""
    cameras = ["16 12 14.25 14.25 8.125 5.875", "18 12 14.5 14.5 8.875 6.25", "16 14 14.75 14.75 7.75 7.125"]
    names = ["view_00/frame_000001.jpg", "view_01/frame_000001.jpg", "view_01/frame_000002.jpg"]
    number = "{:.9g}".format
    files = {
        "cameras.txt": ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
        + [f"{i} PINHOLE {camera}" for i, camera in enumerate(cameras, 1)],
        "images.txt": ["# Image list with two lines of data per image:", "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
        + [line for i, (pose, name) in enumerate(zip(POSES, names), 1)
           for line in (" ".join([str(i), *map(number, pose[0] + pose[1]), str(i), name]), "")],
        "points3D.txt": ["# 3D point list with one line of data per point:", "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]"]
        + [" ".join([str(i), *map(number, position), *map(str, color), "0"]) for i, (position, color) in enumerate(POINTS, 1)],
    }
    for name, lines in files.items():
        path = HERE / "realityscan" / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes("".join(line + "\r\n" for line in lines).encode())


def metashape():
    """Binary files in sparse/0; numbers count from 0, a camera for each sensor, points without error."""
    u32, u64 = (lambda *v: struct.pack(f"<{len(v)}I", *v)), (lambda *v: struct.pack(f"<{len(v)}Q", *v))
    f64 = lambda *v: struct.pack(f"<{len(v)}d", *v)  # noqa: E731
    cameras = u64(2) + u32(0, 1) + u64(16, 12) + f64(14.25, 14.25, 8, 6) + u32(1, 1) + u64(18, 13) + f64(15, 15, 9, 6.5)
    images = u64(len(POSES))
    for i, ((q, t), sensor, name) in enumerate(zip(POSES, (0, 0, 1), ("DSC_0001.JPG", "DSC_0002.JPG", "IMG 7.png"))):
        images += u32(i) + f64(*q, *t) + u32(sensor) + name.encode() + b"\0" + u64(3)
        # The last feature belongs to no point.
        images += b"".join(f64(4 + j, 5 + i) + u64((0, 1, 2**64 - 1)[j]) for j in range(3))
    points = u64(len(POINTS))
    for i, (position, color) in enumerate(POINTS):
        points += u64(i) + f64(*position) + bytes(color) + f64(0) + u64(3) + b"".join(u32(j, i) for j in range(3))
    for name, content in {"cameras": cameras, "images": images, "points3D": points}.items():
        path = HERE / "metashape/sparse/0" / f"{name}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def nerfstudio():
    """The transforms.json of ns-process-data metashape: axes (z, x, y), intrinsics in each frame, a negative zero."""
    frames = []
    for i, ((w, x, y, z), t) in enumerate(POSES):
        # Rows are the camera's axes in the world, of the camera that COLMAP knows.
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix = [[rows[0][j], -rows[1][j], -rows[2][j], -sum(rows[k][j] * t[k] for k in range(3))] for j in (2, 0, 1)]
        sensor = {"w": 16, "h": 12, "fl_x": 14.25, "fl_y": 14.25, "cx": 8.125, "cy": 5.875, "k1": -0.05, "k2": 0.01,
                  "k3": 0.002, "k4": -0.0005, "p1": 0.0003, "p2": -0.0002}
        if i == 2:
            sensor = {"w": 18, "h": 13, "fl_x": 15.0, "fl_y": 15.0, "cx": 9.0, "cy": 6.5, "k1": 0.0, "k2": 0.0, "k3": 0.0,
                      "k4": 0.0, "p1": 0.0, "p2": 0.0}
        frames.append({"file_path": f"images/frame_{i + 1:05}.png", **sensor,
                       "transform_matrix": matrix + [[0.0, -0.0, -0.0, 1.0]]})
    data = {"camera_model": "OPENCV", "frames": frames,
            "applied_transform": [[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]],
            "ply_file_path": "sparse_pc.ply"}
    folder = HERE / "metashape_nerfstudio"
    folder.mkdir(exist_ok=True)
    (folder / "transforms.json").write_text(json.dumps(data, indent=4))
    head = ["ply", "format ascii 1.0", f"element vertex {len(POINTS)}", "property double x", "property double y", "property double z",
            "property uchar red", "property uchar green", "property uchar blue", "end_header"]
    body = [f"{z} {x} {y} {r} {g} {b}" for (x, y, z), (r, g, b) in POINTS]
    (folder / "sparse_pc.ply").write_text("\n".join(head + body) + "\n")


realityscan()
metashape()
nerfstudio()

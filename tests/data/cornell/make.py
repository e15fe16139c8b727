"""Renders a closed Cornell box with Mitsuba 3: the reference of tests/tests/device/cornell.rs.

    pip install mitsuba==3.9.1 numpy
    python make.py            # writes direct.exr, one_bounce.exr and all.exr

All surfaces are diffuse. The images hold linear radiance as half floats. From PARTS renders of different seeds, the
script prints the standard error of the mean over the image and of a pixel.
"""

import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
from mitsuba import ScalarTransform4f as T  # noqa: E402

SIZE, FIELD_OF_VIEW = 96, 90.0
PARTS, SAMPLES = 8, 256
WHITE, RED, GREEN = [0.75, 0.75, 0.75], [0.6, 0.1, 0.05], [0.15, 0.5, 0.1]
RADIANCE = [12.0, 10.0, 8.0]
# Height of the light below the ceiling, which is at 1.
LIGHT = 0.998


def diffuse(color):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}


def wall(transform, color):
    return {"type": "rectangle", "to_world": transform, "bsdf": diffuse(color)}


def block(x, z, angle, half):
    """A block on the floor: center, turn around y in degrees, half of each edge."""
    place = T().translate([x, half[1] - 1.0, z]).rotate([0, 1, 0], angle).scale(half)
    return {"type": "cube", "to_world": place, "bsdf": diffuse(WHITE)}


def scene():
    # A rectangle spans -1 to 1 in x and y and faces z.
    light = wall(T().translate([0, LIGHT, 0]).rotate([1, 0, 0], 90).scale([0.3, 0.25, 1]), WHITE)
    light["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": RADIANCE}}
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": FIELD_OF_VIEW,
            "to_world": T().look_at(origin=[0, 0, 0.98], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"},
                "pixel_format": "rgb", "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        },
        "floor": wall(T().translate([0, -1, 0]).rotate([1, 0, 0], -90), WHITE),
        "ceiling": wall(T().translate([0, 1, 0]).rotate([1, 0, 0], 90), WHITE),
        "back": wall(T().translate([0, 0, -1]), WHITE),
        "front": wall(T().translate([0, 0, 1]).rotate([0, 1, 0], 180), WHITE),
        "left": wall(T().translate([-1, 0, 0]).rotate([0, 1, 0], 90), RED),
        "right": wall(T().translate([1, 0, 0]).rotate([0, 1, 0], -90), GREEN),
        "tall": block(-0.35, -0.35, 18.0, [0.3, 0.6, 0.3]),
        "short": block(0.38, 0.25, -15.0, [0.28, 0.28, 0.28]),
        "light": light,
    }


def main():
    loaded = mi.load_dict(scene())
    parts = int(sys.argv[1]) if len(sys.argv) > 1 else PARTS
    for name, depth in [("direct", 2), ("one_bounce", 3), ("all", -1)]:
        # Russian roulette from the 12th reflection on.
        integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 12})
        renders = np.stack(
            [np.array(mi.render(loaded, integrator=integrator, spp=SAMPLES, seed=seed)) for seed in range(parts)]
        )
        mean = renders.mean(0, dtype=np.float64)
        of_mean = renders.mean((1, 2), dtype=np.float64).std(0, ddof=1) / np.sqrt(parts) / mean.mean((0, 1))
        of_pixel = (renders.std(0, ddof=1) / np.sqrt(parts)).mean((0, 1)) / mean.mean((0, 1))
        print(name, "mean", mean.mean((0, 1)), "standard error", of_mean, "of a pixel", of_pixel, flush=True)
        bitmap = mi.Bitmap(mean.astype(np.float32)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float16, False)
        bitmap.write(f"{name}.exr")


main()

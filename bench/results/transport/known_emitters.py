#!/usr/bin/env python3
"""Writes the true lights of a scene's photographs as known emitters: known_emitters.py SCENE/gt/lights.json > emitters.json"""

import json
import sys


def difference(a, b):
    return [x - y for x, y in zip(a, b)]


def shape(light):
    """Returns the shape of a sphere or rectangle. edge_u x edge_v points along the normal."""
    if "corners" not in light:
        return {"type": "sphere", "center": light["position"], "radius": light["radius"]}
    corner, second, _, last = light["corners"]
    u, v = difference(second, corner), difference(last, corner)
    cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    if sum(a * b for a, b in zip(cross, light["normal"])) < 0:
        u, v = v, u
    return {"type": "rectangle", "corner": corner, "edge_u": u, "edge_v": v}


with open(sys.argv[1], encoding="utf-8") as file:
    lights = json.load(file)["training"]
emitters = [{"name": light["name"], "on": light["on"], "shape": shape(light)} for light in lights]
json.dump({"format": "sgs-emitters-1", "emitters": emitters}, sys.stdout, indent=1)

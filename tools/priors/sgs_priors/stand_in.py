"""A stand-in for every network: answers from a scene's ground truth, with seeded noise. Standard library only.

It knows photographs by the view's name that goes with a question. Masks it also finds in rendered images, by their
camera, or by color where not even that is known. For tests and for trying the whole chain without weights; never for a
result that is to mean something.
"""

import math
import random

from .protocol import pack
from .service import Refusal
from .truth import Truth

CHANNELS = 512
#: Pixels along the side of a feature cell.
CELL = 8


class StandIn:
    """The service. ``noise`` is the spread of every error; 0 gives the truth itself.

    ``leak`` makes albedo depend on the light that the image shows, as estimates of networks do: it is multiplied by the
    shading (image over albedo) relative to its mean, to the power of ``leak``. 1 gives the image itself, up to a gain.
    ``meaning`` is that of the depths; without it there are none.
    """

    name = "stand-in"

    def __init__(self, scene, noise=0.05, frame="camera-stablenormal", color="srgb", leak=0.0, meaning=None):
        self.truth, self.noise, self.frame, self.color, self.leak = Truth(scene), noise, frame, color, leak
        self.meaning = meaning
        self.offers = {"masks": {}}
        if meaning and self.truth.has("depth"):
            self.offers["depth"] = {}
        if self.truth.classes:
            self.offers.update(text={"channels": CHANNELS}, classes={})
        if self.truth.has("normal"):
            self.offers["normals"] = {}
        if self.truth.has("semantic"):
            self.offers["semantics"] = {"channels": CHANNELS}
            self.offers["regions"] = {"ids": "scene"}
        maps = [m for m in ("albedo", "roughness", "metallic") if self.truth.has(m)]
        if maps:
            self.offers["materials"] = {"maps": maps}
            if leak:
                self.offers["materials"]["image"] = "linear"

    def answer(self, question):
        """The answer to a question."""
        return getattr(self, question.name)(question)

    def _view(self, question, kind):
        """Name, columns, rows and pixels of the truth for the first image."""
        name = question.hint(0, "name")
        height, width, _ = question.images[0].shape
        pixels = self.truth.sized(kind, name, width, height) if name else None
        if pixels is None:
            raise Refusal(f"there is no ground truth of {kind} for this image (view {name})")
        return name, width, height, pixels

    def _random(self, question, *more):
        return random.Random(f"{question.seed} {question.name} {more}")

    def normals(self, question):
        """Normals in the chosen frame."""
        name, width, height, pixels = self._view(question, "normal")
        rng = self._random(question, name)
        rows = [r[:3] for r in self.truth.cameras[name]["world_to_camera"]]
        signs = {"camera-opencv": (1, 1, 1), "camera-opengl": (1, -1, -1), "camera-stablenormal": (-1, -1, -1)}
        out = []
        for n in pixels:
            if self.frame != "world":
                n = [s * sum(a * b for a, b in zip(r, n)) for s, r in zip(signs[self.frame], rows)]
            if self.noise:
                n = [v + rng.gauss(0, self.noise) for v in n]
            length = math.sqrt(sum(v * v for v in n))
            # Zero stays zero: nothing is there.
            out.extend(v / length if length > 0.3 else 0.0 for v in n)
        return {"frame": self.frame}, {"normals": pack("F32", (height, width, 3), out)}

    def depth(self, question):
        """Depth with the factor and shift that its meaning leaves open, which differ between views; less confident with noise."""
        name, width, height, pixels = self._view(question, "depth")
        rng = self._random(question, name)
        factor = 1.0 if self.meaning == "metric" else 0.5 + rng.random()
        shift = rng.random() if self.meaning == "inverse-scale-shift" else 0.0
        out = []
        for z, *_ in pixels:
            if not 0 < z < 1e6:
                out.append(float("nan"))
                continue
            if self.noise:
                z *= math.exp(rng.gauss(0, self.noise))
            out.append(factor / z - shift if self.meaning == "inverse-scale-shift" else factor * z)
        trust = [1 / (1 + self.noise)] * (width * height)
        shape = (height, width)
        return {"meaning": self.meaning}, {"depth": pack("F32", shape, out), "confidence": pack("F32", shape, trust)}

    def materials(self, question):
        """The maps that were asked for; albedo in the chosen color space."""
        arrays = {}
        for kind in question.text["maps"]:
            if kind not in self.offers["materials"]["maps"]:
                raise Refusal(f"there is no ground truth of {kind}")
            name, width, height, pixels = self._view(question, kind)
            rng = self._random(question, name, kind)
            gain = 1 + rng.gauss(0, self.noise)
            channels = 3 if kind == "albedo" else 1
            divisor = 255 if isinstance(pixels[0][0], int) else 1
            leaked = self._leaked(question, pixels, divisor) if kind == "albedo" and self.leak else None
            out = []
            for at, p in enumerate(pixels):
                for c, v in enumerate(p[:channels]):
                    v = v / divisor * gain
                    if leaked:
                        v *= leaked[3 * at + c]
                    if kind == "albedo" and self.color == "srgb":
                        v = 12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055
                    if self.noise:
                        v += rng.gauss(0, 0.2 * self.noise)
                    out.append(min(max(v, 0.0), 1.0))
            shape = (height, width, 3) if channels == 3 else (height, width)
            arrays[kind] = pack("F32", shape, out)
        return {"color": self.color}, arrays

    def _leaked(self, question, pixels, divisor):
        """What shading multiplies albedo by: three numbers a pixel, 1 where albedo is black. Images are linear."""
        light = question.images[0].numbers()
        albedo = [v / divisor for p in pixels for v in p[:3]]
        shading = [max(s, 0.0) / a if a > 0.02 else None for s, a in zip(light, albedo)]
        known = [s for s in shading if s is not None]
        mean = sum(known) / len(known) if known else 0.0
        if mean <= 0.0:
            return [1.0] * len(albedo)
        # A pixel in full shadow keeps a hundredth of the mean, so that no estimate is black for want of light.
        return [1.0 if s is None else max(s / mean, 0.01) ** self.leak for s in shading]

    def regions(self, question):
        """The class of each pixel as its region, with ragged borders."""
        name, width, height, pixels = self._view(question, "semantic")
        ids = self._ragged([p[0] + 1 for p in pixels], width, height, self._random(question, name))
        return {}, {"regions": pack("U16", (height, width), ids)}

    def _ragged(self, ids, width, height, rng):
        if not self.noise:
            return ids
        out = list(ids)
        for at, one in enumerate(ids):
            right = at % width + 1 < width and ids[at + 1] != one
            below = at + width < len(ids) and ids[at + width] != one
            if (right or below) and rng.random() < 0.5:
                out[at] = 0
        return out

    def _embedding(self, label):
        rng = random.Random(f"embedding of {label}")
        v = [rng.gauss(0, 1) for _ in range(CHANNELS)]
        length = math.sqrt(sum(x * x for x in v))
        return [x / length for x in v]

    def text(self, question):
        """One fixed unit vector for each name."""
        names = question.text["names"]
        numbers = [x for label in names for x in self._embedding(label)]
        return {"names": names}, {"embeddings": pack("F32", (len(names), CHANNELS), numbers)}

    def classes(self, question):
        """The scene's class names."""
        if not self.truth.classes:
            raise Refusal("the scene names no classes")
        return {"names": self.truth.classes}, {}

    def semantics(self, question):
        """The embedding of the class in the middle of each cell, with noise of the embedding's own size."""
        name = question.hint(0, "name")
        height, width, _ = question.images[0].shape
        rows, columns = -(-height // CELL), -(-width // CELL)
        pixels = self.truth.sized("semantic", name, columns, rows) if name else None
        if pixels is None:
            raise Refusal(f"there is no ground truth of semantic for this image (view {name})")
        rng, out, known = self._random(question, name), [], {}
        spread = self.noise / 4
        for label, *_ in pixels:
            if label not in known:
                text = self.truth.classes[label] if label < len(self.truth.classes) else str(label)
                known[label] = self._embedding(text)
            out.extend(v + rng.gauss(0, spread) if spread else v for v in known[label])
        return {}, {"features": pack("F16", (rows, columns, CHANNELS), out)}

    def masks(self, question):
        """The thing at the point, in three frames: by class where views or cameras are known, else by color."""
        images = question.images
        height, width, _ = images[0].shape
        rng = self._random(question)
        x, y = question.text.get("point") or (rng.random() * width, rng.random() * height)
        at = min(max(int(y), 0), height - 1) * width + min(max(int(x), 0), width - 1)
        frames = [self._ids(question, i, width, height) for i in range(3)]
        if any(f is None for f in frames):
            frames = [_colors(image) for image in images]
            like = frames[0][at]
            found = [[sum((a - b) ** 2 for a, b in zip(p, like)) < 0.01 for p in f] for f in frames]
        else:
            frames = [self._ragged(f, width, height, rng) if i else f for i, f in enumerate(frames)]
            found = [[one == frames[0][at] != 0 for one in f] for f in frames]
        return {}, {"masks": pack("BOOL", (3, height, width), [m for f in found for m in f])}

    def _ids(self, question, index, width, height):
        name, camera = question.hint(index, "name"), question.hint(index, "camera")
        pixels = self.truth.sized("semantic", name, width, height) if name else None
        if pixels is not None:
            return [p[0] + 1 for p in pixels]
        if camera and self.truth.has("semantic") and self.truth.has("depth"):
            return self.truth.classes_from(camera, width, height)
        return None


def _colors(image):
    numbers = image.numbers()
    most = 255 if image.dtype == "U8" else 1
    return [tuple(v / most for v in numbers[i:i + 3]) for i in range(0, len(numbers), 3)]

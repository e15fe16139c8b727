"""StableNormal (Ye et al. 2024): normals of an image.

The library's predictor takes a PIL image and gives one: the normal as color, n/2 + 1/2, with x to the left, y up, z
towards the viewer.
"""

import os

import numpy as np

from .. import tensors
from ..service import Refusal


def load(path, options):
    """From a checkout of the library's repository (``--code``) and a folder with its weights."""
    if not options.code or not os.path.isfile(os.path.join(options.code, "hubconf.py")):
        raise Refusal("stable-normal needs --code, a checkout of its repository with hubconf.py")
    if not os.path.isdir(path):
        raise Refusal(f"there is no folder of weights at {path}")
    # The library looks for its weights there, and must not look further.
    os.environ["HF_HUB_OFFLINE"] = "1"
    import torch

    predictor = torch.hub.load(options.code, "StableNormal_turbo", source="local", trust_repo=True, local_cache_dir=path)
    return StableNormal(predictor, options.max_side)


class StableNormal:
    """Answers ``normals``. ``predictor``: PIL image in, PIL image out."""

    name = "StableNormal turbo"

    def __init__(self, predictor, max_side=1024):
        self.predictor = predictor
        self.offers = {"normals": {"max_side": max_side}}

    def answer(self, question):
        """Normals at the size of the image."""
        image = tensors.picture(question.images[0])
        found = np.asarray(self.predictor(image).convert("RGB"), np.float32) / 255 * 2 - 1
        # Vectors are averaged and then made unit again by whoever reads them.
        found = tensors.resize(found, image.height, image.width)
        length = np.linalg.norm(found, axis=2, keepdims=True)
        found = np.where(length > 0.3, found / np.maximum(length, 1e-6), 0).astype(np.float32)
        return {"frame": "camera-stablenormal"}, {"normals": tensors.to_array(found)}

"""Depth Anything 3 (Lin et al. 2025): depth of an image and its confidence, by the authors' package.

Its models give depth up to a factor. The metric model gives depth for a focal length of 300 pixels; nested models give
meters.
"""

import os

import numpy as np

from .. import tensors
from ..service import Refusal

#: Focal length in pixels for which the metric model gives meters.
CANONICAL_FOCAL = 300.0


def load(path, options):
    """From a folder with weights, as the authors' package saves them."""
    if not os.path.isfile(os.path.join(path, "config.json")):
        raise Refusal(f"there is no saved model at {path}")
    os.environ["HF_HUB_OFFLINE"] = "1"
    from depth_anything_3.api import DepthAnything3 as Network

    network = Network.from_pretrained(path).eval().to(tensors.device(options))
    return DepthAnything3(network, options.max_side, options.free_scale)


class DepthAnything3:
    """Answers ``depth``.

    ``network.inference([image])`` takes a PIL image and gives ``depth`` [1, h, w], and ``conf`` of the same shape, at least
    1, or None. ``network.model_name`` tells the models apart. With ``free_scale`` metric depths count up to a factor of
    each view, for scenes whose unit is not the meter.
    """

    name = "Depth Anything 3"

    def __init__(self, network, max_side=1024, free_scale=False):
        self.network = network
        name = str(getattr(network, "model_name", "")).lower()
        metric = "metric" in name or "nested" in name
        self.meaning = "metric" if metric and not free_scale else "scale"
        self.canonical = self.meaning == "metric" and "nested" not in name
        self.offers = {"depth": {"max_side": max_side}}

    def answer(self, question):
        """Depth and confidence at the size of the image."""
        image = tensors.picture(question.images[0])
        found = self.network.inference([image])
        depth = np.asarray(found.depth, np.float32)[0]
        if self.canonical:
            camera = question.hint(0, "camera")
            if camera is None:
                raise Refusal("metric depth needs the focal length, which photographs with distortion lack; undistort them, "
                              "or use --free-scale")
            # The focal length of the image as the network sees it.
            focal = 0.5 * (camera["fx"] * depth.shape[1] / camera["width"] + camera["fy"] * depth.shape[0] / camera["height"])
            depth = depth * (focal / CANONICAL_FOCAL)
        depth = tensors.resize(depth[..., None], image.height, image.width)[..., 0]
        arrays = {"depth": tensors.to_array(tensors.known(depth, self.meaning))}
        if getattr(found, "conf", None) is not None:
            trust = tensors.confidence(np.asarray(found.conf, np.float32)[0])
            trust = np.clip(tensors.resize(trust[..., None], image.height, image.width)[..., 0], 0, 1)
            arrays["confidence"] = tensors.to_array(trust.astype(np.float32))
        return {"meaning": self.meaning}, arrays

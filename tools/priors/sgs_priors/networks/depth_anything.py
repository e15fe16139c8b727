"""Depth Anything (Yang et al. 2024), version 2: depth of an image, by the transformers library.

Weights of relative depth give inverse depth up to a factor and a shift, those of metric depth meters.
"""

import os

import numpy as np

from .. import tensors
from ..service import Refusal


def load(path, options):
    """From a folder with weights and processor, as the library saves them."""
    if not os.path.isfile(os.path.join(path, "config.json")):
        raise Refusal(f"there is no saved model at {path}")
    from transformers import AutoImageProcessor, AutoModelForDepthEstimation

    model = AutoModelForDepthEstimation.from_pretrained(path, local_files_only=True)
    if model.config.model_type != "depth_anything":
        raise Refusal(f"the model at {path} is {model.config.model_type}, not depth_anything")
    processor = AutoImageProcessor.from_pretrained(path, local_files_only=True)
    return DepthAnything(model.eval().to(tensors.device(options)), processor, options.max_side, options.free_scale)


class DepthAnything:
    """Answers ``depth``.

    ``model`` takes what ``processor`` makes of a PIL image and gives ``predicted_depth`` [1, h, w]. With ``free_scale``
    metric depths count up to a factor of each view, for scenes whose unit is not the meter.
    """

    name = "Depth Anything"

    def __init__(self, model, processor, max_side=1024, free_scale=False):
        self.model, self.processor = model, processor
        metric = getattr(model.config, "depth_estimation_type", "relative") == "metric"
        self.meaning = ("scale" if free_scale else "metric") if metric else "inverse-scale-shift"
        self.offers = {"depth": {"max_side": max_side}}

    def answer(self, question):
        """Depth at the size of the image."""
        import torch

        image = tensors.picture(question.images[0])
        inputs = self.processor(images=image, return_tensors="pt").to(self.model.device)
        with torch.inference_mode():
            found = self.model(**inputs).predicted_depth[0].float().cpu().numpy()
        found = tensors.resize(found[..., None], image.height, image.width)[..., 0]
        return {"meaning": self.meaning}, {"depth": tensors.to_array(tensors.known(found, self.meaning))}

"""RGB→X (Zeng et al. 2024): albedo, roughness and metallic of an image, by diffusion.

The network was trained on linear light; it gets that, clipped to [0, 1]. What it gives for albedo is encoded by its
pipeline with a gamma of 2.2, which is taken as sRGB; roughness and metallic are values.
"""

import os
import sys

import numpy as np

from .. import tensors
from ..service import Refusal

#: The words that the network was trained with.
PROMPTS = {"albedo": "Albedo (diffuse basecolor)", "roughness": "Roughness", "metallic": "Metallicness"}
#: Sides that the network can take are multiples of this.
STEP = 8


def load(path, options):
    """From a checkout of the authors' repository (``--code``), for the pipeline's class, and a folder of weights."""
    folder = os.path.join(options.code or "", "rgb2x")
    if not options.code or not os.path.isfile(os.path.join(folder, "pipeline_rgb2x.py")):
        raise Refusal("rgbx needs --code, a checkout of its repository with rgb2x/pipeline_rgb2x.py")
    if not os.path.isdir(path):
        raise Refusal(f"there is no folder of weights at {path}")
    sys.path.insert(0, folder)
    import torch
    from diffusers import DDIMScheduler
    from pipeline_rgb2x import StableDiffusionAOVMatEstPipeline

    device = tensors.device(options)
    kind = torch.float16 if device.type == "cuda" else torch.float32
    pipeline = StableDiffusionAOVMatEstPipeline.from_pretrained(path, torch_dtype=kind, local_files_only=True).to(device)
    pipeline.scheduler = DDIMScheduler.from_config(
        pipeline.scheduler.config, rescale_betas_zero_snr=True, timestep_spacing="trailing")
    return Rgbx(pipeline, device, options.steps, options.max_side)


class Rgbx:
    """Answers ``materials``. ``pipeline`` is called as the authors' is, and gives ``.images[0][0]``, a PIL image."""

    name = "RGB to X"

    def __init__(self, pipeline, device="cpu", steps=50, max_side=1024):
        self.pipeline, self.device, self.steps, self.max_side = pipeline, device, steps, max_side
        self.offers = {"materials": {"image": "linear", "max_side": max_side, "maps": list(PROMPTS)}}

    def answer(self, question):
        """The maps that were asked for, at the size of the image."""
        image = np.clip(tensors.linear(question.images[0]), 0, 1)
        height, width = image.shape[:2]
        arrays = {}
        for name in question.text["maps"]:
            if name not in PROMPTS:
                raise Refusal(f"there is no map \"{name}\"; there are {', '.join(PROMPTS)}")
            found = tensors.resize(self._run(name, image, question.seed), height, width)
            found = np.clip(found, 0, 1).astype(np.float32)
            arrays[name] = tensors.to_array(found if name == "albedo" else found.mean(axis=2))
        return {"color": "srgb"}, arrays

    def _run(self, name, image, seed):
        import torch

        height, width = tensors.multiple(*image.shape[:2], STEP, self.max_side)
        photo = torch.from_numpy(np.ascontiguousarray(tensors.resize(image, height, width))).permute(2, 0, 1)
        with torch.inference_mode():
            made = self.pipeline(
                prompt=PROMPTS[name], photo=photo.to(self.device), num_inference_steps=self.steps, height=height,
                width=width, generator=torch.Generator(self.device).manual_seed(seed), required_aovs=[name])
        return np.asarray(made.images[0][0].convert("RGB"), np.float32) / 255

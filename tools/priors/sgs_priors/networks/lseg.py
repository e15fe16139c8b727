"""LSeg (Li et al. 2022): features of an image that CLIP's embeddings of texts can be compared with.

The features are what the network's first head puts out, half as large as the image that it sees, before it compares
them with texts.
"""

import os
import sys

import numpy as np

from .. import tensors
from ..service import Refusal

#: The side of the images that the network was trained with, and what sides must be multiples of.
SIDE, STEP = 480, 32


def load(path, options):
    """From a checkout of the authors' repository (``--code``) and a checkpoint. CLIP's own weights must be in its cache
    already: its library would download them otherwise."""
    if not options.code or not os.path.isfile(os.path.join(options.code, "modules", "models", "lseg_net.py")):
        raise Refusal("lseg needs --code, a checkout of its repository with modules/models/lseg_net.py")
    if not os.path.isfile(path):
        raise Refusal(f"there is no checkpoint at {path}")
    clip = os.path.expanduser("~/.cache/clip/ViT-B-32.pt")
    if not os.path.isfile(clip):
        raise Refusal(f"lseg needs the weights of CLIP ViT-B/32 at {clip}, where CLIP's library looks for them")
    sys.path.insert(0, options.code)
    import torch
    from modules.models.lseg_net import LSegNet

    saved = torch.load(path, map_location="cpu", weights_only=False)
    weights = {name.removeprefix("net."): value for name, value in saved.get("state_dict", saved).items()}
    network = LSegNet(labels=["other"], backbone="clip_vitl16_384", features=256, crop_size=SIDE, arch_option=0,
                      block_depth=0, activation="lrelu")
    left = network.load_state_dict(weights, strict=False).missing_keys
    if any(not name.startswith("clip_pretrained.") for name in left):
        raise Refusal(f"the checkpoint lacks {len(left)} weights of the network, {left[0]} among them")
    device = tensors.device(options)
    return LSeg(network.eval().to(device), network.scratch.head1, device)


class LSeg:
    """Answers ``semantics``. ``network`` takes [1, 3, H, W] in [−1, 1]; the features are what ``head``, a part of it,
    puts out meanwhile: [1, C, h, w]."""

    name = "LSeg"

    def __init__(self, network, head, device="cpu", channels=512):
        self.network, self.head, self.device, self.channels = network, head, device, channels
        self.offers = {"semantics": {"channels": channels, "max_side": SIDE}}

    def answer(self, question):
        """Features as halves, unnormalized."""
        import torch

        image = tensors.srgb(question.images[0])
        height, width = tensors.multiple(*image.shape[:2], STEP, SIDE)
        sent = torch.from_numpy(np.ascontiguousarray(tensors.resize(image, height, width))).permute(2, 0, 1)[None]
        outputs = []
        hook = self.head.register_forward_hook(lambda module, inputs, output: outputs.append(output))
        try:
            with torch.inference_mode():
                self.network(((sent - 0.5) / 0.5).to(self.device))
        finally:
            hook.remove()
        if len(outputs) != 1 or outputs[0].shape[:2] != (1, self.channels):
            raise Refusal(f"the network's head gave {[list(h.shape) for h in outputs]}, not [1, {self.channels}, h, w]")
        features = outputs[0][0].permute(1, 2, 0).float().clamp(-65504, 65504).to(torch.float16)
        return {}, {"features": tensors.to_array(features.cpu().numpy())}

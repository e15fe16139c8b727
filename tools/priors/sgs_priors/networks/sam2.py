"""SAM 2 (Ravi et al. 2024): a thing followed through three frames, and all regions of an image, by the transformers
library.
"""

import os

import numpy as np

from .. import tensors
from ..service import Refusal

#: Points along each side of the grid from which regions are sought, and how many go at once.
GRID, BATCH = 24, 64
#: Regions are kept that the network trusts so much, that change so little with the threshold, and that are so large.
TRUST, STABLE, SMALLEST = 0.8, 0.9, 0.0005
#: Two regions that overlap so much (intersection over union) are one.
SAME = 0.7


def load(path, options):
    """From a folder with weights and processor, as the library saves them for video."""
    if not os.path.isfile(os.path.join(path, "config.json")):
        raise Refusal(f"there is no saved model at {path}")
    from transformers import Sam2Model, Sam2Processor, Sam2VideoModel, Sam2VideoProcessor

    device = tensors.device(options)
    video = Sam2VideoModel.from_pretrained(path, local_files_only=True).eval().to(device)
    image = Sam2Model.from_pretrained(path, local_files_only=True).eval().to(device)
    return Sam2(video, Sam2VideoProcessor.from_pretrained(path, local_files_only=True), image,
                Sam2Processor.from_pretrained(path, local_files_only=True))


class Sam2:
    """Answers ``masks`` and ``regions``."""

    name = "SAM 2"

    def __init__(self, video, video_processor, image, image_processor):
        self.video, self.video_processor, self.image, self.image_processor = video, video_processor, image, image_processor
        self.offers = {"masks": {}, "regions": {"ids": "image"}}

    def answer(self, question):
        """The answer to either question."""
        return self.masks(question) if question.name == "masks" else self.regions(question)

    def masks(self, question):
        """One positive point in the first frame, followed forwards. Without a point it is drawn by the seed."""
        import torch

        frames = [tensors.picture(image) for image in question.images]
        width, height = frames[0].size
        point = question.text.get("point")
        if point is None:
            point = (np.random.default_rng(question.seed).random(2) * (width, height)).tolist()
        session = self.video_processor.init_video_session(
            video=[np.asarray(f) for f in frames], inference_device=self.video.device, dtype=self.video.dtype)
        self.video_processor.add_inputs_to_inference_session(
            inference_session=session, frame_idx=0, obj_ids=1, input_points=[[[list(point)]]], input_labels=[[[1]]])
        found = np.zeros((3, height, width), np.bool_)
        with torch.inference_mode():
            self.video(inference_session=session, frame_idx=0)
            for output in self.video.propagate_in_video_iterator(session, start_frame_idx=0):
                masks = self.video_processor.post_process_masks(
                    [output.pred_masks], original_sizes=[[height, width]], binarize=False)[0]
                found[output.frame_idx] = (masks.reshape(-1, height, width)[0] > 0).cpu().numpy()
        return {}, {"masks": tensors.to_array(found)}

    def regions(self, question):
        """Masks from a grid of points, the trusted ones painted from large to small."""
        import torch

        image = tensors.picture(question.images[0])
        inputs = self.image_processor(images=image, return_tensors="pt").to(self.image.device)
        with torch.inference_mode():
            embeddings = self.image.get_image_embeddings(inputs["pixel_values"])
            chosen = []
            for some in np.array_split(grid(image.width, image.height), -(-GRID * GRID // BATCH)):
                chosen.extend(self._around(image, embeddings, some))
        ids = paint(chosen, image.height, image.width)
        return {}, {"regions": tensors.to_array(ids)}

    def _around(self, image, embeddings, points):
        """Masks around points, with the network's trust in them."""
        prompts = self.image_processor(images=image, input_points=[[[p] for p in points.tolist()]],
                                     input_labels=[[[1]] * len(points)], return_tensors="pt").to(self.image.device)
        out = self.image(image_embeddings=embeddings, input_points=prompts["input_points"],
                         input_labels=prompts["input_labels"], multimask_output=True)
        logits = self.image_processor.post_process_masks(
            out.pred_masks.cpu(), [[image.height, image.width]], binarize=False)[0]
        logits = logits.reshape(-1, image.height, image.width).float().numpy()
        return choose(logits, out.iou_scores.reshape(-1).float().cpu().numpy())


def grid(width, height):
    """Points in the middle of equal cells, as [n, 2]."""
    steps = (np.arange(GRID) + 0.5) / GRID
    x, y = np.meshgrid(steps * width, steps * height)
    return np.stack([x.ravel(), y.ravel()], 1)


def choose(logits, trust):
    """The masks worth keeping, as pairs of trust and mask."""
    chosen = []
    for one, score in zip(logits, trust):
        mask = one > 0
        loose = (one > -1).sum()
        if score >= TRUST and mask.mean() >= SMALLEST and loose and (one > 1).sum() >= STABLE * loose:
            chosen.append((float(score), mask))
    return chosen


def paint(chosen, height, width):
    """Region numbers: of masks that are nearly the same the most trusted one is taken, small ones lie over large ones."""
    taken = []
    for _, mask in sorted(chosen, key=lambda k: -k[0]):
        area = mask.sum()
        for other, size in taken:
            both = np.logical_and(mask, other).sum()
            if both > SAME * (area + size - both):
                break
        else:
            taken.append((mask, area))
    ids = np.zeros((height, width), np.uint16)
    for number, (mask, _) in enumerate(sorted(taken, key=lambda t: -t[1]), 1):
        ids[mask] = number
    return ids

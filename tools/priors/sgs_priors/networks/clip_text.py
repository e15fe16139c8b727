"""CLIP (Radford et al. 2021): embeddings of class names, by the transformers library."""

import os

import numpy as np

from .. import tensors
from ..service import Refusal


def load(path, options):
    """From a folder with weights and tokenizer, as the library saves them."""
    if not os.path.isfile(os.path.join(path, "config.json")):
        raise Refusal(f"there is no saved model at {path}")
    from transformers import AutoTokenizer, CLIPTextModelWithProjection

    model = CLIPTextModelWithProjection.from_pretrained(path, local_files_only=True)
    tokenizer = AutoTokenizer.from_pretrained(path, local_files_only=True)
    return ClipText(model.eval().to(tensors.device(options)), tokenizer)


class ClipText:
    """Answers ``text``."""

    name = "CLIP text"

    def __init__(self, model, tokenizer):
        self.model, self.tokenizer = model, tokenizer
        self.offers = {"text": {"channels": model.config.projection_dim}}

    def answer(self, question):
        """Unit vectors."""
        import torch

        names = question.text["names"]
        longest = self.model.config.max_position_embeddings
        tokens = self.tokenizer(names, padding=True, truncation=True, max_length=longest, return_tensors="pt")
        with torch.inference_mode():
            found = self.model(**tokens.to(self.model.device)).text_embeds.float().cpu().numpy()
        found = found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-8)
        return {"names": names}, {"embeddings": tensors.to_array(found.astype(np.float32))}

"""Qwen3-VL: names of the classes of things in a scene's photographs, by the transformers library."""

import json
import os
import re

from ..service import Refusal

#: What it is asked.
PROMPT = ("These photographs show one room. Name the classes of objects and surfaces in them that cover a visible area, "
          "such as wall, floor, sofa. Answer with a JSON list of short lower-case English nouns in the singular, without "
          "repetition, at most {most}.")
#: The most names that are taken.
MOST = 32


def load(path, options):
    """From a folder with weights and processor, as the library saves them."""
    from .. import tensors

    if not os.path.isfile(os.path.join(path, "config.json")):
        raise Refusal(f"there is no saved model at {path}")
    from transformers import AutoModelForImageTextToText, AutoProcessor

    model = AutoModelForImageTextToText.from_pretrained(path, local_files_only=True, dtype="auto")
    processor = AutoProcessor.from_pretrained(path, local_files_only=True)
    return QwenVl(model.eval().to(tensors.device(options)), processor, options.max_side)


def names_in(text):
    """The class names in an answer: a JSON list if there is one, else what stands between commas and line breaks."""
    listed = re.search(r"\[[^\[\]]*\]", text)
    found = []
    if listed:
        try:
            found = [n for n in json.loads(listed.group()) if isinstance(n, str)]
        except ValueError:
            pass
    if not found:
        found = re.split(r"[,;\n]", text.split(":")[-1])
    clean = (re.sub(r"^[\s\d.)*\-\"'\[]+|[\s.\"'\]]+$", "", n).lower() for n in found)
    unique = dict.fromkeys(n for n in clean if n and len(n) <= 40)
    return list(unique)[:MOST]


class QwenVl:
    """Answers ``classes``."""

    name = "Qwen-VL"

    def __init__(self, model, processor, max_side=1024, max_tokens=512):
        self.model, self.processor, self.max_tokens = model, processor, max_tokens
        self.offers = {"classes": {"max_side": max_side}}

    def answer(self, question):
        """Names, the most likely words taken each time, so that the answer is always the same."""
        names = names_in(self.say(question))
        if not names:
            raise Refusal("the network named nothing")
        return {"names": names}, {}

    def say(self, question):
        """The network's own words."""
        import torch

        from .. import tensors

        content = [{"type": "image", "image": tensors.picture(image)} for image in question.images]
        content.append({"type": "text", "text": PROMPT.format(most=MOST)})
        inputs = self.processor.apply_chat_template(
            [{"role": "user", "content": content}], tokenize=True, add_generation_prompt=True, return_dict=True,
            return_tensors="pt").to(self.model.device)
        with torch.inference_mode():
            made = self.model.generate(**inputs, max_new_tokens=self.max_tokens, do_sample=False)
        return self.processor.batch_decode(made[:, inputs["input_ids"].shape[1]:], skip_special_tokens=True)[0]

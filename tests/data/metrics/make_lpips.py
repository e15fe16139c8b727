#!/usr/bin/env python3
"""What the package lpips measures between the pictures of make.py with made-up weights: written once to lpips.json, read by
tests/tests/command/lpips.rs, which makes the same weights.

    pip install torch torchvision lpips==0.1.4
    python3 make_lpips.py

Weights come from a hash of their place, so that two languages agree on them to the last bit. They take the way of real ones:
as state dicts, through tools/priors/sgs_priors/lpips_weights.py, and out of its file into the network.
"""

import json
import struct
import sys
import tempfile
from pathlib import Path

import lpips
import numpy as np
import torch
import torchvision
from PIL import Image

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[2] / "tools/priors"))
from sgs_priors import lpips_weights  # noqa: E402

PAIRS = ["noise", "blur", "color", "shift", "missing", "dark"]


def uniform(tensor, count):
    """Numbers between 0 and 1 for a tensor by its number."""
    x = np.arange(count, dtype=np.uint64) * 0x85EBCA6B + (tensor + 1) * 0x9E3779B1
    x = x.astype(np.uint32)
    for shift, factor in [(16, 0x7FEB352D), (15, 0x846CA68B)]:
        x ^= x >> np.uint32(shift)
        x *= np.uint32(factor)
    x ^= x >> np.uint32(16)
    return (x >> np.uint32(8)).astype(np.float64) / 2**24


def made_up(net):
    """State dicts: weights that keep the size of what comes in, small biases, heads between 0 and 1."""
    found = {"features": {}, "heads": {}}
    for i, (name, shape, where, key) in enumerate(lpips_weights.shapes(net)):
        u = uniform(i, int(np.prod(shape)))
        if where == "heads":
            found[where][key] = torch.from_numpy(u.astype(np.float32).reshape(1, -1, 1, 1))
            continue
        reach = np.sqrt(6 / np.prod(shape[1:])) if name.endswith("weight") else 0.1
        found[where][key] = torch.from_numpy(((2 * u - 1) * reach).astype(np.float32).reshape(shape))
    return found


def read(path):
    data = path.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8:8 + length])
    header.pop("__metadata__")
    base = 8 + length
    of = lambda t: np.frombuffer(data[base + t["data_offsets"][0]:base + t["data_offsets"][1]], "<f4").reshape(t["shape"])
    return {name: torch.from_numpy(of(t).copy()) for name, t in header.items()}


def network(net):
    model = lpips.LPIPS(net=net, version="0.1", pretrained=False, pnet_rand=True, verbose=False).eval()
    with tempfile.TemporaryDirectory() as folder:
        parts = made_up(net)
        for part, state in parts.items():
            torch.save(state, f"{folder}/{part}.pth")
        out = Path(folder) / "lpips.safetensors"
        lpips_weights.main(
            ["--net", net, "--features", f"{folder}/features.pth", "--heads", f"{folder}/heads.pth", "-o", str(out)])
        weights = read(out)
    layers = {int(name): layer for part in model.net.children() if isinstance(part, torch.nn.Sequential)
              for name, layer in part.named_children()}
    with torch.no_grad():
        for name, values in weights.items():
            kind, at, *what = name.split(".")
            if kind == "heads":
                model.lins[int(at)].model[1].weight.copy_(values.reshape(1, -1, 1, 1))
            else:
                getattr(layers[int(at)], what[0]).copy_(values)
    return model


def picture(name):
    data = np.asarray(Image.open(HERE / f"{name}.png").convert("RGB"), dtype=np.float32) / 255
    return torch.from_numpy(data).permute(2, 0, 1)[None]


def main():
    truth = picture("truth")
    nets = {}
    for net in ["vgg", "alex"]:
        model, pairs = network(net), {}
        for name in PAIRS:
            with torch.no_grad():
                plain, layers = model(picture(name), truth, retPerLayer=True, normalize=False)
                signed = model(picture(name), truth, normalize=True)
            pairs[name] = {"lpips": plain.item(), "layers": [v.item() for v in layers], "normalized": signed.item()}
        nets[net] = pairs
    by = {"lpips": "0.1.4", "torch": torch.__version__, "torchvision": torchvision.__version__}
    (HERE / "lpips.json").write_text(json.dumps({"by": by, "nets": nets}, indent=1) + "\n")


if __name__ == "__main__":
    main()

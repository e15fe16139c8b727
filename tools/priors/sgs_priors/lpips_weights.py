"""Weights of LPIPS as `sgs eval --lpips` takes them: one safetensors file from two published ones.

    python3 -m sgs_priors.lpips_weights --net vgg --features vgg16.pth --heads vgg.pth -o lpips-vgg.safetensors

`--features` is the state dict of torchvision's `vgg16` (or `alexnet`) with weights of ImageNet; `--heads` is that of LPIPS 0.1,
which lies in the package `lpips` as `weights/v0.1/vgg.pth` (`alex.pth`). Needs torch to read them. Numbers are float32, as
published.
"""

import argparse
import json
import os
import pickle
import struct
import sys

NETS = {
    "vgg": (
        {0: (64, 3, 3), 2: (64, 64, 3), 5: (128, 64, 3), 7: (128, 128, 3), 10: (256, 128, 3), 12: (256, 256, 3),
         14: (256, 256, 3), 17: (512, 256, 3), 19: (512, 512, 3), 21: (512, 512, 3), 24: (512, 512, 3),
         26: (512, 512, 3), 28: (512, 512, 3)},
        (64, 128, 256, 512, 512),
    ),
    "alex": (
        {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)},
        (64, 192, 384, 256, 256),
    ),
}
"""Convolutions by their number in `features` (outputs, inputs, width), and channels of each head."""


def shapes(net):
    """Names and shapes of all tensors of the file, and where each comes from: (name, shape, "features" or "heads", key)."""
    convolutions, heads = NETS[net]
    for at, (outputs, inputs, width) in convolutions.items():
        yield f"features.{at}.weight", (outputs, inputs, width, width), "features", f"features.{at}.weight"
        yield f"features.{at}.bias", (outputs,), "features", f"features.{at}.bias"
    for i, channels in enumerate(heads):
        yield f"heads.{i}", (channels,), "heads", f"lin{i}.model.1.weight"


def convert(net, features, heads, path):
    """Writes the file beside `path` and renames it. `features`, `heads`: tensors or arrays by name."""
    tensors = {"features": features, "heads": heads}
    header, parts, at = {"__metadata__": {"format": "sgs-lpips-1", "net": net, "version": "0.1"}}, [], 0
    for name, shape, where, key in shapes(net):
        if key not in tensors[where]:
            raise ValueError(f'--{where} has no "{key}"; is it of {net}?')
        values = tensors[where][key]
        values = values.detach().cpu().numpy() if hasattr(values, "detach") else values
        if values.size != _product(shape) or where == "features" and tuple(values.shape) != shape:
            raise ValueError(f'"{key}" of --{where} is {tuple(values.shape)}, but of {net} it is {shape}')
        data = values.astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": list(shape), "data_offsets": [at, at + len(data)]}
        parts.append(data)
        at += len(data)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with open(f"{path}.part", "wb") as f:
        f.write(struct.pack("<Q", len(text)) + text)
        f.writelines(parts)
    os.replace(f"{path}.part", path)


def _product(shape):
    product = 1
    for n in shape:
        product *= n
    return product


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="sgs_priors.lpips_weights", description=__doc__.splitlines()[0])
    parser.add_argument("--net", choices=sorted(NETS), default="vgg")
    parser.add_argument("--features", required=True, metavar="FILE.pth")
    parser.add_argument("--heads", required=True, metavar="FILE.pth")
    parser.add_argument("-o", "--output", required=True, metavar="FILE.safetensors")
    a = parser.parse_args(arguments)
    try:
        import torch
    except ImportError:
        sys.exit("lpips_weights: torch is not installed; it reads the published files")

    def load(path):
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except OSError as e:
            raise ValueError(f"{path}: {e.strerror or e}") from e
        except (RuntimeError, EOFError, KeyError, pickle.UnpicklingError) as e:
            raise ValueError(f"{path} holds no state dict of torch") from e
        if not hasattr(state, "keys"):
            raise ValueError(f"{path} holds no state dict of torch")
        return state

    try:
        convert(a.net, load(a.features), load(a.heads), a.output)
    except (OSError, ValueError) as e:
        sys.exit(f"lpips_weights: {e}")


if __name__ == "__main__":
    main()

"""VGGT (Wang et al. 2025): cameras and points of photographs, written as a scene: ``images/`` and COLMAP's ``sparse/0``.

    python3 -m sgs_priors.networks.vggt FOLDER --weights model.pt -o SCENE [--depth]

With ``--depth`` also ``priors/depth`` with maps of confidence.

This is no provider: it makes the scene that everything else begins with.
"""

import argparse
import json
import os
import shutil
import sys

import numpy as np

from .. import colmap, tensors

#: The longest side that the network sees, and what sides must be multiples of.
SIDE, STEP = 518, 14
EXTENSIONS = (".png", ".jpg", ".jpeg")


def load(path, options):
    """The network and what decodes its camera encoding, from the authors' package and a file of weights."""
    import torch
    from vggt.models.vggt import VGGT
    from vggt.utils.pose_enc import pose_encoding_to_extri_intri

    network = VGGT()
    network.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    return network.eval().to(tensors.device(options)), pose_encoding_to_extri_intri


def reconstruct(images, network, decode, device="cpu", most=100_000, doubtful=0.3, seed=0):
    """Cameras, points, depth and trust [N, h, w] of images, a list of uint8 [H, W, 3].

    ``network`` takes [1, N, 3, h, w] in [0, 1] and gives ``pose_enc``, ``depth`` [1, N, h, w, 1] and ``depth_conf``
    [1, N, h, w]; ``decode(pose_enc, (h, w))`` gives world-to-camera matrices [1, N, 3, 4] and intrinsics [1, N, 3, 3].
    The fraction ``doubtful`` of the pixels that the network trusts least makes no points. All images get the size of the
    first as the network sees it; the cameras are those of the images as they are.
    """
    import torch

    h, w = tensors.multiple(*images[0].shape[:2], STEP, SIDE)
    small = [np.clip(tensors.resize(i.astype(np.float32) / 255, h, w), 0, 1) for i in images]
    batch = torch.from_numpy(np.stack(small)).permute(0, 3, 1, 2)[None].to(device)
    with torch.inference_mode():
        found = network(batch)
        poses, inner = decode(found["pose_enc"], (h, w))
    poses, inner = poses[0].float().cpu().numpy().astype(np.float64), inner[0].float().cpu().numpy().astype(np.float64)
    depth = found["depth"][0].float().cpu().numpy().reshape(-1, h, w)
    trust = found["depth_conf"][0].float().cpu().numpy().reshape(-1, h, w)
    views = []
    for image, pose, k in zip(images, poses, inner):
        sx, sy = image.shape[1] / w, image.shape[0] / h
        views.append({"width": image.shape[1], "height": image.shape[0], "fx": k[0, 0] * sx, "fy": k[1, 1] * sy,
                      "cx": k[0, 2] * sx, "cy": k[1, 2] * sy, "world_to_camera": pose.tolist()})
    return views, _points(small, poses, inner, depth, trust, most, doubtful, seed), depth, trust


def _points(small, poses, inner, depth, trust, most, doubtful, seed):
    """Pixels moved to where they are in the world, with their colors; at most so many, drawn evenly."""
    n, h, w = depth.shape
    good = np.isfinite(depth) & (depth > 0) & (trust >= np.quantile(trust, doubtful))
    chosen = np.flatnonzero(good)
    if len(chosen) > most:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, most, replace=False))
    at, y, x = np.unravel_index(chosen, (n, h, w))
    z = depth[at, y, x].astype(np.float64)
    k = inner[at]
    local = np.stack([(x + 0.5 - k[:, 0, 2]) / k[:, 0, 0] * z, (y + 0.5 - k[:, 1, 2]) / k[:, 1, 1] * z, z], 1)
    rotation, shift = poses[at][:, :, :3], poses[at][:, :, 3]
    world = np.einsum("nji,nj->ni", rotation, local - shift)
    colors = (np.stack(small)[at, y, x] * 255 + 0.5).astype(np.uint8)
    return [(*p, *c) for p, c in zip(world.tolist(), colors.tolist())]


def write_depth(scene, names, depth, trust):
    """Maps of depth and confidence for photographs with these names; what they mean goes into ``priors.json``.

    The network's depths are consistent with its cameras only roughly, so each view has a factor of its own.
    """
    folder = os.path.join(scene, "priors", "depth")
    os.makedirs(os.path.join(folder, "confidence"), exist_ok=True)
    path = os.path.join(scene, "priors", "priors.json")
    settings = {}
    if os.path.isfile(path):
        with open(path, encoding="utf-8") as f:
            settings = json.load(f)
    settings["depth"] = {"meaning": "scale"}
    with open(path, "w", encoding="utf-8") as f:
        json.dump(settings, f, indent=2)
    for name, z, sure in zip(names, depth, trust):
        stem = os.path.splitext(name)[0]
        np.save(os.path.join(folder, "confidence", stem + ".npy"), tensors.confidence(sure))
        np.save(os.path.join(folder, stem + ".npy"), tensors.known(z, "scale"))


def main(arguments=None, loaded=None):
    """Reads a folder of photographs and writes a scene; ``loaded`` stands in for what ``load`` gives."""
    parser = argparse.ArgumentParser(prog="sgs_priors.networks.vggt", description=__doc__.splitlines()[0])
    parser.add_argument("folder", help="photographs, PNG or JPEG")
    parser.add_argument("--weights", required=True, help="file of the network's weights")
    parser.add_argument("-o", "--output", required=True, help="scene directory to make")
    parser.add_argument("--depth", action="store_true", help="write priors/depth with confidence")
    parser.add_argument("--points", type=int, default=100_000, help="most points")
    parser.add_argument("--device", default=None, help="torch device")
    options = parser.parse_args(arguments)
    names = sorted(n for n in os.listdir(options.folder) if n.lower().endswith(EXTENSIONS))
    if not names:
        print(f"vggt: there are no photographs in {options.folder}", file=sys.stderr)
        return 1
    if loaded is None and not os.path.isfile(options.weights):
        print(f"vggt: there are no weights at {options.weights}", file=sys.stderr)
        return 1
    from PIL import Image

    images = [np.asarray(Image.open(os.path.join(options.folder, n)).convert("RGB")) for n in names]
    network, decode = loaded or load(options.weights, options)
    views, points, depth, trust = reconstruct(images, network, decode, tensors.device(options), options.points)
    folder = os.path.join(options.output, "images")
    os.makedirs(folder, exist_ok=True)
    for name, view in zip(names, views):
        view["name"] = name
        target = os.path.join(folder, name)
        if os.path.abspath(target) != os.path.abspath(os.path.join(options.folder, name)):
            shutil.copyfile(os.path.join(options.folder, name), target)
    colmap.write(options.output, views, points)
    if options.depth:
        write_depth(options.output, names, depth, trust)
    print(f"wrote {len(views)} cameras and {len(points)} points into {options.output}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())

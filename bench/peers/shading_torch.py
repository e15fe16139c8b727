"""The shading of `engine-bench passes --filter lights` in PyTorch: the plain way to write it.

    engine-bench passes --filter lights --dump CASE
    python3 shading_torch.py CASE [--repeats 3] [--threads N] [--device cuda]

Reads the case that engine-bench wrote, shades forward and back with tensors of pixels x lights x lobes and automatic
differentiation, compares radiance and every gradient with those of the kernels, and prints its times beside theirs. On a
processor it uses every core that the process may use, as the kernels do, unless `--threads` says otherwise. Exit
status 1 if they disagree. Needs torch and numpy.
"""

import argparse
import json
import math
import os
import pathlib
import sys
import time

import numpy as np
import torch

LUMINANCE = (0.212671, 0.715160, 0.072169)


def load(folder, name, shape):
    return torch.from_numpy(np.fromfile(folder / f"{name}.f32", dtype="<f4").reshape(shape).copy()).to(torch.get_default_device())


def lobe_parameters(raw):
    """Axis, sharpness and amplitude of every lobe; `raw` is lights x lobes x 6, two rows of polar angles."""
    columns = raw.shape[1] // 2
    k = torch.arange(raw.shape[1])
    polar = (k // columns + 0.5) * (math.pi / 4) + 3 * math.pi / 8 * torch.tanh(raw[..., 0])
    azimuth = ((k % columns + 0.5) / columns - 0.5) * (2 * math.pi) + math.pi / 2 * torch.tanh(raw[..., 1])
    axis = torch.stack([torch.sin(polar) * torch.cos(azimuth), torch.sin(polar) * torch.sin(azimuth), torch.cos(polar)], -1)
    return axis, torch.exp(raw[..., 2].clamp(max=9.5)), torch.exp(raw[..., 3:].clamp(max=15.0))


def shade(points, normals, albedo, roughness, camera, positions, raw, normalizer):
    """Radiance, pixels x 3."""
    to_light = positions[None] - points[:, None]                                   # P x L x 3
    square = (to_light * to_light).sum(-1)
    light = to_light / square.sqrt()[..., None].clamp(min=1e-15)
    view = torch.nn.functional.normalize(camera - points, dim=-1)[:, None]
    normal = normals[:, None]
    half = torch.nn.functional.normalize(light + view, dim=-1)
    nl = (normal * light).sum(-1).clamp(min=0.0)
    nv = (normal * view).sum(-1).clamp(min=1e-4)
    nh = (normal * half).sum(-1)
    lh = (light * half).sum(-1).clamp(max=1.0)

    axis, sharpness, amplitude = lobe_parameters(raw)
    cosine = torch.einsum("plc,lkc->plk", light, axis)
    emitted = torch.einsum("plk,lkc->plc", torch.exp(sharpness * (cosine - 1.0)), amplitude)
    arriving = emitted * (nl / square.clamp(min=1e-3))[..., None]

    a = (roughness * roughness).clamp(min=1e-3).square()[:, None]
    cross = torch.linalg.cross(normal.expand_as(half), half)
    d = a / (math.pi * (a * nh * nh + (cross * cross).sum(-1)).square())
    v = 0.5 / (nv * torch.sqrt(a + nl * nl * (1 - a)) + nl * torch.sqrt(a + nv * nv * (1 - a)))
    fresnel = 0.04 + 0.96 * (1 - lh) ** 5
    brdf = albedo[:, None] / math.pi + (fresnel * d * v)[..., None]
    return normalizer * (brdf * arriving).sum(1)


def agree(what, expected, found, absolute):
    """Largest error as a multiple of 1e-3 of the value and `absolute` of the usual one."""
    usual = expected.square().mean().sqrt()
    excess = float(((expected - found).abs() / (1e-3 * expected.abs() + absolute * usual + 1e-30)).max())
    print(f"  {what:22} off by {excess:.3f} of what is allowed")
    return excess <= 1.0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", type=pathlib.Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--device", default="cpu", help="cpu, or cuda for the first GPU")
    options = parser.parse_args()
    torch.set_default_device(options.device)
    torch.set_num_threads(options.threads or len(os.sched_getaffinity(0)))
    case = json.loads((options.case / "case.json").read_text())
    pixels, lights, lobes = case["pixels"], case["lights"], case["lobes"]
    get = lambda name, *shape: load(options.case, name, shape)
    points, normals = get("points", pixels, 3), get("normals", pixels, 3)
    materials, gradient = get("materials", pixels, 4), get("gradient", pixels, 3)
    camera = torch.tensor(case["camera"])
    wanted = [materials[:, :3].clone(), materials[:, 3].clone(), get("positions", lights, 3), get("lobes", lights, lobes, 6)]
    for tensor in wanted:
        tensor.requires_grad_()

    forward, backward = [], []
    finish = torch.cuda.synchronize if options.device.startswith("cuda") else lambda: None
    for _ in range(options.repeats):
        for tensor in wanted:
            tensor.grad = None
        finish()
        begin = time.perf_counter()
        radiance = shade(points, normals, wanted[0], wanted[1], camera, wanted[2], wanted[3], case["normalizer"])
        finish()
        middle = time.perf_counter()
        radiance.backward(gradient)
        finish()
        end = time.perf_counter()
        forward.append(1e3 * (middle - begin))
        backward.append(1e3 * (end - middle))

    ours = get("materials_gradient", pixels, 4)
    right = [
        agree("radiance", get("radiance", pixels, 3), radiance.detach(), 1e-4),
        agree("gradient of albedo", ours[:, :3], wanted[0].grad, 1e-4),
        agree("gradient of roughness", ours[:, 3], wanted[1].grad, 1e-4),
        agree("gradient of positions", get("positions_gradient", lights, 3), wanted[2].grad, 1e-3),
        agree("gradient of lobes", get("lobes_gradient", lights, lobes, 6), wanted[3].grad, 1e-3),
    ]
    best = min(f + b for f, b in zip(forward, backward))
    where = torch.cuda.get_device_name() if options.device.startswith("cuda") else f"{torch.get_num_threads()} threads"
    print(f"{pixels} pixels, {lights} lights of {lobes} lobes; torch {torch.__version__}, {where}")
    print(f"torch: forward {min(forward):.1f} ms, backward {min(backward):.1f} ms, both {best:.1f} ms at best")
    print(f"ours:  both {case['milliseconds']:.2f} ms (median), {case['device']}; {best / case['milliseconds']:.1f} times")
    sys.exit(0 if all(right) else 1)


if __name__ == "__main__":
    main()

"""Differentiable functions for PyTorch, over tensors in the memory of the processor.

:func:`render` blends Gaussians into an image, :func:`shade` shades pixels by point lights. Gradients come from the backward
passes of the engine, in 32-bit floats. Second derivatives do not exist. Needs the package ``torch``.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple, Optional, Sequence

try:
    import torch
except ImportError as _error:
    raise ImportError("sgs.torch needs the package torch; install it with pip install torch") from _error

from . import _sgs
from ._camera import Camera
from ._device import Device, DeviceLike, open_device
from ._errors import usage

_KEPT: dict[tuple[type, int], tuple[Device, Any]] = {}
_LOCK = threading.Lock()


class Rendered(NamedTuple):
    """Images of :func:`render`.

    Attributes:
        image: H × W × 3, display values over the background, not clipped.
        alpha: H × W, opacity, 0 to 1.
        normal: H × W × 3, blended unit normals in world space; ``None`` without ``normals``.
        depth: H × W, blended depth in scene units; divide by ``alpha`` for the mean. ``None`` unless requested.
    """

    image: torch.Tensor
    alpha: torch.Tensor
    normal: Optional[torch.Tensor]
    depth: Optional[torch.Tensor]


def render(
    means: torch.Tensor,
    log_scales: torch.Tensor,
    rotations: torch.Tensor,
    opacity_logits: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    *,
    normals: Optional[torch.Tensor] = None,
    depth: bool = False,
    world_to_camera: Optional[torch.Tensor] = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    device: DeviceLike = None,
) -> Rendered:
    """Renders N Gaussians. All tensors have gradients.

    A splat with an opacity below 1/255 at a pixel is left out there, and light behind opaque splats is, too. Gradients ignore
    these thresholds.

    Args:
        means: N × 3, centers in scene units.
        log_scales: N × 3, logarithms of the standard deviations along the local axes.
        rotations: N × 4, quaternions (w, x, y, z) of any length but 0.
        opacity_logits: N, opacities before the logistic function.
        sh: N × K × 3, coefficients of spherical harmonics, with K = 1, 4, 9 or 16; color = 0.5 + 0.28209479 · sh[:, 0] + ….
        camera: Camera.
        normals: N × 3, normals in world space, of any length but 0.
        depth: Whether depth is blended.
        world_to_camera: 3 × 4, pose that replaces that of the camera. Its twelve numbers have gradients as if they were
            independent; the camera stands at -Rᵀt.
        background: Display values.
        device: Vulkan device; the default one if ``None``.

    Raises:
        sgs.Error: If a tensor has another shape, or the device fails.
    """
    count = means.shape[0] if means.dim() == 2 else 0
    _check("means", means, (count, 3))
    _check("log_scales", log_scales, (count, 3))
    _check("rotations", rotations, (count, 4))
    _check("opacity_logits", opacity_logits, (count,))
    if sh.dim() != 3 or sh.shape[1] not in (1, 4, 9, 16):
        raise usage(f"sh has the shape {tuple(sh.shape)}, but must be {count} × K × 3 with K = 1, 4, 9 or 16.")
    _check("sh", sh, (count, sh.shape[1], 3))
    if normals is not None:
        _check("normals", normals, (count, 3))
    if world_to_camera is None:
        world_to_camera = torch.as_tensor(camera.world_to_camera[:3], dtype=torch.float32)
    _check("world_to_camera", world_to_camera, (3, 4))
    splatter = _kept(_sgs.Splatter, device)
    bands = [sh[:, band * band : (band + 1) * (band + 1)] for band in range(4) if band * band < sh.shape[1]]
    groups = [means, log_scales, rotations, opacity_logits, *bands]
    groups += [means.new_empty(0)] * (8 - len(groups))
    groups.append(means.new_empty(0) if normals is None else normals)
    view = ([camera.width, camera.height], [camera.fx, camera.fy, camera.cx, camera.cy], camera.near or 0.01)
    options = (splatter, view, [float(v) for v in background], depth)
    image, alpha = _Render.apply(options, world_to_camera, *groups)
    at = 3 if normals is None else 6
    normal = None if normals is None else image[..., 3:6]
    return Rendered(image[..., :3], alpha, normal, image[..., at] if depth else None)


def shade(
    points: torch.Tensor,
    normals: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    lights: torch.Tensor,
    lobes: torch.Tensor,
    *,
    position: Sequence[float],
    metallic: Optional[torch.Tensor] = None,
    gains: Optional[torch.Tensor] = None,
    normalizer: float = 1.0,
    device: DeviceLike = None,
) -> torch.Tensor:
    """Shades P pixels by L point lights that emit K lobes each, without shadows. Returns linear radiance, P × 3.

    Light i shines from direction w with ``gain · sum_k exp(a_k) · exp(exp(s_k) · (w · b_k - 1))``, divided by the squared
    distance, which is at least 1e-3. Surfaces are Lambertian with a GGX lobe (docs/how/mathematics.md). ``points``, ``position`` and
    ``gains`` have no gradients.

    Args:
        points: P × 3, in scene units.
        normals: P × 3, of any length but 0.
        albedo: P × 3, linear, 0 to 1.
        roughness: P, 0 to 1.
        lights: L × 3, positions in scene units.
        lobes: L × K × 7: axis b (3, of any length but 0), log sharpness s, log amplitudes a (3). K is 1 to 32. Log sharpness is
            clamped to 9.5, log amplitudes to 15.
        position: Position of the camera, 3, in scene units.
        metallic: P, 0 to 1; 0 if ``None``.
        gains: L, factors on the lights; 1 if ``None``. A light with gain 0 is off.
        normalizer: Factor on all light; a trained run has 1 over its initial number of lights.
        device: Vulkan device; the default one if ``None``.

    Raises:
        sgs.Error: If a tensor has another shape, or the device fails.
    """
    count, number = (t.shape[0] if t.dim() > 1 else 0 for t in (points, lights))
    _check("points", points, (count, 3))
    _check("normals", normals, (count, 3))
    _check("albedo", albedo, (count, 3))
    _check("roughness", roughness, (count,))
    _check("lights", lights, (number, 3))
    if lobes.dim() != 3 or not 1 <= lobes.shape[1] <= 32:
        raise usage(f"lobes has the shape {tuple(lobes.shape)}, but must be {number} × K × 7 with K = 1 to 32.")
    _check("lobes", lobes, (number, lobes.shape[1], 7))
    if metallic is not None:
        _check("metallic", metallic, (count,))
    if gains is None:
        gains = lights.new_ones(number)
    _check("gains", gains, (number,))
    if len(position) != 3:
        raise usage(f"position has {len(position)} numbers, but must have 3.")
    options = (_kept(_sgs.LightShader, device), [float(v) for v in position], float(normalizer))
    unit = torch.nn.functional.normalize(normals, dim=1)
    materials = torch.cat([albedo, roughness[:, None]], dim=1)
    metal = points.new_empty(0) if metallic is None else metallic
    return _Shade.apply(options, points.detach(), unit, materials, metal, lights, lobes, gains.detach())


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, options: Any, pose: torch.Tensor, *groups: torch.Tensor) -> Any:
        splatter, (size, lens, near), background, depth = options
        arrays = [_numpy(group) for group in groups]
        view = (size, lens, _numpy(pose).ravel().tolist(), near)
        image, through = splatter.forward(arrays, view, background, depth)
        ctx.save_for_backward(pose, *groups)
        ctx.options = options
        width, height = size
        alpha = 1 - torch.from_numpy(through).view(height, width)
        return torch.from_numpy(image).view(height, width, -1), alpha

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_image: torch.Tensor, grad_alpha: torch.Tensor) -> Any:
        pose, *groups = ctx.saved_tensors
        splatter, (size, lens, near), background, depth = ctx.options
        arrays = [_numpy(group) for group in groups]
        view = (size, lens, _numpy(pose).ravel().tolist(), near)
        gradients = [_numpy(grad_image), _numpy(-grad_alpha)]
        pulled, of_pose = splatter.backward(arrays, view, background, depth, gradients)
        shaped = [torch.from_numpy(values).view(group.shape) for values, group in zip(pulled, groups)]
        of_pose = torch.from_numpy(of_pose)
        turned = torch.cat([of_pose[:9].view(3, 3), of_pose[9:].view(3, 1)], dim=1)
        return (None, turned, *shaped)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, options: Any, *tensors: torch.Tensor) -> torch.Tensor:
        shader, position, normalizer = options
        radiance = shader.forward([_numpy(tensor) for tensor in tensors], position, normalizer)
        ctx.save_for_backward(*tensors)
        ctx.options = options
        return torch.from_numpy(radiance).view(-1, 3)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:
        shader, position, normalizer = ctx.options
        tensors = ctx.saved_tensors
        arrays = [_numpy(tensor) for tensor in tensors]
        pulled = shader.backward(arrays, position, normalizer, _numpy(gradient))
        # Normals, materials, metallic, positions of lights, lobes.
        shaped = [torch.from_numpy(values).view(tensor.shape) for values, tensor in zip(pulled, tensors[1:6])]
        return (None, None, *shaped, None)


def _kept(kind: Any, device: DeviceLike) -> Any:
    """Returns the object of a device that keeps compiled graphs between calls."""
    opened = open_device(device)
    with _LOCK:
        key = (kind, id(opened))
        if key not in _KEPT:
            _KEPT[key] = (opened, kind(opened._native))
        return _KEPT[key][1]


def _check(name: str, tensor: torch.Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != shape or not shape[0]:
        wanted = " × ".join(str(side) for side in shape)
        raise usage(f"{name} has the shape {tuple(tensor.shape)}, but must be {wanted}, with at least one row.")
    if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
        raise usage(f"{name} is {tensor.dtype} on {tensor.device}, but must be float32 on cpu.")


def _numpy(tensor: torch.Tensor) -> Any:
    return tensor.detach().contiguous().numpy()

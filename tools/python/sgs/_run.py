"""Trained runs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence, Union

import numpy as np

from . import _sgs
from ._camera import Camera, _native
from ._config import Config
from ._device import DeviceLike, open_device
from ._errors import usage
from ._scene import Scene, View

_BLENDED = ("rgb", "alpha", "depth", "normal", "semantic")
_LIT = ("albedo", "roughness", "metallic", "pbr", "diffuse", "specular", "visibility", "env", "direct")

#: Ways to name a viewpoint: a camera, a view, or the name or index of a view of the run's scene.
Viewpoint = Union[Camera, View, str, int]
Edit = Union[Mapping[str, Any], str, os.PathLike, None]
Background = Sequence[float]


class Run:
    """Trained run, or the Gaussians of a PLY or glTF file."""

    def __init__(self, path: Path, native: Any, device: DeviceLike, scene: Optional[Path]) -> None:
        self.path = path
        self._native = native
        self._device = device
        self._moved = scene
        self._scene: Optional[Scene] = None
        self._own: dict[bool, Relit] = {}

    @staticmethod
    def open(
        path: Union[str, os.PathLike[str]],
        *,
        device: DeviceLike = None,
        scene: Union[str, os.PathLike[str], None] = None,
    ) -> Run:
        """Opens a run directory, or a PLY or glTF file.

        Args:
            device: Device for images and measures; the default one if ``None``. It is opened on first use.
            scene: Scene directory, if the scene has moved.

        Raises:
            sgs.Error: If it is no run, or a file is damaged.
        """
        return Run(Path(path), _sgs.Run(os.fspath(path)), device, None if scene is None else Path(scene))

    def __len__(self) -> int:
        """Number of Gaussians."""
        return self._native.count()

    def __repr__(self) -> str:
        return f"<sgs.Run {str(self.path)!r}, {len(self)} Gaussians>"

    @property
    def settings(self) -> dict[str, Any]:
        """All settings of the run, as nested groups; empty for a file."""
        text = self._native.settings()
        return {} if text is None else json.loads(text)

    @property
    def scene(self) -> Scene:
        """Scene of the run, with its split.

        Raises:
            sgs.Error: If the scene is not at its place (give ``scene`` to :meth:`open`), or this is a file.
        """
        if self._scene is None:
            path = self._moved or self._native.scene()
            if path is None:
                raise usage(f'"{self.path}" is not a run directory, so it has no scene; pass cameras.')
            settings = self.settings
            settings.pop("scene", None)
            self._scene = Scene.open(path, Config(settings))
        return self._scene

    @property
    def classes(self) -> list[str]:
        """Names of the semantic classes.

        Raises:
            sgs.Error: If the run has none.
        """
        return self._native.classes()

    def gaussians(self) -> dict[str, np.ndarray]:
        """Returns the parameters of the N Gaussians, as trained. The arrays are read-only and share the memory of the run.

        ============== ============ ==========================================================================
        key            shape        meaning
        ============== ============ ==========================================================================
        means          N × 3        centers in scene units
        log_scales     N × 3        logarithms of the standard deviations along the local axes
        rotations      N × 4        quaternions (w, x, y, z), not normalized
        opacity_logits N            opacities before the logistic function
        sh0 … sh3      N × (2d+1) × 3  coefficients of band d; color = 0.5 + 0.28209479 · sh0 + …, display values
        normals        N × 3        normals in world space, of any length
        albedo         N × 3        before activation: 0.01 + 0.98 · logistic(x), linear
        roughness      N            before activation: 0.09 + 0.9 · logistic(x)
        metallic       N            before activation: logistic(x)
        semantic       N × 32       semantic features
        emitters       N            unsigned: 0 emits nothing, i + 1 belongs to emitter i
        light_gains    N            factor on the light of emitters and of bounces
        ============== ============ ==========================================================================

        Keys from ``normals`` on exist if the run has them.
        """
        return self._native.gaussians()

    def render(
        self, view: Viewpoint, channels: Sequence[str] = ("rgb",), *, background: Background = (0.0, 0.0, 0.0)
    ) -> dict[str, np.ndarray]:
        """Renders a view. Returns an array for each channel, H × W × C, of 32-bit floats unless noted.

        ========== = ==========================================================================================
        channel    C meaning
        ========== = ==========================================================================================
        rgb        3 trained color over the background, display values 0 to 1
        alpha      1 opacity, 0 to 1
        depth      1 mean depth along the camera's axis in scene units; 0 where nothing is visible
        normal     3 unit normals in world space; 0 where nothing is visible
        semantic   1 index into ``classes``, -1 for none (32-bit integers)
        albedo     3 linear
        roughness  1 0 to 1
        metallic   1 0 to 1
        pbr        3 linear light of the trained materials and lights, over the background
        diffuse    3 linear diffuse light
        specular   3 linear specular light
        visibility 1 mean visibility of the lights, 0 to 1
        env        3 linear light of the environment map
        direct     3 linear light of the lights
        ========== = ==========================================================================================

        Args:
            view: Camera, view, or the name or index of a view of the run's scene.
            background: Display values, for ``rgb`` and ``pbr``.

        Raises:
            sgs.Error: If a channel does not exist in this run, or the device fails.
        """
        names = _channels(channels, _BLENDED + _LIT)
        camera, back = _native(self._camera(view)), _background(background)
        blended = [name for name in names if name in _BLENDED]
        lit = [name for name in names if name in _LIT]
        images: dict[str, np.ndarray] = {}
        if blended:
            device = open_device(self._device)._native
            images.update(self._native.render(device, camera, blended, back))
        if lit:
            with_visibility = "visibility" in lit
            if with_visibility not in self._own:
                self._own[with_visibility] = self._relight({}, None, with_visibility)
            images.update(self._own[with_visibility]._native.render(camera, lit, back))
        return {name: images[name] for name in names}

    def relight(self, edit: Edit = None, *, shadows: Optional[str] = None) -> Relit:
        """Applies an edit of lights, materials and contents (docs/guide/relight.md), without training.

        Args:
            edit: The edit that ``sgs relight`` takes, as a dictionary or as the path of a JSON file. Relative paths in a dictionary
                start at the working directory.
            shadows: ``learned``, ``traced`` or ``none``; by default those of the run.

        Raises:
            sgs.Error: If the run has no materials, or the edit cannot be applied.
        """
        return self._relight(edit, shadows, False)

    def _relight(self, edit: Edit, shadows: Optional[str], visibility: bool) -> Relit:
        if edit is None or isinstance(edit, Mapping):
            beside = Path()
            try:
                text = json.dumps(edit or {}, default=lambda v: v.tolist() if hasattr(v, "tolist") else os.fspath(v))
            except TypeError as error:
                raise usage(f"The edit is not made of numbers, strings, lists and dictionaries: {error}.") from error
        else:
            file = Path(edit)
            beside = file.parent
            try:
                text = file.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                raise usage(f'"{file}" cannot be read: {error}.') from error
        device, moved = open_device(self._device)._native, self._moved
        scene = None if moved is None else os.fspath(moved)
        native = self._native.relight(device, (text, os.fspath(beside)), shadows, scene, visibility)
        return Relit(self, native)

    def evaluate(
        self, split: str = "test", *, lpips: Union[str, os.PathLike[str], None] = None, align: bool = False
    ) -> dict[str, Any]:
        """Measures the run against photographs and ground truth, as ``sgs eval`` does, and writes ``metrics.json``.

        The result has ``mean``, the means over the views, and ``views``: ``result["mean"]["nvs"]["psnr"]`` in dB.

        Args:
            split: ``test`` or ``train``.
            lpips: File with the weights of LPIPS, which enables this measure.
            align: Measures each view again with the camera that fits it best: ``psnr_aligned`` and ``ssim_aligned``. Runs that
                learned cameras or exposures do so anyway.

        Raises:
            sgs.Error: If the split has no views, or the scene is not at its place.
        """
        scene = None if self._moved is None else os.fspath(self._moved)
        weights = None if lpips is None else os.fspath(lpips)
        device = open_device(self._device)._native
        return json.loads(self._native.evaluate(device, split, scene, weights, bool(align)))

    def _camera(self, view: Viewpoint) -> Camera:
        if isinstance(view, Camera):
            return view
        return (view if isinstance(view, View) else self.scene.view(view)).camera


class Relit:
    """Run under edited light, ready for any number of views."""

    def __init__(self, run: Run, native: Any) -> None:
        self._run = run
        self._native = native

    @property
    def lights(self) -> int:
        """Number of lights or emitters that are on."""
        return self._native.lights()

    def __len__(self) -> int:
        """Number of Gaussians, with those that the edit inserts."""
        return self._native.count()

    def render(
        self, view: Viewpoint, channels: Sequence[str] = ("relit",), *, background: Background = (0.0, 0.0, 0.0)
    ) -> dict[str, np.ndarray]:
        """Shades a view. Returns an array of 32-bit floats for each channel, H × W × C.

        Channels: ``relit`` is the linear light of all lights over the background (3). ``albedo``, ``roughness``, ``metallic``,
        ``diffuse``, ``specular``, ``env`` and ``direct`` are those of :meth:`Run.render`.

        Raises:
            sgs.Error: If a channel does not exist in this run, or the device fails.
        """
        names = _channels(channels, ("relit", *(name for name in _LIT if name not in ("pbr", "visibility"))))
        return self._native.render(_native(self._run._camera(view)), names, _background(background))


def _channels(channels: Sequence[str], known: Sequence[str]) -> list[str]:
    names = [channels] if isinstance(channels, str) else list(channels)
    for name in names:
        if name not in known:
            raise usage(f'"{name}" is not a channel; there are {", ".join(known)}.')
    if not names:
        raise usage("No channel is requested; name at least one.")
    return names


def _background(background: Background) -> list[float]:
    values = [float(v) for v in background]
    if len(values) != 3 or not np.isfinite(values).all():
        raise usage(f"background is {background}, but must be three finite numbers.")
    return values

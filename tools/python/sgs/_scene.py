"""Scenes."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np

from . import _sgs
from ._camera import Camera, _from_native
from ._config import Config, _native
from ._errors import usage


@dataclass(frozen=True)
class View:
    """View of a scene: a camera and its photograph.

    Attributes:
        name: Stem of the photograph's file name.
        index: Position in ``scene.views``.
        camera: Camera of the undistorted photograph.
        path: File of the photograph.
    """

    name: str
    index: int
    camera: Camera
    path: Path
    _scene: Any = field(repr=False, compare=False)

    def photograph(self) -> np.ndarray:
        """Loads the photograph: H × W × 3, display values 0 to 1, undistorted.

        Raises:
            sgs.Error: If the file is damaged.
        """
        return self._scene.photograph(self.index)


class Scene:
    """Directory of photographs with cameras, points, priors and ground truth (docs/reference/scenes.md)."""

    def __init__(self, path: Path, native: Any) -> None:
        self.path = path
        self._native = native
        self.views: list[View] = []
        for index, (camera, file) in enumerate(native.views()):
            made = _from_native(camera)
            self.views.append(View(made.name, index, made, Path(file), native))

    @staticmethod
    def open(path: Union[str, os.PathLike[str]], config: Optional[Config] = None) -> Scene:
        """Opens a scene.

        Args:
            config: Settings whose ``split``, ``views``, ``scale``, ``exposure`` and ``masks`` apply.

        Raises:
            sgs.Error: If it is no scene, or a file is damaged.
        """
        return Scene(Path(path), _sgs.Scene(os.fspath(path), _native(config)))

    @property
    def train(self) -> list[View]:
        """Training views."""
        return [self.views[i] for i in self._native.split()[0]]

    @property
    def test(self) -> list[View]:
        """Held-out views."""
        return [self.views[i] for i in self._native.split()[1]]

    @property
    def points(self) -> np.ndarray:
        """Initial points: N × 3, in scene units, read-only."""
        return self._native.points()

    @property
    def exposure(self) -> float:
        """Factor on linear (EXR) photographs; 1 for others."""
        return self._native.exposure()

    @property
    def warnings(self) -> list[str]:
        """Warnings of opening the scene, one sentence each."""
        return self._native.warnings()

    def view(self, which: Union[int, str]) -> View:
        """Returns a view by its index or name.

        Raises:
            sgs.Error: If there is no such view.
        """
        if isinstance(which, str):
            found = next((view for view in self.views if view.name == which), None)
            if found is None:
                names = ", ".join(view.name for view in self.views[:8])
                raise usage(f'The scene has no view "{which}"; its first views are {names}.')
            return found
        if not 0 <= which < len(self.views):
            raise usage(f"The scene has no view {which}; its views are 0 to {len(self.views) - 1}.")
        return self.views[which]

    def __repr__(self) -> str:
        return f"<sgs.Scene {str(self.path)!r}, {len(self.views)} views>"


def synthesize(
    path: Union[str, os.PathLike[str]],
    *,
    name: Optional[str] = None,
    views: Optional[int] = None,
    test_views: Optional[int] = None,
    size: Optional[tuple[int, int]] = None,
    seed: int = 0,
    replace: bool = False,
) -> Scene:
    """Generates an indoor scene with path-traced images, priors and ground truth, as ``sgs synth`` does.

    Args:
        path: Directory to create.
        name: Kind of scene; ``livingroom`` by default.
        views, test_views: Numbers of training views and of test views; 12 and 4 by default.
        size: Columns and rows of the images; 160 and 120 by default.
        seed: Seed of furniture and noise.
        replace: Replaces an existing scene.

    Raises:
        sgs.Error: If an option is wrong, or the directory holds other files.
    """
    _sgs.synthesize(os.fspath(path), name, (views, test_views), size, seed, replace)
    return Scene.open(path)

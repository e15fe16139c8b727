"""Cameras."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Optional, Union

import numpy as np

from . import _sgs
from ._arrays import ArrayLike, as_array
from ._errors import usage


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with its pose.

    Axes follow OpenCV: x right, y down, z forward. The origin of the image is its upper left corner; pixel (i, j) has its center
    at (i + 0.5, j + 0.5).

    Attributes:
        width, height: Size of the image in pixels.
        fx, fy: Focal lengths in pixels.
        cx, cy: Principal point in pixels.
        rotation: World to camera, 3 × 3.
        translation: World to camera, 3, in scene units.
        near: Depth in scene units below which nothing is rendered; ``None`` for 0.01 of the run's unit.
        name: Name of the view.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: np.ndarray
    translation: np.ndarray
    near: Optional[float] = None
    name: str = "camera"

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", as_array(self.rotation, (3, 3), "rotation", np.float64))
        object.__setattr__(self, "translation", as_array(self.translation, (3,), "translation", np.float64))

    @property
    def position(self) -> np.ndarray:
        """Center of the camera in world space, 3, in scene units."""
        return -self.rotation.T @ self.translation

    @property
    def world_to_camera(self) -> np.ndarray:
        """Pose as a 4 × 4 matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    @staticmethod
    def look_at(
        position: ArrayLike,
        target: ArrayLike,
        *,
        up: ArrayLike = (0.0, 0.0, 1.0),
        size: tuple[int, int] = (640, 480),
        field_of_view: float = 60.0,
        name: str = "camera",
    ) -> Camera:
        """Returns a camera at ``position`` that looks at ``target``.

        Args:
            up: Direction that points up in the image.
            size: Columns and rows.
            field_of_view: Horizontal field of view in degrees.

        Raises:
            sgs.Error: If position and target are equal, or the view is along ``up``.
        """
        eye = as_array(position, (3,), "position", np.float64)
        forward = as_array(target, (3,), "target", np.float64) - eye
        right = np.cross(forward, as_array(up, (3,), "up", np.float64))
        if not (np.linalg.norm(forward) > 0 and np.linalg.norm(right) > 0):
            raise usage("The camera cannot look along its up direction, or at its own position; move it or change up.")
        forward /= np.linalg.norm(forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        width, height = size
        focal = width / (2 * np.tan(np.radians(field_of_view) / 2))
        return Camera(
            width, height, focal, focal, width / 2, height / 2, rotation, -rotation @ eye, name=name
        )

    @staticmethod
    def read(path: Union[str, os.PathLike[str]]) -> list[Camera]:
        """Reads the cameras of a transforms file.

        Raises:
            sgs.Error: If the file is damaged.
        """
        return [_from_native(camera) for camera in _sgs.read_cameras(os.fspath(path))]

    def scaled(self, width: int, height: int) -> Camera:
        """Returns the camera of the image resized to ``width`` × ``height``."""
        x, y = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y
        )


def _native(camera: Camera) -> _sgs.CameraTuple:
    try:
        size = [int(camera.width), int(camera.height)]
        lens = [float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)]
        if min(size) < 1 or max(size) > 1 << 30:
            raise ValueError(f"the size is {size[0]} × {size[1]}")
    except (TypeError, ValueError) as error:
        raise usage(f'The camera "{camera.name}" is wrong: {error}.') from error
    near = None if camera.near is None else float(camera.near)
    return (str(camera.name), size, lens, camera.rotation.ravel().tolist(), camera.translation.tolist(), near)


def _from_native(camera: Any) -> Camera:
    name, (width, height), (fx, fy, cx, cy), rotation, translation, near = camera
    return Camera(width, height, fx, fy, cx, cy, np.reshape(rotation, (3, 3)), np.array(translation), near, name)

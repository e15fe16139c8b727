"""Images: conversion and files."""

from __future__ import annotations

import os
from typing import Union

import numpy as np

from . import _sgs
from ._arrays import ArrayLike, as_array


def to_display(linear: ArrayLike) -> np.ndarray:
    """Converts linear light or albedo to display values (sRGB), clipped to 0 to 1. Keeps the shape."""
    value = np.clip(np.asarray(linear, dtype=np.float32), 0, 1)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055).astype(np.float32)


def from_display(display: ArrayLike) -> np.ndarray:
    """Converts display values (sRGB) to linear ones. Keeps the shape."""
    value = np.asarray(display, dtype=np.float32)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def write_image(path: Union[str, os.PathLike[str]], image: ArrayLike) -> None:
    """Writes an image of 1 or 3 channels, H × W × C.

    A name in .png stores the values 0 to 1 in 8 bits, as they are: pass display values (:func:`to_display`). A name in .exr stores
    32-bit floats.

    Raises:
        sgs.Error: If the extension or the shape is another one, or the file cannot be written.
    """
    _sgs.write_image(os.fspath(path), as_array(image, (None, None, None), "image"))

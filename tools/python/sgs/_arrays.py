"""Arrays from NumPy, DLPack, the buffer protocol or sequences."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np

from ._errors import usage

#: Anything with ``__dlpack__``, the buffer protocol, or a nested sequence of numbers.
ArrayLike = Any


def as_array(value: ArrayLike, shape: tuple[Optional[int], ...], name: str, dtype: Any = np.float32) -> np.ndarray:
    """Returns an array of a type and shape; ``None`` stands for any length. Copies only to convert."""
    if hasattr(value, "__dlpack__") and not isinstance(value, np.ndarray):
        try:
            value = np.from_dlpack(value)
        except (BufferError, RuntimeError, TypeError) as error:
            raise usage(f"{name} cannot be read by DLPack: {error}; pass an array in the memory of the processor.") from error
    try:
        array: np.ndarray = np.ascontiguousarray(value, dtype=dtype).reshape(np.shape(value))
    except (TypeError, ValueError) as error:
        raise usage(f"{name} is not an array of numbers: {error}.") from error
    found: tuple[int, ...] = array.shape
    if array.ndim != len(shape) or any(want is not None and want != have for want, have in zip(shape, found)):
        text = " × ".join("N" if side is None else str(side) for side in shape)
        raise usage(f"{name} has the shape {array.shape}, but must be {text}.")
    return array

"""Between the protocol's arrays and numpy: colors, sizes. Needs numpy; changing sizes also needs torch."""

import numpy as np

from .protocol import Array

TYPES = {"BOOL": np.bool_, "U8": np.uint8, "U16": np.uint16, "F16": np.float16, "F32": np.float32}


def from_array(array):
    """A numpy array of the same type and shape."""
    return np.frombuffer(bytes(array.data), TYPES[array.dtype]).reshape(array.shape)


def to_array(numbers):
    """An array of the protocol."""
    name = next(n for n, t in TYPES.items() if numbers.dtype == t)
    return Array(name, numbers.shape, np.ascontiguousarray(numbers).astype(TYPES[name]).tobytes())


def to_linear(encoded):
    """Linear light from sRGB-encoded values."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear):
    """sRGB-encoded values from linear light."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def srgb(array):
    """An image as sRGB-encoded floats in [0, 1], whichever way it was sent."""
    image = from_array(array)
    if image.dtype == np.uint8:
        return image.astype(np.float32) / 255
    return to_srgb(np.clip(image, 0, 1)).astype(np.float32)


def linear(array):
    """An image as linear floats, whichever way it was sent."""
    image = from_array(array)
    if image.dtype == np.uint8:
        return to_linear(image.astype(np.float32) / 255).astype(np.float32)
    return image


def picture(array):
    """An image as a PIL image."""
    from PIL import Image

    return Image.fromarray((srgb(array) * 255 + 0.5).astype(np.uint8))


def resize(image, height, width):
    """[H, W, C] at another size; averages where it shrinks."""
    if image.shape[:2] == (height, width):
        return image
    import torch

    planes = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None]
    out = torch.nn.functional.interpolate(planes, (height, width), mode="bilinear", antialias=True, align_corners=False)
    return out[0].permute(1, 2, 0).numpy()


def known(depth, meaning):
    """Depth as float32 with NaN where it is none: where it is not finite, and where it must be above 0 and is not."""
    bad = ~np.isfinite(depth)
    if meaning != "inverse-scale-shift":
        bad |= ~(depth > 0)
    return np.where(bad, np.nan, depth).astype(np.float32)


def confidence(trust):
    """Confidence from 0 to 1 of what networks give as 1 + exp(x): 1 at no confidence, and without a limit."""
    return (1 - 1 / np.maximum(np.nan_to_num(trust, nan=1.0, posinf=3e38), 1)).astype(np.float32)


def multiple(height, width, step, longest):
    """The size nearest in shape whose sides are multiples of ``step`` and at most ``longest``."""
    factor = min(1.0, longest / max(height, width))
    most = max(longest // step, 1)
    return tuple(min(max(round(n * factor / step), 1), most) * step for n in (height, width))


def device(options):
    """The torch device of the options."""
    import torch

    return torch.device(options.device or ("cuda" if torch.cuda.is_available() else "cpu"))

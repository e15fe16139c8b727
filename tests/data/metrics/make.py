#!/usr/bin/env python3
"""Pictures, and what other people's implementations measure between them: written once, read by tests/tests/command/metrics.rs.

    pip install scikit-image==0.26.0 flip-evaluator==1.7
    python3 make.py

Pictures are made of formulas and a seeded generator. Each pair differs in one way: noise, blur, color, a shift by a pixel,
a missing thing.
"""

import json
from pathlib import Path

import flip_evaluator
import numpy as np
import scipy
import skimage
from scipy.spatial.distance import cosine
from skimage import io
from skimage.filters import gaussian
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

HERE = Path(__file__).parent
WIDTH, HEIGHT = 72, 54


def truth():
    """A wall with a lamp's glow, a striped carpet, and two colored boxes."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] / np.array([HEIGHT, WIDTH]).reshape(2, 1, 1)
    image = np.stack([0.75 - 0.3 * y, 0.7 - 0.35 * y, 0.6 - 0.3 * y], axis=-1)
    image += 0.4 * np.exp(-40 * ((x - 0.7) ** 2 + (y - 0.25) ** 2))[..., None] * [1.0, 0.8, 0.5]
    stripes = (np.sin(60 * x + 20 * y) > 0) & (y > 0.7)
    image[stripes] *= [0.5, 0.3, 0.35]
    image[(abs(x - 0.25) < 0.1) & (abs(y - 0.6) < 0.2)] = [0.1, 0.35, 0.7]
    image[(abs(x - 0.55) < 0.06) & (abs(y - 0.55) < 0.1)] = [0.8, 0.15, 0.1]
    return np.clip(image, 0, 1)


def as_stored(image):
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def ssim(a, b):
    """The window of Wang et al. 2004 with zeros outside, over all pixels: the border that scikit-image leaves out of the
    mean is the one added here."""
    pad = [(5, 5), (5, 5), (0, 0)]
    return structural_similarity(
        np.pad(a, pad), np.pad(b, pad), data_range=1.0, channel_axis=2,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    )


def scaled(a, b):
    """Each channel by the gain of least squares."""
    gains = [np.linalg.lstsq(a[..., c].reshape(-1, 1), b[..., c].ravel(), rcond=None)[0][0] for c in range(3)]
    return peak_signal_noise_ratio(b, a * gains, data_range=1.0)


def degrees(a, b):
    """Mean angle between the vectors that the colors of normal maps stand for."""
    pairs = zip((2 * a - 1).reshape(-1, 3), (2 * b - 1).reshape(-1, 3))
    return np.degrees(np.mean([np.arccos(np.clip(1 - cosine(x, y), -1, 1)) for x, y in pairs]))


def relative(a, b):
    """Red as depth, from 1 to 3."""
    return np.mean(np.abs((a[..., 0] - b[..., 0]) * 2) / (1 + 2 * b[..., 0]))


def main():
    rng = np.random.default_rng(7)
    start = truth()
    changed = {
        "noise": start + rng.normal(0, 0.05, start.shape),
        "blur": gaussian(start, 1.5, channel_axis=2),
        "color": start * [0.8, 1.0, 1.15],
        "shift": np.roll(start, 1, axis=1),
        "missing": np.where((np.mgrid[0:HEIGHT, 0:WIDTH][1] > 34)[..., None], start, gaussian(start, 9, channel_axis=2)),
        "dark": start * 0.05,
    }
    io.imsave(HERE / "truth.png", as_stored(start), check_contrast=False)
    b = as_stored(start) / 255.0
    pairs = {}
    for name, image in changed.items():
        io.imsave(HERE / f"{name}.png", as_stored(image), check_contrast=False)
        a = as_stored(image) / 255.0
        _, flip, _ = flip_evaluator.evaluate(b.astype(np.float32), a.astype(np.float32), "LDR")
        pairs[name] = {
            "mse": float(mean_squared_error(b, a)),
            "psnr": float(peak_signal_noise_ratio(b, a, data_range=1.0)),
            "psnr_scaled": float(scaled(a, b)),
            "ssim": float(ssim(a, b)),
            "flip": float(flip),
            "normal_mae_deg": float(degrees(a, b)),
            "depth_rel": float(relative(a, b)),
        }
    by = {"scikit-image": skimage.__version__, "flip-evaluator": "1.7", "scipy": scipy.__version__, "numpy": np.__version__}
    (HERE / "expected.json").write_text(json.dumps({"by": by, "pairs": pairs}, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Gradients of sgs.torch against central differences of the same functions, in 32-bit floats.

Derivatives along random directions are compared, so that the loss moves by far more than its rounding error of about 1e-7. The
tolerance is 0.5 % of the derivative, and 0.5 % of the size that a derivative along a random direction has.
"""

import numpy as np
import pytest

import sgs

torch = pytest.importorskip("torch", reason="the package torch is missing")


def camera(width=40, height=30):
    return sgs.Camera.look_at((0.0, -3.0, 0.3), (0, 0, 0), size=(width, height))


def gaussians(count=8, bands=4, seed=3):
    """Draws Gaussians that cover the whole image, at distinct depths.

    Their opacity is above 1/255 and their transmittance above 1e-4 at every pixel, and no order changes. The loss is then smooth:
    at an edge of a footprint it would jump, which gradients ignore.
    """
    g = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.rand(*shape, generator=g) * 2 - 1
    means = 0.3 * draw(count, 3)
    means[:, 1] = torch.linspace(-0.5, 0.5, count)[torch.randperm(count, generator=g)]
    return {
        "means": means,
        "log_scales": 0.1 + 0.15 * draw(count, 3),
        "rotations": torch.nn.functional.normalize(draw(count, 4), dim=1),
        "opacity_logits": -0.3 + 0.3 * draw(count),
        "sh": 0.5 * draw(count, bands, 3),
        "normals": torch.nn.functional.normalize(draw(count, 3), dim=1),
    }


def pixels(count=50, lights=3, lobes=2, seed=5):
    g = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.rand(*shape, generator=g) * 2 - 1
    lobe = torch.cat([draw(lights, lobes, 3), 0.5 * draw(lights, lobes, 1), -1 + 0.5 * draw(lights, lobes, 3)], dim=2)
    return {
        "points": draw(count, 3),
        "normals": torch.nn.functional.normalize(draw(count, 3), dim=1),
        "albedo": 0.5 + 0.4 * draw(count, 3),
        "roughness": 0.6 + 0.3 * draw(count),
        "metallic": 0.5 + 0.4 * draw(count),
        "lights": 3 * torch.nn.functional.normalize(draw(lights, 3), dim=1),
        "lobes": lobe,
    }


def compare(loss, tensors, name, step, directions=4):
    """Compares the derivative of a loss by one tensor, along random directions, with central differences."""
    leaf = tensors[name].clone().requires_grad_(True)
    loss({**tensors, name: leaf}).backward()
    gradient = leaf.grad.double()
    assert torch.isfinite(gradient).all() and gradient.abs().max() > 0, name
    g = torch.Generator().manual_seed(11)
    for _ in range(directions):
        way = torch.randn(leaf.shape, generator=g)
        at = lambda s: float(loss({**tensors, name: tensors[name] + s * step * way}).detach())
        found = (at(1) - at(-1)) / (2 * step)
        expected = float((gradient * way.double()).sum())
        scale = float(gradient.norm() * way.double().norm()) / np.sqrt(leaf.numel())
        assert abs(found - expected) <= 0.005 * abs(expected) + 0.005 * scale, (name, found, expected, scale)


def weighted(images, seed=7):
    g = torch.Generator().manual_seed(seed)
    return sum((image.double() * (torch.rand(image.shape, generator=g) + 0.5)).mean() for image in images)


def rendered_loss(tensors):
    return weighted(sgs.torch.render(**tensors, camera=camera(), depth=True, background=(0.2, 0.3, 0.4)))


@pytest.mark.parametrize("name", ["means", "log_scales", "rotations", "opacity_logits", "sh", "normals"])
def test_gradients_of_rendering_match_central_differences(name):
    compare(rendered_loss, gaussians(), name, 1e-3)


def test_gradient_of_the_pose_matches_central_differences():
    tensors = gaussians()
    tensors["world_to_camera"] = torch.tensor(camera().world_to_camera[:3], dtype=torch.float32)
    compare(rendered_loss, tensors, "world_to_camera", 1e-3)


@pytest.mark.parametrize("name", ["normals", "albedo", "roughness", "metallic", "lights", "lobes"])
def test_gradients_of_shading_match_central_differences(name):
    def loss(tensors):
        return weighted([sgs.torch.shade(**tensors, position=(0, -3, 0.3), normalizer=0.5)])

    compare(loss, pixels(), name, 1e-3)


def test_a_wrong_gradient_is_caught():
    class Wrong(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            return x.clone()

        @staticmethod
        def backward(ctx, g):
            return 1.1 * g

    def loss(tensors):
        return rendered_loss({**tensors, "means": Wrong.apply(tensors["means"])})

    with pytest.raises(AssertionError):
        compare(loss, gaussians(), "means", 1e-3)


def test_rendering_matches_the_run(run):
    g = {name: torch.from_numpy(np.array(values)) for name, values in run.gaussians().items() if values.dtype == np.float32}
    sh = torch.cat([g[f"sh{d}"] for d in range(4) if f"sh{d}" in g], dim=1)
    view = run.scene.test[0]
    found = sgs.torch.render(
        g["means"], g["log_scales"], g["rotations"], g["opacity_logits"], sh, view.camera, depth=True
    )
    images = run.render(view, ["rgb", "alpha", "depth"])
    # The run may round colors to 16 bits and end rays early.
    assert np.abs(found.image.clamp(0, 1).numpy() - images["rgb"]).mean() < 2e-3
    assert np.abs(found.alpha.numpy() - images["alpha"][..., 0]).mean() < 2e-3


def test_a_fit_of_colors_reduces_the_loss():
    tensors = gaussians()
    target = sgs.torch.render(**tensors, camera=camera()).image
    sh = torch.zeros_like(tensors["sh"], requires_grad=True)
    optimizer = torch.optim.Adam([sh], lr=0.05)
    losses = []
    for _ in range(30):
        optimizer.zero_grad()
        loss = (sgs.torch.render(**{**tensors, "sh": sh}, camera=camera()).image - target).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.1 * losses[0]


def test_wrong_tensors_are_refused():
    tensors = gaussians()
    for change, text in [
        ({"sh": tensors["sh"][:, :3]}, "K = 1, 4, 9 or 16"),
        ({"means": tensors["means"].double()}, "must be float32 on cpu"),
        ({"rotations": tensors["rotations"][:-1]}, "rotations has the shape"),
        ({"means": tensors["means"][:0]}, "at least one row"),
    ]:
        with pytest.raises(sgs.Error, match=text) as caught:
            sgs.torch.render(**{**tensors, **change}, camera=camera())
        assert (caught.value.kind, caught.value.status) == ("usage", 2)

"""Drawing of Gaussians: the numba kernels against the dense formulas, in values and gradients;
the formulas against numeric gradients and against gsplat's own torch code."""

from __future__ import annotations

import math
from types import ModuleType, SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
import torch
from torch import Tensor

from pcore.errors import DependencyError, InputError
from pcore.kernels import (
    backends,
    gaussian_projection,
    gaussian_rasterization,
    reference_gaussians,
)
from pcore.kernels.cpu_gaussian_rows import exponential
from pcore.kernels.gaussian_rasterization import rasterization
from same_bits import assert_same_bits

WIDTH, HEIGHT = 37, 29


def some_gaussians(
    count: int = 60, cameras: int = 2, *, dtype: torch.dtype = torch.float64, seed: int = 1
) -> dict[str, Tensor]:
    """Overlapping Gaussians of very different sizes, some beside the picture or behind."""
    draw = torch.Generator().manual_seed(seed)
    viewmats = torch.eye(4, dtype=torch.float64).repeat(cameras, 1, 1)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=draw, dtype=torch.float64))[0]
    turn = turn * torch.linalg.det(turn)
    for camera in range(cameras):
        viewmats[camera, :3, :3] = torch.linalg.matrix_power(turn, camera)
        viewmats[camera, 2, 3] = 4.0
    focal = torch.tensor([[40.0, 0, WIDTH / 2 + 1.5], [0, 43.0, HEIGHT / 2 - 2], [0, 0, 1]])
    spread = torch.tensor([1.0, 1.0, 1.5], dtype=torch.float64)
    found = {
        "means": 1.2 * spread * torch.randn(count, 3, generator=draw, dtype=torch.float64),
        "quats": torch.randn(count, 4, generator=draw, dtype=torch.float64),
        "scales": 0.25 * torch.rand(count, 3, generator=draw, dtype=torch.float64) + 0.01,
        "opacities": torch.rand(count, generator=draw, dtype=torch.float64),
        "colors": torch.rand(cameras, count, 4, generator=draw, dtype=torch.float64),
        "viewmats": viewmats,
        "Ks": focal.double().repeat(cameras, 1, 1),
        "backgrounds": torch.rand(cameras, 4, generator=draw, dtype=torch.float64),
    }
    return {name: tensor.to(dtype) for name, tensor in found.items()}


def drawn(inputs: dict[str, Tensor], **options: Any) -> tuple[Tensor, Tensor]:
    options = {"eps2d": 0.1, "render_mode": "RGB+ED", "rasterize_mode": "antialiased", **options}
    image, alpha, _ = rasterization(
        **{"quats": None, "scales": None, **inputs}, width=WIDTH, height=HEIGHT, **options
    )
    return image, alpha


def with_gradients(inputs: dict[str, Tensor], **options: Any) -> dict[str, Tensor]:
    """Pictures and the gradients of every input for fixed random weights of the pictures."""
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in inputs.items()}
    image, alpha = drawn(leaves, **options)
    draw = torch.Generator().manual_seed(5)
    weights = torch.randn(image.shape, generator=draw, dtype=torch.float64).to(image)
    of_alpha = torch.randn(alpha.shape, generator=draw, dtype=torch.float64).to(image)
    # Depths where next to nothing is drawn are ill-conditioned and no figure that anybody reads.
    weights[..., -1:] *= alpha.detach() > 0.1
    ((image * weights).sum() + (alpha * of_alpha).sum()).backward()
    gradients = {f"d {name}": leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
    return {"image": image.detach()[..., :-1], "alpha": alpha.detach(), **gradients}


def assert_near(found: dict[str, Tensor], expected: dict[str, Tensor], relative: float) -> None:
    assert {*found} == {*expected}
    for name, truth in expected.items():
        error = float((found[name].double() - truth.double()).norm() / truth.double().norm())
        assert error <= relative, f"{name}: {error:.2g} relative"


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("shape", ["quats and scales", "covars"])
@pytest.mark.parametrize(("dtype", "relative"), [(torch.float32, 1e-5), (torch.float64, 1e-12)])
def test_kernels_are_the_formulas(
    mode: str,
    shape: str,
    dtype: torch.dtype,
    relative: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    exact = some_gaussians()
    if shape == "covars":
        exact["covars"] = reference_gaussians.covariances_of(exact["quats"], exact["scales"])
        del exact["quats"], exact["scales"]
    # What float32 cannot hold must not count as an error of the kernels.
    exact = {name: tensor.float().double() for name, tensor in exact.items()}
    found = with_gradients(
        {name: tensor.to(dtype) for name, tensor in exact.items()}, rasterize_mode=mode
    )
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    expected = with_gradients(exact, rasterize_mode=mode)
    assert float(expected["alpha"].max()) > 0.9
    assert_near(found, expected, relative)


def test_gradients_are_those_of_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """With thresholds that nothing crosses: what is drawn of a Gaussian ends at 1 / 255."""
    inputs = some_gaussians(6, 1, seed=3)
    inputs["scales"] = inputs["scales"] + 1.5  # Larger than the picture: no edge in it.
    inputs["opacities"] = 0.2 + 0.3 * inputs["opacities"]
    names = list(inputs)

    def loss(*tensors: Tensor) -> Tensor:
        image, alpha = drawn(dict(zip(names, tensors, strict=True)))
        return torch.stack([image.sin().sum(), alpha.cos().sum()])

    leaves = tuple(tensor.clone().requires_grad_() for tensor in inputs.values())
    # The bottom row of a view matrix is no parameter.
    assert torch.autograd.gradcheck(loss, leaves, eps=1e-6, atol=1e-4, rtol=1e-4)


def test_a_symmetric_covariance_has_a_symmetric_gradient() -> None:
    inputs = some_gaussians()
    inputs["covars"] = reference_gaussians.covariances_of(inputs["quats"], inputs["scales"])
    del inputs["quats"], inputs["scales"]
    gradient = with_gradients(inputs)["d covars"]
    torch.testing.assert_close(gradient, gradient.mT)


def test_one_thread_and_two_give_the_same_bits() -> None:
    inputs = some_gaussians(2000, 3, dtype=torch.float32)
    assert_same_bits(lambda: with_gradients(inputs))
    assert_same_bits(lambda: with_gradients(inputs, render_mode="RGB+MD"))
    assert_same_bits(lambda: {"depth": drawn(inputs, render_mode="RGB+MD")[0][..., -1]})


@pytest.mark.parametrize(("dtype", "relative"), [(torch.float32, 1e-5), (torch.float64, 1e-12)])
def test_the_median_depth_is_that_of_the_formulas(
    dtype: torch.dtype, relative: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In values and gradients; but for it pictures are those without a depth, bit for bit."""
    exact = {name: tensor.float().double() for name, tensor in some_gaussians().items()}
    rounded = {name: tensor.to(dtype) for name, tensor in exact.items()}
    found = with_gradients(rounded, render_mode="RGB+MD")
    image, alpha = drawn(rounded, render_mode="RGB+MD")
    bare, bare_alpha = drawn(rounded, render_mode="RGB")
    assert torch.equal(bare, image[..., :-1])
    assert torch.equal(bare_alpha, alpha)
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    assert_near(found, with_gradients(exact, render_mode="RGB+MD"), relative)
    depth, true_alpha = drawn(exact, render_mode="RGB+MD")
    solid = true_alpha[..., 0] > 0.6
    assert int(solid.sum()) > 100
    torch.testing.assert_close(image[..., -1].double(), depth[..., -1], rtol=1e-6, atol=0)
    expected = drawn(exact)[0][..., -1][solid]
    assert float((depth[..., -1][solid] - expected).abs().max()) > 0.5


def test_the_median_depth_of_an_edge_is_that_of_one_side() -> None:
    """Half a pixel of a wall before another: the nearer one from over half of its opacity on."""
    for opacity, depth in ((0.2, 4.0), (0.45, 4.0), (0.55, 2.0), (0.9, 2.0)):
        inputs = {
            "means": torch.tensor([[0.0, 0.0, 4.0], [0.0, 0.0, 2.0]]),
            "quats": torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1),
            "scales": torch.full((2, 3), 50.0),
            "opacities": torch.tensor([0.999, opacity]),
            "colors": torch.zeros(2, 3),
            "viewmats": torch.eye(4)[None],
            "Ks": torch.tensor([[[50.0, 0, WIDTH / 2], [0, 50.0, HEIGHT / 2], [0, 0, 1]]]),
        }
        image, _ = drawn(inputs, render_mode="RGB+MD")
        torch.testing.assert_close(image[..., 3], torch.full((1, HEIGHT, WIDTH), depth))


def test_cameras_of_a_batch_are_drawn_as_they_are_alone() -> None:
    inputs = some_gaussians(300, 3, dtype=torch.float32)
    image, alpha = drawn(inputs)
    for camera in range(3):
        alone = {
            name: t[camera : camera + 1]
            if name in ("viewmats", "Ks", "colors", "backgrounds")
            else t
            for name, t in inputs.items()
        }
        one_image, one_alpha = drawn(alone)
        assert torch.equal(image[camera], one_image[0])
        assert torch.equal(alpha[camera], one_alpha[0])


def test_the_order_of_the_gaussians_does_not_matter() -> None:
    inputs = some_gaussians(300, 2, dtype=torch.float32)
    order = torch.randperm(300)
    turned = dict(inputs)
    for name in ("means", "quats", "scales", "opacities"):
        turned[name] = inputs[name][order]
    turned["colors"] = inputs["colors"][:, order]
    for found, expected in zip(drawn(turned), drawn(inputs), strict=True):
        assert torch.equal(found, expected)


def test_one_gaussian_is_its_formula() -> None:
    """A round Gaussian in the middle: o exp(-r^2 / 2 s^2), weakened by what the filter widens."""
    sigma, opacity = 0.1, 0.8
    inputs = {
        "means": torch.tensor([[0.0, 0.0, 0.0]]),
        "quats": torch.tensor([[1.0, 0, 0, 0]]),
        "scales": torch.full((1, 3), sigma),
        "opacities": torch.tensor([opacity]),
        "colors": torch.tensor([[0.2, 0.4, 0.6]]),
        "viewmats": torch.eye(4)[None].clone(),
        "Ks": torch.tensor([[[50.0, 0, WIDTH / 2], [0, 50.0, HEIGHT / 2], [0, 0, 1]]]),
    }
    inputs["viewmats"][:, 2, 3] = 2.0
    image, alpha = drawn(inputs, eps2d=0.3)
    across = (50.0 / 2.0 * sigma) ** 2
    rows, columns = torch.meshgrid(
        torch.arange(HEIGHT) + 0.5 - HEIGHT / 2,
        torch.arange(WIDTH) + 0.5 - WIDTH / 2,
        indexing="ij",
    )
    peak = opacity * across / (across + 0.3)
    expected = peak * torch.exp(-(rows**2 + columns**2) / (2 * (across + 0.3)))
    expected = expected.where(expected >= 1 / 255, 0.0)
    torch.testing.assert_close(alpha[0, ..., 0], expected, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(image[0, ..., 1], 0.4 * expected, atol=1e-6, rtol=1e-5)
    drawn_pixels = expected > 0
    torch.testing.assert_close(
        image[0, ..., 3][drawn_pixels], torch.full((int(drawn_pixels.sum()),), 2.0)
    )


@pytest.mark.parametrize("kernels", ["cpu", "reference"])
def test_what_cannot_be_drawn_is_left_out(kernels: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN, nothing at all, behind the camera, transparent: empty pictures and no NaN."""
    monkeypatch.setenv("PCORE_KERNELS", kernels)
    inputs = some_gaussians(4, 1, dtype=torch.float32)
    inputs["means"][0] = math.nan
    inputs["means"][1] = torch.tensor([0.0, 0, -9])
    inputs["opacities"][2:] = 0.003
    del inputs["backgrounds"]
    image, alpha = drawn(inputs)
    assert float(image[..., :-1].abs().max()) == 0
    assert float(alpha.abs().max()) == 0
    assert float(drawn(inputs, render_mode="RGB+MD")[0].abs().max()) == 0
    none = {
        name: t[:, :0] if name == "colors" else t if name in ("viewmats", "Ks") else t[:0]
        for name, t in inputs.items()
    }
    image, alpha = drawn(none, render_mode="RGB+MD")
    assert image.shape == (1, HEIGHT, WIDTH, 5)
    assert float(alpha.abs().max()) == 0


def test_the_gradient_of_means2d_can_be_retained() -> None:
    inputs = some_gaussians(50, 2, dtype=torch.float32)
    inputs["means"].requires_grad_()
    image, _, meta = rasterization(**inputs, width=WIDTH, height=HEIGHT)
    meta["means2d"].retain_grad()
    image.square().mean().backward()
    assert meta["means2d"].grad.shape == (2, 50, 2)
    assert float(meta["means2d"].grad.abs().max()) > 0
    assert (meta["width"], meta["height"], meta["n_cameras"]) == (WIDTH, HEIGHT, 2)


def test_shapes_that_do_not_go_together_are_refused() -> None:
    inputs = some_gaussians(5, 2)
    with pytest.raises(InputError, match=r"opacities of shape \(5,\)"):
        drawn({**inputs, "opacities": inputs["opacities"][:4]})
    with pytest.raises(InputError, match="colors of shape"):
        drawn({**inputs, "colors": inputs["colors"][:1]})
    with pytest.raises(InputError, match="quats and scales, or covars"):
        drawn({name: t for name, t in inputs.items() if name != "scales"})


def test_a_gpu_without_gsplat_is_told_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "has_gsplat", lambda: False)
    means: Any = SimpleNamespace(device=torch.device("cuda"), dtype=torch.float32)
    with pytest.raises(DependencyError, match=r"pcore-edit\[gsplat\]"):
        backends.of_gaussians(means)
    monkeypatch.setattr(backends, "has_gsplat", lambda: True)
    assert backends.of_gaussians(means) == "gsplat"


def test_gsplat_is_not_asked_for_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaussian_rasterization, "of_gaussians", lambda means: "gsplat")
    with pytest.raises(InputError, match=r"got RGB\+MD, for which gsplat has no kernel"):
        drawn(some_gaussians(5, 2), render_mode="RGB+MD")


def test_projection_is_that_of_gsplat() -> None:
    """gsplat's torch code is private and the only part of it that runs on a CPU."""
    oracle = pytest.importorskip(
        "gsplat.cuda._torch_impl", reason="gsplat is not installed (pip install gsplat --no-deps)"
    )
    inputs = some_gaussians(400, 2, dtype=torch.float32)
    covariances = reference_gaussians.covariances_of(inputs["quats"], inputs["scales"])
    truth, _ = oracle._quat_scale_to_covar_preci(inputs["quats"], inputs["scales"], True, False)
    torch.testing.assert_close(covariances, truth, rtol=1e-5, atol=1e-7)
    radii, means2d, depths, conics, shares = oracle._fully_fused_projection(
        inputs["means"],
        truth,
        inputs["viewmats"],
        inputs["Ks"],
        WIDTH,
        HEIGHT,
        eps2d=0.3,
        near_plane=0.01,
        calc_compensations=True,
    )
    entries = gaussian_projection.covariances_of(inputs["quats"], inputs["scales"])
    found = gaussian_projection.project(
        inputs["means"],
        entries,
        inputs["viewmats"],
        inputs["Ks"],
        (WIDTH, HEIGHT),
        near_plane=0.01,
        eps2d=0.3,
    )
    seen = (radii > 0).all(dim=-1)
    assert int(seen.sum()) > 100
    for ours, theirs in (
        (found.means, means2d),
        (found.depths, depths),
        (found.conics, conics),
        (found.shares, shares),
    ):
        torch.testing.assert_close(ours[seen], theirs[seen], rtol=1e-4, atol=1e-5)


def projected(module: ModuleType, inputs: dict[str, Tensor], shares: Tensor) -> list[Tensor]:
    """What is seen in front of the cameras, and gradients by all inputs."""
    own = {name: one.clone().requires_grad_() for name, one in inputs.items()}
    found = module.project(
        own["means"],
        module.covariances_of(own["quats"], own["scales"]),
        own["viewmats"],
        own["Ks"],
        (WIDTH, HEIGHT),
        near_plane=0.3,
        eps2d=0.1,
    )
    values = torch.cat(
        [found.means, found.depths[..., None], found.conics, found.shares[..., None]], dim=-1
    )
    values = values[found.depths > 0.3]
    (values * shares[: len(values)]).sum().backward()
    return [values.detach(), *(one.grad for one in own.values() if one.grad is not None)]


def test_projection_is_the_reference() -> None:
    """Several chunks, three cameras, many beyond the border: values and all gradients."""
    source = torch.Generator().manual_seed(3)
    turns = torch.linalg.qr(torch.randn(3, 3, 3, generator=source, dtype=torch.float64)).Q
    viewmats = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    viewmats[:, :3, :3], viewmats[:, 2, 3] = turns, 2.5
    lens = torch.tensor([[60.0, 0, 20], [0, 50, 15], [0, 0, 1]], dtype=torch.float64)
    inputs = {
        "means": 1.5 * torch.randn(600, 3, generator=source, dtype=torch.float64),
        "quats": torch.randn(600, 4, generator=source, dtype=torch.float64),
        "scales": 0.01 + 0.1 * torch.rand(600, 3, generator=source, dtype=torch.float64),
        "viewmats": viewmats,
        "Ks": lens.repeat(3, 1, 1),
    }
    shares = torch.randn(1800, 7, generator=source, dtype=torch.float64)
    ours = projected(gaussian_projection, inputs, shares)
    theirs = projected(reference_gaussians, inputs, shares)
    assert len(ours) == 6
    assert 1000 < len(ours[0]) < 1800
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-10 * float(other.abs().max()))
    again = projected(gaussian_projection, inputs, shares)
    assert all(torch.equal(one, other) for one, other in zip(ours, again, strict=True))


def test_second_derivatives_are_refused() -> None:
    inputs = some_gaussians(20, 1)
    inputs["means"].requires_grad_()
    image, _ = drawn(inputs)
    (slope,) = torch.autograd.grad(image.square().sum(), inputs["means"], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


def test_what_is_hidden_may_have_any_colour() -> None:
    inputs = {
        "means": torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 3.0], [0.0, 0.0, 4.0], [0.0, 0.0, 5.0]]),
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(4, 1),
        "scales": torch.full((4, 3), 1.0),
        "opacities": torch.full((4,), 0.9999),
        "colors": torch.tensor([[0.5], [0.5], [0.5], [math.inf]], requires_grad=True),
        "viewmats": torch.eye(4)[None],
        "Ks": torch.tensor([[[8.0, 0.0, 4.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]]]),
    }
    image, _, _ = rasterization(**inputs, width=8, height=8)
    assert math.isclose(float(image.detach()[0, 4, 4, 0]), 0.5, abs_tol=1e-3)
    image[0, 4, 4].sum().backward()
    gradient = inputs["colors"].grad
    assert gradient is not None
    assert float(gradient[3]) == 0
    assert 0.9 < float(gradient[0]) < 1


def test_the_exponential_is_that_of_the_library() -> None:
    powers = np.linspace(-6, 0, 100_001, dtype=np.float32)

    @numba.njit(fastmath={"reassoc", "contract", "nsz"})
    def all_of(powers: np.ndarray, found: np.ndarray) -> None:
        for k in range(len(powers)):
            found[k] = exponential(powers[k])

    found = np.empty_like(powers)
    all_of(powers, found)
    assert np.abs(found / np.exp(powers.astype(np.float64)) - 1).max() < 1e-7

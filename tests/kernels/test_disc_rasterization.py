"""Drawing of flat Gaussians: the numba kernels against the published formulas, in values and
gradients; the formulas against gsplat's own torch code."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tests.kernels.test_gaussian_rasterization import (
    HEIGHT,
    WIDTH,
    assert_near,
    some_gaussians,
)
from torch import Tensor

from pcore.errors import DependencyError, InputError
from pcore.geometry.rotation import rotations
from pcore.kernels import backends
from pcore.kernels.disc_projection import disc_normals, project_discs
from pcore.kernels.disc_rasterization import rasterization_2dgs
from pcore.kernels.gaussian_rasterization import rasterization
from pcore.kernels.reference_discs import ray_transforms
from same_bits import assert_same_bits


def drawn(inputs: dict[str, Tensor], **options: Any) -> tuple[Tensor, Tensor, Tensor]:
    options = {"eps2d": 0.3, "render_mode": "RGB+ED", **options}
    image, alpha, normals, _ = rasterization_2dgs(
        **{"quats": None, "scales": None, **inputs}, width=WIDTH, height=HEIGHT, **options
    )
    return image, alpha, normals


def with_gradients(inputs: dict[str, Tensor], **options: Any) -> dict[str, Tensor]:
    """Pictures and the gradients of every input for fixed random weights of the pictures."""
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in inputs.items()}
    image, alpha, normals = drawn(leaves, **options)
    draw = torch.Generator().manual_seed(5)
    total = torch.zeros((), dtype=image.dtype)
    for one in (image, alpha, normals):
        weights = torch.randn(one.shape, generator=draw, dtype=torch.float64).to(image)
        if one is image:
            # Depths where next to nothing is drawn are ill-conditioned and nobody's figure.
            weights[..., -1:] *= alpha.detach() > 0.1
        total = total + (one * weights).sum()
    total.backward()
    # Of the matrices' other entries the kernels know that they are constant.
    assert leaves["Ks"].grad is not None
    leaves["Ks"].grad *= torch.tensor([[1, 0, 1], [0, 1, 1], [0, 0, 0]])
    gradients = {f"d {name}": leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
    depth = (image[..., -1:] * alpha).detach()
    found = {"image": image.detach()[..., :-1], "depth": depth, "alpha": alpha.detach()}
    return {**found, "normals": normals.detach(), **gradients}


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize(("render_mode", "worse"), [("RGB+ED", 1), ("RGB+MD", 2)])
@pytest.mark.parametrize("shape", ["quats and scales", "tangents"])
@pytest.mark.parametrize(
    ("dtype", "widened", "bare"), [(torch.float32, 1e-5, 3e-5), (torch.float64, 1e-10, 1e-10)]
)
def test_kernels_are_the_formulas(
    mode: str,
    render_mode: str,
    worse: int,
    shape: str,
    dtype: torch.dtype,
    widened: float,
    bare: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bare discs that stand nearly across the view are as sharp as pixels are exact; in the depth
    of one alone nothing averages that."""
    exact = some_gaussians()
    exact["scales"] = 1.5 * exact["scales"]  # Some of them reach behind the camera.
    if shape == "tangents":
        # Sheared, as an affine map leaves them.
        exact["tangents"] = tangents_of(exact) @ torch.tensor([[1.0, 0.6], [0.0, 0.8]]).double()
        del exact["quats"], exact["scales"]
    exact = {name: tensor.float().double() for name, tensor in exact.items()}
    options = {"rasterize_mode": mode, "render_mode": render_mode}
    rounded = {name: tensor.to(dtype) for name, tensor in exact.items()}
    found = with_gradients(rounded, **options)
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    expected = with_gradients(exact, **options)
    assert float(expected["alpha"].max()) > 0.8
    assert_near(found, expected, worse * bare if mode == "classic" else widened)


def tangents_of(inputs: dict[str, Tensor]) -> Tensor:
    return rotations(inputs["quats"])[..., :2] * inputs["scales"][:, None, :2]


def test_one_thread_and_two_give_the_same_bits() -> None:
    inputs = some_gaussians(2000, 3, dtype=torch.float32)
    assert_same_bits(lambda: with_gradients(inputs))
    assert_same_bits(lambda: with_gradients(inputs, render_mode="RGB+MD"))


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_gradients_are_those_of_finite_differences(mode: str) -> None:
    """With thresholds that nothing crosses: what is drawn of a disc ends at 1 / 255."""
    inputs = some_gaussians(6, 1, seed=3)
    inputs["scales"] = inputs["scales"] + 1.5  # Larger than the picture: no edge in it.
    inputs["opacities"] = 0.2 + 0.3 * inputs["opacities"]
    names = list(inputs)

    def loss(*tensors: Tensor) -> Tensor:
        image, alpha, _ = drawn(dict(zip(names, tensors, strict=True)), rasterize_mode=mode)
        # Horizons of discs cross the picture, where depths are without bounds.
        return torch.stack([image[..., :-1].sin().sum(), alpha.cos().sum()])

    leaves = tuple(tensor.clone().requires_grad_() for tensor in inputs.values())
    assert torch.autograd.gradcheck(loss, leaves, eps=1e-6, atol=1e-4, rtol=1e-4)


def test_transforms_are_those_of_gsplat() -> None:
    """gsplat's torch code is private and the only part of it that runs on a CPU."""
    oracle = pytest.importorskip(
        "gsplat.cuda._torch_impl_2dgs",
        reason="gsplat is not installed (pip install gsplat --no-deps)",
    )
    inputs = some_gaussians(400, 2, dtype=torch.float32)
    exact = {name: tensor.double() for name, tensor in inputs.items()}
    names = ("means", "quats", "scales", "viewmats", "Ks")
    round_ = torch.ones_like(inputs["scales"])
    round_[:, :2] = inputs["scales"][:, :2]  # gsplat's normals are as long as the third scale.
    given = {**inputs, "scales": round_}
    radii, _, depths, transforms, normals = oracle._fully_fused_projection_2dgs(
        *(given[name] for name in names), WIDTH, HEIGHT
    )
    tangents = tangents_of(exact)
    seen = (radii > 0).all(dim=-1) & (depths > 0.5)
    assert int(seen.sum()) > 100
    ours = ray_transforms(exact["means"], tangents, exact["viewmats"], exact["Ks"])
    torch.testing.assert_close(ours[seen].float(), transforms[seen], rtol=1e-4, atol=1e-4)
    towards = disc_normals(exact["means"], tangents, exact["viewmats"])
    # Theirs are in the camera's frame.
    local = torch.einsum("cij,cnj->cni", exact["viewmats"][:, :3, :3], towards)
    torch.testing.assert_close(local[seen].float(), normals[seen], rtol=1e-4, atol=1e-5)
    found = project_discs(
        exact["means"], tangents, exact["viewmats"], exact["Ks"], near_plane=0.01, eps2d=None
    )
    torch.testing.assert_close(found.depths[seen].float(), depths[seen])
    # A pixel near the middle, by the planes of its column and row, and by our map.
    pixel = found.means + torch.tensor([0.4, -0.3])
    m = transforms.double()
    met = torch.linalg.cross(
        pixel[..., :1] * m[..., 2, :] - m[..., 0, :], pixel[..., 1:] * m[..., 2, :] - m[..., 1, :]
    )
    theirs = (met[..., :2] / met[..., 2:]).square().sum(dim=-1)
    p, q, w = (found.maps[..., k : k + 2] @ torch.tensor([0.4, -0.3]).double() for k in (0, 2, 4))
    inside = seen & (theirs < 10)
    assert int(inside.sum()) > 100
    torch.testing.assert_close(
        ((p.square() + q.square()) / (1 + w).square())[inside], theirs[inside], rtol=1e-3, atol=1e-4
    )


def middle(tangents: list[list[float]], depth: float = 2.0) -> dict[str, Tensor]:
    """One disc in the middle of the picture."""
    inputs = {
        "means": torch.tensor([[0.0, 0.0, 0.0]]),
        "tangents": torch.tensor([tangents]),
        "opacities": torch.tensor([0.8]),
        "colors": torch.tensor([[0.2, 0.4, 0.6]]),
        "viewmats": torch.eye(4)[None].clone(),
        "Ks": torch.tensor([[[50.0, 0, WIDTH / 2], [0, 50.0, HEIGHT / 2], [0, 0, 1]]]),
    }
    inputs["viewmats"][:, 2, 3] = depth
    return inputs


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_depth_is_where_rays_meet_the_disc(mode: str) -> None:
    """A tilted plane z = 2 + x through the axis: at slope s the ray meets it at z = 2 / (1 - s)."""
    inputs = middle([[0.5, 0.0], [0.0, 0.5], [0.5, 0.0]])
    image, alpha, normals = drawn(inputs, rasterize_mode=mode, eps2d=1e-6)
    slope = (torch.arange(WIDTH) + 0.5 - WIDTH / 2) / 50.0
    expected = (2 / (1 - slope)).expand(HEIGHT, WIDTH)
    shown = alpha[0, ..., 0] > 0.05
    assert int(shown.sum()) > 100
    torch.testing.assert_close(image[0, ..., -1][shown], expected[shown], rtol=1e-4, atol=0)
    facing = normals[0][shown] / alpha[0][shown]
    half = math.sqrt(0.5)
    torch.testing.assert_close(facing, torch.tensor([half, 0, -half]).expand_as(facing))


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_a_disc_across_the_view_is_drawn_and_has_gradients(mode: str) -> None:
    """Exactly edge-on: as published the filter alone is seen, a widened disc fades to nothing."""
    inputs = middle([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])
    inputs["tangents"].requires_grad_()
    image, alpha, _ = drawn(inputs, rasterize_mode=mode, eps2d=0.5)
    if mode == "classic":
        # Round, and 0.8 at the middle, which lies 0.5 pixels from four centres... of one, here.
        assert float(alpha.detach().max()) == pytest.approx(0.8, abs=1e-5)
    else:
        assert float(alpha.detach().max()) < 0.01
    (image.sum() + alpha.sum()).backward()
    assert inputs["tangents"].grad is not None
    assert bool(inputs["tangents"].grad.isfinite().all())


def test_widened_discs_are_flat_gaussians_of_the_same_picture() -> None:
    """Seen from afar, where perspective is next to none, they are drawn as 3D Gaussians are."""
    inputs: dict[str, Any] = some_gaussians(60, 2)
    inputs["means"] = 0.5 * inputs["means"]
    inputs["viewmats"][:, 2, 3] += 400.0
    inputs["Ks"][:, 0, 0] *= 100
    inputs["Ks"][:, 1, 1] *= 100
    inputs["scales"][:, 2] = 1e-9
    image, alpha, _ = drawn(inputs, rasterize_mode="antialiased")
    expected, clear, _ = rasterization(
        **inputs, width=WIDTH, height=HEIGHT, eps2d=0.3, rasterize_mode="antialiased"
    )
    assert float(alpha.max()) > 0.5
    # At the rim, 1 / 255, one or the other may be cut.
    torch.testing.assert_close(alpha, clear, atol=5e-3, rtol=0)
    torch.testing.assert_close(image[..., :-1], expected, atol=5e-3, rtol=0)


@pytest.mark.parametrize("kernels", ["cpu", "reference"])
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_what_cannot_be_drawn_is_left_out(
    kernels: str, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PCORE_KERNELS", kernels)
    inputs = some_gaussians(5, 1, dtype=torch.float32)
    inputs["means"][0] = math.nan
    inputs["means"][1] = torch.tensor([0.0, 0, -9])
    inputs["scales"][2] = math.nan
    inputs["opacities"][3:] = 0.003
    del inputs["backgrounds"]
    image, alpha, _ = drawn(inputs, rasterize_mode=mode)
    assert float(image[..., :-1].abs().max()) == 0
    assert float(alpha.abs().max()) == 0


def test_wrong_shapes_and_a_gpu_are_refused() -> None:
    inputs = some_gaussians(5, 2)
    with pytest.raises(InputError, match="quats and scales, or tangents"):
        drawn({name: t for name, t in inputs.items() if name != "scales"})
    with pytest.raises(InputError, match=r"tangents of shape \(5, 3, 2\)"):
        drawn({**inputs, "tangents": torch.zeros(5, 3, 3)})
    means: Any = SimpleNamespace(device=torch.device("cuda"), dtype=torch.float32)
    with pytest.raises(DependencyError, match="--device cpu"):
        backends.of_discs(means)

"""Surface consistency: exact for the identity, gradients only where the paper wants them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from pcore.deform.base import Affine, Deformation, Identity
from pcore.deform.simple import uniform_scale
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.render.image import Image
from pcore.render.picture import render_rays
from pcore.training.consistency import (
    Canonical,
    Consistency,
    canonical_of,
    consistency,
    points_only_rays,
    rays_and_points_rays,
)
from ray_pictures import moved
from small_training import box_cloud, box_model
from tiny_scene import orbit

MIDDLE = torch.tensor([0.1, -0.05, 0.08])
TWICE = uniform_scale(2.0, MIDDLE)
SHEAR = Affine(torch.eye(3) + torch.tensor([[0, 0.3, 0], [0, 0, 0.2], [0.1, 0, 0]]), 0.2 * MIDDLE)
ALPHA = 0.5
UNIT = 2.0


def rays() -> RayBundle:
    return orbit(3)[0].rays(4, 4, 16, 16)


def model(*, cutoff: float | None = None) -> tuple[Papr, PointCloud]:
    base = box_model(150)
    if cutoff is None:
        return base.papr, base.cloud
    papr = Papr(replace(base.papr.config, cutoff=cutoff))
    papr.load_state_dict(base.papr.state_dict())
    return papr.requires_grad_(False), base.cloud


def canonical(papr: Papr, cloud: PointCloud) -> tuple[Canonical, Image]:
    image = render_rays(papr, PosedCloud.at_rest(cloud), rays())
    # The median splits the rays of these random networks into object and background.
    alpha = float(image.alpha.detach().median())
    return canonical_of(image, cloud, rays(), image.rgb, alpha), image


def moved_rays(mode: str, known: Canonical, field: Deformation, distance: float = 0.5) -> RayBundle:
    if mode == "points":
        return points_only_rays(rays(), known, field)
    return rays_and_points_rays(rays(), known, field, distance)


def compare(
    papr: Papr,
    cloud: PointCloud,
    known: Canonical,
    along: RayBundle,
    field: Deformation,
    *,
    unit: float = UNIT,
    background_rays: bool = True,
) -> Consistency:
    image = render_rays(papr, moved(cloud, field(cloud.positions)), along)
    return consistency(
        image, known, field(known.surface), unit=unit, background_rays=background_rays
    )


# --- where rays end ---------------------------------------------------------------------------


@pytest.mark.parametrize("cutoff", [None, 0.15])
def test_ends_lie_on_their_rays(cutoff: float | None) -> None:
    papr, cloud = model(cutoff=cutoff)
    known, image = canonical(papr, cloud)
    offset = known.ends - rays().origins
    across = torch.linalg.cross(offset, rays().directions)
    assert across.norm(dim=-1).max() < 1e-5
    # Beside the surface point, or the nearest point where there is no surface.
    assert 0 < int(known.foreground.sum()) < known.foreground.numel()
    hits = image.ray_hits
    nearest = cloud.positions[hits.neighbours[:, 0]].view_as(known.ends)
    centroid = hits.centroid.view_as(nearest)
    target = torch.where(known.foreground[..., None], centroid, nearest)
    beside = ((target - known.ends) * rays().directions).sum(dim=-1)
    assert beside.abs().max() < 1e-5


def test_the_foreground_is_what_is_opaque() -> None:
    papr, cloud = model()
    image = render_rays(papr, PosedCloud.at_rest(cloud), rays())
    known = canonical_of(image, cloud, rays(), image.rgb, 0.01)
    assert torch.equal(known.foreground, image.alpha > 0.01)


# --- the deformed rays ------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["points", "rays"])
def test_the_identity_reproduces_the_canonical_rays(mode: str) -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    again = moved_rays(mode, known, Identity(), 1.0)
    assert torch.allclose(again.origins, rays().origins, atol=1e-6)
    assert torch.allclose(again.directions, rays().directions, atol=1e-6)
    assert again.shape == (16, 16)


@pytest.mark.parametrize("mode", ["points", "rays"])
@pytest.mark.parametrize("field", [TWICE, SHEAR])
def test_deformed_rays_pass_through_the_deformed_ends(mode: str, field: Deformation) -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    along = moved_rays(mode, known, field)
    offset = field(known.ends) - along.origins
    assert torch.linalg.cross(offset, along.directions).norm(dim=-1).max() < 1e-5
    # Forwards, not backwards.
    assert ((offset * along.directions).sum(dim=-1) > 0).all()
    assert torch.allclose(along.directions.norm(dim=-1), torch.ones(16, 16), atol=1e-6)


def test_points_only_keeps_the_camera() -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    along = points_only_rays(rays(), known, SHEAR)
    assert torch.equal(along.origins, rays().origins)
    assert not torch.allclose(along.directions, rays().directions, atol=1e-3)


@pytest.mark.parametrize("distance", [0.1, 0.5, 1.0])
def test_rays_and_points_carries_origins_near_the_surface_along(distance: float) -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    along = rays_and_points_rays(rays(), known, SHEAR, distance)
    near = torch.lerp(known.ends, rays().origins, distance)
    assert torch.allclose(along.origins, SHEAR(near), atol=1e-5)


@pytest.mark.parametrize("field", [Identity(), TWICE, SHEAR])
def test_origins_slide_back_to_the_distance_of_the_camera(field: Deformation) -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    near = rays_and_points_rays(rays(), known, field, 0.3)
    far = rays_and_points_rays(rays(), known, field, 0.3, keep_distance=True)
    assert torch.equal(far.directions, near.directions)
    across = torch.linalg.cross(far.origins - near.origins, near.directions)
    assert across.norm(dim=-1).max() < 1e-5
    distance = (rays().origins - known.ends).norm(dim=-1)
    assert torch.allclose((far.origins - field(known.ends)).norm(dim=-1), distance, atol=1e-5)


def test_scaling_about_a_point_keeps_directions() -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    along = rays_and_points_rays(rays(), known, TWICE, 1.0)
    assert torch.allclose(along.directions, rays().directions, atol=1e-6)
    assert torch.allclose(along.origins, 2 * rays().origins - MIDDLE, atol=1e-5)


# --- the losses -------------------------------------------------------------------------------


@pytest.mark.parametrize("cutoff", [None, 0.15])
@pytest.mark.parametrize("mode", ["points", "rays"])
def test_the_identity_costs_nothing(mode: str, cutoff: float | None) -> None:
    papr, cloud = model(cutoff=cutoff)
    known, _ = canonical(papr, cloud)
    found = compare(papr, cloud, known, moved_rays(mode, known, Identity(), 1.0), Identity())
    assert float(found.geometry) < 1e-10
    assert float(found.texture) < 1e-10


def test_losses_are_the_formulas_of_the_paper() -> None:
    papr, cloud = model()
    known, image = canonical(papr, cloud)
    along = points_only_rays(rays(), known, SHEAR)
    found = compare(papr, cloud, known, along, SHEAR)
    again = render_rays(papr, moved(cloud, SHEAR(cloud.positions)), along)
    offset = again.ray_hits.centroid - SHEAR(image.ray_hits.centroid)
    offset = offset.view_as(known.surface)[known.foreground] / UNIT
    assert float(found.geometry) == pytest.approx(float(offset.square().sum(dim=-1).mean()))
    assert float(found.geometry) > 1e-6
    assert float(found.texture) == pytest.approx(float((again.rgb - image.rgb).square().mean()))
    assert float(found.texture) > 1e-8


def test_geometry_is_measured_in_units() -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    along = points_only_rays(rays(), known, SHEAR)
    one, three = (
        float(compare(papr, cloud, known, along, SHEAR, unit=unit).geometry) for unit in (1, 3)
    )
    assert one == pytest.approx(9 * three)


def test_background_rays_enter_the_texture_loss_or_not() -> None:
    papr, cloud = model()
    known, image = canonical(papr, cloud)
    along = moved_rays("rays", known, Identity(), 1.0)
    # The target is wrong by 0.5 on the background alone.
    wrong = image.rgb.detach() + 0.5 * (~known.foreground).unsqueeze(-1)
    known = replace(known, rgb=wrong)
    share = float((~known.foreground).float().mean())
    within = compare(papr, cloud, known, along, Identity(), background_rays=False)
    whole = compare(papr, cloud, known, along, Identity(), background_rays=True)
    assert float(within.texture) < 1e-10
    assert float(whole.texture) == pytest.approx(0.25 * share, rel=1e-3)


def test_without_foreground_there_is_no_geometry_loss() -> None:
    papr, cloud = model()
    known, _ = canonical(papr, cloud)
    known = replace(known, foreground=torch.zeros_like(known.foreground))
    along = points_only_rays(rays(), known, SHEAR)
    found = compare(papr, cloud, known, along, SHEAR, background_rays=False)
    assert (float(found.geometry), float(found.texture)) == (0.0, 0.0)


# --- stop-gradient ----------------------------------------------------------------------------


def live_model() -> tuple[Papr, PointCloud]:
    papr = box_model(150).papr.requires_grad_(True)
    cloud = box_cloud(150)
    return papr, PointCloud(
        positions=nn.Parameter(cloud.positions),
        features=nn.Parameter(cloud.features),
        influence=nn.Parameter(cloud.influence),
    )


def tensors(known: Canonical) -> dict[str, Tensor]:
    return {name: getattr(known, name) for name in ("surface", "ends", "rgb")}


@pytest.mark.parametrize("mode", ["points", "rays"])
def test_no_gradient_flows_into_the_canonical_state(mode: str) -> None:
    """The same gradients as from numbers that were never part of a graph."""
    gradients: list[dict[str, Tensor]] = []
    for cut in (False, True):
        papr, cloud = live_model()
        known, _ = canonical(papr, cloud)
        assert not any(tensor.requires_grad for tensor in tensors(known).values())
        if cut:
            frozen = {name: t.detach().clone() for name, t in tensors(known).items()}
            known = replace(known, **frozen)
        along = moved_rays(mode, known, SHEAR)
        assert not along.directions.requires_grad
        found = compare(papr, cloud, known, along, SHEAR)
        (found.geometry + found.texture).backward()
        named = {**dict(papr.named_parameters()), "influence": cloud.influence}
        gradients.append({n: p.grad for n, p in named.items() if p.grad is not None})
    assert gradients[0].keys() == gradients[1].keys()
    for name, gradient in gradients[0].items():
        assert torch.equal(gradient, gradients[1][name]), name
    assert float(gradients[0]["influence"].abs().max()) > 0


def test_the_geometry_gradient_is_that_of_a_fixed_target() -> None:
    """Against finite differences in which only the deformed pass sees the change."""
    papr, cloud = live_model()
    known, _ = canonical(papr, cloud)
    along = points_only_rays(rays(), known, SHEAR)
    compare(papr, cloud, known, along, SHEAR).geometry.backward()
    gradient = cloud.influence.grad
    assert gradient is not None
    strongest = int(gradient.abs().argmax())

    def loss(step: float) -> float:
        with torch.no_grad():
            influence = cloud.influence.clone()
            influence[strongest] += step
            changed = PointCloud(
                positions=cloud.positions, features=cloud.features, influence=influence
            )
            return float(compare(papr, changed, known, along, SHEAR).geometry.double())

    slope = (loss(0.05) - loss(-0.05)) / 0.1
    assert slope == pytest.approx(float(gradient[strongest]), rel=0.05)
    assert abs(slope) > 1e-6


def test_points_get_gradients_through_the_deformed_pass() -> None:
    papr, cloud = live_model()
    known, _ = canonical(papr, cloud)
    found = compare(papr, cloud, known, points_only_rays(rays(), known, SHEAR), SHEAR)
    found.geometry.backward()
    assert cloud.positions.grad is not None
    assert float(cloud.positions.grad.abs().max()) > 0

"""What is asked of an object wrongly is said so, and never drawn as something else."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from tests.cli.toys import CONFIG, toy_cameras, toy_cloud
from tests.gaussians.some import some_gaussians
from torch import Tensor

import pcore
from pcore.asset.asset import Asset
from pcore.asset.saving import asset_of
from pcore.deform.base import Affine
from pcore.deform.simple import uniform_scale
from pcore.errors import EditError, InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.camera import Camera
from pcore.geometry.rotation import rotations
from pcore.model.papr import Papr

KINDS = ("neural points", "gaussians")
CLOUD = toy_cloud()


@pytest.fixture(params=KINDS)
def asset(request: pytest.FixtureRequest) -> Asset:
    return made(request.param)


def made(kind: str, shift: float = 0.0) -> Asset:
    cloud = replace(CLOUD, positions=CLOUD.positions + shift)
    if kind == "neural points":
        torch.manual_seed(0)  # The same networks every time.
        return asset_of(Papr(CONFIG).requires_grad_(False).eval(), cloud)
    count = len(cloud)
    return asset_of(
        Gaussians(
            means=cloud.positions,
            quats=torch.eye(4)[:1].repeat(count, 1),
            scales=torch.full((count, 3), 0.05),
            opacities=torch.full((count,), 0.8),
            sh=torch.zeros(count, 1, 3),
        )
    )


@pytest.fixture
def camera() -> Camera:
    return toy_cameras(1, size=8)[0]


@pytest.mark.parametrize("names", [{"rays": "awear"}, {"light": "stil"}])
def test_a_name_with_a_slip_of_the_pen(asset: Asset, names: Any) -> None:
    ((what, wrong),) = names.items()
    with pytest.raises(InputError, match=f"{what}: expected one of .*, got {wrong!r}"):
        asset.pose(uniform_scale(1.2), **names)


def test_points_that_are_torn_to_nan(asset: Asset, camera: Camera) -> None:
    positions = asset.points.clone()
    positions[3] = math.nan
    with pytest.raises(InputError, match=r"NaN or infinity in .*1 of "):
        asset.render(asset.pose(pcore.MovedPoints(positions=positions)), camera)


def test_maps_of_moved_points_are_estimated_where_rays_ask_for_them(camera: Camera) -> None:
    neural = asset_of(Papr(CONFIG).requires_grad_(False).eval(), toy_cloud())
    for asset in (asset_of(some_gaussians(60)), neural):
        turned = Affine(rotations(torch.tensor([1.0, 0.0, 0.5, 0.2])), torch.zeros(3))
        exact = asset.pose(turned, light="baked")
        moved = pcore.MovedPoints(positions=exact.points)
        posed = asset.pose(moved, light="baked")
        assert posed.local_maps is not None
        assert exact.local_maps is not None
        torch.testing.assert_close(
            posed.local_maps.to_rest, exact.local_maps.to_rest, atol=1e-4, rtol=0
        )
        torch.testing.assert_close(
            asset.render(posed, camera).rgb, asset.render(exact, camera).rgb, atol=1e-3, rtol=0
        )
        assert asset.pose(moved, rays="plain").local_maps is None
        still = asset.pose(pcore.MovedPoints(positions=asset.points))
        assert torch.equal(asset.render(still, camera).rgb, asset.render(None, camera).rgb)
        followed = pcore.MovedPoints(positions=exact.points.clone().requires_grad_())
        with pytest.raises(EditError, match="draw with plain rays"):
            asset.pose(followed)
        assert asset.pose(followed, rays="plain").points.requires_grad


def test_rays_that_are_no_unit_vectors_or_none_at_all(asset: Asset, camera: Camera) -> None:
    rays = camera.rays()
    longer = replace(rays, directions=2 * rays.directions)
    with pytest.raises(InputError, match="of unit length, got lengths up to 2"):
        asset.trace(None, longer)
    with pytest.raises(InputError, match="of unit length, got no rays"):
        asset.trace(None, rays[:0])


def test_rays_of_another_type_and_colours_as_numbers(asset: Asset, camera: Camera) -> None:
    rays = camera.rays()
    exact = rays.each(Tensor.double)
    red = torch.tensor([1.0, 0.0, 0.0])
    expected = asset.trace(None, rays, red)
    torch.testing.assert_close(asset.trace(None, exact, (1.0, 0.0, 0.0)).rgb, expected.rgb)
    with pytest.raises(InputError, match=r"expected `camera.rays\(\)`, got Camera"):
        asset.trace(None, camera)  # pyright: ignore[reportArgumentType]


def test_rays_from_nowhere(asset: Asset, camera: Camera) -> None:
    rays = camera.rays()
    with pytest.raises(InputError, match="rays: expected finite origins"):
        asset.trace(None, replace(rays, origins=rays.origins * math.nan))


@pytest.mark.parametrize(
    "color", [(0.2, 0.1), (0.0, 0.0, 255.0), "white", torch.ones(8, 8, 3), (0.0, 0.0, math.nan)]
)
def test_a_background_that_is_no_colour(asset: Asset, camera: Camera, color: Any) -> None:
    for ask in (lambda: asset.over(color), lambda: asset.trace(None, camera.rays(), color)):
        with pytest.raises(InputError, match=r"background: expected red, green and blue in \[0, 1"):
            ask()


def test_a_background_is_followed_where_it_can_be(asset: Asset, camera: Camera) -> None:
    color = torch.tensor([0.2, 0.4, 0.6], requires_grad=True)
    image = asset.trace(None, camera.rays(), color)
    (gradient,) = torch.autograd.grad(image.rgb.sum(), color)
    torch.testing.assert_close(gradient, (1 - image.alpha).sum().expand(3))
    with pytest.raises(InputError, match="a gradient is asked for, and a background that is kept"):
        asset.over(color)
    kept, same = asset.over(color.detach()), asset.over((0.2, 0.4, 0.6))
    assert torch.equal(kept.render(None, camera).rgb, same.render(None, camera).rgb)


def test_what_rays_hit_is_not_known_of_cameras(asset: Asset, camera: Camera) -> None:
    with pytest.raises(InputError, match=r"only `asset.trace` of neural points keeps"):
        _ = asset.render(None, camera).ray_hits


def test_rays_that_are_no_picture_for_networks(camera: Camera) -> None:
    points = asset_of(Papr(CONFIG).requires_grad_(False).eval(), toy_cloud())
    for rays in (camera.rays()[0], camera.rays()[:3]):
        with pytest.raises(InputError, match="at least 4 x 4 of them"):
            points.trace(None, rays)


def test_numbers_of_a_camera_are_one_or_one_of_each(camera: Camera) -> None:
    batch = Camera.stack([camera, camera])
    with pytest.raises(InputError, match=r"fx as a number or one of each camera, .* shape \(3,\)"):
        replace(batch, fx=torch.ones(3))
    with pytest.raises(InputError, match=r"cy as a number, got a tensor of shape \(2,\)"):
        replace(camera, cy=torch.ones(2))


USES: dict[str, Callable[[Asset, Any, Camera], object]] = {
    "render": lambda asset, posed, camera: asset.render(posed, camera),
    "render several": lambda asset, posed, camera: asset.render(posed, [camera]),
    "trace": lambda asset, posed, camera: asset.trace(posed, camera.rays()),
    "film": lambda asset, posed, camera: next(asset.film([posed], [camera])),
    "film_detail": lambda asset, posed, camera: asset.film_detail([posed], [camera]),
    "lit": lambda asset, posed, _: asset.lit(posed),
    "gains_of": lambda asset, posed, _: asset.gains_of(posed),
    "splats": lambda asset, posed, _: asset.splats(
        posed, torch.zeros(3), gains=torch.ones(len(asset))
    ),
}


@pytest.mark.parametrize("use", USES)
def test_a_pose_of_another_object(asset: Asset, camera: Camera, use: str) -> None:
    for kind in KINDS:
        other = made(kind, shift=0.01)
        with pytest.raises(InputError, match=r"expected a pose of its own \d+ points .* others \("):
            USES[use](asset, other.pose(uniform_scale(1.2)), camera)


def test_what_is_no_pose_and_a_session_of_another_object(asset: Asset, camera: Camera) -> None:
    for use in USES.keys() - {"splats"}:
        with pytest.raises(InputError, match=r"expected what .* returns, got EditSession"):
            USES[use](asset, asset.session(), camera)
    with pytest.raises(InputError, match=r"expected edits bound to the .* points of this asset"):
        asset.splats(made("gaussians", 0.01).session(), torch.zeros(3))


@pytest.mark.parametrize("kind", KINDS)
def test_a_pose_of_the_other_kind(kind: str, camera: Camera) -> None:
    """The points may even be the same."""
    one, other = made(kind), made(KINDS[1 - KINDS.index(kind)])
    assert torch.equal(one.points, other.points)
    with pytest.raises(InputError, match="expected a pose of its own"):
        one.render(other.pose(), camera)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pose_of_the_same_object_with_another_look(kind: str, camera: Camera) -> None:
    """Read a second time, before another background, or with colours that were learned anew."""
    first = made(kind)
    posed = first.pose(uniform_scale(1.2))
    dark = first.over((0.0, 0.0, 0.0))
    own = dark.render(dark.pose(uniform_scale(1.2)), camera)
    assert torch.equal(dark.render(posed, camera).rgb, own.rgb)
    shown = first.render(posed, camera).rgb
    content: Any = first.content
    assert torch.equal(made(kind).render(posed, camera).rgb, shown)
    if kind == "neural points":
        cloud = replace(content.cloud, features=content.cloud.features + 1.0)
        colored = replace(content, cloud=cloud)
    else:
        gaussians = content.gaussians
        colored = replace(content, gaussians=replace(gaussians, sh=gaussians.sh + 1.0))
    other = replace(first, content=colored)
    assert torch.equal(other.render(posed, camera).rgb, shown)  # A pose has its colours.
    assert not torch.equal(other.render(other.pose(uniform_scale(1.2)), camera).rgb, shown)


@pytest.mark.parametrize("samples", [0, -1, 3, 1.5, 4.0, "4", True, torch.tensor(4)])
def test_rays_per_pixel_that_make_no_square(asset: Asset, camera: Camera, samples: Any) -> None:
    with pytest.raises(InputError, match="expected rays per pixel that make a square grid"):
        asset.render(None, camera, samples=samples)
    with pytest.raises(InputError, match="expected rays per pixel that make a square grid"):
        next(asset.film([asset.pose()], [camera], samples=samples))


def test_more_rays_per_pixel_change_nothing_of_gaussians(camera: Camera) -> None:
    drawn = made("gaussians")
    one, four = (drawn.render(None, camera, samples=count).rgb for count in (1, 4))
    assert torch.equal(one, four)
    assert torch.equal(one, drawn.render(None, camera, samples=np.int64(4)).rgb)  # pyright: ignore


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ([], "expected at least one camera, got none"),
        ("cam", "expected cameras, got 'c' among them"),
        (3, "expected cameras, got int"),
        (None, "expected cameras, got NoneType"),
    ],
)
def test_what_is_no_camera(asset: Asset, cameras: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        asset.render(None, cameras)
    with pytest.raises(InputError, match=message):
        next(asset.film([], cameras))


@pytest.mark.parametrize(("frames", "cameras"), [(1, 2), (2, 1), (0, 1)])
def test_every_frame_of_a_film_has_its_camera(
    asset: Asset, camera: Camera, frames: int, cameras: int
) -> None:
    """Said before the first picture is taken."""
    with pytest.raises(InputError, match=f"for each of {frames} frames, got {cameras}"):
        next(asset.film([asset.pose()] * frames, [camera] * cameras))


def test_what_the_interpreter_shows_is_one_line(asset: Asset, camera: Camera) -> None:
    content: Any = asset.content
    size = " x ".join(f"{float(side):.3g}" for side in asset.points.amax(0) - asset.points.amin(0))
    told = f"{type(content).__name__}(40 points, {size}, no light)"
    assert repr(content) == told
    assert repr(asset) == f"Asset({told})"
    lit = replace(content, read_light=lambda: pytest.fail("it is not read for that"))
    assert repr(replace(asset, content=lit)) == f"Asset({told.replace('no light', 'a light')})"
    twist = {"type": "twist", "axis": "z", "angle_deg": 30}
    session = asset.session({"version": 2, "edits": [twist, twist]})
    assert repr(session) == "EditSession(40 points, 2 edits)"
    assert repr(asset.render(None, camera)) == "Image(8 x 8 pixels)"
    assert repr(asset.render(None, Camera.stack([camera] * 3))) == "Image(3 x 8 x 8 pixels)"

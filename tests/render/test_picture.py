"""Full-image rendering: the tiled picture is the whole forward pass, and its by-products."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.pixel_samples import grid_places
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig
from pcore.render import picture as picture_module
from pcore.render import tiles as tiles_module
from pcore.render.image import Image, normals, whole_normals
from pcore.render.picture import (
    FAST_THRESHOLD,
    RenderCancelledError,
    check_request,
    rays_within,
    render,
    render_rays,
)
from pcore.render.surface import surface_of
from pcore.render.tiles import Canvas, colour
from pcore.render.trace import trace


def config(**changes: object) -> PaprConfig:
    values: dict[str, object] = {
        "neighbours": 4,
        "feature_size": 6,
        "octaves": Octaves(point=3, along=1, across=2, direction=0),
        "key": MlpConfig(layers=2, width=16, size=16),
        "query": MlpConfig(layers=2, width=16, size=16),
        "value": MlpConfig(layers=2, width=16, size=8),
        "unet_channels": (6, 8, 10),
        "background": (0.9, 0.3, 0.1),
        "background_score": 1.0,
    }
    return PaprConfig(**(values | changes))  # pyright: ignore[reportArgumentType]


def network(**changes: object) -> Papr:
    return Papr(config(**changes)).requires_grad_(False).eval()


def features_of(image: Image) -> Tensor:
    """(H, W, C) means over the rays of every pixel."""
    return image.ray_hits.features.unflatten(0, (*image.alpha.shape, -1)).mean(dim=-2)


@pytest.fixture
def posed() -> PosedCloud:
    cloud = PointCloud(
        positions=torch.randn(60, 3) * 0.3,
        features=torch.randn(60, 6),
        influence=torch.rand(60) * 2,
    )
    return PosedCloud.at_rest(cloud)


def camera(width: int, height: int, distance: float = 2.5) -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = distance
    return Camera.from_fov(pose, width=width, height=height, angle_x=0.8)


@pytest.mark.parametrize(
    ("size", "tile", "max_rays"),
    [
        ((37, 53), 16, 100),
        ((100, 101), 32, 999),
        ((101, 34), 20, 1200),
        ((67, 66), 64, 4000),
        ((6, 5), 4, 7),
        ((30, 31), 4, 500),
        ((40, 40), 256, None),
    ],
)
def test_tiles_equal_the_whole_picture(
    posed: PosedCloud, size: tuple[int, int], tile: int, max_rays: int | None
) -> None:
    papr, cam = network(), camera(*size)
    with torch.no_grad():
        whole = render_rays(papr, posed, cam.rays())
    got = render(papr, posed, cam, tile=tile, max_rays=max_rays)
    assert got.rgb.shape == (size[1], size[0], 3)
    torch.testing.assert_close(got.rgb, whole.rgb, atol=1e-5, rtol=0)
    torch.testing.assert_close(got.alpha, whole.alpha, atol=1e-6, rtol=0)
    torch.testing.assert_close(got.surface, whole.surface, atol=1e-6, rtol=0)
    torch.testing.assert_close(got.depth, 2.5 - whole.surface[..., 2], atol=1e-5, rtol=0)


@pytest.mark.parametrize("samples", [4, 9])
@pytest.mark.parametrize(
    ("size", "tile", "max_rays"), [((21, 29), 16, 100), ((9, 10), 4, 7), ((40, 40), 256, None)]
)
def test_several_rays_per_pixel_are_averaged_before_the_unet(
    posed: PosedCloud, samples: int, size: tuple[int, int], tile: int, max_rays: int | None
) -> None:
    """Whatever the tiles and chunks; the rays are those of a picture so many times as large."""
    papr, cam = network(), camera(*size)
    side = math.isqrt(samples)
    large = cam.resized(side * size[0], side * size[1])
    with torch.no_grad():
        each = render_rays(papr, posed, large.rays())
        features = torch.nn.functional.avg_pool2d(features_of(each).permute(2, 0, 1), side)
        alpha = torch.nn.functional.avg_pool2d(each.alpha.unsqueeze(0), side)[0]
        expected = colour(papr, features.permute(1, 2, 0), alpha)
    got = render(papr, posed, cam, tile=tile, max_rays=max_rays, samples=samples)
    torch.testing.assert_close(got.rgb, expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(got.alpha, alpha, atol=1e-6, rtol=0)
    asked = network(samples=samples)
    asked.load_state_dict(papr.state_dict())
    by_model = render(asked, posed, cam, tile=tile, max_rays=max_rays)
    torch.testing.assert_close(by_model.rgb, got.rgb, atol=1e-6, rtol=0)  # The model's own number.
    one = render(asked, posed, cam, samples=1)
    assert torch.equal(one.rgb, render(papr, posed, cam).rgb)
    assert not torch.allclose(one.rgb, got.rgb, atol=1e-3)


def test_the_surface_of_a_pixel_is_that_of_one_of_its_rays(posed: PosedCloud) -> None:
    """The one of the middle distance; rays that meet nothing are left out."""
    papr, cam = network(cutoff=0.1), camera(24, 24)
    got = render(papr, posed, cam, samples=4)
    rays = cam.rays(places=grid_places(4)).flat()
    with torch.no_grad():
        each = trace(papr, posed, rays)
    surface = surface_of(posed, rays, each, 0.1)[0].reshape(24, 24, 4, 3)
    met = each.mask.reshape(24, 24, 4)
    distance = (surface - cam.center).norm(dim=-1)
    counts = set[int]()
    for row, column in torch.cartesian_prod(torch.arange(24), torch.arange(24)).tolist():
        seen = distance[row, column][met[row, column]].sort().values
        counts.add(len(seen))
        found = got.surface[row, column]
        if len(seen) == 0:
            assert found.isnan().all()
            continue
        expected = seen[(len(seen) - 1) // 2]
        assert float((found - cam.center).norm() - expected) == pytest.approx(0, abs=1e-5)
    assert counts == {0, 1, 2, 3, 4}


def in_light(posed: PosedCloud, gains: Tensor) -> PosedCloud:
    """Every point a piece of surface of its own that faces away from the middle."""
    outwards = torch.nn.functional.normalize(posed.positions - posed.sphere[0], dim=1)
    surfels = Surfels(
        places=posed.positions,
        normals=outwards,
        heights=torch.zeros(60),
        beside=torch.cdist(posed.positions, posed.positions).argsort(dim=1)[:, :16],
        spacing=0.1,
    )
    return replace(posed, surfels=surfels, gains=gains)


@pytest.mark.parametrize("samples", [1, 4])
def test_gains_scale_the_object_and_not_the_background(posed: PosedCloud, samples: int) -> None:
    papr, cam = network(background=(0.2, 0.5, 1.0)), camera(37, 30)
    plain = render(papr, posed, cam, tile=16, max_rays=100, samples=samples)
    behind = (1 - plain.alpha).unsqueeze(-1) * torch.tensor([0.2, 0.5, 1.0])
    # Rows at a time are the same in all: some processors' matrix products depend on their number.
    bright = in_light(posed, torch.full((60,), 2.0))
    twice = render(papr, bright, cam, tile=16, max_rays=100, samples=samples)
    torch.testing.assert_close(twice.rgb - behind, 2 * (plain.rgb - behind), atol=1e-5, rtol=1e-5)
    assert torch.equal(twice.alpha, plain.alpha)
    ones = in_light(posed, torch.ones(60))
    same = render(papr, ones, cam, tile=16, max_rays=100, samples=samples)
    torch.testing.assert_close(same.rgb, plain.rgb, atol=1e-5, rtol=0)
    for name in ("surface", "depth"):
        torch.testing.assert_close(getattr(same, name), getattr(twice, name), equal_nan=True)


def test_surfels_in_the_light_of_the_photos_change_depths_alone(posed: PosedCloud) -> None:
    papr, cam = network(cutoff=0.3), camera(37, 30)
    plain = render(papr, posed, cam)
    found = render(papr, replace(in_light(posed, torch.ones(60)), gains=None), cam)
    assert torch.equal(found.rgb, plain.rgb)
    assert torch.equal(found.alpha, plain.alpha)
    met = torch.isfinite(plain.depth)
    assert torch.equal(met, torch.isfinite(found.depth))
    apart = (found.depth - plain.depth)[met].abs()
    assert 0.001 < float(apart.median()) < 0.3


@pytest.mark.parametrize("samples", [1, 4])
def test_a_ray_has_the_gain_of_the_surface_it_meets(posed: PosedCloud, samples: int) -> None:
    """Rays of a pixel count by their opacity; rays that meet nothing do not darken its edge."""
    papr, cam = network(cutoff=0.1), camera(24, 24)
    lit = in_light(posed, torch.rand(60) + 0.5)
    with torch.no_grad():
        out = render_rays(papr, posed, cam.rays(places=grid_places(samples)))
        each = render_rays(
            papr, posed, cam.resized(24 * math.isqrt(samples), 24 * math.isqrt(samples)).rays()
        )
    rays = cam.rays(places=grid_places(samples)).flat()
    with torch.no_grad():
        hits = trace(papr, lit, rays)
    of_rays = surface_of(lit, rays, hits, 0.1)[1]
    assert of_rays is not None
    of_rays = of_rays.reshape(24, 24, -1)
    assert 0.5 <= float(of_rays.min()) < 0.7 < 1.3 < float(of_rays.max()) <= 1.5
    opacity = torch.nn.functional.pixel_unshuffle(each.alpha[None], math.isqrt(samples))
    opacity = opacity.permute(1, 2, 0)
    gain = (of_rays * opacity).sum(dim=-1) / opacity.sum(dim=-1).clamp_min(1e-6)
    expected = colour(papr, features_of(out), out.alpha, gain=gain)
    got = render(papr, lit, cam, samples=samples, tile=8)
    torch.testing.assert_close(got.rgb, expected.detach(), atol=1e-5, rtol=0)
    assert not torch.allclose(got.rgb, out.rgb, atol=1e-2)
    with torch.no_grad():
        whole = render_rays(papr, lit, cam.rays(places=grid_places(samples)))
    torch.testing.assert_close(whole.rgb, expected.detach(), atol=1e-5, rtol=0)


def test_a_light_that_is_not_finite_is_refused(posed: PosedCloud) -> None:
    gains = torch.ones(60)
    gains[3] = math.nan
    with pytest.raises(InputError, match="NaN or infinity in the gain of 1 of 60"):
        render(network(), in_light(posed, gains), camera(8, 8))


@pytest.mark.parametrize("samples", [0, -1, 2, 3, 8])
def test_rays_per_pixel_make_a_square(posed: PosedCloud, samples: int) -> None:
    with pytest.raises(InputError, match=r"rays per pixel that make a square grid"):
        render(network(), posed, camera(8, 8), samples=samples)
    with pytest.raises(InputError, match=r"rays per pixel that make a square grid"):
        config(samples=samples)


@pytest.mark.parametrize(
    ("size", "tile", "max_rays"),
    [((20, 90), 16, 100), ((9, 53), 20, 7), ((64, 97), 8, 1500), ((41, 40), 4, 41)],
)
def test_features_are_held_for_the_rows_that_tiles_still_need(
    posed: PosedCloud,
    size: tuple[int, int],
    tile: int,
    max_rays: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever the height; the picture is the one of a canvas that holds them all, bit for bit."""
    papr, cam, held = network(), camera(*size), list[int]()
    fill = tiles_module.trace_pixels

    def watched(canvas: Canvas, *others: object) -> None:
        held.append(len(canvas.features))
        fill(canvas, *others)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(tiles_module, "trace_pixels", watched)
    found = render(papr, posed, cam, tile=tile, max_rays=max_rays)
    assert set(held) == {min(size[1], tile + 24 + math.ceil(max_rays / size[0]))}
    assert held[0] < size[1]
    monkeypatch.setattr(picture_module, "rows_in_use", lambda *_: size[1])
    whole = render(papr, posed, cam, tile=tile, max_rays=max_rays)
    assert held[-1] == size[1]
    for name in ("rgb", "alpha", "depth", "surface"):
        assert torch.equal(getattr(found, name), getattr(whole, name)), name


def test_fewer_rows_of_features_would_not_do(
    posed: PosedCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    papr, cam = network(), camera(16, 97)
    exact = render(papr, posed, cam, tile=8, max_rays=40).rgb
    monkeypatch.setattr(picture_module, "rows_in_use", lambda *_: 8 + 24 - 2)
    differs = float((render(papr, posed, cam, tile=8, max_rays=40).rgb - exact).abs().max())
    assert differs > 0


def test_a_tile_without_its_surroundings_would_differ(
    posed: PosedCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The margin is needed: the test above would see a smaller one."""
    papr, cam = network(), camera(40, 40)
    exact = render(papr, posed, cam)
    monkeypatch.setattr("pcore.render.raster.RECEPTIVE_MARGIN", 8)
    assert float((render(papr, posed, cam, tile=16).rgb - exact.rgb).abs().max()) > 1e-5


@pytest.mark.parametrize(("size", "pixel"), [((61, 45), None), ((120, 96), 0.06)])
def test_the_unet_sees_only_where_something_is_and_that_changes_no_colour(
    posed: PosedCloud,
    monkeypatch: pytest.MonkeyPatch,
    size: tuple[int, int],
    pixel: float | None,
) -> None:
    papr = network(cutoff=0.1, pixel=pixel)
    small = PosedCloud.at_rest(
        replace(posed.cloud, positions=0.2 * posed.positions + torch.tensor([0.3, 0.0, 0.1]))
    )
    areas: list[int] = []
    forward = Papr.forward

    def counting(self: Papr, features: Tensor) -> Tensor:
        areas.append(features[..., 0].numel())
        return forward(self, features)

    monkeypatch.setattr(Papr, "forward", counting)
    found = render(papr, small, camera(*size), tile=24)
    used = sum(areas)
    areas.clear()
    monkeypatch.setattr(tiles_module, "shown_part", lambda alpha, window, step: window)
    whole = render(papr, small, camera(*size), tile=24)
    assert 0 < float((whole.alpha > 0).double().mean()) < 0.5
    torch.testing.assert_close(found.rgb, whole.rgb, rtol=0, atol=2e-6)
    assert used < 0.8 * sum(areas)


def test_nothing_is_there_where_no_point_answers(posed: PosedCloud) -> None:
    papr, cam = network(cutoff=0.05), camera(40, 30)
    picture = render(papr, posed, cam, tile=8)
    empty = picture.alpha == 0
    assert bool(empty.any())
    assert bool((~empty).any())
    assert torch.equal(picture.depth.isnan(), empty)
    assert torch.equal(picture.surface.isnan().all(dim=-1), empty)
    assert torch.equal(
        picture.rgb[empty], torch.tensor([0.9, 0.3, 0.1]).expand_as(picture.rgb[empty])
    )


def test_rendering_leaves_no_graph_and_no_mode_behind(posed: PosedCloud) -> None:
    papr = network().train()
    assert not render(papr, posed, camera(8, 8)).rgb.requires_grad
    assert torch.is_grad_enabled()
    assert papr.training
    posed.cloud.positions.requires_grad_()
    with torch.no_grad():
        assert not render(papr, posed, camera(8, 8)).rgb.requires_grad
    assert render(papr, posed, camera(8, 8)).rgb.requires_grad


def test_pictures_that_autograd_follows_are_the_same(posed: PosedCloud) -> None:
    """Whatever the chunks and tiles."""
    papr, cam = network(cutoff=0.3), camera(37, 53)
    expected = render(papr, posed, cam)
    posed.cloud.features.requires_grad_()
    for options in ({}, {"tile": 16, "max_rays": 100}):
        found = render(papr, posed, cam, **options)
        torch.testing.assert_close(found.rgb, expected.rgb, atol=1e-5, rtol=0)
        torch.testing.assert_close(found.alpha, expected.alpha, atol=1e-6, rtol=0)
        found.rgb.sum().backward()
        assert posed.cloud.features.grad is not None


def test_a_batch_of_cameras_is_their_pictures_one_by_one(posed: PosedCloud) -> None:
    papr, cameras = network(samples=4), [camera(20, 16, distance) for distance in (2.0, 2.5, 3.0)]
    shares: list[float] = []
    batch = render(papr, posed, cameras, progress=shares.append)
    assert batch.rgb.shape == (3, 16, 20, 3)
    assert shares == sorted(set(shares))
    assert shares[-1] == 1
    for index, one in enumerate(cameras):
        for name, plane in vars(render(papr, posed, one)).items():
            if plane is not None:
                assert torch.equal(getattr(batch, name)[index], plane), name
    with pytest.raises(InputError, match=r"of one image size, got 16 x 20, 20 x 16"):
        render(papr, posed, [camera(20, 16), camera(16, 20)])
    with pytest.raises(InputError, match="image size, got none"):
        render(papr, posed, [])


@pytest.mark.parametrize("samples", [None, 4])
def test_rays_of_any_batch_shape_make_pictures_of_that_shape(
    posed: PosedCloud, samples: int | None
) -> None:
    """How many rays a pixel has is said by name; no axis is taken for them."""
    papr, places = network(), None if samples is None else grid_places(samples)
    cameras = [camera(12, 8, distance) for distance in (2.0, 2.5, 3.0)]
    rays = Camera.stack(cameras).rays(places=places)
    assert rays.pixels == (3, 8, 12)
    found = render_rays(papr, posed, rays)
    assert found.rgb.shape == (3, 8, 12, 3)
    for index, one in enumerate(cameras):
        single = render_rays(papr, posed, one.rays(places=places))
        for name in ("rgb", "alpha", "depth", "surface"):
            expected = getattr(single, name)
            torch.testing.assert_close(getattr(found, name)[index], expected, atol=1e-5, rtol=0)
    with pytest.raises(InputError, match=r"pixels \(..., H, W\), at least 4 x 4 .*, got \(5,\)"):
        render_rays(papr, posed, cameras[0].rays().flat()[:5])


def test_a_threshold_changes_colours_a_little_and_nothing_else(posed: PosedCloud) -> None:
    papr, cam = network(cutoff=0.3), camera(40, 30)
    exact = render(papr, posed, cam)
    assert torch.equal(render(papr, posed, cam, threshold=0.0).rgb, exact.rgb)
    errors: list[float] = []
    for threshold in (FAST_THRESHOLD, 0.3):
        fast = render(papr, posed, cam, threshold=threshold)
        assert torch.equal(fast.alpha, exact.alpha)
        assert torch.equal(fast.surface.nan_to_num(), exact.surface.nan_to_num())
        errors.append(float((fast.rgb - exact.rgb).abs().max()))
    assert 0 < errors[0] < errors[1] < 0.2


def test_chunks_are_larger_on_a_gpu(posed: PosedCloud) -> None:
    """Smaller ones would leave it waiting for the processor."""
    on_gpu = SimpleNamespace(device=torch.device("cuda"))
    rays = [
        check_request(
            SimpleNamespace(config=config(), parameters=parameters),  # pyright: ignore[reportArgumentType]
            posed,
            camera(8, 8),
            None,
            8,
        )
        for parameters in (Papr(config()).parameters, lambda: iter([on_gpu]))
    ]
    assert rays == [rays_within(config(), 512 * 2**20), rays_within(config(), 2 * 2**30)]


def test_progress_ends_at_one_and_grows(posed: PosedCloud) -> None:
    shares: list[float] = []
    render(network(), posed, camera(20, 20), tile=8, max_rays=100, progress=shares.append)
    assert len(shares) == 4 + 9
    assert shares == sorted(set(shares))
    assert shares[-1] == 1


def test_cancelling(posed: PosedCloud) -> None:
    asked: list[int] = []

    def cancel() -> bool:
        asked.append(1)
        return len(asked) == 3

    with pytest.raises(RenderCancelledError, match="cancelled before it was complete"):
        render(network(), posed, camera(20, 20), max_rays=100, cancel=cancel)
    assert len(asked) == 3


@pytest.mark.parametrize(
    ("size", "options", "message"),
    [
        ((3, 9), {}, r"at least 4 x 4 pixels, got 3 x 9"),
        ((9, 9), {"tile": 10}, "a tile that is a multiple of 4, got 10"),
        ((9, 9), {"tile": 0}, "tile: expected a whole number of at least 4, got 0"),
        ((9, 9), {"max_rays": -1}, "max_rays: expected a whole number of at least 1, got -1"),
    ],
)
def test_bad_arguments(
    posed: PosedCloud, size: tuple[int, int], options: dict[str, int], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        render(network(), posed, camera(*size), **options)  # pyright: ignore[reportArgumentType]


def test_larger_models_get_smaller_chunks() -> None:
    small, paper = config(), PaprConfig()
    assert rays_within(paper, 2**28) < rays_within(small, 2**28)
    assert rays_within(paper, 2**29) == pytest.approx(2 * rays_within(paper, 2**28), abs=1)
    assert rays_within(paper, 1) == 256


# --- normals -------------------------------------------------------------------------------


def picture_of(surface: torch.Tensor, cam: Camera, alpha: torch.Tensor | None = None) -> Image:
    shape = surface.shape[:2]
    return Image(
        rgb=torch.zeros(*shape, 3),
        alpha=torch.ones(shape) if alpha is None else alpha,
        depth=cam.depth(surface),
        surface=surface,
    )


def plane(cam: Camera, normal: torch.Tensor) -> torch.Tensor:
    """Where the rays meet the plane through the world's origin."""
    rays = cam.rays()
    s = -(rays.origins @ normal) / (rays.directions @ normal)
    return rays.origins + s.unsqueeze(-1) * rays.directions


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 1.0), (1.0, 0.5, 1.0), (-0.4, 2.0, 1.0)])
def test_normals_of_a_plane(tilt: tuple[float, float, float]) -> None:
    normal = torch.tensor(tilt) / torch.tensor(tilt).norm()
    cam = camera(12, 9)
    got = normals(picture_of(plane(cam, normal), cam), cam)
    expected = normal.expand(7, 10, 3)
    torch.testing.assert_close(got[1:-1, 1:-1], expected, atol=1e-4, rtol=0)
    border = got.isnan().all(dim=-1)
    assert bool(border[0].all() and border[-1].all() and border[:, 0].all() and border[:, -1].all())


def test_normals_of_a_sphere_point_outwards() -> None:
    cam = camera(64, 64)
    rays = cam.rays()
    b = (rays.origins * rays.directions).sum(dim=-1)
    root = b.square() - rays.origins.square().sum(dim=-1) + 0.49
    hit = root > 0
    surface = rays.origins + (-b - root.clamp_min(0).sqrt()).unsqueeze(-1) * rays.directions
    surface[~hit] = math.nan
    got = normals(picture_of(surface, cam, hit.float()), cam)
    known = ~got.isnan().any(dim=-1)
    assert int(known.sum()) > 0.6 * int(hit.sum())
    assert not bool((known & ~hit).any())
    cosine = (got[known] * surface[known] / 0.7).sum(dim=-1)
    assert float(cosine.min()) > 0.97


def test_no_normals_across_jumps_and_beside_holes() -> None:
    cam = camera(12, 9)
    surface = plane(cam, torch.tensor([0.0, 0.0, 1.0]))
    jump = surface.clone()
    jump[:, 6:] *= 2.0
    jump[:, 6:, 2] = -2.5
    known = ~normals(picture_of(jump, cam), cam).isnan().any(dim=-1)
    assert known[4].tolist() == [False, *[True] * 4, False, False, *[True] * 4, False]
    alpha = torch.ones(9, 12)
    alpha[4, 6] = 0.4
    known = ~normals(picture_of(surface, cam, alpha), cam).isnan().any(dim=-1)
    holes = [(y, x) for y in range(1, 8) for x in range(1, 11) if not known[y, x]]
    assert holes == [(3, 6), (4, 5), (4, 6), (4, 7), (5, 6)]


def test_normals_for_pictures_have_no_gaps() -> None:
    cam = camera(12, 9)
    jump = plane(cam, torch.tensor([0.0, 0.0, 1.0]))
    jump[:, 6:] *= 2.0
    jump[:, 6:, 2] = -2.5
    alpha = torch.ones(9, 12)
    alpha[4, 6] = 0.4
    image = picture_of(jump, cam, alpha)
    got, strict = whole_normals(image, cam), normals(image, cam)
    known = ~strict.isnan()
    assert torch.equal(got[known], strict[known])
    assert torch.equal(got.isnan().all(dim=-1), alpha < 0.5)
    # Each side of the jump is a plane of its own.
    solid = got[alpha > 0.5]
    torch.testing.assert_close(
        solid, torch.tensor([0.0, 0.0, 1.0]).expand_as(solid), atol=1e-3, rtol=0
    )


def test_no_normals_in_a_picture_of_two_columns() -> None:
    cam = camera(2, 5)
    surface = plane(cam, torch.tensor([0.0, 0.0, 1.0]))
    assert bool(normals(picture_of(surface, cam), cam).isnan().all())
    assert not bool(whole_normals(picture_of(surface, cam), cam).isnan().any())

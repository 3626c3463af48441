"""Parts that an edit brings before one another hide each other in the order of the new depth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

import tiny_scene
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.pixel_samples import grid_places
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.hits import Hits, composite_over
from pcore.model.papr import Papr
from pcore.model.papr_config import ReferenceOrigin
from pcore.render import trace as trace_module
from pcore.render.trace import layer_of, search, trace
from ray_pictures import picture_of

CUTOFF = 0.2
CONFIG = replace(
    tiny_scene.CONFIG,
    neighbours=6,
    feature_size=5,
    background_score=-20.0,  # Whatever a ray meets is opaque.
    cutoff=CUTOFF,
    reference=ReferenceOrigin(center=(0.0, 0.0, 0.0), distance=1.5),
)


SHEET = 324


def sheet(x: float, z: float) -> torch.Tensor:
    """Points (324, 3) of a square of side 0.7 that faces z, a fifth of the cut-off apart."""
    steps = torch.linspace(-0.35, 0.35, 18)
    rows, columns = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([columns + x, rows, torch.full_like(rows, z)], dim=-1).reshape(-1, 3)


def camera() -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_fov(pose, width=16, height=16, angle_x=0.15)


def two_sheets(front: float) -> PosedCloud:
    """Two sheets side by side at rest; the second was brought before the first at depth `front`."""
    rest = torch.cat([sheet(-0.5, 0.0), sheet(0.5, 0.0)])
    moved = rest.clone()
    moved[:SHEET] += torch.tensor([0.5, 0.0, 0.0])
    moved[SHEET:] += torch.tensor([-0.5, 0.0, front])
    maps = LocalMaps(to_rest=torch.eye(3).expand(2 * SHEET, 3, 3))
    cloud = PointCloud(
        positions=rest,
        features=torch.randn(2 * SHEET, 5),
        influence=torch.rand(2 * SHEET) + 0.5,
    )
    return PosedCloud(cloud=cloud, positions=moved, local_maps=maps)


def network(**changes: Any) -> Papr:
    return Papr(replace(CONFIG, **changes)).requires_grad_(False).eval()


def layer(
    posed: PosedCloud, rays: RayBundle, *, back: bool = False
) -> tuple[torch.Tensor, RayBundle]:
    """Neighbours (M, k) of one layer of rays that all come near, and the rays as those see them."""
    _, ray_of_near, candidates = search(posed, rays, CONFIG.neighbours, CUTOFF)
    assert len(ray_of_near) == len(rays.flat().origins)
    lines = rays.flat()
    neighbours, seen, has_back = layer_of(
        posed, lines, candidates, CONFIG.neighbours, CUTOFF, back_layer=back
    )
    assert has_back.all()
    return neighbours, seen


def attended(
    papr: Papr, posed: PosedCloud, rays: RayBundle, *options: float, back: bool = False
) -> Hits:
    neighbours, seen = layer(posed, rays, back=back)
    return papr.attention(posed, rays, neighbours, seen.slid(torch.zeros(3), 1.5), *options)


@pytest.mark.parametrize("front", [0.3, -0.3])
def test_the_sheet_before_the_other_is_seen(front: float) -> None:
    papr, cloud = network(), two_sheets(front)
    with torch.no_grad():
        out = picture_of(papr, cloud, camera().rays())
    seen = out.weights * (out.neighbours >= SHEET)
    assert (out.alpha > 0.99).all()
    share = seen.sum(dim=-1)
    expected = torch.ones_like(share) if front > 0 else torch.zeros_like(share)
    # Behind an opacity of 0.97 nothing more is looked at.
    torch.testing.assert_close(share, expected, atol=0.03, rtol=0)
    torch.testing.assert_close(
        camera().depth(out.centroid), torch.full((16, 16), 3 - max(front, 0.0)), atol=0.02, rtol=0
    )


def test_without_layers_both_sheets_would_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the tests above would find if nothing was done."""
    monkeypatch.setattr(trace_module, "CLOSE", 0.0)
    papr, cloud = network(), two_sheets(0.3)
    with torch.no_grad():
        out = picture_of(papr, cloud, camera().rays())
    share = (out.weights * (out.neighbours >= SHEET)).sum(dim=-1)
    assert 0.1 < float(share.mean()) < 0.9


def test_all_neighbours_are_of_the_front(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where points of the sheet behind are nearer to the ray: they do not crowd it out."""
    monkeypatch.setattr(trace_module, "CANDIDATES", 4)
    posed, rays = two_sheets(0.3), camera().rays().flat()
    assert (layer(posed, rays)[0] >= SHEET).all()
    assert (layer(posed, rays, back=True)[0] < SHEET).all()


def test_what_the_front_lets_through_is_seen_behind_it() -> None:
    """A front that is half transparent: opacities and weights are those of two layers."""
    posed, rays = two_sheets(0.3), camera().rays().flat()
    papr = network(background_score=2.0)
    out = trace(papr, posed, rays)
    front, back = (1 - attended(papr, posed, rays, back=one).background for one in (False, True))
    assert 0.05 < float(front.mean()) < 0.95
    expected = front + (1 - front) * back
    torch.testing.assert_close(1 - out.background, expected, atol=1e-5, rtol=0)
    # Of twelve points with a weight six are kept; they share what their layer has.
    share = (out.weights * (out.neighbours < SHEET)).sum(dim=-1)
    torch.testing.assert_close(share, (1 - front) * back / expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(out.weights.sum(dim=-1), torch.ones_like(share))


def half_transparent() -> tuple[Papr, PosedCloud]:
    """Sheets that let light through; the one behind was stretched along x."""
    posed = two_sheets(0.3)
    assert posed.local_maps is not None
    to_rest = posed.local_maps.to_rest.clone()
    to_rest[:SHEET, 0, 0] = 0.5
    return network(background_score=2.0), replace(posed, local_maps=LocalMaps(to_rest=to_rest))


def wide_camera() -> Camera:
    """It sees past the sheets on all sides."""
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_fov(pose, width=20, height=20, angle_x=0.6)


@pytest.mark.parametrize("samples", [1, 4])
def test_rays_meet_together_what_each_meets_alone(samples: int) -> None:
    """Some miss everything, some come near and miss, some have strangers, some have none."""
    papr, cloud = half_transparent()
    pixels = wide_camera().rays(places=grid_places(samples)).by_pixel()
    together = trace(papr, cloud, pixels)
    _, ray_of_near, candidates = search(cloud, pixels, CONFIG.neighbours, CUTOFF)
    lines = pixels.flat()[ray_of_near]
    _, _, has_back = layer_of(cloud, lines, candidates, CONFIG.neighbours, CUTOFF)
    assert 0 < int(together.mask.sum()) < len(ray_of_near) < len(together.mask)
    assert 0 < int(has_back.sum()) < len(has_back)
    for pixel in range(0, len(pixels.origins), 7):
        alone = trace(papr, cloud, pixels[pixel : pixel + 1])
        rows = slice(pixel * samples, (pixel + 1) * samples)
        met = alone.mask
        for name, found in vars(alone).items():
            expected = getattr(together, name)[rows]
            if name == "neighbours":
                assert torch.equal(found[met], expected[met])
            else:
                torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4, msg=name)


def test_rays_that_are_opaque_look_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second look costs; behind an opaque front it shows nothing."""
    asked: list[int] = []
    whole = trace_module.layer_of

    def counted(posed: PosedCloud, lines: RayBundle, *rest: Any, back_layer: bool = False) -> Any:
        if back_layer:
            asked.append(len(lines.origins))
        return whole(posed, lines, *rest, back_layer=back_layer)

    monkeypatch.setattr(trace_module, "layer_of", counted)
    trace(network(), two_sheets(0.3), camera().rays())
    assert asked == []
    papr, cloud = half_transparent()
    trace(papr, cloud, camera().rays())
    assert asked == [256]


def test_a_threshold_holds_in_both_layers() -> None:
    """Opacity is exact; features are those of the points above it."""
    papr, cloud = half_transparent()
    rays = camera().rays().flat()
    exact, fast = trace(papr, cloud, rays), trace(papr, cloud, rays, threshold=0.9)
    layers = [attended(papr, cloud, rays, 0.9, back=one) for one in (False, True)]
    torch.testing.assert_close(fast.background, exact.background)
    assert not torch.allclose(fast.features, exact.features, atol=1e-3)
    front, back = layers
    first, second = 1 - front.background, front.background * (1 - back.background)
    share = (second / (first + second)).unsqueeze(1)
    expected = (1 - share) * front.features + share * back.features
    torch.testing.assert_close(fast.features, expected, atol=1e-5, rtol=1e-4)


def test_slots_without_a_point_are_mute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five points alone lie behind: the sixth slot repeats one, and has no weight."""
    posed = two_sheets(0.3)
    assert posed.local_maps is not None
    kept = torch.tensor([*range(150, 155), *range(SHEET, 2 * SHEET)])
    few = posed.each(lambda one: one[kept])
    monkeypatch.setattr(trace_module, "MOST_CANDIDATES", len(kept))
    monkeypatch.setattr(trace_module, "CANDIDATES", len(kept))
    k, lines = CONFIG.neighbours, camera().rays().flat()
    _, ray_of_near, candidates = search(few, lines, k, CUTOFF)
    lines = lines[ray_of_near]
    _, _, has_back = layer_of(few, lines, candidates, k, CUTOFF)
    assert has_back.any()
    others, seen, _ = layer_of(
        few, lines[has_back], candidates[has_back], k, CUTOFF, back_layer=True
    )
    rest = few.cloud.positions[others]
    along = ((rest - seen.origins) * seen.directions).sum(dim=-1, keepdim=True)
    answers = (rest - seen.origins - along * seen.directions).norm(dim=-1) <= CUTOFF
    assert set(others[answers].tolist()) == {0, 1, 2, 3, 4}
    assert not answers[:, 5].any()
    for points, heard in zip(others, answers, strict=True):
        heard_points = points[heard].tolist()
        assert len(heard_points) == len(set(heard_points)), "no point speaks twice"


def test_what_is_behind_the_camera_hides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    papr, cloud = network(), two_sheets(4.0)
    with torch.no_grad():
        layered = picture_of(papr, cloud, camera().rays())
        monkeypatch.setattr(trace_module, "CLOSE", 0.0)
        flat = picture_of(papr, cloud, camera().rays())
    torch.testing.assert_close(layered.weights, flat.weights)


def test_two_layers_are_composited() -> None:
    def hits(background: float, value: float, first: int) -> Hits:
        return Hits(
            neighbours=first + torch.arange(8).reshape(2, 4),
            weights=torch.full((2, 4), value),
            background=torch.full((2,), background),
            features=torch.full((2, 3), value),
            centroid=torch.full((2, 3), value),
            spread=torch.full((2,), value),
        )

    first = torch.tensor([0])
    front, back = hits(0.4, 1.0, 0), hits(0.5, 2.0, 8)
    found = composite_over(front, torch.tensor([1]), back[first])
    # 0.6 of the front, 0.4 * 0.5 of the back.
    assert found.background.tolist() == pytest.approx([0.4, 0.2])
    mixed = (0.6 * 1.0 + 0.2 * 2.0) / 0.8
    for name in ("features", "centroid", "spread"):
        value = getattr(found, name)
        assert value[0].flatten().tolist() == pytest.approx([1.0] * value[0].numel())
        assert value[1].flatten().tolist() == pytest.approx([mixed] * value[1].numel())
    assert found.neighbours[0].tolist() == [0, 1, 2, 3]
    nothing = composite_over(hits(1.0, 1.0, 0), first, hits(1.0, 0.0, 4)[first])
    assert nothing.background.tolist() == [1.0, 1.0]
    assert nothing.features[0].tolist() == [1.0] * 3
    assert nothing.neighbours.sort(dim=1).values.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]


def test_of_two_layers_the_points_with_the_greatest_weights_are_kept() -> None:
    def hits(background: float, weights: list[float], first: int) -> Hits:
        return Hits(
            neighbours=first + torch.arange(3)[None],
            weights=torch.tensor([weights]),
            background=torch.tensor([background]),
            features=torch.zeros(1, 3),
            centroid=torch.zeros(1, 3),
            spread=torch.zeros(1),
        )

    front, back = hits(0.5, [0.9, 0.1, 0.0], 0), hits(0.0, [0.2, 0.7, 0.1], 5)
    found = composite_over(front, torch.tensor([0]), back)
    # Half of each: 0.45, 0.05, 0 and 0.1, 0.35, 0.05.
    assert found.neighbours.tolist() == [[0, 6, 5]]
    assert found.weights[0].tolist() == pytest.approx([0.5, 0.35 / 0.9, 0.1 / 0.9])
    # A layer that keeps no point leaves its share to the other.
    front, back = hits(0.9, [0.4, 0.3, 0.3], 0), hits(0.0, [0.5, 0.3, 0.2], 5)
    found = composite_over(front, torch.tensor([0]), back)
    assert found.neighbours.tolist() == [[5, 6, 7]]
    assert found.weights[0].tolist() == pytest.approx([0.5, 0.3, 0.2])


def test_one_affine_map_has_no_strangers() -> None:
    """Told without looking at a ray; parts that are moved apart are seen, turned or not."""
    rest = torch.randn(40, 3)
    matrix = torch.tensor([[1.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.3, 0.0, 0.7]])
    shift = torch.tensor([0.1, 2.0, -3.0])
    back = torch.linalg.inv(matrix).expand(40, 3, 3)
    moved = rest @ matrix.T + shift

    def as_one(positions: torch.Tensor, to_rest: torch.Tensor) -> bool:
        features, influence = torch.zeros(40, 1), torch.ones(40)
        cloud = PointCloud(positions=rest, features=features, influence=influence)
        assert not PosedCloud.at_rest(cloud).moved_as_one, "nothing was moved"
        maps = LocalMaps(to_rest=to_rest)
        return PosedCloud(cloud=cloud, positions=positions, local_maps=maps).moved_as_one

    assert as_one(moved, back)
    apart = moved.clone()
    apart[20:] += 0.01
    assert not as_one(apart, back)
    turned = back.clone()
    turned[20:] = torch.eye(3)
    assert not as_one(moved, turned)

"""Parts that an edit brings before one another hide each other in the order of the new depth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

import pcore.model.papr as papr_module
import pcore.render.sight as sight_module
import tiny_scene
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.pixel_samples import grid_places
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.ray_layers import LayerRules
from pcore.model.attention import Attended
from pcore.model.papr import Papr
from pcore.model.papr_config import ReferenceOrigin
from pcore.render.sight import Hidden, look, look_behind
from pcore.render.strangers import behind, layer_rules

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
NOBODY = LayerRules(close=0.0, apart=1.0, cutoff=CUTOFF)


def sheet(x: float, z: float) -> torch.Tensor:
    """Points (324, 3) of a square of side 0.7 that faces z, a fifth of the cut-off apart."""
    steps = torch.linspace(-0.35, 0.35, 18)
    rows, columns = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([columns + x, rows, torch.full_like(rows, z)], dim=-1).reshape(-1, 3)


def camera() -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_fov(pose, width=16, height=16, angle_x=0.15)


def two_sheets(front: float) -> PointCloud:
    """Two sheets side by side at rest; the second was brought before the first at depth `front`."""
    rest = torch.cat([sheet(-0.5, 0.0), sheet(0.5, 0.0)])
    moved = rest.clone()
    moved[:SHEET] += torch.tensor([0.5, 0.0, 0.0])
    moved[SHEET:] += torch.tensor([-0.5, 0.0, front])
    frames = LocalMaps(rest=rest, to_rest=torch.eye(3).expand(2 * SHEET, 3, 3))
    cloud = PointCloud(
        positions=rest,
        features=torch.randn(2 * SHEET, 5),
        influence=torch.rand(2 * SHEET) + 0.5,
    )
    return cloud.moved(moved, frames)


@pytest.mark.parametrize("front", [0.3, -0.3])
def test_the_sheet_before_the_other_is_seen(front: float) -> None:
    papr, cloud = Papr(CONFIG).eval(), two_sheets(front)
    with torch.no_grad():
        out = papr(cloud, camera().rays())
    seen = out.weights * (out.neighbours >= SHEET)
    assert (out.alpha > 0.99).all()
    share = seen.sum(dim=-1)
    expected = torch.ones_like(share) if front > 0 else torch.zeros_like(share)
    # Behind an opacity of 0.97 nothing more is looked at.
    torch.testing.assert_close(share, expected, atol=0.03, rtol=0)
    torch.testing.assert_close(
        camera().depth(out.surface), torch.full((16, 16), 3 - max(front, 0.0)), atol=0.02, rtol=0
    )


def test_without_layers_both_sheets_would_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the tests above would find if nothing was done."""
    monkeypatch.setattr(sight_module, "layer_rules", lambda _: NOBODY)
    papr, cloud = Papr(CONFIG).eval(), two_sheets(0.3)
    with torch.no_grad():
        out = papr(cloud, camera().rays())
    share = (out.weights * (out.neighbours >= SHEET)).sum(dim=-1)
    assert 0.1 < float(share.mean()) < 0.9


def test_all_neighbours_are_of_the_front(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where points of the sheet behind are nearer to the ray: they do not crowd it out."""
    monkeypatch.setattr(sight_module, "_CANDIDATES", 4)
    cloud, rays = two_sheets(0.3), camera().rays().flat()
    sight = look(cloud, rays, CONFIG.neighbours, CUTOFF)
    assert sight.hidden is not None
    assert sight.hidden.strangers.all()
    assert (sight.neighbours >= SHEET).all()
    others, _ = look_behind(cloud, sight.hidden, torch.arange(9), CONFIG.neighbours)
    assert (others < SHEET).all()


def test_what_the_front_lets_through_is_seen_behind_it() -> None:
    """A front that is half transparent: opacities and weights are those of two layers."""
    cloud, rays = two_sheets(0.3), camera().rays().flat()
    papr = Papr(replace(CONFIG, background_score=2.0)).eval()
    with torch.no_grad():
        out, near = papr.attend(cloud, rays)
        sight = look(cloud, rays, CONFIG.neighbours, CUTOFF)
        assert sight.hidden is not None
        everyone = torch.arange(len(rays.origins))
        others, seen = look_behind(cloud, sight.hidden, everyone, CONFIG.neighbours)
        front, back = (
            1 - papr.attention(cloud, rays, points, lines.slid(torch.zeros(3), 1.5)).background
            for points, lines in ((sight.neighbours, sight.seen), (others, seen))
        )
    assert 0.05 < float(front.mean()) < 0.95
    expected = front + (1 - front) * back
    torch.testing.assert_close(1 - out.background, expected, atol=1e-5, rtol=0)
    # Of twelve points with a weight six are kept; they share what their layer has.
    share = (out.weights * (near < SHEET)).sum(dim=-1)
    torch.testing.assert_close(share, (1 - front) * back / expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(out.weights.sum(dim=-1), torch.ones_like(share))


def half_transparent() -> tuple[Papr, PointCloud]:
    """Sheets that let light through; the one behind was stretched along x."""
    cloud = two_sheets(0.3)
    frames = cloud.frames
    assert frames is not None
    to_rest = frames.to_rest.clone()
    to_rest[:SHEET, 0, 0] = 0.5
    stretched = LocalMaps(rest=frames.rest, to_rest=to_rest)
    papr = Papr(replace(CONFIG, background_score=2.0)).eval()
    return papr, cloud.moved(cloud.positions, stretched)


def wide_camera() -> Camera:
    """It sees past the sheets on all sides."""
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_fov(pose, width=20, height=20, angle_x=0.6)


@pytest.mark.parametrize("samples", [1, 4])
def test_rays_meet_together_what_each_meets_alone(samples: int) -> None:
    """Some miss everything, some come near and miss, some have strangers, some have none."""
    papr, cloud = half_transparent()
    rays = wide_camera().rays(places=grid_places(samples)).flat()
    pixels = RayBundle(
        origins=rays.origins.reshape(-1, samples, 3),
        directions=rays.directions.reshape(-1, samples, 3),
    )
    with torch.no_grad():
        sight = look(cloud, pixels, CONFIG.neighbours, CUTOFF)
        together, near = papr.attend(cloud, pixels)
    hidden = sight.hidden
    assert hidden is not None
    assert 0 < len(hidden.asked) < len(hidden.rays.origins) < len(rays.origins)
    assert 0 < int(hidden.strangers.sum()) < len(hidden.strangers)
    for pixel in range(0, len(pixels.origins), 7):
        with torch.no_grad():
            alone, points = papr.attend(cloud, pixels[pixel : pixel + 1])
        rows = slice(pixel * samples, (pixel + 1) * samples)
        for name, found in vars(alone).items():
            expected = getattr(together, name)[rows]
            torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4, msg=name)
        met = alone.weights.sum(dim=1) > 0
        assert torch.equal(points[met], near[rows][met])


def test_rays_that_are_opaque_look_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second look costs; behind an opaque front it shows nothing."""
    asked: list[int] = []
    whole = papr_module.look_behind

    def counted(cloud: PointCloud, hidden: Hidden, rows: torch.Tensor, *rest: Any) -> Any:
        asked.append(len(rows))
        return whole(cloud, hidden, rows, *rest)

    monkeypatch.setattr(papr_module, "look_behind", counted)
    with torch.no_grad():
        Papr(CONFIG).eval().attend(two_sheets(0.3), camera().rays().flat())
    assert asked == []
    papr, cloud = half_transparent()
    with torch.no_grad():
        papr.attend(cloud, camera().rays().flat())
    assert asked == [256]


def test_a_threshold_holds_in_both_layers() -> None:
    """Opacity is exact; features are those of the points above it."""
    papr, cloud = half_transparent()
    rays = camera().rays().flat()
    with torch.no_grad():
        exact, _ = papr.attend(cloud, rays)
        fast, _ = papr.attend(cloud, rays, threshold=0.9)
        sight = look(cloud, rays, CONFIG.neighbours, CUTOFF)
        assert sight.hidden is not None
        everyone = torch.arange(256)
        others, seen = look_behind(cloud, sight.hidden, everyone, CONFIG.neighbours)
        layers = [
            papr.attention(cloud, rays, points, lines.slid(torch.zeros(3), 1.5), 0.9)
            for points, lines in ((sight.neighbours, sight.seen), (others, seen))
        ]
    torch.testing.assert_close(fast.background, exact.background)
    assert not torch.allclose(fast.features, exact.features, atol=1e-3)
    front, back = layers
    first, second = 1 - front.background, front.background * (1 - back.background)
    share = (second / (first + second)).unsqueeze(1)
    expected = (1 - share) * front.features + share * back.features
    torch.testing.assert_close(fast.features, expected, atol=1e-5, rtol=1e-4)


def test_slots_without_a_point_are_mute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five points alone lie behind: the sixth slot repeats one, and has no weight."""
    cloud = two_sheets(0.3)
    frames = cloud.frames
    assert frames is not None
    kept = [*range(150, 155), *range(SHEET, 2 * SHEET)]
    few = PointCloud(
        positions=frames.rest[kept], features=cloud.features[kept], influence=cloud.influence[kept]
    ).moved(cloud.positions[kept], LocalMaps(rest=frames.rest[kept], to_rest=frames.to_rest[kept]))
    monkeypatch.setattr(sight_module, "_MOST_CANDIDATES", len(kept))
    monkeypatch.setattr(sight_module, "_CANDIDATES", len(kept))
    sight = look(few, camera().rays().flat(), CONFIG.neighbours, CUTOFF)
    assert sight.hidden is not None
    rows = torch.nonzero(sight.hidden.strangers).squeeze(-1)
    assert len(rows) > 0
    others, seen = look_behind(few, sight.hidden, rows, CONFIG.neighbours)
    rest = frames.rest[kept][others]
    along = ((rest - seen.origins) * seen.directions).sum(dim=-1, keepdim=True)
    answers = (rest - seen.origins - along * seen.directions).norm(dim=-1) <= CUTOFF
    assert set(others[answers].tolist()) == {0, 1, 2, 3, 4}
    assert not answers[:, 5].any()
    for points, heard in zip(others, answers, strict=True):
        heard_points = points[heard].tolist()
        assert len(heard_points) == len(set(heard_points)), "no point speaks twice"


def test_what_is_behind_the_camera_hides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    papr, cloud = Papr(CONFIG).eval(), two_sheets(4.0)
    with torch.no_grad():
        layered = papr(cloud, camera().rays())
        monkeypatch.setattr(sight_module, "layer_rules", lambda _: NOBODY)
        flat = papr(cloud, camera().rays())
    torch.testing.assert_close(layered.weights, flat.weights)


def test_two_layers_are_composited() -> None:
    def layer(background: float, value: float) -> Attended:
        return Attended(
            features=torch.full((2, 3), value),
            background=torch.full((2,), background),
            weights=torch.full((2, 4), value),
            surface=torch.full((2, 3), value),
            behind=torch.full((2,), value),
        )

    front, back = layer(0.4, 1.0), layer(0.5, 2.0)
    only = Attended(**{name: one[:1] for name, one in vars(back).items()})
    points = torch.arange(8).reshape(2, 4)
    found, met = behind(front, points, torch.tensor([1]), only, torch.tensor([[8, 9, 10, 11]]))
    # 0.6 of the front, 0.4 * 0.5 of the back.
    assert found.background.tolist() == pytest.approx([0.4, 0.2])
    mixed = (0.6 * 1.0 + 0.2 * 2.0) / 0.8
    for name in ("features", "surface", "behind"):
        value = getattr(found, name)
        assert value[0].flatten().tolist() == pytest.approx([1.0] * value[0].numel())
        assert value[1].flatten().tolist() == pytest.approx([mixed] * value[1].numel())
    assert met[0].tolist() == [0, 1, 2, 3]
    empty = Attended(**{name: one[:1] for name, one in vars(layer(1.0, 0.0)).items()})
    nothing, met = behind(layer(1.0, 1.0), points, torch.tensor([0]), empty, points[1:])
    assert nothing.background.tolist() == [1.0, 1.0]
    assert nothing.features[0].tolist() == [1.0] * 3
    assert met.sort(dim=1).values.tolist() == points.tolist()


def test_of_two_layers_the_points_with_the_greatest_weights_are_kept() -> None:
    def layer(background: float, weights: list[float]) -> Attended:
        return Attended(
            features=torch.zeros(1, 3),
            background=torch.tensor([background]),
            weights=torch.tensor([weights]),
            surface=torch.zeros(1, 3),
            behind=torch.zeros(1),
        )

    front, back = layer(0.5, [0.9, 0.1, 0.0]), layer(0.0, [0.2, 0.7, 0.1])
    points, strangers = torch.tensor([[0, 1, 2]]), torch.tensor([[5, 6, 7]])
    found, met = behind(front, points, torch.tensor([0]), back, strangers)
    # Half of each: 0.45, 0.05, 0 and 0.1, 0.35, 0.05.
    assert met.tolist() == [[0, 6, 5]]
    assert found.weights[0].tolist() == pytest.approx([0.5, 0.35 / 0.9, 0.1 / 0.9])
    # A layer that keeps no point leaves its share to the other.
    front, back = layer(0.9, [0.4, 0.3, 0.3]), layer(0.0, [0.5, 0.3, 0.2])
    found, met = behind(front, points, torch.tensor([0]), back, strangers)
    assert met.tolist() == [[5, 6, 7]]
    assert found.weights[0].tolist() == pytest.approx([0.5, 0.3, 0.2])


def test_rules_are_in_cutoffs() -> None:
    assert layer_rules(2.0) == LayerRules(close=0.4, apart=1.0, cutoff=2.0)


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
        assert not cloud.moved_as_one, "nothing was moved"
        return cloud.moved(positions, LocalMaps(rest=rest, to_rest=to_rest)).moved_as_one

    assert as_one(moved, back)
    apart = moved.clone()
    apart[20:] += 0.01
    assert not as_one(apart, back)
    turned = back.clone()
    turned[20:] = torch.eye(3)
    assert not as_one(moved, turned)

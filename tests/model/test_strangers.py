"""Parts that an edit brings before one another hide each other in the order of the new depth."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import pcore.model.papr as papr_module
import tiny_scene
from pcore.geometry.camera import Camera
from pcore.geometry.local_frames import LocalFrames
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.attention import Attended
from pcore.model.config import ReferenceOrigin
from pcore.model.papr import Papr
from pcore.model.sight import look
from pcore.model.strangers import behind, strangers, without

CUTOFF = 0.2
CONFIG = replace(
    tiny_scene.CONFIG,
    neighbours=6,
    feature_size=5,
    background_score=-20.0,  # Whatever a ray meets is opaque.
    cutoff=CUTOFF,
    reference=ReferenceOrigin(center=(0.0, 0.0, 0.0), distance=1.5),
)


def sheet(x: float, z: float) -> torch.Tensor:
    """Points (64, 3) of a square of side 0.7 that faces z."""
    steps = torch.linspace(-0.35, 0.35, 8)
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
    moved[:64] += torch.tensor([0.5, 0.0, 0.0])
    moved[64:] += torch.tensor([-0.5, 0.0, front])
    frames = LocalFrames(rest=rest, to_rest=torch.eye(3).expand(128, 3, 3))
    cloud = PointCloud(
        positions=rest, features=torch.randn(128, 5), influence=torch.rand(128) + 0.5
    )
    return cloud.moved(moved, frames)


@pytest.mark.parametrize("front", [0.3, -0.3])
def test_the_sheet_before_the_other_is_seen(front: float) -> None:
    papr, cloud = Papr(CONFIG).eval(), two_sheets(front)
    with torch.no_grad():
        out = papr(cloud, camera().rays())
    seen = out.weights * (out.neighbours >= 64)
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
    nobody = lambda positions, *_: torch.zeros(positions.shape[:2], dtype=torch.bool)  # noqa: E731
    monkeypatch.setattr(papr_module, "strangers", nobody)
    papr, cloud = Papr(CONFIG).eval(), two_sheets(0.3)
    with torch.no_grad():
        out = papr(cloud, camera().rays())
    share = (out.weights * (out.neighbours >= 64)).sum(dim=-1)
    assert 0.1 < float(share.mean()) < 0.9


def test_what_the_front_lets_through_is_seen_behind_it() -> None:
    """A front that is half transparent: opacities and weights are those of two layers."""
    cloud, rays = two_sheets(0.3), camera().rays().flat()
    papr = Papr(replace(CONFIG, background_score=2.0)).eval()
    with torch.no_grad():
        out, near = papr.attend(cloud, rays)
        seen = look(cloud, rays, CONFIG.neighbours, CUTOFF).seen.slid(torch.zeros(3), 1.5)
        of_front, rest = near >= 64, _rest(cloud)[near]
        layers = [
            papr.attention(cloud, rays, near, without(rest, seen, left_out, CUTOFF), 0.0)
            for left_out in (~of_front, of_front)
        ]
    both = of_front.any(dim=1) & (~of_front).any(dim=1)
    assert both.float().mean() > 0.5
    front, back = (1 - layer.background for layer in layers)
    assert 0.05 < float(front[both].mean()) < 0.95
    expected = front + (1 - front) * back
    torch.testing.assert_close(1 - out.background[both], expected[both], atol=1e-5, rtol=0)
    share = (out.weights * ~of_front).sum(dim=-1)
    expected = (1 - front) * back / expected
    torch.testing.assert_close(share[both], expected[both], atol=1e-5, rtol=0)


def test_what_is_behind_the_camera_hides_nothing() -> None:
    papr, cloud = Papr(CONFIG).eval(), two_sheets(4.0)
    with torch.no_grad():
        layered = papr(cloud, camera().rays())
        patched = pytest.MonkeyPatch()
        nobody = lambda positions, *_: torch.zeros(positions.shape[:2], dtype=torch.bool)  # noqa: E731
        with patched.context() as patch:
            patch.setattr(papr_module, "strangers", nobody)
            flat = papr(cloud, camera().rays())
    torch.testing.assert_close(layered.weights, flat.weights)


def _rest(cloud: PointCloud) -> torch.Tensor:
    assert cloud.frames is not None
    return cloud.frames.rest


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
    found = behind(front, torch.tensor([1]), only)
    # 0.6 of the front, 0.4 * 0.5 of the back.
    assert found.background.tolist() == pytest.approx([0.4, 0.2])
    mixed = (0.6 * 1.0 + 0.2 * 2.0) / 0.8
    for name in ("features", "weights", "surface", "behind"):
        value = getattr(found, name)
        assert value[0].flatten().tolist() == pytest.approx([1.0] * value[0].numel())
        assert value[1].flatten().tolist() == pytest.approx([mixed] * value[1].numel())
    empty = Attended(**{name: one[:1] for name, one in vars(layer(1.0, 0.0)).items()})
    nothing = behind(layer(1.0, 1.0), torch.tensor([0]), empty)
    assert nothing.background.tolist() == [1.0, 1.0]
    assert nothing.features[0].tolist() == [1.0] * 3


def test_strangers_are_those_whose_rest_ray_never_met_the_foremost() -> None:
    cloud, rays = two_sheets(0.3), camera().rays().flat()[:5]
    near = torch.tensor([[91, 27, 28, 92]]).expand(5, 4)
    rest = _rest(cloud)[near]
    shift = (rest - cloud.positions[near]).detach()
    seen = RayBundle(
        origins=rays.origins.unsqueeze(1) + shift,
        directions=rays.directions.unsqueeze(1).expand(5, 4, 3),
    )
    found = strangers(cloud.positions[near], rest, rays, seen, 2.0)
    assert found.tolist() == [[False] * 4] * 5, "with such a cut-off both sheets met any ray"
    found = strangers(cloud.positions[near], rest, rays, seen, 0.5)
    assert found.tolist() == [[False, True, True, False]] * 5
    away = without(rest, seen, found, 0.5)
    offset = rest - away.origins
    along = (offset * away.directions).sum(dim=-1, keepdim=True)
    distance = (offset - along * away.directions).norm(dim=-1)
    assert (distance[found] > 0.5).all()
    assert torch.equal(away.origins[~found], seen.origins[~found])


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
        return cloud.moved(positions, LocalFrames(rest=rest, to_rest=to_rest)).moved_as_one

    assert as_one(moved, back)
    apart = moved.clone()
    apart[20:] += 0.01
    assert not as_one(apart, back)
    turned = back.clone()
    turned[20:] = torch.eye(3)
    assert not as_one(moved, turned)

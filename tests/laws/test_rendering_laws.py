"""Laws of rendering: what changes nothing, and what PAPR does not promise."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from pcore.editing.script import parse_edit
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, PaprConfig
from ray_pictures import RayPicture, moved, picture_of

CONFIG = PaprConfig(
    neighbours=5,
    feature_size=8,
    key=MlpConfig(layers=3, width=24, size=24),
    query=MlpConfig(layers=3, width=24, size=24),
    value=MlpConfig(layers=4, width=24, size=8, skip_after=2),
    negative_slope=0.2,
    background_score=1.0,
    unet_channels=(8, 12, 16),
    background=(0.9, 0.3, 0.1),
)


@pytest.fixture
def papr() -> Papr:
    return Papr(CONFIG).eval()


@pytest.fixture
def cloud() -> PointCloud:
    return PointCloud(
        positions=torch.randn(80, 3) * 0.3,
        features=torch.randn(80, 8),
        influence=torch.rand(80) * 2,
    )


def camera(width: int = 12, height: int = 10) -> Camera:
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([0.2, 0.1, 2.5])
    return Camera.from_fov(pose, width=width, height=height, angle_x=0.9)


def render(papr: Papr, cloud: PointCloud | PosedCloud, rays: RayBundle | None = None) -> RayPicture:
    with torch.no_grad():
        return picture_of(papr, cloud, camera().rays() if rays is None else rays)


def same(a: RayPicture, b: RayPicture, tolerance: float) -> bool:
    names = ("rgb", "alpha", "centroid", "features")
    return all(float((getattr(a, n) - getattr(b, n)).abs().max()) <= tolerance for n in names)


def rotation() -> torch.Tensor:
    angle = torch.tensor(0.7)
    out = torch.eye(4)
    out[0, 0] = out[2, 2] = angle.cos()
    out[0, 2], out[2, 0] = angle.sin(), -angle.sin()
    return out


def carried(papr: Papr, cloud: PointCloud, motion: torch.Tensor) -> RayPicture:
    """Render the cloud and the camera after the same rigid motion."""
    positions = cloud.positions @ motion[:3, :3].T + motion[:3, 3]
    seen = camera().moved(motion @ camera().world_from_camera)
    return render(papr, moved(cloud, positions), seen.rays())


def test_permuting_the_points_changes_nothing(papr: Papr, cloud: PointCloud) -> None:
    order = torch.randperm(len(cloud))
    shuffled = PointCloud(
        positions=cloud.positions[order],
        features=cloud.features[order],
        influence=cloud.influence[order],
    )
    assert not torch.equal(shuffled.positions, cloud.positions)
    assert same(render(papr, cloud), render(papr, shuffled), 1e-5)


def test_rendering_twice_is_bitwise_the_same(papr: Papr, cloud: PointCloud) -> None:
    assert same(render(papr, cloud), render(papr, cloud), 0.0)


def test_points_that_no_ray_chooses_change_nothing(papr: Papr, cloud: PointCloud) -> None:
    far = PointCloud(
        positions=torch.cat([cloud.positions, torch.full((3, 3), 40.0)]),
        features=torch.cat([cloud.features, torch.randn(3, 8)]),
        influence=torch.cat([cloud.influence, torch.full((3,), 9.0)]),
    )
    assert same(render(papr, cloud), render(papr, far), 1e-6)


def test_rays_are_independent_before_the_unet(papr: Papr, cloud: PointCloud) -> None:
    whole = render(papr, cloud)
    part = render(papr, cloud, camera().rays().crop(2, 4, 6, 5))
    window = (slice(2, 8), slice(4, 9))
    for name in ("alpha", "centroid", "features"):
        assert torch.allclose(getattr(whole, name)[window], getattr(part, name), atol=1e-5)


def test_units_do_not_matter(cloud: PointCloud) -> None:
    """World in metres or in decimetres: the same picture when coord_scale says so."""
    papr = Papr(CONFIG)
    other = Papr(replace(CONFIG, coord_scale=CONFIG.coord_scale / 8))
    other.load_state_dict(papr.state_dict())
    rays = camera().rays()
    scaled = render(
        other,
        moved(cloud, cloud.positions * 8),
        RayBundle(origins=rays.origins * 8, directions=rays.directions),
    )
    expected = render(papr, cloud)
    assert same(expected, replace(scaled, centroid=scaled.centroid / 8), 1e-4)


def test_rigid_motion_of_camera_and_cloud_together_is_not_promised(
    papr: Papr, cloud: PointCloud
) -> None:
    """Vanilla PAPR reads world coordinates: positions in the key, directions in the query.

    So moving camera and object together changes its picture, although nothing changed between
    them. Fine-tuning (P-CORE) teaches it to care less; nothing guarantees it. This test keeps the
    fact in writing: where it fails, the model has become invariant and the docs must say so.
    """
    still = render(papr, cloud)
    shift = torch.eye(4)
    shift[:3, 3] = torch.tensor([0.4, -0.3, 0.2])
    for motion in (shift, rotation()):
        after = carried(papr, cloud, motion)
        assert torch.equal(after.neighbours.sort(-1).values, still.neighbours.sort(-1).values)
        assert float((after.alpha - still.alpha).abs().max()) > 1e-3


def test_values_ignore_where_the_object_stands(papr: Papr, cloud: PointCloud) -> None:
    """Half of the law that PAPR does keep: values read h, t and mu only, so shifts cancel."""
    with torch.no_grad():
        papr.attention.w_key.weight.zero_()  # equal scores: only the values are left
    shift = torch.eye(4)
    shift[:3, 3] = torch.tensor([0.5, -0.25, 0.125])
    assert same_features(render(papr, cloud), carried(papr, cloud, shift), 1e-3)


def same_features(a: RayPicture, b: RayPicture, tolerance: float) -> bool:
    return float((a.features - b.features).abs().max()) <= tolerance


# --- the cut-off ---------------------------------------------------------------------------


def with_cutoff(papr: Papr, cutoff: float | None) -> Papr:
    other = Papr(replace(papr.config, cutoff=cutoff)).eval()
    other.load_state_dict(papr.state_dict())
    return other


def test_a_huge_cutoff_is_no_cutoff(papr: Papr, cloud: PointCloud) -> None:
    assert same(render(papr, cloud), render(with_cutoff(papr, 1e3), cloud), 1e-6)


def test_rays_beyond_the_cutoff_are_exactly_background(papr: Papr, cloud: PointCloud) -> None:
    cutoff = 0.05
    rays = camera(24, 20).rays()
    out = render(with_cutoff(papr, cutoff), cloud, rays)
    offset = cloud.positions - rays.origins[..., None, :]
    direction = rays.directions[..., None, :].expand_as(offset)
    distance = torch.linalg.cross(offset, direction, dim=-1).norm(dim=-1).amin(dim=-1)
    beyond = distance > cutoff * 1.001
    assert 0 < int(beyond.sum()) < beyond.numel()
    assert torch.equal(
        out.rgb[beyond], torch.tensor(CONFIG.background).expand(int(beyond.sum()), 3)
    )
    for name in ("alpha", "features", "weights", "centroid"):
        assert float(getattr(out, name)[beyond].abs().max()) == 0, name
    assert float(out.alpha[distance < cutoff * 0.999].min()) > 0


def test_permuting_the_points_changes_nothing_with_a_cutoff(papr: Papr, cloud: PointCloud) -> None:
    cut, order = with_cutoff(papr, 0.08), torch.randperm(len(cloud))
    shuffled = PointCloud(
        positions=cloud.positions[order],
        features=cloud.features[order],
        influence=cloud.influence[order],
    )
    assert same(render(cut, cloud), render(cut, shuffled), 1e-5)


@pytest.mark.parametrize(
    "edit",
    [
        {"type": "twist", "axis": "z", "angle_deg": 0},
        {"type": "scale", "factor": 1},
        {"type": "rigid", "axis": "x", "angle_deg": 0},
    ],
)
def test_the_identity_edit_gives_the_identical_picture(
    papr: Papr, cloud: PointCloud, edit: dict[str, object]
) -> None:
    script = parse_edit({"version": 2, "edits": [edit]})
    deformation = script.bind(cloud.positions)
    still = moved(cloud, deformation(cloud.positions.double()).float())
    assert same(render(papr, still), render(papr, cloud), 0.0)

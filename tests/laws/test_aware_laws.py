"""Laws of deformation-aware rays (docs/concepts/deformation-aware-rays.md)."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine, Compose, Deformation, Identity
from pcore.deform.jacobian import analytic_maps, estimated_maps, unchecked_maps
from pcore.deform.motion import rigid
from pcore.deform.pose import pose
from pcore.deform.simple import uniform_scale
from pcore.errors import EditError, InputError
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.kernels.reference import encode
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig, ReferenceOrigin
from pcore.relight.lamps import Light, sphere
from pcore.relight.relighting import Relighting
from pcore.render.picture import render
from pcore.render.surface import surface_of
from pcore.render.trace import trace
from ray_pictures import RayPicture, moved, picture_of

CONFIG = PaprConfig(
    neighbours=5,
    # Low octaves only: phases of float32 positions are exact enough to see 1e-4.
    coord_scale=2.0,
    # As `tiny` encodes: the part along the ray stays in world units.
    octaves=Octaves(point=4, along=0, across=4, direction=1),
    feature_size=8,
    key=MlpConfig(layers=3, width=24, size=24),
    query=MlpConfig(layers=3, width=24, size=24),
    value=MlpConfig(layers=4, width=24, size=8, skip_after=2),
    background_score=1.0,
    unet_channels=(8, 12, 16),
    cutoff=0.5,
)
REFERENCE = ReferenceOrigin(center=(0.05, 0.0, -0.1), distance=2.5)
ORIGINS = pytest.mark.parametrize("reference", [None, REFERENCE], ids=["camera", "reference"])


@pytest.fixture
def cloud() -> PointCloud:
    return PointCloud(
        positions=torch.randn(200, 3) * 0.3,
        features=torch.randn(200, 8),
        influence=torch.rand(200) * 2,
    )


def camera(width: int = 16, height: int = 12) -> Camera:
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([0.2, 0.1, 2.5])
    return Camera.from_fov(pose, width=width, height=height, angle_x=0.9)


def network(reference: ReferenceOrigin | None) -> Papr:
    return Papr(replace(CONFIG, reference=reference)).requires_grad_(False).eval()


def carried(rays: RayBundle, matrix: Tensor, offset: Tensor) -> RayBundle:
    directions = rays.directions @ matrix.T
    return RayBundle(
        origins=rays.origins @ matrix.T + offset,
        directions=directions / directions.norm(dim=-1, keepdim=True),
    )


def affine(deformation: Deformation) -> tuple[Tensor, Tensor]:
    offset = deformation(torch.zeros(3, dtype=torch.float64))
    return deformation.jacobian(torch.zeros(3, dtype=torch.float64)).float(), offset.float()


@torch.no_grad()
def both(papr: Papr, cloud: PointCloud, deformation: Deformation) -> tuple[RayPicture, RayPicture]:
    """The canonical picture, and the deformed one from the correspondingly moved camera."""
    rays = camera().rays()
    seen = carried(rays, *affine(deformation))
    return picture_of(papr, cloud, rays), picture_of(papr, pose(cloud, deformation), seen)


@ORIGINS
@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_similarities_give_the_canonical_picture(
    cloud: PointCloud, reference: ReferenceOrigin | None, scale: float
) -> None:
    turn = rigid((0.2, 1.0, -0.4), 0.9, (0.3, -0.2, 0.1), (0.1, 0.0, 0.0))
    deformation = Compose(uniform_scale(scale), turn)
    canonical, deformed = both(network(reference), cloud, deformation)
    assert torch.equal(canonical.neighbours, deformed.neighbours)
    for name in ("rgb", "alpha", "features"):
        torch.testing.assert_close(
            getattr(deformed, name), getattr(canonical, name), rtol=0, atol=1e-4
        )
    hit = canonical.weights.sum(dim=-1) > 0
    expected = deformation(canonical.centroid)
    torch.testing.assert_close(deformed.centroid[hit], expected[hit], rtol=0, atol=1e-4)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
@torch.no_grad()
def test_similarities_move_the_surface_that_pictures_show(scale: float) -> None:
    """Layers are as thick as at rest, and the order along a ray is the same."""
    turn = rigid((0.2, 1.0, -0.4), 0.9, (0.3, -0.2, 0.1), (0.1, 0.0, 0.0))
    deformation = Compose(uniform_scale(scale), turn)
    papr = Papr(replace(CONFIG, neighbours=8, cutoff=0.3, reference=REFERENCE)).eval()
    rest, turned = PosedCloud.at_rest(ball()), pose(ball(), deformation)
    rays = camera().rays().flat()
    seen = carried(rays, *affine(deformation))
    found, expected = (
        surface_of(posed, lines, trace(papr, posed, lines), 0.3)[0]
        for posed, lines in ((turned, seen), (rest, rays))
    )
    hit = ~expected.isnan().any(dim=1)
    assert torch.equal(found.isnan(), expected.isnan())
    means = trace(papr, rest, rays).centroid
    layered = (means - expected)[hit].norm(dim=1) > 0.05
    assert 0.05 < float(layered.float().mean()) < 0.95, "front and back answer some of the rays"
    torch.testing.assert_close(found[hit], deformation(expected)[hit], rtol=0, atol=1e-4)


@pytest.mark.parametrize("scale", [0.5, 2.0])
@torch.no_grad()
def test_similarities_move_the_surfels(scale: float) -> None:
    """And in light from everywhere change no brightness: nothing of a ball shades itself."""
    turn = rigid((0.2, 1.0, -0.4), 0.9, (0.3, -0.2, 0.1), (0.1, 0.0, 0.0))
    deformation = Compose(uniform_scale(scale), turn)
    papr = Papr(replace(CONFIG, neighbours=8, cutoff=0.3, reference=REFERENCE)).eval()
    points = ball().positions
    normals = torch.nn.functional.normalize(points - points.mean(dim=0), dim=1)
    even = Light(
        directions=sphere(60),
        radiance=torch.ones(60),
        nearness=torch.zeros(60),
        center=torch.zeros(3),
    )
    surfels = Surfels.at_rest(points, normals, torch.full((len(points),), 0.02))
    relighting = Relighting.of(even, points, surfels, torch.full((len(points),), 0.3))
    turned = pose(ball(), deformation, surfels=surfels)
    turned = replace(turned, gains=relighting.gains(turned))
    rays = camera().rays().flat()
    seen = carried(rays, *affine(deformation))
    rest, bare = PosedCloud.at_rest(ball(), surfels), PosedCloud.at_rest(ball())
    found, gains = surface_of(turned, seen, trace(papr, turned, seen), 0.3)
    expected, none = surface_of(rest, rays, trace(papr, rest, rays), 0.3)
    hit = ~expected.isnan().any(dim=1)
    torch.testing.assert_close(found[hit], deformation(expected)[hit], rtol=0, atol=1e-4)
    of_points, _ = surface_of(bare, rays, trace(papr, bare, rays), 0.3)
    assert float((of_points - expected)[hit].norm(dim=1).mean()) > 0.01
    assert none is None
    assert gains is not None
    torch.testing.assert_close(gains, torch.ones(len(hit)), rtol=0, atol=0.05)


@ORIGINS
def test_affine_maps_give_the_canonical_features(
    cloud: PointCloud, reference: ReferenceOrigin | None
) -> None:
    """With the same neighbours: all 200 points are candidates."""
    matrix = torch.tensor([[1.3, 0.2, 0.0], [0.0, 0.8, -0.1], [0.1, 0.0, 1.1]])
    deformation = Affine(matrix, torch.tensor([0.2, -0.1, 0.3]))
    papr = Papr(replace(CONFIG, neighbours=200, reference=reference)).eval()
    canonical, deformed = both(papr, cloud, deformation)
    torch.testing.assert_close(deformed.features, canonical.features, rtol=0, atol=1e-4)
    torch.testing.assert_close(deformed.alpha, canonical.alpha, rtol=0, atol=1e-4)


STRONG = {
    "mild": [[1.3, 0.2, 0.0], [0.0, 0.8, -0.1], [0.1, 0.0, 1.1]],
    "half as long": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]],
    "shear": [[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "thin": [[0.3, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]],
}


def ball() -> PointCloud:
    """3,000 points on a sphere."""
    draw = torch.Generator().manual_seed(3)
    return PointCloud(
        positions=torch.nn.functional.normalize(torch.randn(3000, 3, generator=draw), dim=-1) * 0.6,
        features=torch.randn(3000, 8, generator=draw),
        influence=torch.rand(3000, generator=draw),
    )


@pytest.mark.parametrize("name", STRONG)
def test_a_map_that_moves_all_points_gives_the_canonical_features(name: str) -> None:
    """However strong the map, with 6 of 3,000 points: their neighbours are those of the rest."""
    deformation = Affine(torch.tensor(STRONG[name]), torch.tensor([0.2, -0.1, 0.3]))
    papr = Papr(replace(CONFIG, neighbours=6, cutoff=0.1, reference=REFERENCE)).eval()
    canonical, deformed = both(papr, ball(), deformation)
    assert int((canonical.weights.sum(dim=-1) > 0).sum()) > 40
    # Two points may be as far from a ray as rounding can tell.
    same = (deformed.neighbours == canonical.neighbours).all(dim=-1)
    assert float(same.float().mean()) > 0.97
    for part in ("features", "alpha"):
        found, wanted = getattr(deformed, part)[same], getattr(canonical, part)[same]
        torch.testing.assert_close(found, wanted, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", STRONG)
def test_few_neighbours_of_many_are_found_and_give_the_canonical_features(name: str) -> None:
    """As above beside a point that moves otherwise: the right ones must be among candidates."""
    cloud = ball()
    cloud.positions[-1] = torch.tensor([0.0, 0.0, -40.0])
    deformation = Affine(torch.tensor(STRONG[name]), torch.tensor([0.2, -0.1, 0.3]))
    papr = Papr(replace(CONFIG, neighbours=6, cutoff=0.1, reference=REFERENCE)).eval()
    rays, posed = camera().rays(), pose(cloud, deformation)
    assert posed.local_maps is not None
    posed.local_maps.to_rest[-1] *= 1.5
    assert not posed.moved_as_one
    with torch.no_grad():
        canonical = picture_of(papr, cloud, rays)
        deformed = picture_of(papr, posed, carried(rays, *affine(deformation)))
    hit = canonical.weights.sum(dim=-1) > 0
    right = deformed.neighbours[..., :, None] == canonical.neighbours[..., None, :]
    recall = right.any(dim=-2).float().mean(dim=-1)[hit]
    assert int(hit.sum()) > 40
    assert float(recall.mean()) > 0.92
    same = right.any(dim=-2).all(dim=-1) & hit
    assert float(same.sum() / hit.sum()) > 0.8
    torch.testing.assert_close(deformed.features[same], canonical.features[same], rtol=0, atol=1e-4)
    torch.testing.assert_close(deformed.alpha[same], canonical.alpha[same], rtol=0, atol=1e-4)


def test_the_query_sees_the_mean_direction_of_the_neighbours() -> None:
    """Two points whose frames turn by as much to either side: the query sees the ray itself."""
    places = torch.tensor([[-0.06, 0.0, 0.0], [0.05, 0.0, 0.0]])
    cloud = PointCloud(positions=places, features=torch.randn(2, 8), influence=torch.ones(2))
    turns = torch.stack([rigid("y", angle).matrix.float() for angle in (0.4, -0.4)])
    rays = RayBundle(
        origins=torch.tensor([[[0.0, 0.0, 2.5]]]), directions=torch.tensor([[[0.0, 0.0, -1.0]]])
    )
    papr, seen = Papr(replace(CONFIG, neighbours=2)).eval(), list[Tensor]()
    papr.attention.query.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    with torch.no_grad():
        trace(papr, moved(cloud, places, turns), rays)
    expected = encode(rays.flat().directions, CONFIG.octaves.direction)
    torch.testing.assert_close(seen[0], expected, rtol=0, atol=1e-6)


def test_the_anisotropy_of_an_edit_is_that_of_most_points() -> None:
    eye = torch.eye(3).repeat(100, 1, 1)
    flat = eye * torch.tensor([1.0, 1.0, 0.1])
    few = torch.where((torch.arange(100) < 3)[:, None, None], flat, eye)
    found = [LocalMaps(to_rest=maps).anisotropy for maps in (eye, 3 * flat, few)]
    assert found == pytest.approx([1.0, 10.0, 1.0])


def test_without_frames_a_scaled_object_looks_different(cloud: PointCloud) -> None:
    """The law above can fail: it does for plain rays."""
    papr, rays = network(REFERENCE), camera().rays()
    scaled = RayBundle(origins=2 * rays.origins, directions=rays.directions)
    with torch.no_grad():
        difference = picture_of(papr, moved(cloud, 2 * cloud.positions), scaled).features
        difference = difference - picture_of(papr, cloud, rays).features
    assert float(difference.abs().max()) > 1e-2


def test_the_identity_edit_is_the_identical_picture(cloud: PointCloud) -> None:
    papr, rays = network(REFERENCE), camera().rays()
    still = pose(cloud, Compose(uniform_scale(1.0), Identity()))
    with torch.no_grad():
        assert torch.equal(picture_of(papr, still, rays).rgb, picture_of(papr, cloud, rays).rgb)


def test_frames_of_the_identity_change_nothing_that_is_seen(cloud: PointCloud) -> None:
    papr, rays = network(REFERENCE), camera().rays()
    still = moved(cloud, cloud.positions, torch.eye(3).expand(200, 3, 3))
    with torch.no_grad():
        plain, mapped = picture_of(papr, cloud, rays), picture_of(papr, still, rays)
    torch.testing.assert_close(mapped.rgb, plain.rgb, rtol=0, atol=1e-4)


def test_the_origin_on_a_ray_does_not_matter_with_a_reference(cloud: PointCloud) -> None:
    rays = camera().rays()
    slid = RayBundle(origins=rays.origins - 3.0 * rays.directions, directions=rays.directions)
    with torch.no_grad():
        near, far = (
            picture_of(network_, cloud, one).rgb
            for network_ in [network(REFERENCE)]
            for one in (rays, slid)
        )
        torch.manual_seed(0)
        plain = network(None)
        assert (
            float(
                (picture_of(plain, cloud, rays).rgb - picture_of(plain, cloud, slid).rgb)
                .abs()
                .max()
            )
            > 1e-3
        )
    torch.testing.assert_close(near, far, rtol=0, atol=1e-4)


def test_estimated_frames_obey_the_law_for_similarities(cloud: PointCloud) -> None:
    deformation = uniform_scale(2.0)
    places = deformation(cloud.positions)
    to_rest = estimated_maps(cloud.positions, places).to_rest
    papr, rays = network(REFERENCE), camera().rays()
    with torch.no_grad():
        canonical = picture_of(papr, cloud, rays)
        seen = carried(rays, *affine(deformation))
        deformed = picture_of(papr, moved(cloud, places, to_rest), seen)
    torch.testing.assert_close(deformed.rgb, canonical.rgb, rtol=0, atol=1e-3)


def test_gradients_reach_the_points_through_the_rest_state(cloud: PointCloud) -> None:
    """For an affine map the loss of the deformed picture pulls the points as the canonical one."""
    matrix = torch.diag(torch.tensor([1.2, 0.9, 1.1]))
    deformation, rays = Affine(matrix, torch.zeros(3)), camera().rays()
    papr = Papr(replace(CONFIG, neighbours=200, reference=REFERENCE)).eval()
    gradients: list[Tensor] = []
    for aware in (False, True):
        positions = cloud.positions.clone().requires_grad_()
        now = replace(cloud, positions=positions)
        posed = PosedCloud.at_rest(now)
        if aware:
            to_rest = unchecked_maps(deformation, positions).to_rest
            posed = moved(now, deformation(positions), to_rest)
        seen = carried(rays, matrix, torch.zeros(3)) if aware else rays
        loss = picture_of(papr, posed, seen).features.square().sum()
        gradients.append(torch.autograd.grad(loss, positions)[0])
    largest = float(gradients[0].abs().max())
    torch.testing.assert_close(gradients[1], gradients[0], rtol=0, atol=1e-3 * largest)


def test_a_fold_is_an_error_and_plain_rays_still_move_the_points(cloud: PointCloud) -> None:
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3))
    with pytest.raises(EditError, match="at 200 of 200 points"):
        pose(cloud, mirror)
    assert pose(cloud, mirror, aware=False).local_maps is None


@pytest.mark.parametrize("part", ["position", "rest position", "local map"])
def test_nan_is_an_error_and_no_black_picture(cloud: PointCloud, part: str) -> None:
    posed = pose(cloud, uniform_scale(2.0))
    assert posed.local_maps is not None
    values = {
        "position": posed.positions,
        "rest position": posed.cloud.positions,
        "local map": posed.local_maps.to_rest,
    }[part]
    values[3:5] = torch.nan
    with pytest.raises(InputError, match=f"NaN or infinity in the {part} of 2 of 200"):
        render(network(None), posed, camera())


def test_frames_that_fold_space_are_not_drawn(cloud: PointCloud) -> None:
    maps = torch.eye(3).repeat(200, 1, 1)
    maps[7:10, 2, 2] = -1.0
    maps[11] = 0.0
    folded = moved(cloud, cloud.positions, maps)
    with pytest.raises(InputError, match=r"det > 0\), got 4 of 200 that do not"):
        render(network(None), folded, camera())


def test_frames_of_another_cloud_are_refused(cloud: PointCloud) -> None:
    to_rest = analytic_maps(uniform_scale(2.0), cloud.positions[:50]).to_rest
    with pytest.raises(InputError, match="local maps of its 200 points, got 50"):
        moved(cloud, 2 * cloud.positions, to_rest)

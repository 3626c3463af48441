"""Pictures have the right gradients to all that they are made of, or say that they have none.

Against central differences in float64, which points a ray meets held fixed: steps are so small that
no ray meets others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from bent_arm import Arm
from pcore.asset.content import RaysName
from pcore.asset.saving import asset_of
from pcore.deform.base import Affine, Compose, Deformation
from pcore.deform.jacobian import estimated_maps
from pcore.deform.pose import pose
from pcore.deform.simple import uniform_scale
from pcore.errors import EditError, InputError, PcoreError
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig, ReferenceOrigin
from pcore.render import trace as trace_module
from pcore.render.image import Image
from pcore.render.picture import render

CONFIG = PaprConfig(
    neighbours=6,
    coord_scale=2.0,
    octaves=Octaves(point=3, along=0, across=3, direction=1),
    feature_size=6,
    key=MlpConfig(layers=3, width=16, size=16),
    query=MlpConfig(layers=3, width=16, size=16),
    value=MlpConfig(layers=3, width=16, size=6),
    # Smooth enough for differences: kinks of a ReLU are met by no step.
    negative_slope=0.2,
    background_score=2.0,
    unet_channels=(6, 8, 10),
    cutoff=0.25,
    reference=ReferenceOrigin(center=(0.0, 0.0, 0.0), distance=2.0),
    samples=4,
)
STEP = 1e-6
PLANES = ("rgb", "alpha", "depth", "surface")
COUNT = 300


def network(**changes: Any) -> Papr:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        return Papr(replace(CONFIG, **changes)).double().requires_grad_(False).eval()


def rod() -> tuple[PointCloud, Tensor]:
    """A rod along x of radius 0.2, and its normals."""
    draw = torch.Generator().manual_seed(5)
    along, turn = torch.rand(2, COUNT, generator=draw, dtype=torch.float64)
    normal = torch.stack([0 * turn, (2 * math.pi * turn).cos(), (2 * math.pi * turn).sin()], dim=1)
    positions = 0.2 * normal
    positions[:, 0] = 2.2 * along - 0.8
    features = torch.randn(COUNT, 6, generator=draw, dtype=torch.float64)
    influence = torch.rand(COUNT, generator=draw, dtype=torch.float64) + 0.5
    return PointCloud(positions=positions, features=features, influence=influence), normal


def camera(dtype: torch.dtype = torch.float64) -> Camera:
    pose_ = torch.eye(4, dtype=dtype)
    pose_[:3, 3] = torch.tensor([0.3, 0.1, 2.6])
    return Camera.from_fov(pose_, width=12, height=9, angle_x=0.8)


def turned(vector: Tensor) -> Tensor:
    """Rotation (3, 3) by a vector (3,): its axis, and its angle in radians."""
    x, y, z = vector.unbind()
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return torch.linalg.matrix_exp(cross)


def parameters() -> dict[str, Tensor]:
    cloud, _ = rod()
    arm = Arm(torch.tensor(1.3, dtype=torch.float64))
    posed = pose(cloud, arm)
    assert posed.local_maps is not None
    return {
        "points": cloud.positions,
        "features": cloud.features,
        "influence": cloud.influence,
        "angle": arm.angle,
        "moved": posed.positions,
        # No two of one size: they have a median.
        "maps": posed.local_maps.to_rest * torch.linspace(1.0, 1.1, COUNT)[:, None, None],
        "camera place": torch.zeros(3, dtype=torch.float64),
        "camera turn": torch.zeros(3, dtype=torch.float64),
        "focal": torch.tensor(0.0, dtype=torch.float64),
    }


def seen_by(values: dict[str, Tensor]) -> Camera:
    """The camera, moved, turned and with another focal length."""
    base = camera()
    rotation = turned(values["camera turn"]) @ base.world_from_camera[:3, :3]
    place = base.center + values["camera place"]
    upper = torch.cat([rotation, place[:, None]], dim=1)
    matrix = torch.cat([upper, base.world_from_camera[3:]])
    focal = base.fx * (1 + values["focal"])
    return replace(base, world_from_camera=matrix, fx=focal, fy=focal)


def drawn(values: dict[str, Tensor], *, rays: RaysName, surfels: bool, direct: bool) -> Image:
    """The picture of all parameters; `direct` gives moved points and maps, not the deformation."""
    cloud = PointCloud(
        positions=values["points"], features=values["features"], influence=values["influence"]
    )
    over = None
    if surfels:
        # Where the points were when the surface was estimated.
        rest, normals = rod()
        heights = torch.full((COUNT,), 0.03, dtype=torch.float64)
        over = Surfels.at_rest(rest.positions, normals, heights)
    if direct:
        maps = LocalMaps(to_rest=values["maps"])
        posed = PosedCloud(
            cloud=cloud,
            positions=values["moved"],
            local_maps=maps if rays == "aware" else None,
            surfels=None if over is None else over.moved(values["moved"], maps),
        )
    else:
        asset = asset_of(network(), cloud, surfels=over)
        moved = asset.pose(Arm(values["angle"]), rays=rays)
        return asset.render(moved, seen_by(values), samples=_samples(surfels))
    return render(network(), posed, seen_by(values), samples=_samples(surfels))


def _samples(surfels: bool) -> int | None:
    """Rays per pixel: of several that graze one surfel the middle distance is a tie."""
    return 1 if surfels else None


def check(
    draw: Callable[[dict[str, Tensor]], Image], names: tuple[str, ...], tolerance: float = 1e-4
) -> None:
    """Directional derivatives of all planes, one parameter after another."""
    values, random = parameters(), torch.Generator().manual_seed(1)
    cotangents: dict[str, Tensor] = {}

    def losses(image: Image) -> dict[str, Tensor]:
        found: dict[str, Tensor] = {}
        for name in PLANES:
            plane = getattr(image, name)
            if name not in cotangents:
                cotangents[name] = torch.randn(plane.shape, generator=random, dtype=plane.dtype)
            whole = plane.isfinite()
            assert int(whole.sum()) > 30
            found[name] = (cotangents[name] * torch.where(whole, plane, 0.0)).sum()
        return found

    for name in names:
        leaf = values[name].clone().requires_grad_()
        change = torch.randn(leaf.shape, generator=random, dtype=leaf.dtype)
        found = losses(draw({**values, name: leaf}))
        ends: list[dict[str, Tensor]] = []
        with torch.no_grad():
            for sign in (-1, 1):
                ends.append(losses(draw({**values, name: values[name] + sign * STEP * change})))
        for plane in PLANES:
            gradient = torch.zeros_like(leaf)
            if found[plane].requires_grad:
                (gradient,) = torch.autograd.grad(
                    found[plane], leaf, retain_graph=True, allow_unused=True, materialize_grads=True
                )
            slope = float(ends[1][plane] - ends[0][plane]) / (2 * STEP)
            got = float((gradient * change).sum())
            assert got == pytest.approx(slope, rel=tolerance, abs=tolerance), (name, plane)
            if plane == "rgb":
                assert abs(slope) > 1e-3, name


CLOUD = ("points", "features", "influence")
CAMERA = ("camera place", "camera turn", "focal")


@pytest.mark.parametrize("surfels", [False, True])
@pytest.mark.parametrize("rays", ["plain", "aware"])
def test_deformed_pictures_have_the_gradients_of_differences(rays: RaysName, surfels: bool) -> None:
    def draw(values: dict[str, Tensor]) -> Image:
        return drawn(values, rays=rays, surfels=surfels, direct=False)

    check(draw, ("points", "angle", "features", *CAMERA))


def test_without_a_reference_rays_from_the_other_end_begin_where_the_points_say() -> None:
    def draw(values: dict[str, Tensor]) -> Image:
        cloud = PointCloud(**{name: values[old] for name, old in _CLOUD.items()})
        posed = PosedCloud(
            cloud=cloud, positions=values["moved"], local_maps=LocalMaps(to_rest=values["maps"])
        )
        return render(network(reference=None), posed, seen_by(values))

    check(draw, ("points", "moved", "maps", "camera place"))


@pytest.mark.parametrize("surfels", [False, True])
@pytest.mark.parametrize("rays", ["plain", "aware"])
def test_pictures_of_given_points_and_maps_have_them_too(rays: RaysName, surfels: bool) -> None:
    """Deformed points and local maps as they come, from a simulation say."""

    def draw(values: dict[str, Tensor]) -> Image:
        return drawn(values, rays=rays, surfels=surfels, direct=True)

    names = ("moved", "influence", *(("points", "maps") if rays == "aware" else ()))
    check(draw, names)


def test_the_law_above_covers_layers_and_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm before the rod hides it, and lines that see through are traced from the other end."""
    counts = {"layers": 0, "gaps": 0}
    layer_of, gaps = trace_module.layer_of, trace_module.gaps

    def layers_counted(posed: PosedCloud, lines: Any, *rest: Any, back_layer: bool = False) -> Any:
        counts["layers"] += back_layer * len(lines.origins)
        return layer_of(posed, lines, *rest, back_layer=back_layer)

    def gaps_counted(*given: Any) -> Tensor:
        found = gaps(*given)
        counts["gaps"] += len(found)
        return found

    monkeypatch.setattr(trace_module, "layer_of", layers_counted)
    monkeypatch.setattr(trace_module, "gaps", gaps_counted)
    drawn(parameters(), rays="aware", surfels=False, direct=False)
    assert counts["layers"] > 20
    assert counts["gaps"] > 5


@pytest.mark.parametrize("surfels", [False, True])
def test_canonical_pictures_have_the_gradients_of_differences(surfels: bool) -> None:
    rest, normals = rod()
    heights = torch.full((COUNT,), 0.03, dtype=torch.float64)
    over = Surfels.at_rest(rest.positions, normals, heights) if surfels else None

    def draw(values: dict[str, Tensor]) -> Image:
        cloud = PointCloud(**{name: values[old] for name, old in _CLOUD.items()})
        samples = _samples(surfels)
        return render(network(), PosedCloud.at_rest(cloud, over), seen_by(values), samples=samples)

    check(draw, (*CLOUD, *CAMERA))


def test_traced_rays_have_them_where_some_hit_nothing() -> None:
    def draw(values: dict[str, Tensor]) -> Image:
        cloud = PointCloud(**{name: values[old] for name, old in _CLOUD.items()})
        asset = asset_of(network(), cloud)
        image = asset.trace(asset.pose(Arm(values["angle"])), seen_by(values).rays())
        assert bool(image.depth.isnan().any())
        return image

    check(draw, ("points", "features", "angle", *CAMERA))


def test_before_another_background_the_networks_are_followed_still() -> None:
    papr = network().requires_grad_(True)
    image = asset_of(papr, rod()[0]).over((0.0, 0.5, 1.0)).render(None, camera())
    gradients = torch.autograd.grad(image.rgb.sum(), list(papr.unet.parameters()))
    assert all(float(one.abs().max()) > 0 for one in gradients)


_CLOUD = {"positions": "points", "features": "features", "influence": "influence"}


def test_one_map_for_all_points_has_a_gradient_to_every_point() -> None:
    """Its search asks one point's map for all rays; autograd follows each."""
    cloud, _ = rod()
    posed = pose(cloud, Affine(torch.diag(torch.tensor([1.2, 0.9, 1.1])), torch.zeros(3)))
    assert posed.moved_as_one
    still = render(network(), posed, camera())
    moved = posed.positions.clone().requires_grad_()
    found = render(network(), replace(posed, positions=moved), camera())
    for name in PLANES:
        torch.testing.assert_close(
            getattr(found, name), getattr(still, name), rtol=0, atol=1e-9, equal_nan=True
        )
    (gradient,) = torch.autograd.grad(found.rgb.sum(), moved)
    assert int((gradient.abs().sum(dim=1) > 0).sum()) > COUNT // 3


@pytest.mark.parametrize("rays", ["plain", "aware"])
def test_float32_and_its_kernels_have_the_same_gradients(rays: str) -> None:
    values = {name: one.detach() for name, one in parameters().items()}
    gradients: list[dict[str, Tensor]] = []
    for dtype in (torch.float64, torch.float32):
        leaves = {
            name: values[name].to(dtype, copy=True).requires_grad_()
            for name in ("points", "features")
        }
        angle = values["angle"].clone().requires_grad_()
        cloud = PointCloud(
            positions=leaves["points"],
            features=leaves["features"],
            influence=values["influence"].to(dtype),
        )
        posed = pose(cloud, Arm(angle), aware=rays == "aware")
        image = render(network().to(dtype), posed, camera(dtype))
        image.rgb.square().sum().backward()
        leaves["angle"] = angle
        gradients.append(
            {name: leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
        )
    for name, exact in gradients[0].items():
        largest = float(exact.abs().max())
        assert largest > 0
        off = (gradients[1][name].double() - exact).abs().max()
        assert float(off) < 2e-2 * largest, name


def test_where_nothing_asks_pictures_have_no_graph() -> None:
    cloud, _ = rod()
    assert not render(network(), pose(cloud, Arm(torch.tensor(1.0))), camera()).rgb.requires_grad


# --- what cannot be differentiated says so, and only when it is asked ------------------------


@dataclass(frozen=True)
class ByNumpy(Deformation):
    """A map that leaves torch."""

    def __call__(self, points: Tensor) -> Tensor:
        x, y, z = np.array(points.numpy()).T
        return torch.from_numpy(np.stack([1.1 * x, 1.1 * y + 0.3 * np.sin(x), 1.1 * z], axis=-1))


@dataclass(frozen=True)
class Cut(ByNumpy):
    """A map that is cut off from the graph."""

    def __call__(self, points: Tensor) -> Tensor:
        return super().__call__(points.detach())


@dataclass(frozen=True)
class Lost(Arm):
    """A map that loses the gradient of its own parameter."""

    def __call__(self, points: Tensor) -> Tensor:
        return Arm(self.angle.detach())(points)


class Frozen(Deformation):
    """A network that is drawn without gradients."""

    def __init__(self) -> None:
        self.network = torch.nn.Linear(3, 3).double()

    def __call__(self, points: Tensor) -> Tensor:
        with torch.no_grad():
            return points + 0.01 * self.network(points)


@dataclass(frozen=True)
class ByHand(Arm):
    """A map whose Jacobian is, though it is right, cut off from the graph."""

    def jacobian(self, points: Tensor) -> Tensor:
        return super().jacobian(points).detach()


def following(cloud: PointCloud) -> PointCloud:
    return replace(cloud, positions=cloud.positions.clone().requires_grad_())


@pytest.mark.parametrize("kind", [ByNumpy, Cut])
def test_a_deformation_without_a_gradient(kind: type[Deformation]) -> None:
    cloud, _ = rod()
    maps = pose(cloud, kind()).local_maps
    # Autograd cannot differentiate it, so it is measured.
    assert maps is not None
    formula = 1.1 * torch.eye(3).double().repeat(len(cloud.positions), 1, 1)
    formula[:, 1, 0] = 0.3 * cloud.positions[:, 0].double().cos()
    assert torch.allclose(maps.to_rest.double(), torch.linalg.inv(formula), atol=1e-6)
    with pytest.raises(EditError, match="canonical points is asked for, and this deformation has"):
        pose(following(cloud), kind())
    with torch.no_grad():
        assert pose(following(cloud), kind()).local_maps is not None


def test_a_measured_jacobian_follows_a_parameter() -> None:
    """Of points that leave torch, times a number that does not."""
    points = torch.rand(5, 3, dtype=torch.float64)
    amount = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)

    class Half(Deformation):
        def __call__(self, points: Tensor) -> Tensor:
            return points.detach() * (1 + amount)

    class Whole(Deformation):
        def __call__(self, points: Tensor) -> Tensor:
            return torch.from_numpy(np.array(points.numpy())) * (1 + amount)

    for kind in (Half, Whole):
        maps = kind().jacobian(points)
        assert torch.allclose(maps, 1.7 * torch.eye(3).double(), atol=1e-9)
        (slope,) = torch.autograd.grad(maps.sum(), amount)
        assert abs(float(slope) - 15) < 1e-6
    assert kind().jacobian(points[:0]).shape == (0, 3, 3)


def test_a_parameter_without_a_gradient() -> None:
    cloud, _ = rod()
    angle = torch.tensor(0.5, dtype=torch.float64)
    assert pose(cloud, Lost(angle)).local_maps is not None
    lost = Lost(angle.requires_grad_())
    for deformation in (lost, Compose(lost, uniform_scale(2.0)), Frozen()):
        with pytest.raises(EditError, match="is asked for, and this deformation has none"):
            pose(cloud, deformation)
    with torch.no_grad():
        assert pose(cloud, lost).local_maps is not None


def test_a_jacobian_without_a_gradient() -> None:
    cloud, _ = rod()
    angle = torch.tensor(0.5, dtype=torch.float64)
    assert pose(cloud, ByHand(angle)).local_maps is not None
    with pytest.raises(EditError, match="ByHand: a gradient is asked for, and its `jacobian` has"):
        pose(cloud, ByHand(angle.requires_grad_()))
    with pytest.raises(EditError, match="leave `jacobian` to the base class"):
        pose(following(cloud), ByHand(angle.detach()))
    # Of a map that is linear it is rightly without one.
    assert pose(following(cloud), Compose(uniform_scale(2.0))).positions.requires_grad


def test_library_deformations_do_not_take_parameters_that_ask() -> None:
    with pytest.raises(InputError, match="affine matrix: expected a fixed parameter"):
        Affine(torch.eye(3).requires_grad_(), torch.zeros(3))


def test_estimated_maps_do_not_follow_points() -> None:
    cloud, _ = rod()
    moved = Arm(torch.tensor(0.5))(cloud.positions)
    assert len(estimated_maps(cloud.positions, moved)) == COUNT
    with pytest.raises(PcoreError, match="estimated from where points went, which has no gradient"):
        estimated_maps(cloud.positions, moved.requires_grad_())

"""PAPR's forward pass: shapes, constants, gradients, and what bad numbers must not do."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels import reference_attention
from pcore.kernels.backends import usable
from pcore.kernels.reference import encode
from pcore.model import papr as papr_module
from pcore.model.attention import Mlp
from pcore.model.encoding import Normalisation, encoded_size
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, PaprConfig, ReferenceOrigin
from pcore.model.unet import Unet
from pcore.render.trace import trace
from ray_pictures import moved, picture_of


def small_config(**changes: object) -> PaprConfig:
    values: dict[str, object] = {
        "neighbours": 4,
        "feature_size": 6,
        "key": MlpConfig(layers=3, width=16, size=16),
        "query": MlpConfig(layers=3, width=16, size=16),
        "value": MlpConfig(layers=3, width=16, size=8),
        "unet_channels": (8, 12, 16),
    }
    return PaprConfig(**(values | changes))  # pyright: ignore[reportArgumentType]


def small_cloud(count: int = 40, *, influence: float = 1.0) -> PointCloud:
    return PointCloud(
        positions=torch.randn(count, 3) * 0.3,
        features=torch.randn(count, 6),
        influence=torch.full((count,), influence),
    )


def colourful_cloud(features: int = 12) -> PointCloud:
    return replace(small_cloud(), features=torch.randn(40, features))


def view(width: int = 9, height: int = 6) -> RayBundle:
    pose = torch.eye(4)
    pose[2, 3] = 2.5
    return Camera.from_fov(pose, width=width, height=height, angle_x=0.8).rays()


@pytest.fixture(params=usable(torch.device("cpu")), autouse=True)
def kernels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("PCORE_KERNELS", request.param)
    return request.param


def test_shapes_and_ranges() -> None:
    out = picture_of(Papr(small_config()), small_cloud(), view())
    assert out.rgb.shape == out.centroid.shape == (6, 9, 3)
    assert out.alpha.shape == (6, 9)
    assert out.weights.shape == out.neighbours.shape == (6, 9, 4)
    assert out.features.shape == (6, 9, 8)
    assert torch.allclose(out.weights.sum(dim=-1), torch.ones(6, 9))
    assert bool(((out.alpha >= 0) & (out.alpha <= 1)).all())


def test_surface_is_the_weighted_mean_of_the_neighbours() -> None:
    cloud = small_cloud()
    out = picture_of(Papr(small_config()), cloud, view())
    expected = (out.weights.unsqueeze(-1) * cloud.positions[out.neighbours]).sum(dim=-2)
    assert torch.allclose(out.centroid, expected, atol=1e-6)


def test_colours_of_points_go_around_the_networks() -> None:
    """Their blend by the weights stands in the first channels, and the network adds to it."""
    cloud, papr = small_cloud(), Papr(small_config(point_colors=True))
    out = picture_of(papr, cloud, view())
    blend = (out.weights.unsqueeze(-1) * cloud.features[out.neighbours][..., :3]).sum(dim=-2)
    assert torch.allclose(out.features[..., :3], blend, atol=1e-6)
    with torch.no_grad():
        for parameter in papr.unet.outc.parameters():
            parameter.zero_()
    opacity = out.alpha.unsqueeze(-1)
    bare = picture_of(papr, cloud, view()).rgb
    assert torch.allclose(bare, blend * opacity + 1 - opacity, atol=1e-6)
    features = cloud.features.clone().requires_grad_()
    learning = PointCloud(positions=cloud.positions, features=features, influence=cloud.influence)
    picture_of(papr, learning, view()).rgb[..., 0].sum().backward()
    assert features.grad is not None
    expected = torch.zeros(40).index_add(
        0, out.neighbours.flatten(), (out.weights * opacity).flatten()
    )
    assert torch.allclose(features.grad[:, 0], expected, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 1])
def test_rays_that_meet_nothing_have_no_colour(degree: int) -> None:
    config = small_config(point_colors=True, color_degree=degree, feature_size=12, cutoff=0.3)
    aside = torch.eye(4)
    aside[0, 3] = 50.0
    rays = Camera.from_fov(aside, width=9, height=6, angle_x=0.8).rays()
    out = picture_of(Papr(config), colourful_cloud(), rays)
    assert torch.all(out.alpha == 0)
    assert torch.all(out.rgb == 1)


def test_colours_depend_on_the_side_by_harmonics() -> None:
    """The plain colour is the constant part; the harmonics are those of Gaussians."""
    config = small_config(point_colors=True, color_degree=1, feature_size=12)
    papr, cloud, rays = Papr(config), colourful_cloud(), view()
    out = picture_of(papr, cloud, rays)
    features = cloud.features[out.neighbours]
    x, y, z = (rays.directions[..., None, None, axis] for axis in range(3))
    # The order and the signs of 3D Gaussian Splatting.
    slopes = -y * features[..., 3:6] + z * features[..., 6:9] - x * features[..., 9:12]
    colors = features[..., :3] + math.sqrt(3 / (4 * math.pi)) * slopes
    blend = (out.weights.unsqueeze(-1) * colors).sum(dim=-2)
    assert torch.allclose(out.features[..., :3], blend, atol=1e-5)
    learning = replace(cloud, features=cloud.features.clone().requires_grad_())
    picture_of(papr, learning, rays).features[..., 0].sum().backward()
    assert learning.features.grad is not None
    upward = math.sqrt(3 / (4 * math.pi)) * rays.directions[..., 2:] * out.weights
    expected = torch.zeros(40).index_add(0, out.neighbours.flatten(), upward.flatten())
    assert torch.allclose(learning.features.grad[:, 6], expected, atol=1e-5)


def test_sides_turn_with_the_object_under_aware_rays() -> None:
    """Camera and object turned together show the same, by the ways back of the points alone."""
    papr = Papr(small_config(point_colors=True, color_degree=2, feature_size=27, cutoff=0.3))
    cloud, rays = colourful_cloud(27), view()
    turn: Tensor = torch.linalg.qr(torch.randn(3, 3)).Q
    turn = turn * torch.linalg.det(turn)
    positions, back = cloud.positions @ turn.T, turn.T.expand(len(cloud), 3, 3).clone()
    # Not one map for all, so that every point sees a ray of its own.
    back[0] *= 1.0 + 1e-5
    around = rays.each(lambda one: one @ turn.T)
    there = picture_of(papr, moved(cloud, positions, back), around)
    assert torch.allclose(there.rgb, picture_of(papr, cloud, rays).rgb, atol=1e-4)
    plain = picture_of(papr, moved(cloud, positions), around)
    assert not torch.allclose(plain.rgb, there.rgb, atol=1e-2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"feature_size": 2}, r"at least 3 and values .* of degree 0, got 2 and 8"),
        ({"color_degree": 1}, r"at least 12 and values .* of degree 1, got 6 and 8"),
        ({"color_degree": 3}, "color_degree from 0 to 2, and 0 where points have no .* got 3"),
        ({"color_degree": 1, "point_colors": False}, "where points have no colours, got 1"),
    ],
)
def test_colours_need_room(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        small_config(**({"point_colors": True} | changes))


def test_fewer_points_than_neighbours() -> None:
    out = picture_of(Papr(small_config(neighbours=20)), small_cloud(3), view())
    assert out.weights.shape == (6, 9, 3)
    assert bool(torch.isfinite(out.rgb).all())


def test_empty_cloud() -> None:
    with pytest.raises(InputError, match="expected at least one point and k >= 1, got 0 points"):
        picture_of(Papr(small_config()), small_cloud(0), view())


def test_zero_influence_leaves_the_opacity_of_equal_scores() -> None:
    """All scores are 0 then: k points share exp(0) each against exp(background)."""
    config = small_config(background_score=1.5)
    out = picture_of(Papr(config), small_cloud(influence=0.0), view())
    expected = 4 / (4 + math.exp(1.5))
    assert torch.allclose(out.alpha, torch.full((6, 9), expected))
    assert torch.allclose(out.weights, torch.full((6, 9, 4), 0.25))


def test_background_colour_shows_where_nothing_answers() -> None:
    config = small_config(background=(0.1, 0.5, 0.9), background_score=80.0)
    out = picture_of(Papr(config), small_cloud(influence=0.0), view())
    assert torch.allclose(out.rgb, torch.tensor(config.background).expand(6, 9, 3), atol=1e-6)


def test_encoding_is_block_by_block() -> None:
    x = torch.tensor([[0.3, -1.2]])
    blocks = [
        [v, *(f(2.0**o * v) for o in range(3) for f in (math.sin, math.cos))] for v in (0.3, -1.2)
    ]
    expected = torch.tensor([[*blocks[0], *blocks[1]]])
    assert torch.allclose(encode(x, 3), expected, atol=1e-6)
    assert expected.shape[1] == encoded_size(2, 3)


def test_normalisation_is_the_originals() -> None:
    norm = Normalisation(5)
    torch.nn.init.normal_(norm.gain)
    torch.nn.init.normal_(norm.offset)
    x = torch.randn(7, 5) * 3
    expected = norm.gain * (x - x.mean(-1, keepdim=True)) / (x.std(-1, keepdim=True) + 1e-6)
    assert torch.allclose(norm(x), expected + norm.offset, atol=2e-6)


def test_normalisation_of_equal_numbers_is_the_offset() -> None:
    norm = Normalisation(4)
    x = torch.full((2, 4), 3.0, requires_grad=True)
    out = norm(x)
    out.sum().backward()
    assert torch.allclose(out, torch.zeros(2, 4), atol=1e-4)
    assert x.grad is not None
    assert bool(torch.isfinite(x.grad).all())


def test_mlp_skip_takes_hidden_then_input() -> None:
    mlp = Mlp(3, MlpConfig(layers=3, width=4, size=2, skip_after=1), 0.2)
    x = torch.randn(5, 3)
    first, second, third = mlp.layers
    hidden = torch.nn.functional.leaky_relu(first(x), 0.2)
    hidden = torch.nn.functional.leaky_relu(second(torch.cat([hidden, x], dim=-1)), 0.2)
    assert torch.allclose(mlp(x), third(hidden), atol=1e-6)
    assert [tuple(layer.weight.shape) for layer in mlp.layers] == [(4, 3), (4, 7), (2, 4)]


@pytest.mark.parametrize("size", [(5, 123), (4, 4), (4, 7), (160, 6), (6, 5)])
def test_unet_keeps_odd_sizes(size: tuple[int, int]) -> None:
    out = Unet(8, (4, 4, 4))(torch.randn(1, 8, *size))
    assert out.shape == (1, 3, *size)


# --- gradients -----------------------------------------------------------------------------


def leaf_cloud() -> PointCloud:
    cloud = small_cloud()
    for tensor in (cloud.positions, cloud.features, cloud.influence):
        tensor.requires_grad_()
    return cloud


def test_gradients_reach_points_features_influence_and_networks() -> None:
    papr, cloud = Papr(small_config(background_score=0.0)), leaf_cloud()
    out = picture_of(papr, cloud, view())
    (out.rgb.square().mean() + out.centroid.square().mean()).backward()
    for tensor in (cloud.positions, cloud.features, cloud.influence):
        assert tensor.grad is not None
        assert float(tensor.grad.abs().max()) > 0
    for name, parameter in papr.named_parameters():
        assert parameter.grad is not None, name
        assert bool(torch.isfinite(parameter.grad).all()), name


@pytest.fixture
def bare_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keys without standardising, which would mix what a network reads with what it ignores."""
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    monkeypatch.setattr(reference_attention, "standardise", lambda x: x)


@pytest.mark.usefixtures("bare_keys")
def test_training_has_no_gradient_through_the_keys_encoded_position() -> None:
    """A key that reads nothing but enc(p): points move the opacity, unknown to its autograd."""
    papr, cloud = Papr(small_config(background_score=0.0)), leaf_cloud()
    with torch.no_grad():
        papr.attention.key.mlp.layers[0].weight[:, encoded_size(3, 6) :] = 0
    alpha = picture_of(papr, cloud, view(), stop_encoding=True).alpha
    gradient = torch.autograd.grad(alpha.sum(), cloud.positions)[0]
    assert float(gradient.abs().max()) == 0
    after = picture_of(papr, moved(cloud, cloud.positions + 0.003), view()).alpha
    assert float((after - alpha).detach().abs().max()) > 1e-3
    # Pictures that are not trained on have it.
    alpha = picture_of(papr, cloud, view()).alpha
    assert float(torch.autograd.grad(alpha.sum(), cloud.positions)[0].abs().max()) > 0


@pytest.mark.usefixtures("bare_keys")
@pytest.mark.parametrize("part", ["h", "t"])
def test_gradients_flow_through_the_offsets(part: str) -> None:
    papr, cloud = Papr(small_config(background_score=0.0)), leaf_cloud()
    vector = encoded_size(3, 6)
    kept = slice(vector, 2 * vector) if part == "h" else slice(2 * vector, 3 * vector)
    with torch.no_grad():
        weight = papr.attention.key.mlp.layers[0].weight
        keep = torch.zeros_like(weight)
        keep[:, kept] = 1
        weight *= keep
    gradient = torch.autograd.grad(picture_of(papr, cloud, view()).alpha.sum(), cloud.positions)[0]
    assert float(gradient.abs().max()) > 0


@pytest.mark.parametrize("influence", [0.0, -1e4, 1e4])
def test_extreme_influence_gives_finite_gradients(influence: float) -> None:
    papr = Papr(small_config())
    cloud = small_cloud(influence=influence)
    cloud.positions.requires_grad_()
    cloud.influence.requires_grad_()
    out = picture_of(papr, cloud, view())
    (1e3 * (out.rgb.sum() + out.centroid.sum() + out.alpha.sum())).backward()
    for tensor in (cloud.positions, cloud.influence, *papr.parameters()):
        assert tensor.grad is not None
        assert bool(torch.isfinite(tensor.grad).all())
    assert torch.allclose(out.weights.sum(dim=-1), torch.ones(6, 9))


# --- the cut-off ---------------------------------------------------------------------------


def test_all_masked_pairs_give_finite_gradients() -> None:
    """Attention itself, on rays that have no point within the cut-off."""
    papr, cloud = Papr(small_config(cutoff=1e-6)), leaf_cloud()
    rays = view().flat()
    neighbours = torch.zeros(54, 4, dtype=torch.int64)
    out = papr.attention(PosedCloud.at_rest(cloud), rays, neighbours, rays)
    assert torch.equal(out.background, torch.ones(54))
    assert torch.equal(out.weights, torch.zeros(54, 4))
    (1e3 * (out.features.sum() + out.background.sum() + out.centroid.sum())).backward()
    for tensor in (cloud.positions, cloud.features, cloud.influence, *papr.parameters()):
        if tensor.grad is not None:
            assert bool(torch.isfinite(tensor.grad).all())


def test_no_ray_within_the_cutoff() -> None:
    config = small_config(cutoff=1e-4, background=(0.2, 0.4, 0.6))
    papr, cloud = Papr(config), leaf_cloud()
    out = picture_of(papr, moved(cloud, cloud.positions + 5.0), view())
    assert torch.equal(out.alpha, torch.zeros(6, 9))
    assert torch.equal(out.rgb, torch.tensor(config.background).expand(6, 9, 3))
    out.rgb.sum().backward()


def test_points_beyond_the_cutoff_get_no_weight() -> None:
    cloud = small_cloud()
    rays = view()
    out = picture_of(Papr(small_config(cutoff=0.1)), cloud, rays)
    offset = cloud.positions[out.neighbours] - rays.origins.unsqueeze(-2)
    distance = torch.linalg.cross(
        offset, rays.directions.unsqueeze(-2).expand_as(offset), dim=-1
    ).norm(dim=-1)
    assert bool((distance > 0.1).any())
    assert bool((distance[..., 0] < 0.1).any())
    weights = out.weights.detach()
    assert float(weights[distance > 0.101].abs().max()) == 0
    assert float(weights[distance < 0.099].min()) > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"neighbours": 0},
            "expected neighbours and feature_size of at least 1, got 0 and 6",
        ),
        ({"cutoff": -1.0}, r"expected a positive coord_scale and cutoff, got 10.0 and -1.0"),
        (
            {"key": MlpConfig(layers=2, size=8)},
            "key and query embeddings of one size, got 8 and 16",
        ),
    ],
)
def test_wrong_configuration(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        small_config(**changes)


@pytest.mark.parametrize(
    ("layers", "skip", "message"),
    [(1, None, "at least 2 layers"), (3, 3, "skip_after between 1 and 2, got 3")],
)
def test_wrong_mlp(layers: int, skip: int | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        MlpConfig(layers=layers, skip_after=skip)


def test_surface_points_keep_full_precision_under_autocast() -> None:
    papr, cloud, rays = Papr(small_config()), small_cloud(), view().flat()
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        found = trace(papr, PosedCloud.at_rest(cloud), rays)
    assert found.centroid.dtype == torch.float32
    weighted = (found.weights.unsqueeze(-1).float() * cloud.positions[found.neighbours]).sum(dim=1)
    torch.testing.assert_close(found.centroid, weighted, rtol=0, atol=1e-5)


def test_the_numbers_of_a_configuration_are_sent_to_a_device_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Sending them at every step would make it wait for the GPU every time."""
    papr_module._sent_once.cache_clear()
    made: list[tuple[float, ...]] = []
    tensor = torch.tensor

    def counted(values: tuple[float, ...], **options: object) -> Tensor:
        made.append(values)
        return tensor(values, **options)  # pyright: ignore[reportArgumentType, reportCallIssue]

    monkeypatch.setattr(papr_module.torch, "tensor", counted)
    reference = ReferenceOrigin(center=(0.1, 0.2, 0.3), distance=2.0)
    single = papr_module.constant(reference.center, torch.zeros(1))
    assert papr_module.constant(reference.center, torch.ones(2)) is single
    assert made == [(0.1, 0.2, 0.3)]
    double = papr_module.constant(reference.center, torch.zeros(1, dtype=torch.float64))
    assert double.tolist() == [0.1, 0.2, 0.3]

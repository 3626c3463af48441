"""The random deformations of fine-tuning."""

import math

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine, Deformation, orientation
from pcore.deform.sampler import DeformationRanges, sample_deformation
from pcore.deform.simple import AxialStretch, Bend, SimpleDeform, Twist, VolumeStretch
from pcore.errors import InputError


def cloud(size: tuple[float, float, float]) -> Tensor:
    points = torch.rand(400, 3, generator=torch.Generator().manual_seed(5)) - 0.5
    return points * torch.tensor(size) + torch.tensor([0.3, -1.0, 2.0])


def draws(points: Tensor, count: int, seed: int = 0, **ranges) -> list[Deformation]:
    generator = torch.Generator().manual_seed(seed)
    lower, upper = points.amin(dim=0), points.amax(dim=0)
    options = DeformationRanges(**ranges)
    return [sample_deformation(generator, lower, upper, points, options) for _ in range(count)]


@pytest.mark.parametrize(
    "size", [(1.0, 1.0, 1.0), (2.0, 0.1, 1.0), (0.05, 0.05, 2.0)], ids=["cube", "plate", "stick"]
)
@pytest.mark.parametrize("profile", ["axial", "volume"])
def test_never_folds(size, profile: str):
    points = cloud(size)
    for deformation in draws(points, 300, profile=profile):
        assert float(orientation(deformation, points).min()) > 0


def test_draws_all_kinds_equally():
    counts = {Twist: 0, Bend: 0, AxialStretch: 0, Affine: 0}
    for deformation in draws(cloud((1.0, 0.8, 1.2)), 1200):
        counts[type(deformation)] += 1
    # 300 expected each, standard deviation 15.
    assert all(240 < count < 360 for count in counts.values())


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_scales_are_drawn_as_often_as_asked(share: float):
    sampled = draws(cloud((1.0, 0.8, 1.2)), 400, scale_share=share)
    # Standard deviation at most 10.
    assert abs(sum(isinstance(d, Affine) for d in sampled) - 400 * share) <= 40 * (share == 0.5)


def test_magnitudes_fill_their_ranges():
    points = cloud((1.0, 0.8, 1.2))
    sampled = draws(points, 1200)
    for kind, least, greatest in (
        (Twist, -math.pi / 3, math.pi / 3),
        (Bend, -math.pi / 3, math.pi / 3),
        (AxialStretch, 0.0, 2.0),
    ):
        values = torch.tensor([d.value for d in sampled if isinstance(d, kind)])
        width = greatest - least
        assert least <= values.min() < least + 0.05 * width
        assert greatest - 0.05 * width < values.max() <= greatest
        assert abs(values.mean() - 0.5 * (least + greatest)) < 0.1 * width
    scales = torch.tensor([d.matrix[0, 0] for d in sampled if isinstance(d, Affine)])
    assert 0.5 <= scales.min() < 0.58
    assert 1.92 < scales.max() <= 2.0


def test_directions_are_uniform_on_the_sphere():
    axes = [
        d.rotation[2] for d in draws(cloud((1.0, 1.0, 1.0)), 1200) if isinstance(d, SimpleDeform)
    ]
    stacked = torch.stack(axes)
    second_moment = stacked.T @ stacked / len(axes)
    torch.testing.assert_close(
        second_moment, torch.eye(3, dtype=torch.float64) / 3, rtol=0, atol=0.06
    )
    assert float(stacked.mean(dim=0).norm()) < 0.1


def test_acts_about_the_box_with_the_extent_of_the_points():
    points = cloud((1.0, 0.5, 2.0))
    center = 0.5 * (points.amin(dim=0) + points.amax(dim=0)).double()
    for deformation in draws(points, 60):
        torch.testing.assert_close(deformation(center), center)
        if isinstance(deformation, SimpleDeform):
            driving = deformation.rotation[0 if isinstance(deformation, Bend) else 2]
            along = (points.double() - center) @ driving
            assert deformation.extent == pytest.approx(
                (along.min().item(), along.max().item()), abs=1e-5
            )
            assert deformation.limits == (0.0, 1.0)


def test_the_same_seed_draws_the_same():
    points = cloud((1.0, 1.0, 1.0))
    first, again, other = (draws(points, 20, seed=seed) for seed in (7, 7, 8))
    assert all(torch.equal(a(points), b(points)) for a, b in zip(first, again, strict=True))
    assert not all(torch.equal(a(points), b(points)) for a, b in zip(first, other, strict=True))


def test_ranges_are_obeyed():
    points = cloud((1.0, 1.0, 1.0))
    narrow = draws(
        points, 200, stretch=(1.5, 1.5), twist_degrees=10.0, bend_degrees=0.0, scale=(0.9, 0.9),
        profile="volume",
    )  # fmt: skip
    kinds = {type(deformation) for deformation in narrow}
    assert kinds == {VolumeStretch, Twist, Bend, Affine}
    for deformation in narrow:
        if isinstance(deformation, VolumeStretch):
            assert deformation.value == pytest.approx(0.5)
        elif isinstance(deformation, Twist):
            assert abs(deformation.value) <= math.radians(10.0)
        elif isinstance(deformation, Bend):
            assert deformation.value == 0.0
        else:
            assert float(deformation.matrix[1, 1]) == pytest.approx(0.9)


def test_a_bend_that_must_fold_is_made_smaller():
    """Asked for bends far beyond what the points allow, the sampler ends and does not fold."""
    points = cloud((1.0, 1.0, 1.0))
    for deformation in draws(points, 40, bend_degrees=100_000.0):
        assert float(orientation(deformation, points).min()) > 0


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"stretch": (0.0, 3.0)}, r"0 < least <= greatest for stretch, got \(0.0, 3.0\)"),
        ({"scale": (2.0, 0.5)}, r"0 < least <= greatest for scale, got \(2.0, 0.5\)"),
        ({"twist_degrees": -1.0}, "twist_degrees of 0 or more, got -1.0"),
        ({"bend_degrees": math.nan}, "bend_degrees of 0 or more, got nan"),
        ({"scale_share": 1.5}, r"scale_share in \[0, 1\], got 1.5"),
        ({"profile": "blender"}, 'profile "axial" or "volume", got \'blender\''),
    ],
)
def test_bad_ranges_are_refused(ranges: dict, message: str):
    with pytest.raises(InputError, match=message):
        DeformationRanges(**ranges)


@pytest.mark.parametrize("shape", [(0, 3), (5, 2), (3,)])
def test_points_are_needed(shape: tuple[int, ...]):
    with pytest.raises(InputError, match=r"expected canonical points \(N, 3\), got"):
        sample_deformation(
            torch.Generator(), torch.zeros(3), torch.ones(3), torch.zeros(shape),
            DeformationRanges(),
        )  # fmt: skip

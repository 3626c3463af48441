"""Laws that every deformation keeps, whatever its parameters."""

import math

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine, Compose, Deformation, Identity, orientation
from pcore.deform.frame import axis_frame, axis_vector, bend_frame
from pcore.deform.simple import (
    AxialStretch,
    Bend,
    SimpleDeform,
    Stretch,
    Taper,
    Twist,
    VolumeStretch,
    rigid,
    uniform_scale,
)
from pcore.errors import InputError

TILTED = (0.3, -0.8, 0.5)


def simple(kind: type[SimpleDeform], axis="z", **changes) -> SimpleDeform:
    frame = bend_frame(axis) if kind is Bend else axis_frame(axis)
    fields = {
        "rotation": frame,
        "origin": torch.tensor([0.1, -0.2, 0.05]),
        "extent": (-0.9, 1.1),
        "value": 0.7,
        **changes,
    }
    return kind(**fields)


DEFORMATIONS = {
    "identity": Identity(),
    "affine": Affine(torch.tensor([[1.0, 0.2, 0], [0, 1.5, -0.3], [0.1, 0, 0.8]]), torch.ones(3)),
    "rigid": rigid(TILTED, 0.8, (0.1, 0.2, -0.3), (1, 0, 0)),
    "scale": uniform_scale(1.7, (0.1, 0.2, 0.3)),
    "twist": simple(Twist, TILTED),
    "twist_limits": simple(Twist, "x", limits=(0.3, 0.6)),
    "twist_lock": simple(Twist, "y", lock=(True, False)),
    "taper": simple(Taper, "x"),
    "taper_lock_limits": simple(Taper, TILTED, lock=(False, True), limits=(0.2, 0.8)),
    "stretch": simple(Stretch, "y"),
    "stretch_limits": simple(Stretch, TILTED, limits=(0.25, 0.75)),
    "axial": simple(AxialStretch, TILTED, value=2.0, limits=(0.0, 0.5)),
    "volume": simple(VolumeStretch, TILTED, value=2.0),
    "bend_x": simple(Bend, "x"),
    "bend_limits": simple(Bend, TILTED, limits=(0.3, 0.6)),
    "compose": Compose(simple(Twist), simple(Bend, TILTED), uniform_scale(2.0)),
}


def cloud(count: int = 300, dtype: torch.dtype = torch.float64) -> Tensor:
    return 2.4 * torch.rand(count, 3, generator=torch.Generator().manual_seed(3)).to(dtype) - 1.2


@pytest.fixture(params=DEFORMATIONS.values(), ids=DEFORMATIONS.keys())
def deformation(request) -> Deformation:
    return request.param


def test_jacobian_agrees_with_finite_differences(deformation: Deformation):
    points, step = cloud(), 1e-6
    columns = [
        (deformation(points + step * unit) - deformation(points - step * unit)) / (2 * step)
        for unit in torch.eye(3, dtype=torch.float64)
    ]
    numeric = torch.stack(columns, dim=-1)
    torch.testing.assert_close(deformation.jacobian(points), numeric, rtol=1e-6, atol=1e-7)


def test_formula_agrees_with_the_automatic_jacobian(deformation: Deformation):
    points = cloud()
    automatic = Deformation.jacobian(deformation, points)
    assert not automatic.requires_grad
    torch.testing.assert_close(deformation.jacobian(points), automatic, rtol=1e-12, atol=1e-12)
    with torch.inference_mode():
        inside = Deformation.jacobian(deformation, cloud())
    assert torch.equal(inside, automatic)


def test_the_automatic_jacobian_can_be_differentiated():
    points = cloud(4).requires_grad_(True)
    twist = DEFORMATIONS["twist"]
    gradients = [
        torch.autograd.grad(jacobian.square().sum(), points)[0]
        for jacobian in (twist.jacobian(points), Deformation.jacobian(twist, points))
    ]
    torch.testing.assert_close(gradients[0], gradients[1])


def test_reverse_autograd_agrees_with_jacobian(deformation: Deformation):
    points = cloud(5).requires_grad_(True)
    for row in range(3):
        (gradient,) = torch.autograd.grad(deformation(points)[:, row].sum(), points)
        torch.testing.assert_close(gradient, deformation.jacobian(points.detach())[:, row])


def test_jacobian_can_be_differentiated(deformation: Deformation):
    points = cloud(4).requires_grad_(True)
    loss = deformation.jacobian(points).square().sum() + deformation(points).sum()
    (gradient,) = torch.autograd.grad(loss, points)
    assert bool(torch.isfinite(gradient).all())


def test_a_point_does_not_know_its_company(deformation: Deformation):
    points = cloud(1000, torch.float32)
    together = deformation(points)
    for index in (0, 1, 500, 999):
        torch.testing.assert_close(deformation(points[index]), together[index], rtol=0, atol=1e-6)
        torch.testing.assert_close(
            deformation(points[: index + 1])[-1], together[index], rtol=0, atol=1e-6
        )


def test_batch_shapes_are_kept(deformation: Deformation):
    points = cloud(24, torch.float32)
    shaped = points.reshape(2, 3, 4, 3)
    torch.testing.assert_close(deformation(shaped).reshape(24, 3), deformation(points))
    assert deformation.jacobian(shaped).shape == (2, 3, 4, 3, 3)
    assert deformation(points[:0]).shape == (0, 3)
    assert deformation.jacobian(points[:0]).shape == (0, 3, 3)
    assert deformation.jacobian(points[0]).shape == (3, 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_follows_the_points(deformation: Deformation, dtype: torch.dtype):
    points = cloud(7, dtype)
    assert deformation(points).dtype == dtype
    assert deformation.jacobian(points).dtype == dtype


def test_autocast_does_not_coarsen_places(deformation: Deformation):
    points = cloud(50, torch.float32)
    plain, plain_jacobian = deformation(points), deformation.jacobian(points)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(deformation(points), plain)
        assert torch.equal(deformation.jacobian(points), plain_jacobian)


@pytest.mark.parametrize(
    ("points", "found"),
    [(torch.zeros(4, 2), r"got \(4, 2\)"), (torch.zeros(4, 3, dtype=torch.int64), "torch.int64")],
)
def test_other_points_are_refused(deformation: Deformation, points: Tensor, found: str):
    for action in (deformation, deformation.jacobian):
        with pytest.raises(InputError, match=r"expected floating-point points of shape.*" + found):
            action(points)


def test_inputs_are_left_alone(deformation: Deformation):
    points = cloud(20, torch.float32)
    before = points.clone()
    deformation(points)
    deformation.jacobian(points)
    assert torch.equal(points, before)


def test_parameters_are_frozen_copies():
    origin, rotation = torch.zeros(3), axis_frame("x")
    twist = simple(Twist, rotation=rotation, origin=origin)
    points = cloud(10)
    before = twist(points)
    origin += 5.0
    rotation += 1.0
    assert torch.equal(twist(points), before)


@pytest.mark.parametrize("kind", [Twist, Taper, Stretch, AxialStretch, VolumeStretch, Bend])
@pytest.mark.parametrize("value", [0.0, 1e-9])
def test_no_amount_is_the_identity(kind: type[SimpleDeform], value: float):
    points = cloud()
    deformation = simple(kind, TILTED, value=value, limits=(0.1, 0.7))
    expected = points
    if kind is Stretch:
        # Blender's profile is 1 - k + k t^2: also the identity at k = 0.
        assert deformation.rate == pytest.approx(value / 1.2)
    torch.testing.assert_close(deformation(points), expected, rtol=0, atol=1e-8)
    single = deformation(points.float())
    torch.testing.assert_close(single, expected.float(), rtol=0, atol=5e-7)


@pytest.mark.parametrize("angle", [1e-8, 1e-6, 1e-4, 1e-3])
def test_small_bends_are_smooth_in_single_precision(angle: float):
    points = cloud(dtype=torch.float32)
    single = simple(Bend, value=angle)(points)
    double = simple(Bend, value=angle)(points.double())
    torch.testing.assert_close(single.double(), double, rtol=0, atol=5e-7)
    assert float((double - points).norm(dim=-1).max()) < 2 * angle + 1e-12


def test_a_right_angle_bend_rolls_up_a_quarter_circle():
    bend = Bend(
        rotation=bend_frame("z"), origin=torch.zeros(3), extent=(0.0, 1.0), value=math.pi / 2
    )
    radius = 2 / math.pi
    ends = bend(torch.tensor([[0.0, 0, 0], [1.0, 0, 0.4], [1.5, 0, 0]], dtype=torch.float64))
    expected = torch.tensor([[0, 0, 0], [radius, radius, 0.4], [radius, radius + 0.5, 0]])
    torch.testing.assert_close(ends, expected.double(), rtol=0, atol=1e-7)


def test_twist_turns_the_end_by_the_angle():
    twist = Twist(
        rotation=axis_frame("z"), origin=torch.zeros(3), extent=(0.0, 2.0), value=math.pi / 2
    )
    end = twist(torch.tensor([1.0, 0.0, 2.0]))
    torch.testing.assert_close(end, torch.tensor([0.0, 1.0, 2.0]))


@pytest.mark.parametrize("kind", [AxialStretch, VolumeStretch])
def test_stretch_factor_is_growth_of_the_extent(kind: type[SimpleDeform]):
    stretch = simple(kind, TILTED, value=2.0)
    direction, lo_hi = axis_vector(TILTED), torch.tensor([-0.9, 1.1], dtype=torch.float64)
    ends = stretch.origin + lo_hi[:, None] * direction
    grown = stretch(ends)
    assert float((grown[1] - grown[0]) @ direction) == pytest.approx(3.0 * 2.0)


def test_volume_stretch_keeps_volume_and_axial_the_cross_section():
    points = 0.4 * cloud()
    volume = torch.linalg.det(simple(VolumeStretch, TILTED, value=1.4).jacobian(points))
    torch.testing.assert_close(volume, torch.ones_like(volume))
    axial = torch.linalg.det(simple(AxialStretch, TILTED, value=1.4).jacobian(points))
    torch.testing.assert_close(axial, torch.full_like(axial, 2.4))


def test_rigid_keeps_distances_and_its_inverse_undoes_it():
    motion, points = rigid(TILTED, 1.1, (0.4, 0, -2), (0.3, 0.2, 0.1)), cloud()
    moved = motion(points)
    torch.testing.assert_close(torch.pdist(moved), torch.pdist(points))
    torch.testing.assert_close(motion.inverse()(moved), points)
    assert float(torch.linalg.det(motion.matrix)) == pytest.approx(1.0)


def test_rigid_turns_right_handed_about_its_origin():
    motion = rigid("z", math.pi / 2, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    moved = motion(torch.tensor([2.0, 0.0, 0.0]))
    torch.testing.assert_close(moved, torch.tensor([1.0, 1.0, 1.0]), rtol=0, atol=1e-6)


def test_scale_multiplies_distances_from_its_origin():
    center = torch.tensor([0.3, 0.1, -0.2], dtype=torch.float64)
    points = cloud()
    torch.testing.assert_close(uniform_scale(0.5, center)(points) - center, 0.5 * (points - center))


def test_composition_is_one_after_the_other():
    first, second = DEFORMATIONS["twist"], DEFORMATIONS["bend_x"]
    points = cloud()
    torch.testing.assert_close(Compose(first, second)(points), second(first(points)))
    assert not torch.allclose(Compose(second, first)(points), second(first(points)))
    assert torch.equal(Compose()(points), points)


def test_reversing_the_axis():
    """A twist is the same seen from the other end; a bend turns the other way."""
    points = cloud()
    back = tuple(-value for value in TILTED)
    here = simple(Twist, TILTED, extent=(-1.0, 1.0))
    there = simple(Twist, back, extent=(-1.0, 1.0))
    torch.testing.assert_close(here(points), there(points))
    bent = simple(Bend, TILTED, value=0.5)(points)
    torch.testing.assert_close(simple(Bend, back, value=-0.5)(points), bent)


@pytest.mark.parametrize("frame", [axis_frame, bend_frame])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_vector_along_a_named_axis_is_that_axis(frame, axis: str):
    vector = [0.0, 0.0, 0.0]
    vector["xyz".index(axis)] = 3.0
    assert torch.equal(frame(vector), frame(axis))
    vector["xyz".index(axis)] = 1.0
    near = [value + 1e-6 for value in vector]
    torch.testing.assert_close(frame(near), frame(axis), rtol=0, atol=1e-5)


def test_frames_are_orthonormal_around_their_axis():
    generator = torch.Generator().manual_seed(1)
    for _ in range(50):
        vector = torch.randn(3, generator=generator, dtype=torch.float64)
        for frame in (axis_frame(vector.tolist()), bend_frame(vector.tolist())):
            torch.testing.assert_close(frame @ frame.T, torch.eye(3, dtype=torch.float64))
            torch.testing.assert_close(frame[2], vector / vector.norm())


def test_tiny_and_huge_axes_are_directions():
    for size in (1e-300, 1e300):
        torch.testing.assert_close(axis_vector([0.0, size, size]), axis_vector([0.0, 1.0, 1.0]))


def test_orientation_does_not_depend_on_units():
    points = cloud(10)
    for size in (1e-4, 1.0, 1e4):
        ones = orientation(uniform_scale(size), points)
        torch.testing.assert_close(ones, torch.ones_like(ones))
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3))
    assert orientation(mirror, points).tolist() == pytest.approx([-1.0] * 10)
    flat = Affine(torch.zeros(3, 3), torch.zeros(3))
    assert orientation(flat, points).tolist() == [0.0] * 10


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotation": 2 * torch.eye(3)}, "deform frame: expected orthonormal rows.*off by 3"),
        ({"rotation": torch.eye(2)}, r"deform frame: expected shape \(3, 3\), got \(2, 2\)"),
        ({"origin": torch.tensor([0, math.nan, 0])}, "deform origin: expected finite numbers"),
        ({"extent": (1.0, 1.0)}, r"deform extent: expected finite lo < hi, got \(1.0, 1.0\)"),
        ({"extent": (0.0, math.inf)}, "deform extent: expected finite lo < hi"),
        ({"limits": (0.8, 0.2)}, "deform limits: expected 0 <= first < second <= 1"),
        ({"extent": (0.0, 1e-320)}, "deform limits: expected a span that numbers can resolve"),
        ({"limits": (-0.1, 1.0)}, "deform limits: expected 0 <= first < second <= 1"),
        ({"value": math.nan}, "deform value: expected a finite number, got nan"),
    ],
)
def test_bad_parameters_are_refused(changes: dict, message: str):
    with pytest.raises(InputError, match=message):
        simple(Twist, **changes)


@pytest.mark.parametrize("kind", [AxialStretch, VolumeStretch])
def test_stretch_to_nothing_is_refused(kind: type[SimpleDeform]):
    with pytest.raises(InputError, match="stretch factor: expected more than -1"):
        simple(kind, value=-1.0)


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        ("w", 'expected "x", "y", "z" or \\[x, y, z\\], got \'w\''),
        ([0.0, 0.0, 0.0], "expected a direction, got the zero vector"),
        ([1.0, 0.0], "expected three finite numbers"),
        ([1.0, math.nan, 0.0], "expected three finite numbers"),
    ],
)
def test_bad_axes_are_refused(axis, message: str):
    for action in (axis_frame, bend_frame, rigid):
        with pytest.raises(InputError, match=message):
            action(axis)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.inf, math.nan])
def test_bad_scales_are_refused(factor: float):
    with pytest.raises(InputError, match="scale factor: expected a positive finite number"):
        uniform_scale(factor)


def test_a_singular_affine_has_no_inverse():
    with pytest.raises(InputError, match="expected an invertible matrix"):
        Affine(torch.zeros(3, 3), torch.zeros(3)).inverse()


def test_folds_are_found_where_the_determinant_stays_positive():
    """A taper past its apex turns the cross-section over by half a turn: det J > 0 again."""
    taper = Taper(
        rotation=axis_frame("z"), origin=torch.zeros(3), extent=(-1.0, 1.0), value=-3.0
    )  # cross-sections times 1 - 1.5 t
    points = torch.tensor([[0.1, 0.1, -0.5], [0.1, 0.1, 0.5], [0.1, 0.1, 0.9]])
    assert float(orientation(taper, points).min()) > 0
    assert taper.folded(points).tolist() == [False, False, True]


def test_two_folds_do_not_undo_each_other():
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3))
    points = cloud(10)
    assert bool((orientation(Compose(mirror, mirror), points) > 0).all())
    assert bool(Compose(mirror, mirror).folded(points).all())
    assert not bool(Compose(rigid("x", 1.0), Identity()).folded(points).any())

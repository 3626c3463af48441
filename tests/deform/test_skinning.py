"""Linear blend skinning, anchor motions and weights by distance."""

import pytest
import torch
from scipy.spatial.transform import Rotation

from pcore.deform.anchor_distance import (
    PathDistance,
    StraightDistance,
    distance_weigher,
    path_distance,
)
from pcore.deform.base import Affine
from pcore.deform.motion import rigid, uniform_scale
from pcore.deform.simple import Twist
from pcore.deform.skinning import (
    AnchorPose,
    SkinnedDeformation,
    SkinningWeights,
    gaussian_logits,
    pose_of,
    skin,
    softmax_weights,
)
from pcore.errors import InputError
from pcore.geometry.farthest_points import farthest_points

POINTS = torch.rand(300, 3, generator=torch.Generator().manual_seed(4)) * 2 - 1


def path(count: int = 20) -> PathDistance:
    return path_distance(POINTS, farthest_points(POINTS, count))


def random_pose(count: int) -> AnchorPose:
    return AnchorPose(
        rest=torch.randn(count, 3),
        moved=torch.randn(count, 3),
        rotations=torch.from_numpy(Rotation.random(count, rng=1).as_matrix()).float(),
    )


def test_it_is_the_formula_of_the_paper() -> None:
    pose = random_pose(6)
    weights = SkinningWeights(
        anchors=torch.tensor([[0, 3], [5, 1]]), values=torch.tensor([[0.25, 0.75], [1.0, 0.0]])
    )
    points = torch.randn(2, 3)
    found = skin(points, weights, pose)
    for i in range(2):
        terms = [
            w * (pose.rotations[m] @ points[i] + pose.translations[m])
            for m, w in zip(weights.anchors[i], weights.values[i], strict=True)
        ]
        torch.testing.assert_close(found.positions[i], sum(terms))
    blend = 0.25 * pose.rotations[0] + 0.75 * pose.rotations[3]
    torch.testing.assert_close(found.linear[0], blend)
    torch.testing.assert_close(found.linear[1], pose.rotations[5])


def test_anchors_at_rest_move_nothing_at_all() -> None:
    distance = path()
    eye = torch.eye(3).expand(20, 3, 3)
    pose = AnchorPose(rest=distance.anchors, moved=distance.anchors, rotations=eye)
    weights = distance_weigher(distance, sigma=0.2)(POINTS)
    found = skin(POINTS, weights, pose)
    assert torch.equal(found.positions, POINTS)
    assert torch.equal(found.linear, torch.eye(3).expand(300, 3, 3))


def test_rigid_motion_is_exact_for_any_weights() -> None:
    motion = rigid([1.0, 2.0, 0.5], 1.1, [0.3, -2.0, 1.0])
    distance = path()
    pose = pose_of(motion, distance.anchors)
    found = skin(POINTS, distance_weigher(distance, sigma=1.0)(POINTS), pose)
    torch.testing.assert_close(found.positions, motion(POINTS), atol=1e-5, rtol=0)
    torch.testing.assert_close(found.linear, motion.jacobian(POINTS), atol=1e-6, rtol=0)


def test_the_motion_of_an_anchor_takes_it_where_the_field_does() -> None:
    field = Twist(
        rotation=torch.eye(3), origin=torch.zeros(3), extent=(-1.0, 1.0), limits=(0, 1), value=1.0
    )
    anchors = path().anchors
    pose = pose_of(field, anchors)
    carried = (pose.rotations @ anchors.unsqueeze(-1)).squeeze(-1) + pose.translations
    torch.testing.assert_close(carried, field(anchors), atol=1e-6, rtol=0)
    orthonormal = pose.rotations @ pose.rotations.transpose(1, 2)
    torch.testing.assert_close(orthonormal, torch.eye(3).expand(20, 3, 3), atol=1e-6, rtol=0)


def test_a_scaling_turns_nothing_and_a_mirror_stays_proper() -> None:
    anchors = path().anchors
    eye = torch.eye(3).expand(20, 3, 3)
    torch.testing.assert_close(pose_of(uniform_scale(2.5), anchors).rotations, eye)
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3))
    assert (torch.det(pose_of(mirror, anchors).rotations) > 0.99).all()


def test_gaussian_weights() -> None:
    distances = torch.tensor([[0.0, 1.0, 2.0]])
    weights = softmax_weights(torch.tensor([[4, 2, 9]]), gaussian_logits(distances, 0.8)).values
    expected = torch.exp(-distances.square() / (2 * 0.8**2))
    torch.testing.assert_close(weights, expected / expected.sum())
    with pytest.raises(InputError, match="expected a sigma above 0, got 0"):
        gaussian_logits(distances, 0.0)


def test_the_nearest_anchors_through_space() -> None:
    anchors = torch.randn(30, 3)
    found = StraightDistance(anchors=anchors).candidates(POINTS, 8)
    expected = torch.cdist(POINTS, anchors).sort(dim=1)
    torch.testing.assert_close(found.distances, expected.values[:, :8], atol=1e-5, rtol=1e-5)
    assert StraightDistance(anchors=anchors[:3]).candidates(POINTS, 8).anchors.shape == (300, 3)


def test_paths_keep_touching_parts_apart() -> None:
    """Two rods that nearly touch at one end and are joined at the other."""
    rod = torch.linspace(0, 1, 200)
    left = torch.stack([-0.03 + 0 * rod, 0 * rod, rod], dim=1)
    right = torch.stack([0.03 + 0 * rod, 0 * rod, rod], dim=1)
    joint = torch.tensor([[-0.015, 0.0, 0.0], [0.0, 0.0, 0.0], [0.015, 0.0, 0.0]])
    points = torch.cat([left, right, joint])
    distance = path_distance(points, farthest_points(points, 24), links=4)
    tip = points[199:200]
    along, straight = (
        kind.candidates(tip, 8) for kind in (distance, StraightDistance(anchors=distance.anchors))
    )
    assert (distance.anchors[along.anchors[0], 0] < 0).all()
    assert (distance.anchors[straight.anchors[0], 0] > 0).any()
    assert float(distance.distances(tip)[0, distance.anchors[:, 0] > 0.02].min()) > 0.9


def test_points_of_the_cloud_and_points_beside_it() -> None:
    distance = path()
    own = distance.distances(POINTS)
    torch.testing.assert_close(own, distance.lengths)
    beside = POINTS + 1e-3
    assert (distance.distances(beside) - own).abs().max() < 3e-3
    # A far point takes the way in that is shortest, and each point is treated by itself.
    far = torch.tensor([[9.0, 0.0, 0.0]])
    assert (distance.distances(far) >= 8.0).all()
    many = distance.candidates(torch.cat([POINTS] * 20), 8)
    assert torch.equal(many.anchors[:300], distance.candidates(POINTS, 8).anchors)


def test_no_points_have_no_candidates() -> None:
    assert path().candidates(torch.zeros(0, 3), 8).anchors.shape == (0, 8)


def test_gradients_reach_points_and_weights() -> None:
    pose = random_pose(4)
    points = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    logits = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    chosen = torch.randint(4, (5, 3))

    def moved(p: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        return skin(p, softmax_weights(chosen, z), pose).positions

    assert torch.autograd.gradcheck(moved, (points, logits))


def skinned() -> SkinnedDeformation:
    distance = path()
    field = Twist(
        rotation=torch.eye(3), origin=torch.zeros(3), extent=(-1.0, 1.0), limits=(0, 1), value=1.0
    )
    weigher = distance_weigher(distance, sigma=0.3)
    return SkinnedDeformation(
        pose=pose_of(field, distance.anchors),
        weigher=weigher,
        bound=POINTS,
        weights=weigher(POINTS),
    )


def test_a_pose_is_a_map_of_space() -> None:
    deformation = skinned()
    at_once = deformation(POINTS.reshape(30, 10, 3))
    assert at_once.shape == (30, 10, 3)
    torch.testing.assert_close(at_once.reshape(-1, 3), deformation(POINTS), atol=1e-6, rtol=0)
    one = deformation(POINTS[7])
    torch.testing.assert_close(one, deformation(POINTS)[7], atol=1e-6, rtol=0)
    assert deformation(POINTS.double()).dtype == torch.float64
    assert torch.equal(deformation.jacobian(POINTS), deformation.at(POINTS).linear)
    assert not deformation.folded(POINTS).any()


def test_known_points_are_not_weighed_again() -> None:
    deformation = skinned()

    def refuse(points: torch.Tensor) -> SkinningWeights:
        raise AssertionError(f"{len(points)} points were weighed again")

    object.__setattr__(deformation, "weigher", refuse)
    assert deformation(POINTS.double()).shape == (300, 3)
    with pytest.raises(AssertionError, match="299 points were weighed again"):
        deformation(POINTS[1:])


def test_bad_input() -> None:
    pose = random_pose(4)
    with pytest.raises(InputError, match=r"expected weights of 3 points, got anchors \(2, 1\)"):
        skin(
            torch.zeros(3, 3),
            SkinningWeights(anchors=torch.zeros(2, 1, dtype=torch.int64), values=torch.ones(2, 1)),
            pose,
        )
    with pytest.raises(InputError, match=r"expected rest \(M, 3\)"):
        AnchorPose(rest=pose.rest, moved=pose.moved[:2], rotations=pose.rotations)
    with pytest.raises(InputError, match="got NaN or infinity"):
        AnchorPose(rest=pose.rest, moved=pose.moved * torch.nan, rotations=pose.rotations)

"""Points that were moved by whatever means, and came apart: a hand on a hip that is lifted."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from pcore.deform.checks import count_folds
from pcore.deform.jacobian import estimated_maps
from pcore.deform.motion import rigid
from pcore.deform.pose import pose
from pcore.editing.script import EditScript, parse_edit
from pcore.errors import EditError
from pcore.geometry.point_cloud import PointCloud

LIFT = rigid("y", math.radians(70), (0.1, 0.0, 0.25), (0.5, 0.0, 0.4))


def body_and_hand() -> tuple[Tensor, Tensor]:
    """A body and a hand that touches it, points on both surfaces; and which points are hand."""
    draw = torch.Generator().manual_seed(4)
    body = torch.nn.functional.normalize(torch.randn(3000, 3, generator=draw), dim=-1) * 0.4
    hand = torch.nn.functional.normalize(torch.randn(600, 3, generator=draw), dim=-1)
    hand = hand * torch.tensor([0.06, 0.15, 0.2]) + torch.tensor([0.45, 0.0, 0.0])
    points = torch.cat([body, hand])
    return points, torch.arange(3600) >= 3000


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    points, hand = body_and_hand()
    np.save("before.npy", points.numpy())
    np.save("after.npy", torch.where(hand[:, None], LIFT(points), points).numpy())


def script(**change) -> EditScript:
    edit = {"type": "displacement", "before": "before.npy", "after": "after.npy", **change}
    return parse_edit({"version": 2, "edits": [edit]}, source="edit.json")


def cloud(points: Tensor) -> PointCloud:
    count = len(points)
    return PointCloud(
        positions=points, features=torch.zeros(count, 4), influence=torch.zeros(count)
    )


@pytest.mark.parametrize("match", ["id", "position"])
def test_a_hand_that_is_lifted_keeps_its_local_maps_and_the_hip_its_own(match: str):
    points, hand = body_and_hand()
    moved = pose(cloud(points), script(match=match).bind(points))
    assert moved.local_maps is not None
    truth = torch.where(hand[:, None, None], LIFT.matrix.T.float(), torch.eye(3))
    off = torch.linalg.matrix_norm(moved.local_maps.to_rest - truth)
    apart = torch.cdist(points[hand], points[~hand]).amin(dim=1) < 0.04
    near = torch.cdist(points[~hand], points[hand]).amin(dim=1) < 0.04
    assert int(apart.sum()) > 50
    assert int(near.sum()) > 50
    # Touching points: most follow their own part. A fit that is not robust is off by 0.5 and more.
    assert float(off[hand][apart].median()) < 0.1
    assert float(off[~hand][near].median()) < 0.1
    assert float(off[~hand][~near].quantile(0.95)) < 0.05


def test_the_local_maps_of_the_edit_are_those_of_the_estimate():
    points, _ = body_and_hand()
    moved = torch.from_numpy(np.load("after.npy"))
    local_maps = pose(cloud(points), script().bind(points)).local_maps
    assert local_maps is not None
    expected = estimated_maps(points, moved)
    torch.testing.assert_close(local_maps.to_rest, expected.to_rest, rtol=0, atol=1e-5)
    assert torch.equal(local_maps.mended, expected.mended)


def folded() -> Tensor:
    """Where a solid goes whose layers change places; the fits in the middle would fold."""
    rest = torch.rand(1500, 3, generator=torch.Generator().manual_seed(1))
    middle = (rest[:, 2] > 0.3) & (rest[:, 2] < 0.7)
    moved = rest.clone()
    moved[middle, 2] = 1.0 - moved[middle, 2]
    np.save("before.npy", rest.numpy())
    np.save("after.npy", moved.numpy())
    return rest


@pytest.mark.parametrize("amount", [1.0, 0.9])
def test_maps_that_fold_are_mended_and_said(amount: float):
    points = folded()
    bound = script(amount=amount).bound(points)
    local_maps = pose(cloud(points), bound.deformation).local_maps
    assert local_maps is not None
    assert len(local_maps.mended) > 100
    assert float(torch.linalg.det(local_maps.to_rest).min()) > 0
    (note,) = bound.notes
    first = ", ".join(str(int(number)) for number in local_maps.mended[:5])
    assert note.startswith(
        f"edit 1 (displacement): at {len(local_maps.mended)} of 1500 points (numbers {first}, ...) "
        "the local map turns space inside out"
    )
    quiet = script(region={"shape": "sphere", "center": [0.5, 0.5, 0], "radius": 0.2, "falloff": 0})
    assert quiet.bound(points).notes == ()


def test_a_mirrored_object_is_refused_with_advice_that_fits_and_drawn_with_plain_rays():
    points = torch.rand(400, 3)
    np.save("before.npy", points.numpy())
    np.save("after.npy", (points * torch.tensor([1.0, 1.0, -1.0])).numpy())
    with pytest.raises(EditError, match="at 400 of 400 points") as caught:
        script().bound(points)
    text = str(caught.value)
    assert "turn the object instead of mirroring it" in text
    assert "plain rays can draw it" in text
    assert "angle" not in text
    deformation = script().bound(points, check=False).deformation
    moved = pose(cloud(points), deformation, aware=False)
    assert torch.equal(moved.positions, points * torch.tensor([1.0, 1.0, -1.0]))
    assert count_folds(deformation, points.double()).folded == 400

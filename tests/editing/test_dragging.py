"""Handles that are dragged, pinned, turned and mirrored."""

import math

import pytest
import torch

from pcore.editing.dragging import Drag, Mirror
from pcore.editing.session import EditSession
from pcore.errors import EditError
from pcore.geometry.point_cloud import size_of
from pcore.geometry.rotation import rotations


def figure() -> torch.Tensor:
    """Random points and their images in the plane x = 0."""
    half = torch.rand(300, 3, generator=torch.Generator().manual_seed(5))
    return torch.cat([half, half * torch.tensor([-1.0, 1, 1])])


def a_drag(**more) -> Drag:
    return Drag(size=size_of(figure()), count=60, **more)


def test_a_dragged_handle_takes_its_surroundings_along_and_pins_hold():
    points = figure()
    top, low = points[points[:, 2].argmax()], points[points[:, 2].argmin()]
    drag = a_drag(reach=10.0).put(top).put(low)
    to = top + torch.tensor([0.0, 0.0, 0.3])
    session = EditSession(points)
    state = session.do(drag.moved(0, to).edit())
    way = (state.points - points).norm(dim=1)
    assert float(way[points[:, 2].argmax()]) > 0.25
    assert float(way[points[:, 2].argmin()]) < 0.02
    assert drag.moved(0, to).without(0).edit()["handles"][0]["to"] == low.double().tolist()


def test_what_is_done_on_one_side_is_done_on_the_other():
    points = figure()
    mirror = Mirror.of(points)
    hand = points[:300][points[:300, 0].argmax()]
    turn = (math.cos(0.3), 0.0, math.sin(0.3), 0.0)
    drag = a_drag(mirror=mirror).put(hand)
    assert len(drag.handles) == 2
    moved = drag.moved(0, hand + torch.tensor([0.1, 0.0, 0.2]), turn)
    first, second = moved.handles
    assert second.to == pytest.approx(mirror.image(first.to))
    assert second.rotation is not None
    # A mirrored turn is the turn between two mirrorings.
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    expected = flip @ rotations(torch.tensor(turn)) @ flip
    torch.testing.assert_close(rotations(torch.tensor(second.rotation)), expected)


def test_on_the_plane_there_is_one_handle():
    mirror = Mirror(origin=(0, 0, 0), normal=(1, 0, 0))
    drag = a_drag(mirror=mirror).put([0.0, 0.5, 0.5])
    assert len(drag.handles) == 1
    assert drag.moved(0, [0.2, 0.5, 0.5]).handles[0].to == (0.2, 0.5, 0.5)


def test_what_cannot_be_dragged():
    with pytest.raises(EditError, match="expected at least one handle"):
        a_drag().edit()
    with pytest.raises(EditError, match="a number below 0, got 0"):
        a_drag().moved(0, [0, 0, 0])
    with pytest.raises(EditError, match="a place without one"):
        a_drag().put([0, 0, 0]).put([0, 0, 0])

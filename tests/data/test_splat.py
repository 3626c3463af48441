"""Pictures of bare points."""

import pytest
import torch

from pcore.data.splat import point_picture
from pcore.errors import InputError
from pcore.geometry.camera import Camera

RED, BLUE = [255, 0, 0], [0, 0, 255]


def camera() -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = 5.0
    return Camera.from_fov(pose, width=11, height=9, angle_x=0.6)


def test_the_nearer_point_covers_the_farther():
    points = torch.tensor([[0.0, 0, 1], [0, 0, 0], [0, 0, 9]])
    colors = torch.tensor([RED, BLUE, BLUE], dtype=torch.uint8)
    for order in ([0, 1, 2], [2, 1, 0]):
        picture = point_picture(points[order], colors[order], camera())
        assert picture[3:6, 4:7].reshape(-1, 3).tolist() == [RED] * 9
        assert int((picture == 255).all(dim=-1).sum()) == 99 - 9


def test_right_is_right_and_up_is_up():
    points = torch.tensor([[1.0, 0.8, 0]])
    picture = point_picture(points, torch.tensor([BLUE], dtype=torch.uint8), camera(), dot=1)
    ((row, column),) = (picture != 255).any(dim=-1).nonzero().tolist()
    assert (row, column) == (1, 9)


def test_every_point_needs_a_colour():
    with pytest.raises(InputError, match=r"expected colours \(N, 3\) uint8 for 1 points"):
        point_picture(torch.zeros(1, 3), torch.zeros(1, 3), camera())

"""A box with few vertices as a cage."""

import pytest
import torch

from pcore.deform.box_cage import box_cage
from pcore.deform.cage import CageDeform
from pcore.errors import InputError

LOW, HIGH = torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([1.0, 2.0, 0.5])


@pytest.mark.parametrize(("cells", "count"), [((1, 1, 1), 8), ((2, 2, 2), 26), ((3, 1, 2), 24)])
def test_it_is_closed_turned_outward_and_holds_what_is_within(cells, count):
    cage = box_cage(LOW, HIGH, cells)
    assert len(cage.vertices) == count
    inside = torch.lerp(LOW, HIGH, torch.rand(50, 3, generator=torch.manual_seed(0)))
    assert cage.holds(inside).all()
    assert not cage.holds(inside + 5.0).any()
    a, b, c = cage.vertices[cage.faces].unbind(dim=1)
    normal = torch.linalg.cross(b - a, c - a)
    assert ((normal * ((a + b + c) / 3 - (LOW + HIGH) / 2)).sum(dim=1) > 0).all()


def test_a_vertex_takes_what_is_near_it_along():
    cage = box_cage(LOW, HIGH, (2, 2, 2))
    corner = int((cage.vertices - HIGH).norm(dim=1).argmin())
    after = cage.vertices.clone()
    after[corner, 2] += 1.0
    points = torch.stack([HIGH - 0.05, LOW + 0.05]).double()
    moved = CageDeform(cage, after)(points) - points
    assert float(moved[0, 2]) > 0.5
    assert abs(float(moved[1, 2])) < 0.1


def test_boxes_without_volume_are_refused():
    with pytest.raises(InputError, match="a box with volume"):
        box_cage(LOW, LOW, (2, 2, 2))
    with pytest.raises(InputError, match="a box with volume"):
        box_cage(LOW, HIGH, (2, 0, 2))

"""Places under pixels, selections, live diagnosis: what a page asks a session."""

import math
from pathlib import Path

import pytest
import torch

from pcore.editing.diagnosis import LiveDiagnosis, diagnose
from pcore.editing.picking import pick, ray_through
from pcore.editing.selection import Selector, save_mask
from pcore.editing.session import EditSession
from pcore.errors import EditError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around
from pcore.render.image import Image

TWIST = {"type": "twist", "axis": "z", "angle_deg": 40}


def ball(count: int = 800) -> torch.Tensor:
    """Evenly spread over a sphere of radius 1."""
    turns = torch.arange(count, dtype=torch.float64)
    height = 1 - (2 * turns + 1) / count
    ring, angle = (1 - height.square()).sqrt(), turns * math.pi * (3 - math.sqrt(5))
    return torch.stack([ring * angle.cos(), ring * angle.sin(), height], dim=1).float()


def camera() -> Camera:
    return orbit_around(ball(), size=(120, 100))[0]


@pytest.mark.parametrize("edit", [None, TWIST])
def test_a_picked_place_is_on_the_surface_under_the_pixel(edit):
    session = EditSession(ball())
    if edit is not None:
        session.do(edit)
    one = camera()
    for column, row in ((60.0, 50.0), (40.5, 61.0), (75.0, 35.5)):
        hit = pick(session.state, one, column, row)
        assert hit is not None
        there = one.project(hit.place.unsqueeze(0))
        assert abs(float(there[0]) - column) < 1
        assert abs(float(there[1]) - row) < 1
        assert math.isclose(float(hit.place.norm()), 1, abs_tol=0.05)
        assert float((one.center - hit.place).norm()) < float(one.center.norm())
        moved = session.state.deformation(hit.rest.double().unsqueeze(0))[0]
        torch.testing.assert_close(moved.float(), hit.place, atol=5e-3, rtol=0)
    assert pick(session.state, one, 2, 2) is None


def test_a_picture_says_exactly_where():
    session, one = EditSession(ball()), camera()
    surface = torch.full((100, 120, 3), math.nan)
    surface[50, 60] = torch.tensor([0.0, -1.0, 0.0])
    alpha = torch.ones(100, 120)
    picture = Image(rgb=surface, alpha=alpha, depth=surface[..., 0], surface=surface)
    hit = pick(session.state, one, 60.4, 50.9, picture=picture)
    assert hit is not None
    assert hit.place.tolist() == [0, -1, 0]
    assert pick(session.state, one, 61, 50, picture=picture) is None
    assert pick(session.state, one, 500, 50, picture=picture) is None


def test_a_ray_goes_through_its_place_of_the_picture():
    origin, direction = ray_through(camera(), 33.25, 70.75)
    column, row, _ = camera().project((origin + 2 * direction).unsqueeze(0))
    assert abs(float(column) - 33.25) < 1e-3
    assert abs(float(row) - 70.75) < 1e-3


def test_a_box_takes_what_is_seen_or_all_through():
    chooser, points, one = Selector(rest=ball()), ball(), camera()
    everything = (0.0, 0.0, 120.0, 100.0)
    through = chooser.box(points, one, everything, through=True)
    seen = chooser.box(points, one, everything)
    assert through.all()
    assert 0.25 < float(seen.float().mean()) < 0.45
    left = chooser.box(points, one, (0.0, 0.0, 60.0, 100.0), through=True)
    column, _, _ = one.project(points)
    assert torch.equal(left, column <= 60)


def test_a_brush_takes_what_its_stroke_passes():
    chooser, points, one = Selector(rest=ball()), ball(), camera()
    stroke = torch.tensor([[40.0, 50.0], [80.0, 50.0]])
    chosen = chooser.brush(points, one, stroke, 5.0)
    column, row, _ = one.project(points[chosen])
    all_through = chooser.brush(points, one, stroke, 5.0, through=True)
    assert 3 < int(chosen.sum()) < int(all_through.sum()) < 60
    assert float((row - 50).abs().max()) <= 5
    assert float(column.min()) >= 35
    assert int(chooser.brush(points, one, stroke[:1], 5.0).sum()) < int(chosen.sum())


def test_a_lasso_takes_what_lies_within_its_outline():
    chooser, points, one = Selector(rest=ball()), ball(), camera()
    left, right, top, bottom = 40.0, 80.0, 30.0, 70.0
    square = torch.tensor([[left, top], [right, top], [right, bottom], [left, bottom]])
    box = chooser.box(points, one, (left, top, right, bottom))
    assert torch.equal(chooser.lasso(points, one, square), box)
    assert torch.equal(chooser.lasso(points, one, square.flip(0)), box)
    notched = torch.cat([square, torch.tensor([[60.0, 50.0]])])
    column, row, _ = one.project(points)
    inside = chooser.lasso(points, one, notched)
    assert not inside[(column < 50) & ((row - 50).abs() < 5)].any()
    assert torch.equal(inside | box, box)
    assert not chooser.lasso(points, one, square[:2], through=True).any()


def test_a_rim_lies_where_paths_have_its_length():
    chooser, points = Selector(rest=ball()), ball()
    rim = chooser.rim(torch.tensor([0]), 0.5).at(points)
    away = (rim - points[0]).norm(dim=1)
    assert len(rim) > 20
    assert float(away.max()) <= 0.5
    assert float(away.min()) > 0.4
    moved = chooser.rim(torch.tensor([0]), 0.5).at(points + torch.tensor([1.0, 0, 0]))
    assert torch.allclose(moved, rim + torch.tensor([1.0, 0, 0]), atol=1e-6)
    assert not len(chooser.rim(torch.tensor([0]), 50.0).at(points))


def test_growing_and_shrinking_go_along_the_surface():
    chooser, points = Selector(rest=ball()), ball()
    weight = chooser.geodesic(0, 0.3, 0.2)
    start = weight == 1
    assert float(weight[(points - points[0]).norm(dim=1) > 0.6].max()) == 0
    grown = chooser.grow(start, 2)
    assert bool((grown | ~start).all())
    assert int(grown.sum()) > int(start.sum())
    assert bool((chooser.shrink(grown, 2) | ~start).all())
    assert torch.equal(chooser.shrink(~start), ~chooser.grow(start))


def test_a_selection_is_a_region_of_an_edit(tmp_path: Path):
    chosen = ball()[:, 2] > 0.5
    region = save_mask(tmp_path / "top.npy", chosen, falloff=0.0)
    session = EditSession(ball())
    moved = session.do({"type": "rigid", "translation": [0, 0, 1], "region": region}).points
    assert torch.equal((moved - ball())[:, 2] > 0.5, chosen)
    session.freeze(region)
    assert torch.equal(session.state.points, ball())
    with pytest.raises(EditError, match="a selection that holds a point, got none"):
        save_mask(tmp_path / "none.npy", chosen & ~chosen)
    with pytest.raises(EditError, match=r"ends in \.npy"):
        save_mask(tmp_path / "top.png", chosen)


def test_live_strain_is_that_of_the_careful_diagnosis():
    session = EditSession(ball())
    live = LiveDiagnosis(rest=ball(), cameras=[camera()])
    state = session.do({"type": "stretch", "axis": "z", "factor": 0.6, "profile": "axial"})
    quick, careful = live.of(state), diagnose(ball(), state.points)
    torch.testing.assert_close(quick.strain, careful.strain, rtol=1e-6, atol=1e-6)
    assert quick.hole_score == 0 == careful.hole_score
    assert quick.colors().shape == (800, 3)
    exposed = live.exposed(-ball())
    assert 0.2 < float(exposed.float().mean()) < 0.7
    assert not bool(live.exposed(ball()).any())

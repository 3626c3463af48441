"""Masks cut out of photos: near the truth, the same in every unit, doubtful where wrong."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pcore.capture.auto_masks import find_masks
from pcore.errors import InputError
from pcore.geometry.object_region import Region, region_of_box
from room_scene import moved_camera, photos, picture, similarity

pytest.importorskip("cv2", reason="automatic masks need OpenCV")

BOX = region_of_box(torch.full((3,), -0.9), torch.full((3,), 0.9))


def _overlap(mask: Tensor, truth: Tensor) -> float:
    one, other = (m > (127 if m.dtype == torch.uint8 else 0.5) for m in (mask, truth))
    return float((one & other).sum() / (one | other).sum())


def test_masks_are_near_the_truth_also_for_views_without_a_vote() -> None:
    shot, truth = photos(12)
    found = find_masks(shot[:10], BOX, judged=shot[10:])
    assert min(_overlap(m, t) for m, t in zip(found.masks, truth, strict=True)) > 0.95
    assert found.doubtful() == ()


def test_masks_do_not_depend_on_the_number_of_threads() -> None:
    shot, _ = photos(8)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        alone = find_masks(shot, BOX).masks
        torch.set_num_threads(3)
        together = find_masks(shot, BOX).masks
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(alone, together, strict=True))
    assert sum(int((mask > 127).sum()) for mask in alone) > 1000


def test_of_many_photos_some_vote(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcore.capture.auto_masks._VOTERS", 6)
    shot, truth = photos(12)
    told: list[tuple[int, int]] = []
    found = find_masks(shot[:10], BOX, judged=shot[10:], progress=lambda *done: told.append(done))
    assert told[-1] == (6 + 6 + 12, 6 + 6 + 12)
    assert min(_overlap(m, t) for m, t in zip(found.masks, truth, strict=True)) > 0.95


def test_a_scene_in_other_units_has_the_same_masks() -> None:
    shot, _ = photos(8)
    turn, shift, scale = motion = similarity()
    region = Region(center=turn @ BOX.center * scale + shift, radius=BOX.radius * scale)
    there = [replace(one, camera=moved_camera(one.camera, motion)) for one in shot]
    here = find_masks(shot, Region(center=BOX.center, radius=BOX.radius))
    again = find_masks(there, region)
    # The grid of voxels is not turned along: rims may differ by a pixel.
    pairs = zip(here.masks, again.masks, strict=True)
    assert min(_overlap(a, b) for a, b in pairs) > 0.97


def test_a_photo_of_something_else_is_doubtful() -> None:
    shot, _ = photos(10)
    _, _, scale = 0, 0, 1.0
    empty, _ = picture(
        moved_camera(shot[3].camera, (torch.eye(3), torch.tensor([0, 0, 1.1]), scale))
    )
    shot[3] = replace(shot[3], rgb=empty)
    assert 3 in find_masks(shot, BOX).doubtful()


def test_a_region_that_no_photo_shows_is_refused() -> None:
    shot, _ = photos(4)
    far = Region(center=torch.tensor([0.0, 0.0, 500.0]), radius=1.0)
    with pytest.raises(InputError, match="--box"):
        find_masks(shot, far)


def test_the_region_is_the_sphere_where_no_box_is_known() -> None:
    """Its cube reaches over the whole of these photos, its sphere does not."""
    shot, truth = photos(8)
    found = find_masks(shot, Region(center=torch.zeros(3), radius=1.4))
    assert min(_overlap(m, t) for m, t in zip(found.masks, truth, strict=True)) > 0.9


def test_photos_without_known_background_are_refused() -> None:
    shot, _ = photos(4)
    with pytest.raises(InputError, match=r"fills 4 of 4 photos.*--box"):
        find_masks(shot, Region(center=torch.zeros(3), radius=2.9))


def test_a_table_is_not_taken_for_what_stands_on_it() -> None:
    """Points of a patterned table are as dense as those of the object, and one thing with it."""
    shot, truth = photos(12)
    brown = torch.tensor([0.45, 0.3, 0.2])
    for number, (one, mask) in enumerate(zip(shot, truth, strict=True)):
        rays = one.camera.rays()
        down = (-0.7 - rays.origins[..., 2]) / rays.directions[..., 2]
        there = rays.origins + down.unsqueeze(-1) * rays.directions
        table = (down > 0) & (there[..., :2].abs() < 2.4).all(dim=-1) & (mask < 0.5)
        rgb = torch.where(table.unsqueeze(-1), brown, one.rgb)
        shot[number] = replace(one, rgb=rgb)
    region = region_of_box(torch.tensor([-2.4, -2.4, -0.75]), torch.tensor([2.4, 2.4, 0.3]))
    with pytest.raises(InputError, match=r"along the border of 12 of 12 photos.*--masks trained"):
        find_masks(shot, region)
    find_masks(shot, BOX)

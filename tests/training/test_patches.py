"""Random patches: the right rays, the right pixels, draws from the generator alone."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.pixel_samples import drawn_places
from pcore.training import patches
from pcore.training.config import PatchConfig
from pcore.training.patches import Patch, draw_patch
from small_training import FakeView

CPU = torch.device("cpu")


def views(*, has_alpha: bool = True, covered: float = 1.0) -> list[FakeView]:
    """Four views of 20 x 14 pixels of noise."""
    cameras = orbit_cameras(torch.zeros(3), 4.0, 4, elevation=0.3, width=20, height=14, angle_x=0.7)
    return [FakeView(camera, covered * torch.rand(14, 20, 4), has_alpha) for camera in cameras]


def draw(
    candidates: list[FakeView], *, side: int = 8, background: str = "white", seed: int = 0
) -> Patch:
    generator = torch.Generator().manual_seed(seed)
    return draw_patch(candidates, PatchConfig(side=side), background, generator, CPU)  # pyright: ignore


def place(patch: Patch, candidates: list[FakeView]) -> tuple[FakeView, int, int]:
    """The view and the corner that the patch's rays come from."""
    for view in candidates:
        rays = view.camera.rays()
        if torch.equal(rays.origins[0, 0], patch.rays.origins[0, 0]):
            same = (rays.directions == patch.rays.directions[0, 0]).all(dim=-1)
            ((top, left),) = torch.nonzero(same).tolist()
            return view, top, left
    raise AssertionError("the rays are those of no view")


@pytest.mark.parametrize("seed", range(6))
def test_a_patch_is_a_crop_of_the_composited_image(seed: int) -> None:
    candidates = views()
    patch = draw(candidates, background="black", seed=seed)
    view, top, left = place(patch, candidates)
    rows, columns = slice(top, top + 8), slice(left, left + 8)
    assert torch.equal(patch.rays.directions, view.camera.rays().directions[rows, columns])
    assert torch.equal(patch.rgb, view.rgb(torch.zeros(3))[rows, columns])
    assert patch.alpha is not None
    assert torch.equal(patch.alpha, view.alpha()[rows, columns])
    assert torch.equal(patch.background, torch.zeros(3))


def test_every_view_and_every_place_comes_up() -> None:
    candidates = views()
    found = [place(draw(candidates, seed=seed), candidates) for seed in range(300)]
    assert {id(view) for view, _, _ in found} == {id(view) for view in candidates}
    assert {top for _, top, _ in found} == set(range(14 - 8 + 1))
    assert {left for _, _, left in found} == set(range(20 - 8 + 1))


def test_draws_come_from_the_generator_alone() -> None:
    candidates = views()
    first = draw(candidates, background="random", seed=4)
    torch.manual_seed(99)
    state = torch.get_rng_state()
    second = draw(candidates, background="random", seed=4)
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(first.rgb, second.rgb)
    assert torch.equal(first.rays.directions, second.rays.directions)
    assert torch.equal(first.background, second.background)


@pytest.mark.parametrize(("side", "size"), [(100, (14, 20)), (16, (14, 16)), (14, (14, 14))])
def test_images_smaller_than_the_patch_are_taken_whole(side: int, size: tuple[int, int]) -> None:
    patch = draw(views(), side=side)
    assert patch.rays.shape == patch.rgb.shape[:2] == size


def test_a_random_background_is_another_one_every_time() -> None:
    candidates = views()
    drawn = [draw(candidates, background="random", seed=seed) for seed in range(3)]
    colors = torch.stack([patch.background for patch in drawn])
    assert len(colors.unique(dim=0)) == 3
    for patch in drawn:
        view, top, left = place(patch, candidates)
        expected = view.rgb(patch.background)[top : top + 8, left : left + 8]
        assert torch.equal(patch.rgb, expected)


def test_photos_without_alpha_have_no_opacity_to_learn() -> None:
    patch = draw(views(has_alpha=False))
    assert patch.alpha is None


def _corner(camera: Camera) -> Tensor:
    pixels = torch.zeros(camera.height, camera.width, 4)
    pixels[:4, :4] = 1.0
    return pixels


def test_patches_that_miss_the_object_are_drawn_again() -> None:
    candidates = [FakeView(view.camera, _corner(view.camera)) for view in views()]
    hits = 0
    for seed in range(40):
        alpha = draw(candidates, seed=seed).alpha
        assert alpha is not None
        hits += bool(alpha.sum() > 0)
    # One place in five shows the object: twenty tries find it in 99 of 100 cases.
    assert hits >= 38


def test_an_empty_image_ends_the_search() -> None:
    patch = draw([FakeView(view.camera, torch.zeros(14, 20, 4)) for view in views()])
    assert torch.equal(patch.rgb, torch.ones(8, 8, 3))


def test_a_gpu_gets_patches_from_pinned_memory_without_waiting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pinned: list[int] = []
    waited: list[bool] = []

    def pin(self: Tensor) -> Tensor:
        pinned.append(id(self))
        return self

    def to(self: Tensor, device: torch.device, *, non_blocking: bool = False) -> Tensor:
        assert device.type == "cuda"
        assert pinned[-1] == id(self)
        waited.append(not non_blocking)
        return self

    candidates, generator = views(), torch.Generator().manual_seed(0)
    with monkeypatch.context() as patched:
        patched.setattr(patches, "composite", lambda crop, color: crop[..., :3])
        patched.setattr(Tensor, "pin_memory", pin)
        patched.setattr(Tensor, "to", to)
        draw_patch(candidates, PatchConfig(side=8), "white", generator, torch.device("cuda"))
    assert waited == [False] * 5


@pytest.mark.parametrize("samples", [2, 3, 4])
def test_rays_of_a_pixel_cover_it(samples: int) -> None:
    """Each in a column and a row of its own; over many pixels evenly, and anew with every draw."""
    generator = torch.Generator().manual_seed(0)
    places = drawn_places(60, 70, samples, generator)
    assert places.shape == (60, 70, samples, 2)
    cells = (places * samples).long()
    for axis in (0, 1):
        assert torch.equal(
            cells[..., axis].sort(dim=-1).values, torch.arange(samples).expand(60, 70, samples)
        )
    assert torch.allclose(places.mean(dim=(0, 1, 2)), torch.tensor(0.5), atol=0.01)
    together = (places[..., 0] - 0.5) * (places[..., 1] - 0.5)
    assert abs(float(together.mean())) < 2e-3, "no diagonal is preferred"
    assert not torch.equal(places, drawn_places(60, 70, samples, generator))


def test_rays_of_a_patch_stay_in_their_pixels() -> None:
    candidates = views()
    generator = torch.Generator().manual_seed(3)
    patch = draw_patch(candidates, PatchConfig(side=8, samples=3), "white", generator, CPU)  # pyright: ignore
    assert patch.rays.shape == (8, 8, 3)
    for view in candidates:
        if not torch.equal(view.camera.center, patch.rays.origins[0, 0, 0]):
            continue
        camera = view.camera
        local = patch.rays.directions @ camera.world_from_camera[:3, :3]
        column = camera.cx - camera.fx * local[..., 0] / local[..., 2]
        row = camera.cy + camera.fy * local[..., 1] / local[..., 2]
        corner = column[0, 0, 0].floor(), row[0, 0, 0].floor()
        expected = torch.arange(8).unsqueeze(-1).expand(8, 3).float()
        assert torch.equal((column - corner[0]).floor(), expected.expand(8, 8, 3))
        assert torch.equal((row - corner[1]).floor(), expected.unsqueeze(1).expand(8, 8, 3))
        top, left = int(corner[1]), int(corner[0])
        white = view.rgb(torch.ones(3))[top : top + 8, left : left + 8]
        assert torch.equal(patch.rgb, white)
        return
    raise AssertionError("the rays are those of no view")

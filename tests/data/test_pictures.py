"""Pictures and videos as files."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image

from pcore.data.pictures import (
    depth_picture,
    depth_range,
    normal_picture,
    to_bytes,
    write_png,
    write_raw,
)
from pcore.data.video import VideoWriter, require_video, write_video
from pcore.data.whole_file import replacing
from pcore.errors import DependencyError, InputError
from pcore.geometry.orbit import orbit_cameras


def test_bytes_are_clamped_and_rounded() -> None:
    values = torch.tensor([-1.0, 0.0, 0.5 / 255, 0.51 / 255, 0.7, 1.0, 2.0])
    assert to_bytes(values).tolist() == [0, 0, 0, 1, 178, 255, 255]


@pytest.mark.parametrize("kind", [torch.float32, torch.uint8])
def test_a_png_holds_the_pixels(tmp_path: Path, kind: torch.dtype) -> None:
    pixels = torch.randint(0, 256, (5, 7, 3), dtype=torch.uint8)
    write_png(tmp_path / "a.png", pixels if kind == torch.uint8 else pixels / 255)
    with Image.open(tmp_path / "a.png") as image:
        assert (image.mode, image.size) == ("RGB", (7, 5))
        assert np.array_equal(np.asarray(image), pixels.numpy())
    assert [item.name for item in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize(
    ("rgb", "message"),
    [
        (torch.zeros(4, 5), r"expected a picture \(H, W, 3\), got the shape \(4, 5\)"),
        (torch.zeros(4, 5, 4), r"got the shape \(4, 5, 4\)"),
        (torch.zeros(0, 5, 3), r"got the shape \(0, 5, 3\)"),
        (torch.full((2, 2, 3), math.nan), "expected colours, got NaN"),
    ],
)
def test_no_picture(tmp_path: Path, rgb: torch.Tensor, message: str) -> None:
    with pytest.raises(InputError, match=message):
        write_png(tmp_path / "a.png", rgb)
    assert not list(tmp_path.iterdir())


def test_raw_arrays_keep_what_is_not_a_colour(tmp_path: Path) -> None:
    rgb = torch.tensor([[[-3.0, 0.5, math.nan]]], dtype=torch.float64)
    write_raw(tmp_path / "a.npz", rgb=rgb, alpha=torch.ones(1, 1))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as raw:
        assert sorted(raw) == ["alpha", "rgb"]
        assert raw["rgb"].dtype == np.float32
        np.testing.assert_array_equal(raw["rgb"], rgb.float().numpy())


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_png(path, torch.zeros(2, 2, 3))
    old = path.read_bytes()

    def stop_halfway() -> None:
        with replacing(path) as partial:
            partial.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_halfway()
    assert path.read_bytes() == old
    assert [item.name for item in tmp_path.iterdir()] == ["a.png"]
    with pytest.raises(FileNotFoundError):
        write_png(tmp_path / "absent" / "a.png", torch.zeros(2, 2, 3))


# --- depth and normals in colours ----------------------------------------------------------


def lightness(rgb: torch.Tensor) -> torch.Tensor:
    return rgb @ torch.tensor([0.2126, 0.7152, 0.0722])


def test_depth_gets_darker_and_never_white() -> None:
    depth = torch.linspace(2, 5, 50).expand(1, 50)
    shown = depth_picture(depth, torch.ones(1, 50), near=2, far=5)[0]
    assert bool((lightness(shown).diff() < 0).all())
    assert float(lightness(shown)[0]) < 0.9
    assert float(lightness(shown)[-1]) < 0.2
    beyond = depth_picture(torch.tensor([[1.0, 9.0]]), torch.ones(1, 2), near=2, far=5)[0]
    assert torch.equal(beyond, shown[[0, -1]])


def test_nothing_is_white_in_depth() -> None:
    depth = torch.tensor([[3.0, math.nan, 3.0, 3.0]])
    alpha = torch.tensor([[1.0, 1.0, 0.0, 0.5]])
    full, none, clear, half = depth_picture(depth, alpha, near=2, far=5)[0]
    assert none.tolist() == clear.tolist() == [1, 1, 1]
    torch.testing.assert_close(half, 0.5 * (full + 1))


def test_depth_without_a_range() -> None:
    with pytest.raises(InputError, match=r"expected near < far, got 2\.0 and 2\.0"):
        depth_picture(torch.ones(2, 2), torch.ones(2, 2), near=2.0, far=2.0)


def test_one_range_of_depth_covers_all_cameras_but_not_strays() -> None:
    near_and_far = [
        orbit_cameras(torch.zeros(3), d, 3, elevation=0.2, width=4, height=4, angle_x=0.7)[1]
        for d in (3.0, 5.0)
    ]
    points = torch.nn.functional.normalize(torch.randn(2000, 3), dim=-1)
    points[0] = 100.0
    near, far = depth_range(points, near_and_far)
    assert near == pytest.approx(2, abs=0.1)
    assert far == pytest.approx(6, abs=0.1)
    near, far = depth_range(torch.zeros(1, 3), near_and_far[:1])
    assert near < 3 < far


def test_normals_are_coloured_in_the_cameras_axes() -> None:
    camera = orbit_cameras(torch.zeros(3), 3, 4, elevation=0.3, width=4, height=4, angle_x=0.7)[1]
    right, up, back = camera.world_from_camera[:3, :3].T
    normals = torch.stack([right, up, back, torch.full((3,), math.nan)]).unsqueeze(0)
    shown = normal_picture(normals, camera.world_from_camera)[0]
    expected = torch.tensor([[1, 0.5, 0.5], [0.5, 1, 0.5], [0.5, 0.5, 1], [1, 1, 1]])
    torch.testing.assert_close(shown, expected, atol=1e-5, rtol=0)


# --- video ---------------------------------------------------------------------------------


def frames(count: int, height: int, width: int) -> list[torch.Tensor]:
    return [torch.rand(1, 1, 3).expand(height, width, 3) for _ in range(count)]


@pytest.mark.parametrize(("height", "width"), [(32, 46), (31, 45), (4, 5)])
def test_a_video_can_be_read_back(tmp_path: Path, height: int, width: int) -> None:
    made = frames(7, height, width)
    assert write_video(tmp_path / "a.mp4", made, fps=24) == 7
    with av.open(str(tmp_path / "a.mp4")) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.height, stream.width) == (height + height % 2, width + width % 2)
        assert stream.average_rate == 24
        shown = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(shown) == 7
    for got, frame in zip(shown, made, strict=True):
        error = np.abs(got.astype(float) - frame[0, 0].numpy() * 255)
        assert error.max() < 6
    assert [item.name for item in tmp_path.iterdir()] == ["a.mp4"]


def test_a_video_begins_with_its_index(tmp_path: Path) -> None:
    """Otherwise a browser has to load all of it before it can show anything."""
    write_video(tmp_path / "a.mp4", frames(3, 16, 16))
    content = (tmp_path / "a.mp4").read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


@pytest.mark.parametrize(
    ("made", "message"),
    [
        ([], "expected at least one frame for a video, got none"),
        ([torch.zeros(4, 4, 3), torch.zeros(6, 4, 3)], r"of one size, got \(6, 4, 3\) after \(4,"),
        ([torch.zeros(4, 4)], r"expected frames \(H, W, 3\), got \(4, 4\)"),
    ],
)
def test_no_video(tmp_path: Path, made: list[torch.Tensor], message: str) -> None:
    with pytest.raises(InputError, match=message):
        write_video(tmp_path / "a.mp4", made)
    assert not list(tmp_path.iterdir())


def test_an_interrupted_video_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    write_video(path, frames(1, 16, 16))
    old = path.read_bytes()

    def stop_halfway() -> None:
        with VideoWriter(path) as video:
            video.add(torch.zeros(16, 16, 3))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_halfway()
    assert path.read_bytes() == old
    assert [item.name for item in tmp_path.iterdir()] == ["a.mp4"]


def test_frames_per_second(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="video: fps: expected a whole number of at least 1"):
        VideoWriter(tmp_path / "a.mp4", fps=0)


def test_a_missing_video_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(DependencyError, match=r"pip install 'pcore-edit\[video\]'"):
        require_video()

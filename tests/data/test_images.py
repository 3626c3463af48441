import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, features
from torch import Tensor

from pcore.data.image_files import read_header, read_rgba
from pcore.data.images import ImageCache, area_downscale, background_color, composite
from pcore.errors import InputError, SceneError


def _naive_downscale(rgba: np.ndarray, factor: int) -> np.ndarray:
    height, width = rgba.shape[0] // factor, rgba.shape[1] // factor
    out = np.zeros((height, width, 4))
    for y in range(height):
        for x in range(width):
            alpha, color = 0.0, np.zeros(3)
            for dy in range(factor):
                for dx in range(factor):
                    pixel = rgba[y * factor + dy, x * factor + dx].astype(float)
                    alpha += pixel[3]
                    color += pixel[:3] * pixel[3]
            if alpha > 0:
                out[y, x] = [*(color / alpha), alpha / factor**2]
    return out


@pytest.mark.parametrize("factor", [1, 2, 3, 6])
def test_area_filter_agrees_with_a_naive_computation(factor: int) -> None:
    rgba = torch.rand(12, 18, 4)
    rgba[:6, :6, 3] = 0.0  # a block with nothing in it
    got = area_downscale(rgba, factor)
    if factor == 1:
        assert torch.equal(got, rgba)
        return
    assert np.allclose(got.numpy(), _naive_downscale(rgba.numpy(), factor), atol=1e-6)


def test_area_filter_commutes_with_compositing() -> None:
    rgba, background = torch.rand(8, 8, 4), torch.rand(3)
    small = composite(area_downscale(rgba, 4), background)
    whole = composite(rgba, background).reshape(2, 4, 2, 4, 3).mean(dim=(1, 3))
    assert torch.allclose(small, whole, atol=1e-6)


def test_hidden_colour_does_not_bleed_into_edges() -> None:
    rgba = torch.zeros(2, 2, 4)
    rgba[..., 0] = 1.0  # red under alpha 0
    rgba[0, 0] = torch.tensor([0.0, 0.0, 1.0, 1.0])
    assert torch.allclose(area_downscale(rgba, 2)[0, 0], torch.tensor([0.0, 0.0, 1.0, 0.25]))


def test_factor_that_does_not_divide_names_those_that_do() -> None:
    with pytest.raises(InputError, match=r"400 x 300 .* divided by 3; use one of 1, 2, 4, 5, 10"):
        area_downscale(torch.zeros(300, 400, 4), 3)
    with pytest.raises(InputError, match="whole number of at least 1, got 0"):
        area_downscale(torch.zeros(4, 4, 4), 0)


def test_backgrounds() -> None:
    assert background_color("white").tolist() == [1, 1, 1]
    assert background_color("black").tolist() == [0, 0, 0]
    generator = torch.Generator().manual_seed(3)
    first, second = (background_color("random", generator) for _ in range(2))
    assert not torch.equal(first, second)
    assert torch.equal(first, background_color("random", torch.Generator().manual_seed(3)))
    with pytest.raises(InputError, match="expected white, black or random, got 'grey'"):
        background_color("grey")


def test_decodes_straight_alpha_exactly(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 4), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert torch.equal(read_rgba(tmp_path / "a.png"), torch.from_numpy(pixels / np.float32(255)))


def test_image_without_alpha_is_opaque(tmp_path: Path) -> None:
    Image.new("RGB", (4, 3), (255, 0, 0)).save(tmp_path / "a.png")
    assert not read_header(tmp_path / "a.png").has_alpha
    assert read_rgba(tmp_path / "a.png")[..., 3].min() == 1.0


def test_missing_image(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.png: no such file; put it there"):
        read_rgba(tmp_path / "none.png")


def test_truncated_image(tmp_path: Path) -> None:
    path = tmp_path / "cut.png"
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 4), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(SceneError, match=r"cut\.png: expected 64 x 64 pixels, got a truncated"):
        read_rgba(path)


def test_not_an_image(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(SceneError, match="expected an image such as PNG, got a file of another"):
        read_rgba(tmp_path / "text.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(SceneError, match=r"folder\.png: cannot be opened"):
        read_rgba(tmp_path / "folder.png")


def test_wrong_size(tmp_path: Path) -> None:
    Image.new("RGBA", (4, 3)).save(tmp_path / "a.png")
    with pytest.raises(SceneError, match="expected 5 x 3 pixels, got 4 x 3"):
        read_rgba(tmp_path / "a.png", size=(5, 3))


def test_sixteen_bits_are_grey(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 40000, dtype=np.uint16)).save(tmp_path / "deep.png")
    found = read_rgba(tmp_path / "deep.png")
    assert found[0, 0].tolist() == pytest.approx([40000 / 65535] * 3 + [1.0])


def test_numbers_that_are_no_picture_are_refused(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 0.5, dtype=np.float32)).save(tmp_path / "depth.tif")
    with pytest.raises(SceneError, match=r"expected 8 bits per channel, or grey of 16.*'F'"):
        read_header(tmp_path / "depth.tif")
    Image.fromarray(np.full((4, 4), 70000, dtype=np.int32)).save(tmp_path / "deep.tif")
    with pytest.raises(SceneError, match="expected grey of 16 bits, got values between 70000"):
        read_rgba(tmp_path / "deep.tif")


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        ("a.png", "P"),
        ("a.png", "L"),
        ("a.png", "LA"),
        ("a.jpg", "CMYK"),
        ("a.jpg", "L"),
        ("a.webp", "RGB"),
        ("a.tif", "CMYK"),
        ("a.tif", "LAB"),
        ("a.avif", "RGB"),
    ],
)
def test_kinds_of_pixels(name: str, mode: str, tmp_path: Path) -> None:
    if name.endswith("avif") and not features.check("avif"):
        pytest.skip("this Pillow has no AVIF")
    grey = Image.new("L", (16, 16), 128)
    picture = grey.convert("RGB") if mode != "LAB" else Image.new("LAB", (16, 16), (137, 128, 128))
    picture = picture.quantize(4) if mode == "P" else picture
    picture = picture if mode in ("LAB", "P") else picture.convert(mode)
    picture.save(tmp_path / name)
    found = read_rgba(tmp_path / name)
    assert found.shape == (16, 16, 4)
    assert float((found[..., :3] - 128 / 255).abs().max()) < 0.03
    assert float(found[..., 3].min()) == 1.0


def _decoder(log: list[int], number: int, size: int = 25) -> Tensor:
    log.append(number)
    return torch.full((size,), float(number))


def test_cache_keeps_to_its_budget_and_drops_the_least_recent() -> None:
    cache, log = ImageCache(memory_budget=200), []
    for number in (0, 1, 0, 2, 0, 1):
        image = cache.get((Path(str(number)), 1), lambda n=number: _decoder(log, n))
        assert image[0] == number
        assert cache.bytes_used <= 200
    # 0 was used again before 2 came, so 1 had to go.
    assert log == [0, 1, 2, 1]


def test_image_larger_than_the_budget_is_handed_out_but_not_kept() -> None:
    cache, log = ImageCache(memory_budget=50), []
    for _ in range(2):
        assert len(cache.get((Path("a"), 1), lambda: _decoder(log, 1))) == 25
    assert log == [1, 1]
    assert cache.bytes_used == 0


def test_cache_under_threads() -> None:
    cache, wrong = ImageCache(memory_budget=300), []

    def work(seed: int) -> None:
        for number in np.random.default_rng(seed).integers(0, 6, 200).tolist():
            image = cache.get((Path(str(number)), 1), lambda n=number: _decoder([], n))
            if image[0] != number or cache.bytes_used > 300:
                wrong.append(number)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert cache.bytes_used == 300


def test_negative_budget() -> None:
    with pytest.raises(InputError, match="memory budget in bytes: expected a whole number"):
        ImageCache(-1)

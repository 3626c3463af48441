"""The two ways of scoring a picture and what they do about missing LPIPS weights."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.errors import InputError, WeightsError
from pcore.evaluation.protocol import (
    PAPR,
    PROTOCOLS,
    STANDARD,
    Perceptual,
    load_perceptual,
    measure,
    on_white,
)
from pcore.metrics.perceptual import Lpips


@pytest.fixture
def target():
    """A square object, half of it soft, on nothing."""
    rng = np.random.default_rng(1)
    rgba = rng.integers(0, 256, (36, 40, 4)) / 255
    rgba[..., 3] = 0
    rgba[10:26, 10:20, 3] = 1
    rgba[10:26, 20:30, 3] = 0.4
    return rgba


@pytest.fixture
def no_weights(monkeypatch, tmp_path):
    monkeypatch.delenv("PCORE_LPIPS_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))


def test_on_white():
    rgba = np.array([[[0.2, 0.4, 0.6, 0.5], [0.2, 0.4, 0.6, 0.0]]])
    assert np.allclose(on_white(rgba), [[[0.6, 0.7, 0.8], [1, 1, 1]]])


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=PROTOCOLS.keys())
def test_a_perfect_picture(protocol, target):
    scores = measure(protocol, on_white(target), target)
    assert scores.psnr == math.inf
    assert scores.foreground_psnr == math.inf
    assert scores.ssim == pytest.approx(1.0)
    assert scores.foreground_ssim == pytest.approx(1.0)
    assert scores.lpips == {}


def test_papr_compares_floats_and_standard_compares_files(target):
    rgba = np.round(target * 255) / 255
    rgba[..., 3] = rgba[..., 3] > 0.5
    nearly = np.clip(on_white(rgba) + 0.001, 0, 1)
    assert measure(STANDARD, nearly, rgba).psnr == math.inf
    assert 60 <= measure(PAPR, nearly, rgba).psnr < 80


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=PROTOCOLS.keys())
def test_predictions_are_clamped(protocol, target):
    picture = on_white(target)
    wild = np.where(picture == 1, 1.7, picture)
    assert measure(protocol, wild, target).psnr == math.inf


def test_foreground_is_where_the_object_is_more_than_half_opaque(target):
    picture = on_white(target)
    spoilt = picture.copy()
    spoilt[:, 20:] = 0.0
    scores = measure(PAPR, spoilt, target)
    assert scores.foreground_psnr == math.inf
    assert scores.psnr < 10
    spoilt = picture.copy()
    spoilt[10:26, 10:20] = np.clip(picture[10:26, 10:20] + 0.5, 0, 1)
    scores = measure(PAPR, spoilt, target)
    assert scores.foreground_psnr is not None
    assert scores.foreground_ssim is not None
    assert scores.foreground_psnr < scores.psnr
    assert scores.foreground_ssim < scores.ssim


def test_protocols_use_their_own_ssim_window(target):
    picture = np.clip(on_white(target) * 0.8, 0, 1)
    papr, standard = measure(PAPR, picture, target), measure(STANDARD, picture, target)
    assert papr.ssim != pytest.approx(standard.ssim, abs=1e-4)


def test_no_foreground():
    scores = measure(PAPR, torch.ones(16, 16, 3), torch.zeros(16, 16, 4))
    assert scores.psnr == math.inf
    assert scores.foreground_psnr is None
    assert scores.foreground_ssim is None


def test_papr_feeds_lpips_unmapped_and_standard_maps(target):
    network = Lpips("alex")
    picture = on_white(target) * 0.5
    perceptual = Perceptual(loaded={"alex": network})

    def direct(first, second, gain, shift):
        batch = [
            torch.from_numpy(x).float().permute(2, 0, 1)[None] * gain + shift
            for x in (first, second)
        ]
        return network(*batch).item()

    papr = measure(PAPR, picture, target, perceptual).lpips["alex"]
    assert papr == pytest.approx(direct(picture, on_white(target), 1, 0), rel=1e-4)
    eight_bit = [np.round(x * 255) / 255 for x in (picture, on_white(target))]
    standard = measure(STANDARD, picture, target, perceptual).lpips["alex"]
    assert standard == pytest.approx(direct(*eight_bit, 2, -1), rel=1e-4)


def test_published_lpips_value_in_the_standard_protocol(shared_data):
    folder = shared_data / "lpips"
    first, second = (
        np.asarray(Image.open(folder / f"{n}.png").convert("RGB")) / 255
        for n in ("ex_p1", "ex_ref")
    )
    rgba = np.concatenate([second, np.ones_like(second[..., :1])], axis=2)
    perceptual = load_perceptual(("alex", "squeeze"), folder=folder)
    scores = measure(STANDARD, first, rgba, perceptual)
    assert scores.lpips["alex"] == pytest.approx(0.1376, abs=5e-5)
    assert scores.lpips["squeeze"] == pytest.approx(0.1479, abs=5e-5)
    assert perceptual.note() is None


@pytest.mark.usefixtures("no_weights")
def test_missing_weights_leave_a_visible_gap(target):
    perceptual = load_perceptual(("alex", "vgg"))
    scores = measure(PAPR, on_white(target), target, perceptual)
    assert scores.lpips == {"alex": None, "vgg": None}
    assert scores.row()["lpips_vgg"] is None
    note = perceptual.note()
    assert note is not None
    assert "vgg16-397923af.pth" in note
    assert "alexnet-owt-7be5be79.pth" in note


@pytest.mark.usefixtures("no_weights")
def test_damaged_weights_are_not_passed_over(tmp_path):
    for name in ("alexnet_features_torchvision.pth", "lin_alex.pth"):
        (tmp_path / name).write_bytes(b"not weights")
    with pytest.raises(WeightsError, match="could not read it"):
        load_perceptual(("alex",), folder=tmp_path)


def test_row_is_flat(target):
    row = measure(PAPR, on_white(target), target).row()
    assert list(row) == ["psnr", "ssim", "foreground_psnr", "foreground_ssim"]


def test_bad_pictures(target):
    with pytest.raises(InputError, match="prediction 30 x 36, target 40 x 36"):
        measure(PAPR, np.zeros((36, 30, 3)), target)
    with pytest.raises(InputError, match=r"target: expected shape \(H, W, 4\)"):
        measure(PAPR, np.zeros((36, 40, 3)), target[..., :3])
    with pytest.raises(InputError, match="prediction: expected finite numbers"):
        measure(PAPR, np.full((36, 40, 3), np.inf), target)

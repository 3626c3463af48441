"""LPIPS: published values, laws, and weights that are missing, damaged or hostile."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.errors import InputError, WeightsError
from pcore.metrics.perceptual import (
    Lpips,
    find_weights,
    load_lpips,
    missing_weights,
    weight_folders,
)
from pcore.metrics.trunks import TRUNKS


@pytest.fixture(autouse=True)
def _no_weights_of_this_machine(monkeypatch, tmp_path_factory):
    empty = tmp_path_factory.mktemp("empty")
    monkeypatch.delenv("PCORE_LPIPS_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(empty / "cache"))
    monkeypatch.setenv("TORCH_HOME", str(empty / "torch"))


def save_random_weights(trunk: str, folder: Path, *, trunk_file: str | None = None) -> Lpips:
    """Random weights in the layout of torchvision and of the LPIPS heads."""
    module = Lpips(trunk)
    layers = {f"features.{k}": v for k, v in module.features.state_dict().items()}
    layers["classifier.1.weight"] = torch.zeros(3, 3)  # torch hub files carry a classifier too
    heads = {f"lin{i}.model.1.weight": h.view(1, -1, 1, 1) for i, h in enumerate(module.heads)}
    folder.mkdir(parents=True, exist_ok=True)
    torch.save(layers, folder / (trunk_file or module.spec.files[0]))
    torch.save(heads, folder / module.spec.heads[0])
    return module


def example(shared_data: Path, name: str) -> torch.Tensor:
    image = np.asarray(Image.open(shared_data / "lpips" / f"{name}.png").convert("RGB"))
    return torch.from_numpy(image / 127.5 - 1).float().permute(2, 0, 1)[None]


@pytest.mark.parametrize(
    ("trunk", "expected"), [("alex", (0.7219, 0.1376)), ("squeeze", (0.7110, 0.1479))]
)
def test_published_values_to_four_decimals(shared_data, trunk, expected):
    lpips = load_lpips(trunk, folder=shared_data / "lpips")
    reference = example(shared_data, "ex_ref")
    for name, value in zip(("ex_p0", "ex_p1"), expected, strict=True):
        assert lpips(reference, example(shared_data, name)).item() == pytest.approx(value, abs=5e-5)
    assert lpips(reference, reference).item() == 0.0


@pytest.mark.parametrize("trunk", ["alex", "squeeze", "vgg"])
def test_distance_laws(trunk):
    lpips = Lpips(trunk)
    size = lpips.spec.smallest
    a, b = torch.rand(2, 3, size, size) * 2 - 1, torch.rand(2, 3, size, size) * 2 - 1
    assert torch.equal(lpips(a, a), torch.zeros(2))
    assert (lpips(a, b) > 0).all()
    assert torch.allclose(lpips(a, b), lpips(b, a))
    assert torch.allclose(lpips(a, b)[1:], lpips(a[1:], b[1:]), rtol=1e-4)


def test_gradients_reach_the_images_and_nothing_else():
    lpips = Lpips("squeeze")
    image = (torch.rand(1, 3, 32, 40) * 2 - 1).requires_grad_()
    lpips(image, torch.zeros(1, 3, 32, 40)).sum().backward()
    assert image.grad is not None
    assert image.grad.isfinite().all()
    assert image.grad.abs().max() > 0
    assert all(not p.requires_grad and p.grad is None for p in lpips.parameters())


def test_gradients_are_finite_where_all_features_are_off():
    lpips = Lpips("alex")
    for name, parameter in lpips.features.named_parameters():
        parameter.data.fill_(-1.0 if name.endswith("bias") else 0.0)
    image = torch.zeros(1, 3, 32, 32, requires_grad=True)
    lpips(image, torch.ones(1, 3, 32, 32)).sum().backward()
    assert image.grad is not None
    assert image.grad.isfinite().all()


@pytest.mark.parametrize(("trunk", "count"), [("alex", 5), ("squeeze", 25), ("vgg", 13)])
def test_trunks_have_torchvisions_layers(trunk, count):
    weights = {
        k: tuple(v.shape) for k, v in Lpips(trunk).features.state_dict().items() if "weight" in k
    }
    assert len(weights) == count
    if trunk == "vgg":
        assert list(weights) == [
            f"{i}.weight" for i in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
        ]
        assert weights["28.weight"] == (512, 512, 3, 3)


@pytest.mark.parametrize("trunk", ["alex", "squeeze", "vgg"])
def test_taps_have_the_channels_of_the_heads(trunk):
    lpips = Lpips(trunk)
    taps = lpips._taps(torch.rand(1, 3, 64, 64))
    assert tuple(t.shape[1] for t in taps) == TRUNKS[trunk].channels
    for tap in taps:
        assert torch.allclose(tap.norm(dim=1).max(), torch.ones(()), atol=1e-4)


@pytest.mark.parametrize("trunk", ["alex", "vgg"])
def test_weights_in_torch_hub_and_heads_in_the_named_folder(trunk, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    hub, heads = tmp_path / "torch" / "hub" / "checkpoints", tmp_path / "heads"
    original = save_random_weights(trunk, hub, trunk_file=TRUNKS[trunk].files[-1])
    heads.mkdir()
    (hub / TRUNKS[trunk].heads[0]).rename(heads / TRUNKS[trunk].heads[0])
    monkeypatch.setenv("PCORE_LPIPS_DIR", str(heads))
    found = find_weights(trunk)
    assert found is not None
    assert (found.trunk.parent, found.heads.parent) == (hub, heads)
    a, b = torch.rand(2, 1, 3, 32, 32)
    assert torch.equal(load_lpips(trunk)(a, b), original(a, b))


def test_search_order(tmp_path, monkeypatch):
    monkeypatch.setenv("PCORE_LPIPS_DIR", str(tmp_path / "env"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    assert weight_folders(tmp_path / "mine") == (
        tmp_path / "mine",
        tmp_path / "env",
        tmp_path / "cache" / "pcore" / "lpips",
        tmp_path / "torch" / "hub" / "checkpoints",
    )


def test_missing_weights_are_named_with_the_places_looked_in(tmp_path):
    assert find_weights("vgg", tmp_path) is None
    with pytest.raises(WeightsError) as caught:
        load_lpips("vgg", folder=tmp_path)
    message = str(caught.value)
    for part in ("VGG-16", "vgg16-397923af.pth", "lin_vgg.pth", "PCORE_LPIPS_DIR", "https://"):
        assert part in message
    for folder in weight_folders(tmp_path):
        assert str(folder) in message


def test_only_what_is_missing_is_asked_for(tmp_path):
    save_random_weights("alex", tmp_path)
    assert missing_weights("alex", tmp_path) is None
    (tmp_path / "lin_alex.pth").unlink()
    message = missing_weights("alex", tmp_path)
    assert message is not None
    assert "lin_alex.pth" in message
    assert "alexnet-owt" not in message


def test_truncated_file(tmp_path):
    save_random_weights("alex", tmp_path)
    path = tmp_path / TRUNKS["alex"].files[0]
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(WeightsError, match="could not read it"):
        load_lpips("alex", folder=tmp_path)


class Hostile:
    """Writes a file when unpickled by a careless reader."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self):
        return (Path.touch, (self.witness,))


@pytest.mark.parametrize("form", ["pickle", "torch"])
def test_a_pickle_is_refused_and_never_executed(tmp_path, form):
    save_random_weights("alex", tmp_path)
    witness, path = tmp_path / "executed", tmp_path / TRUNKS["alex"].files[0]
    if form == "pickle":
        path.write_bytes(pickle.dumps(Hostile(witness)))
    else:
        torch.save({"features.0.weight": Hostile(witness)}, path)
        assert zipfile.is_zipfile(path)
    with pytest.raises(WeightsError, match="expected a PyTorch file that holds tensors only"):
        load_lpips("alex", folder=tmp_path)
    assert not witness.exists()


def test_weights_of_another_network(tmp_path):
    save_random_weights("alex", tmp_path)
    save_random_weights("squeeze", tmp_path, trunk_file=TRUNKS["alex"].files[0])
    with pytest.raises(WeightsError, match="is it the file of another network"):
        load_lpips("alex", folder=tmp_path)


def test_a_list_is_not_weights(tmp_path):
    save_random_weights("alex", tmp_path)
    torch.save([torch.zeros(1)], tmp_path / "lin_alex.pth")
    with pytest.raises(WeightsError, match="expected a dictionary of tensors, got list"):
        load_lpips("alex", folder=tmp_path)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ((1, 3, 32, 32), (1, 3, 32, 33), r"one shape \(B, 3, H, W\)"),
        ((1, 4, 32, 32), (1, 4, 32, 32), r"one shape \(B, 3, H, W\)"),
        ((3, 32, 32), (3, 32, 32), r"one shape \(B, 3, H, W\)"),
        ((1, 3, 31, 40), (1, 3, 31, 40), "at least 32 x 32 pixels, got 40 x 31"),
    ],
)
def test_bad_images(first, second, message):
    with pytest.raises(InputError, match=message):
        Lpips("alex")(torch.zeros(first), torch.zeros(second))


def test_unknown_trunk():
    with pytest.raises(InputError, match="a trunk of alex, squeeze, vgg, got 'resnet'"):
        Lpips("resnet")  # type: ignore[arg-type]

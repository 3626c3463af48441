"""The model file: round trip, and every way in which a file can be wrong."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from pcore.errors import CheckpointError
from pcore.files import atomic
from pcore.files.model_file import describe_model, load_model, save_model
from pcore.files.provenance import pcore_version, provenance_of
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig

CONFIG = PaprConfig(
    neighbours=4,
    octaves=Octaves.all(2),
    feature_size=6,
    key=MlpConfig(layers=2, width=8, size=8),
    query=MlpConfig(layers=2, width=8, size=8),
    value=MlpConfig(layers=3, width=8, size=4, skip_after=2),
    unet_channels=(4, 6, 8),
    background=(0.0, 0.5, 1.0),
)


def make_cloud(points: int = 5) -> PointCloud:
    return PointCloud(
        positions=torch.randn(points, 3),
        features=torch.randn(points, 6),
        influence=torch.rand(points),
    )


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, Papr, PointCloud]:
    papr, cloud, path = Papr(CONFIG), make_cloud(), tmp_path / "model.safetensors"
    provenance = provenance_of(
        cloud.positions, CONFIG.background, scene="lego", stage="pretrain", step=70
    )
    save_model(path, papr.state_dict(), cloud, CONFIG, provenance)
    return path, papr, cloud


def rewrite(path: Path, *, tensors: dict | None = None, header: dict | None = None) -> None:
    """Write the file again with other tensors or header entries (None drops one)."""
    with safe_open(path, framework="pt") as file:
        content = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        lines = dict(file.metadata())
    content, lines = {**content, **(tensors or {})}, {**lines, **(header or {})}
    save_file(
        {k: v for k, v in content.items() if v is not None},
        path,
        metadata={k: v for k, v in lines.items() if v is not None},
    )


def error_of(path: Path) -> str:
    with pytest.raises(CheckpointError) as caught:
        load_model(path)
    return str(caught.value)


def test_everything_comes_back_bitwise(saved: tuple[Path, Papr, PointCloud]) -> None:
    path, papr, cloud = saved
    loaded = load_model(path)
    assert loaded.config == CONFIG
    assert torch.equal(loaded.cloud.positions, cloud.positions)
    assert torch.equal(loaded.cloud.features, cloud.features)
    assert torch.equal(loaded.cloud.influence, cloud.influence)
    state = loaded.papr().state_dict()
    assert all(torch.equal(state[name], value) for name, value in papr.state_dict().items())
    came = loaded.provenance
    assert (came.scene, came.stage, came.step) == ("lego", "pretrain", 70)
    assert came.background == (0.0, 0.5, 1.0)
    assert came.pcore == pcore_version()
    assert came.extent[1] == tuple(cloud.positions.amax(dim=0).tolist())


def test_colours_that_depend_on_the_side_come_back(tmp_path: Path) -> None:
    config = replace(CONFIG, feature_size=12, point_colors=True, color_degree=1)
    papr, path = Papr(config), tmp_path / "model.safetensors"
    cloud = replace(make_cloud(), features=torch.randn(5, 12))
    provenance = provenance_of(
        cloud.positions, config.background, scene="lego", stage="pretrain", step=70
    )
    save_model(path, papr.state_dict(), cloud, config, provenance)
    assert load_model(path).config == config
    with safe_open(path, framework="pt") as file:
        header = json.loads(file.metadata()["config"])
    # Files of before say nothing of it.
    del header["color_degree"]
    rewrite(path, header={"config": json.dumps(header)})
    assert load_model(path).config == replace(config, color_degree=0)


def test_a_run_folder_stands_for_its_model(saved: tuple[Path, Papr, PointCloud]) -> None:
    assert load_model(saved[0].parent).config == CONFIG


def test_the_header_alone_tells_what_it_is(saved: tuple[Path, Papr, PointCloud]) -> None:
    path, papr, _ = saved
    summary = describe_model(path)
    assert describe_model(str(path)) == summary
    assert summary.points == 5
    assert not summary.surfels
    assert load_model(path).surfels is None
    expected = sum(p.numel() for p in papr.state_dict().values()) + 5 * (3 + 6 + 1)
    assert summary.parameters == expected
    assert summary.provenance.scene == "lego"


def test_missing(tmp_path: Path) -> None:
    assert f"no model at {tmp_path / 'model.safetensors'}" in error_of(tmp_path)
    assert "pcore train" in error_of(tmp_path / "other")


@pytest.mark.parametrize("kept", [0, 5, 100, -1])
def test_truncated_anywhere(saved: tuple[Path, Papr, PointCloud], kept: int) -> None:
    path = saved[0]
    path.write_bytes(path.read_bytes()[:kept])
    message = error_of(path)
    assert "truncated, damaged or not a safetensors file" in message
    assert str(path) in message


def test_something_else(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(b"\x89PNG\r\n" + bytes(500))
    assert "not a safetensors file" in error_of(path)


class Bomb:
    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple:
        return Path.touch, (self.target,)


@pytest.mark.parametrize("zipped", [True, False])
def test_a_pickle_is_not_executed_and_the_importer_is_named(tmp_path: Path, zipped: bool) -> None:
    path, mark = tmp_path / "model.pth", tmp_path / "executed"
    torch.save({"1": Bomb(mark)}, path, _use_new_zipfile_serialization=zipped)
    message = error_of(path)
    assert "pickle file of PyTorch" in message
    assert "pcore import papr" in message
    assert not mark.exists()


def test_safetensors_of_somebody_else(tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    save_file({"w": torch.zeros(2)}, path)
    assert "not a model of pcore: expected the format 'pcore-model'" in error_of(path)


@pytest.mark.parametrize("version", ["5", "7"])
def test_another_version(saved: tuple[Path, Papr, PointCloud], version: str) -> None:
    rewrite(saved[0], header={"version": version})
    message = error_of(saved[0])
    assert f"version '{version}'" in message
    assert "reads version 6 alone; train the scene again (`pcore train`)" in message
    assert "`pcore import papr`" in message


def test_the_surface_comes_back_bitwise_where_it_is_known(tmp_path: Path) -> None:
    papr, cloud, path = Papr(CONFIG), make_cloud(), tmp_path / "model.safetensors"
    normals = torch.nn.functional.normalize(torch.randn(5, 3), dim=1)
    normals[2] = 0
    surfels = Surfels.at_rest(cloud.positions, normals, torch.rand(5))
    came = provenance_of(
        cloud.positions, CONFIG.background, scene="lego", stage="pretrain", step=70
    )
    save_model(path, papr.state_dict(), cloud, CONFIG, came, surfels)
    found = load_model(path).surfels
    assert found is not None
    for name in ("places", "normals", "heights", "beside"):
        assert torch.equal(getattr(found, name), getattr(surfels, name)), name
    assert found.spacing == surfels.spacing
    assert describe_model(path).surfels
    rewrite(path, tensors={"surfels.heights": None})
    assert "missing tensor 'surfels.heights'" in error_of(path)
    rewrite(path, tensors={"surfels.heights": torch.zeros(5), "surfels.normals": torch.ones(5, 3)})
    assert "normals of unit length" in error_of(path)
    rewrite(path, tensors={"surfels.normals": torch.zeros(4, 3)})
    assert "'surfels.normals': expected F32 (5, 3), got F32 (4, 3)" in error_of(path)


def test_a_changed_configuration(saved: tuple[Path, Papr, PointCloud]) -> None:
    with safe_open(saved[0], framework="pt") as file:
        config = json.loads(file.metadata()["config"])
    rewrite(saved[0], header={"config": json.dumps({**config, "colour": 1})})
    assert "config: unknown key 'colour'" in error_of(saved[0])
    rewrite(saved[0], header={"config": "{"})
    assert "expected a JSON object under 'config'" in error_of(saved[0])


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"cloud.influence": None}, "missing tensor 'cloud.influence'"),
        ({"cloud.positions": None}, "missing tensor 'cloud.positions'"),
        ({"papr.extra": torch.zeros(1)}, "unexpected tensor 'papr.extra'"),
        (
            {"cloud.features": torch.zeros(5, 7)},
            "'cloud.features': expected F32 (5, 6), got F32 (5, 7)",
        ),
        (
            {"cloud.influence": torch.zeros(5, dtype=torch.float64)},
            "'cloud.influence': expected F32 (5,), got F64 (5,)",
        ),
        ({"cloud.positions": torch.zeros(0, 3)}, "the cloud has no points"),
        (
            {"cloud.features": torch.full((5, 6), float("nan"))},
            "got NaN or infinity in cloud.features",
        ),
    ],
)
def test_wrong_tensors_are_named(
    saved: tuple[Path, Papr, PointCloud], tensors: dict, message: str
) -> None:
    rewrite(saved[0], tensors=tensors)
    assert message in error_of(saved[0])


@pytest.mark.parametrize("length", range(8))
def test_a_header_whose_length_looks_like_a_pickle_is_read(tmp_path: Path, length: int) -> None:
    # The first byte of the file is the header's length modulo 256; 0x80 begins pickles, too.
    papr, cloud, path = Papr(CONFIG), make_cloud(), tmp_path / "model.safetensors"
    starts = set()
    for extra in range(length * 32, length * 32 + 32, 8):
        scene = "s" * extra
        provenance = provenance_of(
            cloud.positions, CONFIG.background, scene=scene, stage="pretrain", step=1
        )
        save_model(path, papr.state_dict(), cloud, CONFIG, provenance)
        starts.add(path.read_bytes()[0])
        assert load_model(path).provenance.scene == scene
    assert len(starts) == 4


def test_a_diverged_model_never_replaces_a_good_one(
    saved: tuple[Path, Papr, PointCloud],
) -> None:
    path, papr, cloud = saved
    before = path.read_bytes()
    provenance = provenance_of(
        cloud.positions, CONFIG.background, scene="lego", stage="pretrain", step=71
    )
    bad = PointCloud(
        positions=cloud.positions, features=cloud.features, influence=cloud.influence / 0.0 * 0.0
    )
    with pytest.raises(CheckpointError, match=r"NaN or infinity in cloud\.influence"):
        save_model(path, papr.state_dict(), bad, CONFIG, provenance)
    assert path.read_bytes() == before


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_file(
    saved: tuple[Path, Papr, PointCloud], monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    path, papr, cloud = saved
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((atomic.os, "fsync") if call == "fsync" else (Path, "replace")), full)
    provenance = provenance_of(
        cloud.positions, CONFIG.background, scene="lego", stage="pretrain", step=71
    )
    with pytest.raises(OSError, match="No space left"):
        save_model(path, papr.state_dict(), cloud, CONFIG, provenance)
    assert path.read_bytes() == before
    assert [item.name for item in path.parent.iterdir()] == [path.name]

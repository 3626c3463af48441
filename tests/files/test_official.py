"""Official checkpoints: what comes in renders as the original would; what is wrong is named."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

import numpy_papr
from pcore.errors import CheckpointError, InputError
from pcore.files.official import OfficialModel, load_official, to_official_state
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, PaprConfig
from ray_pictures import picture_of

EMBED = "proximity_attn.embed.embed_"
WIDTH, FEATURES, POINTS = 16, 6, 50
State = dict[str, torch.Tensor]


def official_shapes(*, skip: bool) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the original's file, at smaller sizes."""
    value_in = 39 + 39 + FEATURES
    shapes: dict[str, tuple[int, ...]] = {
        "points": (POINTS, 3),
        "points_influ_scores": (POINTS, 1),
        "bkg_feats": (1, 3),
        "pc_feats": (POINTS, FEATURES),
    }
    for name, size in {
        "renderer.inc.double_conv.0": (8, 5, 3, 3),
        "renderer.down1.maxpool_conv.1.double_conv.0": (12, 8, 3, 3),
        "renderer.down2.maxpool_conv.1.double_conv.0": (16, 12, 3, 3),
        "renderer.up1.up": (16, 12, 2, 2),
        "renderer.up1.conv.double_conv.0": (12, 24, 3, 3),
        "renderer.up2.up": (12, 8, 2, 2),
        "renderer.up2.conv.double_conv.0": (8, 16, 3, 3),
        "renderer.outc.conv": (3, 8, 1, 1),
    }.items():
        shapes[f"{name}.weight"] = size
        shapes[f"{name}.bias"] = (size[1 if name.endswith("up") else 0],)
    for net, layers, size_in, size_out in (
        ("k", 5, 117, WIDTH),
        ("q", 5, 39, WIDTH),
        ("v", 8, value_in, 5),
    ):
        for layer in range(layers):
            inputs = size_in if layer == 0 else WIDTH
            if skip and net == "v" and layer == 5:
                inputs += value_in
            outputs = size_out if layer == layers - 1 else WIDTH
            shapes[f"{EMBED}{net}.mlp.model.{2 * layer + 1}.weight"] = (outputs, inputs)
            shapes[f"{EMBED}{net}.mlp.model.{2 * layer + 1}.bias"] = (outputs,)
        if net != "v":
            for norm, size in (("innorm", size_in), ("outnorm", size_out)):
                shapes[f"{EMBED}{net}.{norm}.a_2"] = (size,)
                shapes[f"{EMBED}{net}.{norm}.b_2"] = (size,)
    for side in "kq":
        shapes[f"proximity_attn.attention_layer.w_{side}.weight"] = (WIDTH, WIDTH)
        shapes[f"proximity_attn.attention_layer.w_{side}.bias"] = (WIDTH,)
    return shapes


def official_state(*, skip: bool) -> State:
    generator = torch.Generator().manual_seed(3)
    state: State = {"select_k": torch.tensor(9)}
    for name, shape in official_shapes(skip=skip).items():
        value = torch.randn(shape, generator=generator)
        if len(shape) > 1 and name not in ("points", "pc_feats", "points_influ_scores"):
            value = value * 1.4 / value[0].numel() ** 0.5
        state[name] = value
    state["points"] = state["points"] * 4
    state["points_influ_scores"] = state["points_influ_scores"].abs() + 2
    state["bkg_feats"] = torch.tensor([[0.2, 0.4, 0.9]])
    return state


def yaml_tree(*, act: str = "leakyrelu", skip: list[int] | None = None) -> dict[str, Any]:
    nets: dict[str, dict[str, Any]] = {n: {"ff_act": act} for n in ("key", "query", "value")}
    nets["value"]["skip_layers"] = [5] if skip is None else skip
    return {
        "index": "lego",
        "dataset": {"coord_scale": 10.0},
        "geoms": {"background": {"constant": 3.0}},
        "models": {"attn": {"embed": nets}},
    }


def write(folder: Path, state: Any, *trees: dict[str, Any]) -> tuple[Path, list[Path]]:
    model = folder / "model.pth"
    torch.save(state, model)
    configs: list[Path] = []
    for index, tree in enumerate(trees):
        configs.append(folder / f"config{index}.yml")
        configs[-1].write_text(yaml.safe_dump(tree))
    return model, configs


def load(folder: Path, state: Any, *trees: dict[str, Any]) -> OfficialModel:
    model, configs = write(folder, state, *trees)
    return load_official(model, configs)


def view(width: int = 10, height: int = 7) -> RayBundle:
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([0.1, -0.2, 3.0])
    return Camera.from_fov(pose, width=width, height=height, angle_x=0.7).rays()


def render(model: OfficialModel, rays: RayBundle) -> dict[str, np.ndarray]:
    papr = Papr(model.config)
    papr.load_state_dict(model.state)
    with torch.no_grad():
        out = picture_of(papr, model.cloud, rays)
    names = ("rgb", "alpha", "features", "neighbours")
    return {name: getattr(out, name).numpy() for name in names} | {"surface": out.centroid.numpy()}


@pytest.mark.parametrize("variant", ["chair", "lego"])
def test_import_renders_as_the_description_says(tmp_path: Path, variant: str) -> None:
    skip, act, slope = (True, "leakyrelu", 0.2) if variant == "lego" else (False, "relu", 0.0)
    state = official_state(skip=skip)
    tree = yaml_tree(act=act, skip=[5] if skip else [])
    model = load(tmp_path, {"250000": state}, tree)
    rays = view()
    expected = numpy_papr.forward(
        {name: value.numpy() for name, value in state.items()},
        rays.origins.numpy(),
        rays.directions.numpy(),
        coord_scale=10.0,
        constant=3.0,
        slope=slope,
    )
    found = render(model, rays)
    assert np.array_equal(np.sort(found["neighbours"], -1), expected["neighbours"])
    # Features are sums of many: rounding moves them by 5e-5 to 8.5e-5, the others by 2e-5 at most.
    for name, most in {"rgb": 1e-4, "alpha": 1e-4, "features": 3e-4, "surface": 1e-4}.items():
        assert np.abs(found[name] - expected[name]).max() < most, name
    assert 0.05 < expected["alpha"].mean() < 0.95
    assert expected["rgb"].std() > 0.01


def test_import_reads_sizes_constants_and_provenance(tmp_path: Path) -> None:
    state = official_state(skip=True)
    config, _, cloud, provenance = load(tmp_path, {"250000": state}, yaml_tree())
    assert config == PaprConfig(
        neighbours=9,
        feature_size=FEATURES,
        key=MlpConfig(layers=5, width=WIDTH, size=WIDTH),
        query=MlpConfig(layers=5, width=WIDTH, size=WIDTH),
        value=MlpConfig(layers=8, width=WIDTH, size=5, skip_after=5),
        negative_slope=0.2,
        background_score=3.0,
        unet_channels=(8, 12, 16),
        background=tuple(state["bkg_feats"][0].tolist()),
    )
    assert torch.equal(cloud.positions, state["points"] / 10)
    assert cloud.influence.shape == (POINTS,)
    assert provenance["step"] == 250000
    assert provenance["scene"] == "lego"
    assert provenance["model_file"] == "model.pth"
    assert len(provenance["model_sha256"]) == 64


def test_bare_state_dict_has_no_step(tmp_path: Path) -> None:
    model = load(tmp_path, official_state(skip=False), yaml_tree(skip=[]))
    assert model.provenance["step"] is None


def test_absent_keys_take_the_originals_defaults(tmp_path: Path) -> None:
    config = load(tmp_path, official_state(skip=True), {"index": "mine"}).config
    assert (config.coord_scale, config.background_score, config.negative_slope) == (10.0, 5.0, 0.0)
    assert config.value.skip_after == 5, "the shapes say so even where the YAML is silent"


def test_later_config_files_win(tmp_path: Path) -> None:
    default = yaml_tree(act="relu", skip=[]) | {"dataset": {"coord_scale": 4.0, "factor": 1}}
    config = load(tmp_path, official_state(skip=True), default, yaml_tree()).config
    assert (config.coord_scale, config.background_score, config.negative_slope) == (10.0, 3.0, 0.2)


def test_older_spelling_of_the_attention_section(tmp_path: Path) -> None:
    tree = yaml_tree()
    tree["models"]["transformer"] = tree["models"].pop("attn")
    assert load(tmp_path, official_state(skip=True), tree).config.negative_slope == 0.2


@pytest.mark.parametrize("lego", [False, True])
def test_round_trip_renders_identically(tmp_path: Path, lego: bool) -> None:
    config = PaprConfig(
        neighbours=5,
        feature_size=FEATURES,
        key=MlpConfig(layers=3, width=12, size=8),
        query=MlpConfig(layers=2, width=12, size=8),
        value=MlpConfig(layers=8, width=12, size=4, skip_after=5 if lego else None),
        negative_slope=0.2 if lego else 0.0,
        background_score=3.0,
        unet_channels=(4, 6, 8),
        background=(0.0, 0.5, 1.0),
        coord_scale=8.0,  # a power of two: scaling there and back is exact
    )
    papr = Papr(config).eval()
    cloud = PointCloud(
        positions=torch.randn(30, 3) * 0.4,
        features=torch.randn(30, FEATURES),
        influence=torch.rand(30) + 1,
    )
    tree = yaml_tree(act="leakyrelu" if lego else "relu", skip=[5] if lego else [])
    tree["dataset"]["coord_scale"] = 8.0
    model = load(tmp_path, {"17": to_official_state(papr, cloud)}, tree)
    assert model.config == config
    with torch.no_grad():
        expected = picture_of(papr, cloud, view()).rgb.numpy()
    assert np.array_equal(render(model, view())["rgb"], expected)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (PaprConfig(cutoff=0.1), r"without a cut-off, got cutoff = 0\.1"),
        (PaprConfig(point_colors=True), "make all of a colour, got points with"),
    ],
)
def test_export_refuses_what_the_original_does_not_know(config: PaprConfig, message: str) -> None:
    cloud = PointCloud(
        positions=torch.zeros(1, 3), features=torch.zeros(1, 64), influence=torch.ones(1)
    )
    with torch.device("meta"):
        papr = Papr(config)
    with pytest.raises(InputError, match=message):
        to_official_state(papr, cloud)


# --- what is wrong is named -----------------------------------------------------------------


def drop(name: str) -> Callable[[State], None]:
    return lambda state: state.__delitem__(name)


def put(name: str, value: torch.Tensor) -> Callable[[State], None]:
    return lambda state: state.__setitem__(name, value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (drop("points"), r"missing tensor points; expected a checkpoint of the original PAPR"),
        (drop("renderer.up1.up.bias"), r"missing tensor renderer\.up1\.up\.bias"),
        (drop(f"{EMBED}k.mlp.model.3.weight"), r"missing tensor .*embed_k\.mlp\.model\.3\.weight"),
        (put("mapping_mlp.0.weight", torch.ones(2)), r"unknown tensor mapping_mlp\.0\.weight"),
        (
            put("points_influ_scores", torch.ones(POINTS)),
            r"misshaped tensor points_influ_scores \(expected \(50, 1\), got \(50,\)\)",
        ),
        (put("points", torch.ones(0, 3)), r"points: expected a non-empty tensor of 2 axes"),
        (
            put("points", torch.full((POINTS, 3), float("nan"))),
            r"NaN or infinity in tensor points",
        ),
        (put("select_k", torch.tensor(0)), r"select_k: expected a positive whole number, got 0"),
        (put("bkg_feats", torch.ones(2, 3)), r"bkg_feats: expected shape \(1, 3\), got \(2, 3\)"),
        (
            put(f"{EMBED}q.mlp.model.1.weight", torch.ones(WIDTH, 40)),
            r"embed_q\.mlp\.model\.1\.weight: expected 3 \(1 \+ 2 L\) inputs, e\.g\. 39, got 40",
        ),
    ],
)
def test_wrong_tensors(tmp_path: Path, change: Callable[[State], None], message: str) -> None:
    state = official_state(skip=True)
    change(state)
    with pytest.raises(CheckpointError, match=message):
        load(tmp_path, {"1": state}, yaml_tree())


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, r"got nothing at all"),
        ([torch.ones(1)], r"expected \{step: state dict\} or a state dict .* got something else"),
        (torch.ones(1), r"or a state dict .* got one tensor"),
        ({"1": {"points": 3.0}}, r"an entry 'points' that is no array of real numbers"),
        ({"optimizer": {"lr": 1.0}, "step": 3}, r"an entry 'optimizer' that is no array"),
    ],
)
def test_tensors_of_something_else(tmp_path: Path, data: Any, message: str) -> None:
    with pytest.raises(CheckpointError, match=message):
        load(tmp_path, data, yaml_tree())


class Evil:
    """Unpickling this creates a file."""

    def __init__(self, victim: Path) -> None:
        self.victim = victim

    def __reduce__(self) -> tuple[Any, ...]:
        return (open, (str(self.victim), "w"))


@pytest.mark.parametrize("writer", ["torch", "pickle"])
def test_code_in_a_pickle_is_never_executed(tmp_path: Path, writer: str) -> None:
    control, victim = tmp_path / "control", tmp_path / "victim"
    model, configs = write(tmp_path, {}, yaml_tree())
    pickle.loads(pickle.dumps(Evil(control))).close()
    assert control.exists(), "the attack works where pickles are trusted"
    if writer == "torch":
        torch.save({"1": {"points": Evil(victim)}}, model)
    else:
        model.write_bytes(pickle.dumps(Evil(victim)))
    with pytest.raises(CheckpointError, match=r"nothing in it was executed"):
        load_official(model, configs)
    assert not victim.exists()


@pytest.mark.parametrize("kept", [0, 10, 5000])
def test_truncated_file(tmp_path: Path, kept: int) -> None:
    model, configs = write(tmp_path, {"1": official_state(skip=True)}, yaml_tree())
    model.write_bytes(model.read_bytes()[:kept])
    with pytest.raises(CheckpointError, match=r"model\.pth: .*damaged, cut short"):
        load_official(model, configs)


def test_missing_model(tmp_path: Path) -> None:
    _, configs = write(tmp_path, {}, yaml_tree())
    with pytest.raises(CheckpointError, match=r"other\.pth: .* found no such file"):
        load_official(tmp_path / "other.pth", configs)


def test_sparse_tensors_are_refused(tmp_path: Path) -> None:
    state = official_state(skip=True)
    state["points"] = state["points"].to_sparse()
    with pytest.raises(
        CheckpointError, match=r"an entry 'points' that is no array of real numbers"
    ):
        load(tmp_path, {"1": state}, yaml_tree())


def set_key(dotted: str, value: Any) -> dict[str, Any]:
    tree = yaml_tree()
    node = tree
    *sections, last = dotted.split(".")
    for section in sections:
        node = node.setdefault(section, {})
    node[last] = value
    return tree


@pytest.mark.parametrize(
    ("dotted", "value", "message"),
    [
        (
            "dataset.coord_scale",
            "big",
            r"dataset\.coord_scale: expected a finite number, got 'big'",
        ),
        ("dataset.coord_scale", -1.0, r"expected a positive coord_scale"),
        ("geoms.background.constant", True, r"constant: expected a finite number, got True"),
        ("models.attn.embed.key.ff_act", "relu", r"expected one activation.*key\.ff_act = relu"),
        (
            "models.attn.embed.value.skip_layers",
            [3],
            r"after layer 5, the configuration after layer 3",
        ),
        ("models.attn.embed.value.skip_layers", [], r"after layer 5, .* after layer None"),
        ("models.attn.embed.value.skip_layers", [3, 5], r"at most one layer, e\.g\. \[5\]"),
        ("models.use_renderer", False, r"models\.use_renderer: expected True, got False"),
        ("models.attn.score_act", "none", r"models\.attn\.score_act: expected 'relu', got 'none'"),
        ("exposure_control.use", True, r"this variant of PAPR is not supported"),
    ],
)
def test_wrong_configuration(tmp_path: Path, dotted: str, value: Any, message: str) -> None:
    with pytest.raises(CheckpointError, match=message):
        load(tmp_path, {"1": official_state(skip=True)}, set_key(dotted, value))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"- 1\n- 2\n", r"expected a YAML mapping .* got something else"),
        (b"a: [1\n", r"expected a YAML configuration .* not plain YAML"),
        (b"\xff\xfe\x00", r"expected a YAML configuration .* not plain YAML"),
        (b"a: !!python/object/apply:os.system ['touch x']\n", r"not plain YAML"),
    ],
)
def test_not_a_configuration(tmp_path: Path, content: bytes, message: str) -> None:
    model, configs = write(tmp_path, {"1": official_state(skip=True)}, yaml_tree())
    configs[0].write_bytes(content)
    with pytest.raises(CheckpointError, match=message):
        load_official(model, configs)


def test_configuration_is_required(tmp_path: Path) -> None:
    model, configs = write(tmp_path, {"1": official_state(skip=True)}, yaml_tree())
    with pytest.raises(CheckpointError, match=r"expected its YAML configuration, got none"):
        load_official(model, [])
    configs[0].unlink()
    with pytest.raises(CheckpointError, match=r"config0\.yml: cannot read the configuration"):
        load_official(model, configs)

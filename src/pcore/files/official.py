"""Checkpoints of the original PAPR: their names, shapes and units, to ours and back."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.files.official_config import OfficialSettings, read_settings
from pcore.files.official_file import read_tensors
from pcore.files.official_older import todays_tensors
from pcore.files.official_shapes import check_tensors
from pcore.geometry.point_cloud import PointCloud
from pcore.model.encoding import encoded_size
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig

_EMBED = "proximity_attn.embed.embed_"
_UNET = {
    "unet.inc": "renderer.inc.double_conv.0",
    "unet.down1": "renderer.down1.maxpool_conv.1.double_conv.0",
    "unet.down2": "renderer.down2.maxpool_conv.1.double_conv.0",
    "unet.up1": "renderer.up1.up",
    "unet.merge1": "renderer.up1.conv.double_conv.0",
    "unet.up2": "renderer.up2.up",
    "unet.merge2": "renderer.up2.conv.double_conv.0",
    "unet.outc": "renderer.outc.conv",
}


class OfficialModel(NamedTuple):
    """An official checkpoint in our terms.

    Attributes:
        config: the architecture.
        state: state dict of `Papr(config)`, float32 on the CPU.
        cloud: the points, world units.
        provenance: where the model came from (kind, scene, model_file, model_sha256,
            config_files, step); plain JSON values.
    """

    config: PaprConfig
    state: dict[str, Tensor]
    cloud: PointCloud
    provenance: dict[str, Any]


def load_official(model_path: Path, config_paths: Sequence[Path]) -> OfficialModel:
    """Read a checkpoint of the original PAPR without executing anything in it.

    Args:
        model_path: the original's `model.pth`, `{"<step>": state_dict}` or a bare state dict.
        config_paths: its YAML configuration; keys of later files win.

    Raises:
        CheckpointError: a file is missing, damaged, not a checkpoint of the original, or of a
            variant that is not supported; the message names the tensors or keys.
    """
    settings = read_settings(config_paths)
    step, tensors = read_tensors(model_path)
    config, state, cloud = from_official_state(tensors, settings, where=str(model_path))
    with model_path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    provenance = {
        "kind": "official PAPR checkpoint",
        "scene": settings.name or config_paths[-1].stem,
        "model_file": model_path.name,
        "model_sha256": digest,
        "config_files": [path.name for path in config_paths],
        "step": step,
    }
    return OfficialModel(config, state, cloud, provenance)


def from_official_state(
    tensors: Mapping[str, Tensor], settings: OfficialSettings, *, where: str
) -> tuple[PaprConfig, dict[str, Tensor], PointCloud]:
    """Translate the original's tensors; the sizes are read from their shapes.

    Args:
        tensors: the original's state dict, also under the names of before June 2024.
        settings: what its YAML says.
        where: the file, for messages.

    Returns:
        The architecture, the state dict of `Papr` and the points in world units.

    Raises:
        CheckpointError: tensors are missing, unknown, misshaped or not finite.
    """
    tensors = todays_tensors(tensors)
    config = _config(tensors, settings, where)
    with torch.device("meta"):
        expected = {k: tuple(v.shape) for k, v in Papr(config).state_dict().items()}
    names = {ours: _official_name(ours) for ours in expected}
    count, features = tensors["points"].shape[0], config.feature_size
    shapes = {names[ours]: shape for ours, shape in expected.items()}
    shapes |= {
        "points": (count, 3),
        "points_influ_scores": (count, 1),
        "pc_feats": (count, features),
        "bkg_feats": (1, 3),
        "select_k": (),
    }
    check_tensors(tensors, shapes, where)
    state = {ours: _copy(tensors[name]) for ours, name in names.items()}
    cloud = PointCloud(
        positions=_copy(tensors["points"]) / settings.coord_scale,
        features=_copy(tensors["pc_feats"]),
        influence=_copy(tensors["points_influ_scores"]).squeeze(-1),
    )
    return config, state, cloud


def to_official_state(papr: Papr, cloud: PointCloud) -> dict[str, Tensor]:
    """Return our model under the original's names, in its units (inverse of the import).

    The background score, the activation and the coordinate scale are not part of the original's
    files; the cut-off has no counterpart there.

    Raises:
        InputError: the model uses a cut-off, encodes with several numbers of octaves, has a frame
            of its own, or points with colours.
    """
    octaves = papr.config.octaves
    if octaves != Octaves.all(octaves.point):
        raise InputError(
            f"official checkpoint: expected one number of octaves for all encodings, got {octaves}"
        )
    if papr.config.cutoff is not None:
        raise InputError(
            "official checkpoint: expected a model without a cut-off, got cutoff = "
            f"{papr.config.cutoff}; the original lets every point answer every ray"
        )
    if papr.config.point_colors:
        raise InputError(
            "official checkpoint: expected networks that make all of a colour, got points with "
            "colours of their own; train with PaprConfig.point_colors = False"
        )
    frame = papr.config.frame
    if frame is not None:
        raise InputError(
            "official checkpoint: expected networks that see world coordinates, got a frame about "
            f"{frame.center} with the unit {frame.unit:g}; the original knows scenes of the usual "
            "size about the origin: bring the cameras there before training"
        )
    out = {_official_name(ours): _copy(v) for ours, v in papr.state_dict().items()}
    out["points"] = _copy(cloud.positions) * papr.config.coord_scale
    out["points_influ_scores"] = _copy(cloud.influence).unsqueeze(-1)
    out["pc_feats"] = _copy(cloud.features)
    out["bkg_feats"] = torch.tensor([papr.config.background])
    out["select_k"] = torch.tensor(papr.config.neighbours)
    return out


def _config(tensors: Mapping[str, Tensor], settings: OfficialSettings, where: str) -> PaprConfig:
    """Architecture from the shapes and the YAML."""
    feature_size = _shape(tensors, "pc_feats", 2, where)[1]
    frequencies = _frequencies(tensors, where)
    vector = encoded_size(3, frequencies)
    key = _mlp(tensors, "k", 3 * vector, where)
    query = _mlp(tensors, "q", vector, where)
    value = _mlp(tensors, "v", 2 * vector + feature_size, where)
    _check_skips(key, query, value, settings, where)
    full, half, quarter = (
        _shape(tensors, f"{_UNET[f'unet.{stage}']}.weight", 4, where)[0]
        for stage in ("inc", "down1", "down2")
    )
    _shape(tensors, "points", 2, where)
    try:
        return PaprConfig(
            neighbours=_select_k(tensors, where),
            coord_scale=settings.coord_scale,
            octaves=Octaves.all(frequencies),
            feature_size=feature_size,
            key=key,
            query=query,
            value=value,
            negative_slope=settings.negative_slope,
            background_score=settings.background_score,
            unet_channels=(full, half, quarter),
            background=_background(tensors, where),
        )
    except InputError as error:
        raise CheckpointError(f"{where}: {error}") from error


def _frequencies(tensors: Mapping[str, Tensor], where: str) -> int:
    """Octaves L of the encoding: the query reads the encoded direction and nothing else."""
    name = f"{_EMBED}q.mlp.model.1.weight"
    inputs = _shape(tensors, name, 2, where)[1]
    frequencies = (inputs // 3 - 1) // 2
    if frequencies < 1 or encoded_size(3, frequencies) != inputs:
        raise CheckpointError(
            f"{where}: {name}: expected 3 (1 + 2 L) inputs, e.g. 39, got {inputs}"
        )
    return frequencies


def _check_skips(
    key: MlpConfig, query: MlpConfig, value: MlpConfig, settings: OfficialSettings, where: str
) -> None:
    for name, net in (("key", key), ("query", query)):
        if net.skip_after is not None:
            raise CheckpointError(
                f"{where}: expected no skip of the input in the {name} network, got one after "
                f"layer {net.skip_after}; this variant of PAPR is not supported"
            )
    if settings.value_skip_stated and settings.value_skip != value.skip_after:
        raise CheckpointError(
            f"{where}: skip of the value network: the tensors have it after layer "
            f"{value.skip_after}, the configuration after layer {settings.value_skip}; pass the "
            ".yml this checkpoint was trained with"
        )


def _select_k(tensors: Mapping[str, Tensor], where: str) -> int:
    _shape(tensors, "select_k", 0, where)
    k = float(tensors["select_k"])
    if not (k >= 1 and k.is_integer()):
        raise CheckpointError(f"{where}: select_k: expected a positive whole number, got {k:g}")
    return int(k)


def _background(tensors: Mapping[str, Tensor], where: str) -> tuple[float, float, float]:
    shape = _shape(tensors, "bkg_feats", 2, where)
    if shape != (1, 3):
        raise CheckpointError(f"{where}: bkg_feats: expected shape (1, 3), got {shape}")
    red, green, blue = (float(channel) for channel in tensors["bkg_feats"][0])
    return red, green, blue


def _mlp(tensors: Mapping[str, Tensor], net: str, size_in: int, where: str) -> MlpConfig:
    """Shape of one embedding network; a skip shows in the inputs of the layer behind it."""
    pattern = re.compile(re.escape(f"{_EMBED}{net}.mlp.model.") + r"(\d+)\.weight")
    slots = [int(m.group(1)) for m in map(pattern.fullmatch, tensors) if m]
    layers = (max(slots, default=1) + 1) // 2
    if layers < 2:
        raise CheckpointError(f"{where}: {_EMBED}{net}.mlp: expected at least two linear layers")
    shapes = [
        _shape(tensors, f"{_EMBED}{net}.mlp.model.{2 * i + 1}.weight", 2, where)
        for i in range(layers)
    ]
    width = shapes[0][0]
    skips = [i for i in range(1, layers) if shapes[i][1] == width + size_in]
    if len(skips) > 1:
        raise CheckpointError(
            f"{where}: {_EMBED}{net}.mlp: expected at most one skip of the input, got {len(skips)}"
        )
    return MlpConfig(
        layers=layers, width=width, size=shapes[-1][0], skip_after=skips[0] if skips else None
    )


def _shape(tensors: Mapping[str, Tensor], name: str, axes: int, where: str) -> tuple[int, ...]:
    tensor = tensors.get(name)
    if tensor is None:
        raise CheckpointError(
            f"{where}: missing tensor {name}; expected a checkpoint of the original PAPR"
        )
    if tensor.ndim != axes or tensor.numel() == 0:
        raise CheckpointError(
            f"{where}: {name}: expected a non-empty tensor of {axes} axes, got shape "
            f"{tuple(tensor.shape)}"
        )
    return tuple(tensor.shape)


def _official_name(ours: str) -> str:
    """Name of one of our parameters in the original's files."""
    stem, leaf = ours.rsplit(".", 1)
    if stem in _UNET:
        return f"{_UNET[stem]}.{leaf}"
    path = stem.split(".")[1:]
    if path[0] in ("w_key", "w_query"):
        return f"proximity_attn.attention_layer.w_{path[0][2]}.{leaf}"
    net = f"{_EMBED}{path[0][0]}"
    if path[-1] in ("innorm", "outnorm"):
        return f"{net}.{path[-1]}.{'a_2' if leaf == 'gain' else 'b_2'}"
    # The original's list alternates activations (even places) and linear layers (odd places).
    return f"{net}.mlp.model.{2 * int(path[-1]) + 1}.{leaf}"


def _copy(tensor: Tensor) -> Tensor:
    return tensor.detach().to(device="cpu", dtype=torch.float32, copy=True)

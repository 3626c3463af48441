"""Checkpoints of the original PAPR: their names, shapes and units, to ours and back."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.geometry.point_cloud import PointCloud
from pcore.model.config import MlpConfig, PaprConfig
from pcore.model.encoding import encoded_size
from pcore.model.official_config import OfficialSettings, read_settings
from pcore.model.papr import Papr

_POINT_TENSORS = ("points", "points_influ_scores", "pc_feats", "bkg_feats", "select_k")
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
_LISTED = 6
"""Names that an error message spells out before it says how many more there are."""


class OfficialModel(NamedTuple):
    """An official checkpoint in our terms.

    Attributes:
        config: the architecture.
        state: state dict of `Papr(config)`, float32 on the CPU.
        cloud: the points, world units.
        provenance: where the model came from: file names, SHA-256, step; plain JSON values.
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
    step, tensors = _split_step(_load_pickle(model_path), model_path)
    config, state, cloud = from_official_state(tensors, settings, where=str(model_path))
    with model_path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    provenance = {
        "kind": "official PAPR checkpoint",
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
        tensors: the original's state dict.
        settings: what its YAML says.
        where: the file, for messages.

    Returns:
        The architecture, the state dict of `Papr` and the points in world units.

    Raises:
        CheckpointError: tensors are missing, unknown, misshaped or not finite.
    """
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
    _check_tensors(tensors, shapes, where)
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
        InputError: the model uses a cut-off.
    """
    if papr.config.cutoff is not None:
        raise InputError(
            "official checkpoint: expected a model without a cut-off, got cutoff = "
            f"{papr.config.cutoff}; the original lets every point answer every ray"
        )
    out = {_official_name(ours): _copy(v) for ours, v in papr.state_dict().items()}
    out["points"] = _copy(cloud.positions) * papr.config.coord_scale
    out["points_influ_scores"] = _copy(cloud.influence).unsqueeze(-1)
    out["pc_feats"] = _copy(cloud.features)
    out["bkg_feats"] = torch.tensor([papr.config.background])
    out["select_k"] = torch.tensor(papr.config.neighbours)
    return out


def _load_pickle(path: Path) -> Any:
    if not path.is_file():
        raise CheckpointError(f"{path}: expected the original's model.pth, found no such file")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged or hostile pickle can make the reader raise anything
        raise CheckpointError(
            f"{path}: expected a PyTorch file that holds nothing but tensors, got one that is "
            "damaged, cut short or contains Python objects; nothing in it was executed. Download "
            "it again, or ask its author for the plain state dict"
        ) from error


def _split_step(data: Any, path: Path) -> tuple[int | None, dict[str, Tensor]]:
    """Separate `{"<step>": state_dict}`; a bare state dict has no step."""
    step: int | None = None
    if isinstance(data, dict) and len(cast("dict[Any, Any]", data)) == 1:
        key, value = next(iter(cast("dict[Any, Any]", data).items()))
        if isinstance(value, dict) and str(key).isdigit():
            step, data = int(key), value
    if not isinstance(data, dict) or not data:
        raise CheckpointError(
            f"{path}: expected {{step: state dict}} or a state dict of the original PAPR, got "
            f"{_describe(data)}"
        )
    tensors = cast("dict[Any, Any]", data)
    for name, value in tensors.items():
        if not (isinstance(name, str) and isinstance(value, Tensor)):
            raise CheckpointError(
                f"{path}: expected {{step: state dict}} or a state dict of the original PAPR, got "
                f"an entry {name!r} of type {type(value).__name__}"
            )
    return step, cast("dict[str, Tensor]", tensors)


def _describe(data: Any) -> str:
    return "an empty dict" if isinstance(data, dict) else type(data).__name__


def _config(tensors: Mapping[str, Tensor], settings: OfficialSettings, where: str) -> PaprConfig:
    """Architecture from the shapes and the YAML."""
    feature_size = _shape(tensors, "pc_feats", 2, where)[1]
    query_size = _shape(tensors, f"{_EMBED}q.mlp.model.1.weight", 2, where)[1]
    octaves = (query_size / 3 - 1) / 2
    if octaves < 1 or octaves != int(octaves):
        raise CheckpointError(
            f"{where}: {_EMBED}q.mlp.model.1.weight: expected 3 (1 + 2 L) inputs, e.g. 39, got "
            f"{query_size}"
        )
    vector = encoded_size(3, int(octaves))
    value = _mlp(tensors, "v", 2 * vector + feature_size, where)
    if settings.value_skip_stated and settings.value_skip != value.skip_after:
        raise CheckpointError(
            f"{where}: value network: the configuration puts the skip after layer "
            f"{settings.value_skip}, the shapes put it after layer {value.skip_after}; pass the "
            ".yml this checkpoint was trained with"
        )
    unet = [_shape(tensors, f"{_UNET[f'unet.{n}']}.weight", 4, where)[0] for n in _STAGES]
    background = _shape(tensors, "bkg_feats", 2, where)
    select_k = _shape(tensors, "select_k", 0, where)
    if background != (1, 3) or select_k != () or int(tensors["select_k"]) < 1:
        raise CheckpointError(
            f"{where}: expected bkg_feats of shape (1, 3) and a positive select_k, got shape "
            f"{background} and {tensors['select_k'].tolist()}"
        )
    _shape(tensors, "points", 2, where)
    red, green, blue = (float(c) for c in tensors["bkg_feats"][0])
    return PaprConfig(
        neighbours=int(tensors["select_k"]),
        coord_scale=settings.coord_scale,
        frequencies=int(octaves),
        feature_size=feature_size,
        key=_mlp(tensors, "k", 3 * vector, where),
        query=_mlp(tensors, "q", vector, where),
        value=value,
        negative_slope=settings.negative_slope,
        background_score=settings.background_score,
        unet_channels=(unet[0], unet[1], unet[2]),
        background=(red, green, blue),
    )


_STAGES = ("inc", "down1", "down2")


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


def _check_tensors(
    tensors: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]], where: str
) -> None:
    problems: list[str] = []
    problems += _listing("missing tensor", [n for n in shapes if n not in tensors])
    problems += _listing("unknown tensor", [n for n in tensors if n not in shapes])
    common = [n for n in shapes if n in tensors]
    wrong = [n for n in common if tuple(tensors[n].shape) != shapes[n]]
    problems += _listing(
        "misshaped tensor",
        [f"{n} (expected {shapes[n]}, got {tuple(tensors[n].shape)})" for n in wrong],
    )
    problems += _listing(
        "NaN or infinity in tensor",
        [n for n in common if not bool(torch.isfinite(tensors[n]).all())],
    )
    if problems:
        raise CheckpointError(
            f"{where}: {'; '.join(problems)}; expected a checkpoint of the original PAPR"
        )


def _listing(what: str, names: Sequence[str]) -> list[str]:
    if not names:
        return []
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return [f"{what} {', '.join(names[:_LISTED])}{more}"]


def _copy(tensor: Tensor) -> Tensor:
    return tensor.detach().to(device="cpu", dtype=torch.float32, copy=True)

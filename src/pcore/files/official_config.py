"""The YAML configuration of an official PAPR checkpoint: what its weights alone do not say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml

from pcore.errors import CheckpointError
from pcore.files.official_older import todays_settings

Tree = dict[str, Any]

LEAKY_SLOPE = 0.2
"""Slope below zero that the original gives its leaky ReLU."""

_ATTENTION = "models.attn"

_ONLY_VALUES: dict[str, Any] = {
    "geoms.points.select_k_type": "d2r",
    "geoms.point_feats.use_inv": True,
    "geoms.point_feats.use_ink": False,
    "geoms.point_feats.use_inq": False,
    "models.use_renderer": True,
    "models.last_act": "none",
    "models.normalize_topk_attn": True,
    "models.renderer.generator.type": "small-unet",
    "models.renderer.generator.small_unet.bilinear": False,
    "models.renderer.generator.small_unet.norm": "none",
    "models.renderer.generator.small_unet.single": True,
    "models.renderer.generator.small_unet.last_act": "none",
    "exposure_control.use": False,
    "models.mapping_mlp.use": False,
}
"""Settings of the original with one supported value: all of its released scenes have it."""

_ONLY_ATTENTION_VALUES: dict[str, Any] = {
    "score_act": "relu",
    "block.score_act": "relu",
    "block.k_act": "none",
    "block.q_act": "none",
    "block.transform_kq": True,
    "block.temperature": 1.0,
    "block.n_head": 1,
    "block.n_block": 1,
    "k_type": 1,
    "q_type": 1,
    "v_type": 1,
    "embed.embed_type": 1,
    "embed.share_embed": False,
    "embed.pe_factor": 2.0,
    "embed.pe_mult_factor": 1.0,
    "embed.pe_type": "none",
    "embed.temperature": 1.0,
    "embed.key.norm": "layernorm",
    "embed.query.norm": "layernorm",
    "embed.value.norm": "none",
    **{f"embed.{net}.ff_last_act": "none" for net in ("key", "query", "value")},
    **{f"embed.{net}.residual_ff": False for net in ("key", "query", "value")},
    **{f"embed.{net}.use_wn": False for net in ("key", "query", "value")},
    **{f"embed.{net}.half_layers": [] for net in ("key", "query", "value")},
    **{f"embed.{net}.residual_layers": [] for net in ("key", "query", "value")},
    **{f"embed.{net}.skip_layers": [] for net in ("key", "query")},
}
"""The same, below the attention's section."""


@dataclass(frozen=True, kw_only=True)
class OfficialSettings:
    """What an original configuration says about the model; the defaults are the original's."""

    name: str = ""
    """Name of the experiment, empty when the configuration gives none."""
    coord_scale: float = 10.0
    """World coordinates were multiplied by this."""
    background_score: float = 5.0
    """Constant attention score of the background."""
    negative_slope: float = 0.0
    """Slope of the leaky ReLU in the embedding networks, 0 for ReLU."""
    value_skip: int | None = None
    """The value network's input is concatenated behind this layer's output (1 is the first)."""
    value_skip_stated: bool = False
    """Whether the configuration says anything about the skip."""


def read_settings(paths: Sequence[Path]) -> OfficialSettings:
    """Read the original's YAML files; keys of later files win over those of earlier ones.

    Raises:
        CheckpointError: no file, a file that is missing or not YAML, a value of another type, or a
            variant of the model that no released checkpoint uses and that is not supported.
    """
    if not paths:
        raise CheckpointError(
            "official checkpoint: expected its YAML configuration, got none; the background score "
            "and the activation are not in the weights, pass the file of configs/ it was trained "
            "with"
        )
    tree: Tree = {}
    for path in paths:
        # Renamed before they are laid over one another: files of both ages can be combined.
        tree = _merged(tree, todays_settings(_load_yaml(path)))
    where = ", ".join(path.name for path in paths)
    _check_supported(tree, where)
    skip = _get(tree, f"{_ATTENTION}.embed.value.skip_layers")
    return OfficialSettings(
        name=str(_get(tree, "index") or ""),
        coord_scale=_number(tree, "dataset.coord_scale", OfficialSettings.coord_scale, where),
        background_score=_number(
            tree, "geoms.background.constant", OfficialSettings.background_score, where
        ),
        negative_slope=_slope(tree, where),
        value_skip=_skip(skip, f"{_ATTENTION}.embed.value.skip_layers", where),
        value_skip_stated=skip is not None,
    )


def _load_yaml(path: Path) -> Tree:
    try:
        content = path.read_bytes()
        # Comments may be in any encoding; Latin-1 gives every byte a letter.
        encoding = "utf-8-sig" if _is_utf8(content) else "latin-1"
        data = yaml.safe_load(content.decode(encoding))
    except OSError as error:
        raise CheckpointError(
            f"{path}: cannot read the configuration ({error.strerror}); check the path"
        ) from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise CheckpointError(
            f"{path}: expected a YAML configuration of the original PAPR, got a file that is not "
            "plain YAML; pass the .yml the checkpoint was trained with"
        ) from error
    if not isinstance(data, dict):
        raise CheckpointError(
            f"{path}: expected a YAML mapping with sections such as dataset, geoms and models, got "
            "something else; pass the .yml the checkpoint was trained with"
        )
    return cast(Tree, data)


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _merged(base: Tree, over: Tree) -> Tree:
    """Lay the keys of `over` on top of `base`, section by section."""
    out = dict(base)
    for key, value in over.items():
        old = out.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            out[key] = _merged(cast(Tree, old), cast(Tree, value))
        else:
            out[key] = value
    return out


def _get(tree: Tree, dotted: str) -> Any:
    """Return the value at a dotted key, None when a step is absent."""
    node: Any = tree
    for key in dotted.split("."):
        if not isinstance(node, dict):
            return None
        node = cast(Tree, node).get(key)
    return node


def _number(tree: Tree, dotted: str, default: float, where: str) -> float:
    value = _get(tree, dotted)
    if value is None:
        return default
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value):
        raise CheckpointError(f"{where}: {dotted}: expected a finite number, got {value!r}")
    return float(value)


def _check_supported(tree: Tree, where: str) -> None:
    wanted = _ONLY_VALUES | {f"{_ATTENTION}.{k}": v for k, v in _ONLY_ATTENTION_VALUES.items()}
    for dotted, supported in wanted.items():
        value = _get(tree, dotted)
        if value is not None and value != supported:
            raise CheckpointError(
                f"{where}: {dotted}: expected {supported!r}, got {value!r}; this variant of PAPR "
                "is not supported"
            )


def _slope(tree: Tree, where: str) -> float:
    slopes = {"relu": 0.0, "leakyrelu": LEAKY_SLOPE}
    found: dict[str, str] = {}
    for net in ("key", "query", "value"):
        dotted = f"{_ATTENTION}.embed.{net}.ff_act"
        name = _get(tree, dotted)
        found[dotted] = "relu" if name is None else str(name).lower()
    names = set(found.values())
    if len(names) > 1 or not names <= slopes.keys():
        stated = ", ".join(f"{dotted} = {name}" for dotted, name in found.items())
        raise CheckpointError(
            f"{where}: expected one activation, relu or leakyrelu, for key, query and value, got "
            f"{stated}; this variant of PAPR is not supported"
        )
    return slopes[names.pop()]


def _skip(value: Any, dotted: str, where: str) -> int | None:
    """Read the skip: the original counts layers from 0 and names the one that takes the input."""
    if value is None or value == []:
        return None
    entries = cast("list[Any]", value) if isinstance(value, list) else [value]
    entry = entries[0]
    if len(entries) != 1 or isinstance(entry, bool) or not isinstance(entry, int) or entry < 1:
        raise CheckpointError(
            f"{where}: {dotted}: expected at most one layer, e.g. [5], got {value!r}; this variant "
            "of PAPR is not supported"
        )
    # Layer 5 counted from 0 has layers 1..5 counted from 1 before it.
    return entry

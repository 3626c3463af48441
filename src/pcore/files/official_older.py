"""Names that the original PAPR gave its tensors and settings before June 2024, to today's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from torch import Tensor

_OLDER = {
    "transformer.embed.": "proximity_attn.embed.",
    "transformer.blocks.0.w_k.": "proximity_attn.attention_layer.w_k.",
    "transformer.blocks.0.w_q.": "proximity_attn.attention_layer.w_q.",
}
_UNUSED = ("transformer.blocks.0.w_v.", "transformer.blocks.0.w_o.", "transformer.blocks.0.ff.")
"""Layers that older models had and never called: no picture depends on them."""


def todays_tensors(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Give tensors of an older checkpoint the names of today; others are returned as they are.

    Args:
        tensors: the original's state dict. One that has any tensor of today's attention is not
            older.
    """
    if any(name.startswith("proximity_attn.") for name in tensors):
        return dict(tensors)
    return {_today(name): v for name, v in tensors.items() if not name.startswith(_UNUSED)}


def todays_settings(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Give the sections of an older configuration the names of today.

    The section `models.transformer` is `models.attn` today. A file that has both means the newer.
    """
    models = tree.get("models")
    if not isinstance(models, dict) or "transformer" not in models:
        return dict(tree)
    renamed = dict(cast("dict[str, Any]", models))
    older = renamed.pop("transformer")
    renamed.setdefault("attn", older)
    return {**tree, "models": renamed}


def _today(name: str) -> str:
    start = next((old for old in _OLDER if name.startswith(old)), None)
    return name if start is None else _OLDER[start] + name[len(start) :]

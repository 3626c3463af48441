"""How the interpreter shows what holds many numbers: their shapes, and not the numbers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from torch import Tensor


class Brief:
    """Base of dataclasses (made with `repr=False`) that show shapes in the place of tensors."""

    def __repr__(self) -> str:
        shown: Any = self
        parts = [f"{one.name}={_short(getattr(self, one.name))}" for one in fields(shown)]
        return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, Tensor) and value.ndim:
        return f"[{' x '.join(map(str, value.shape))}]"
    return repr(value.item() if isinstance(value, Tensor) else value)

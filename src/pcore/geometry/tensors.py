"""What dataclasses of tensors have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, Self

import torch
from torch import Tensor


class Tensors:
    """Base of frozen dataclasses whose fields are tensors, and single numbers beside them.

    Made with `repr=False`, one is shown with the shapes of its tensors in the place of numbers.
    """

    def each(self, change: Callable[[Tensor], Tensor]) -> Self:
        """Return the same with every tensor changed but single numbers; rows may be chosen so."""
        made: Any = self
        before = {one.name: getattr(self, one.name) for one in fields(made)}
        tensors = {k: v for k, v in before.items() if isinstance(v, Tensor) and v.ndim}
        after = {name: change(value) for name, value in tensors.items()}
        return self if all(after[k] is v for k, v in tensors.items()) else replace(made, **after)

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> Self:
        """Return the same on a device, in a floating-point type; this very one if it is so."""
        return self.each(lambda tensor: tensor.to(device=device, dtype=dtype))

    def detached(self) -> Self:
        """Return the same, cut off from the autograd graph."""
        return self.each(Tensor.detach)

    def __repr__(self) -> str:
        shown: Any = self
        parts = [f"{one.name}={_short(getattr(self, one.name))}" for one in fields(shown)]
        return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, Tensor) and value.ndim:
        return f"[{' x '.join(map(str, value.shape))}]"
    return repr(value.item() if isinstance(value, Tensor) else value)

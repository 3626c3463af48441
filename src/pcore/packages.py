"""Packages that only some commands need: each comes with an extra of this project."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pcore.errors import DependencyError


def package(module: str, *, extra: str, need: str, named: str = "", instead: str = "") -> Any:
    """Import a package that an extra brings.

    Args:
        module: what is imported: "skimage.measure".
        extra: the extra that brings it, as in `pip install 'pcore-edit[mesh]'`.
        need: what cannot be done without it, the beginning of the message: "writing USD needs".
        named: what it is called where it is installed from, if not as the module.
        instead: what else a user can do: "or write .glb instead".

    Raises:
        DependencyError: it, or a package that it needs, is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        way = f"`pip install 'pcore-edit[{extra}]'`" + (f", {instead}" if instead else "")
        raise DependencyError(
            f"{need} the package {named or module}, which is not installed: {way}"
        ) from error

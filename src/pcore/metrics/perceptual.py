"""LPIPS v0.1 (Zhang et al. 2018): perceptual distance with AlexNet, SqueezeNet-1.1 and VGG-16.

Used twice: as the perceptual part of the training loss and as a metric. The networks are written
with plain layers (`pcore.metrics.trunks`) so that torchvision is not needed.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from pcore.errors import InputError, WeightsError
from pcore.metrics.trunks import TRUNKS, Trunk, TrunkName

# Mean and spread of ImageNet colours, expressed for inputs in [-1, 1].
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_EPSILON = 1e-10


@dataclass(frozen=True, kw_only=True)
class WeightPaths:
    """Files of one trunk: convolutions and linear heads."""

    trunk: Path
    heads: Path


class Lpips(nn.Module):
    """LPIPS v0.1 with frozen weights, differentiable in both images.

    Per tap, features are normalised to unit length over channels, their squared difference is
    weighted per channel by the linear head and averaged over the image; taps are summed.
    Weights are random until `load_lpips` fills them in.
    """

    def __init__(self, trunk: TrunkName) -> None:
        super().__init__()
        self.name: TrunkName = trunk
        self.spec = _trunk(trunk)
        self.features = self.spec.build()
        self.heads = nn.ParameterList([torch.rand(c) for c in self.spec.channels])
        self.register_buffer("shift", torch.tensor(_SHIFT).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("scale", torch.tensor(_SCALE).view(1, 3, 1, 1), persistent=False)
        self.requires_grad_(False)
        self._measure: Callable[[Tensor, Tensor], Tensor] = self._distance

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Distance of two image batches.

        Args:
            first: (B, 3, H, W) in [-1, 1].
            second: the same shape.

        Returns:
            (B,) distances, 0 for identical images.

        Raises:
            InputError: shapes differ, are not (B, 3, H, W) or are too small for the trunk.
        """
        self._check(first, second)
        return self._measure(first, second)

    def compile(self, *arguments: Any, **options: Any) -> None:
        """Compile all but the check of the input, whose errors are for people."""
        self._measure = torch.compile(self._distance, *arguments, **options)

    def _distance(self, first: Tensor, second: Tensor) -> Tensor:
        total = first.new_zeros(first.shape[0], dtype=torch.float32)
        for a, b, head in zip(self._taps(first), self._taps(second), self.heads, strict=True):
            difference = (a - b).square() * head.view(1, -1, 1, 1)
            total = total + difference.sum(dim=1).mean(dim=(1, 2))
        return total

    def _taps(self, images: Tensor) -> list[Tensor]:
        found: list[Tensor] = []
        current = (images - self.get_buffer("shift")) / self.get_buffer("scale")
        for index, layer in enumerate(self.features):
            current = layer(current)
            if index in self.spec.taps:
                found.append(_unit_length(current))
        return found

    def _check(self, first: Tensor, second: Tensor) -> None:
        shape = tuple(first.shape)
        if shape != tuple(second.shape) or len(shape) != 4 or shape[1] != 3:
            raise InputError(
                "LPIPS: expected two image batches of one shape (B, 3, H, W), got "
                f"{shape} and {tuple(second.shape)}"
            )
        if min(shape[2:]) < self.spec.smallest:
            raise InputError(
                f"LPIPS with the {self.spec.title} trunk: expected images of at least "
                f"{self.spec.smallest} x {self.spec.smallest} pixels, got {shape[3]} x {shape[2]}; "
                "use larger patches or leave LPIPS out"
            )


def weight_folders(folder: Path | None = None) -> tuple[Path, ...]:
    """Folders in which weights are looked for, in order; they need not exist.

    The order: `folder`, `$PCORE_LPIPS_DIR`, the user's cache, the torch hub cache.
    """
    chosen = [folder] if folder is not None else []
    if os.environ.get("PCORE_LPIPS_DIR"):
        chosen.append(Path(os.environ["PCORE_LPIPS_DIR"]))
    return (*chosen, _user_folder(), Path(torch.hub.get_dir()) / "checkpoints")


def find_weights(trunk: TrunkName, folder: Path | None = None) -> WeightPaths | None:
    """Files of a trunk and its heads, or None when one of them is missing.

    The two may lie in different folders, so that a trunk in the torch hub cache is used.
    """
    spec, folders = _trunk(trunk), weight_folders(folder)
    layers, heads = _first(spec.files, folders), _first(spec.heads, folders)
    if layers is None or heads is None:
        return None
    return WeightPaths(trunk=layers, heads=heads)


def missing_weights(trunk: TrunkName, folder: Path | None = None) -> str | None:
    """Say what is missing for a trunk, where it was sought and how to get it; None if nothing."""
    spec, folders = _trunk(trunk), weight_folders(folder)
    lacking = [
        f"{kind}: {' or '.join(names)} (from {source})"
        for kind, names, source in (
            ("trunk", spec.files, f"https://download.pytorch.org/models/{spec.files[-1]}"),
            (
                "linear heads",
                spec.heads,
                "https://github.com/richzhang/PerceptualSimilarity, "
                f"lpips/weights/v0.1/{trunk}.pth, saved under this name",
            ),
        )
        if _first(names, folders) is None
    ]
    if not lacking:
        return None
    return (
        f"LPIPS with the {spec.title} trunk: weights are missing. Needed: {'; '.join(lacking)}. "
        f"Looked in: {', '.join(str(path) for path in folders)}. Put the files into "
        f"{_user_folder()} or set PCORE_LPIPS_DIR to their folder; "
        "or choose another trunk or no LPIPS"
    )


def load_lpips(
    trunk: TrunkName = "alex",
    *,
    folder: Path | None = None,
    device: torch.device | str = "cpu",
) -> Lpips:
    """LPIPS with its published weights.

    Args:
        trunk: "alex", "squeeze" or "vgg".
        folder: looked into first; see `weight_folders`.
        device: where the module ends up.

    Raises:
        WeightsError: a file is missing, damaged or holds something else. Nothing in a file is
            ever executed: they are read with `weights_only=True`.
    """
    paths = find_weights(trunk, folder)
    if paths is None:
        raise WeightsError(missing_weights(trunk, folder))
    module = Lpips(trunk)
    _fill(module.features, _read(paths.trunk), "features.{}", paths.trunk)
    _fill(module.heads, _read(paths.heads), "lin{}.model.1.weight", paths.heads)
    return module.to(device).eval()


def _trunk(name: str) -> Trunk:
    for known, spec in TRUNKS.items():
        if known == name:
            return spec
    raise InputError(f"LPIPS: expected a trunk of {', '.join(TRUNKS)}, got {name!r}")


def _user_folder() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "pcore" / "lpips"


def _first(names: tuple[str, ...], folders: tuple[Path, ...]) -> Path | None:
    candidates = (folder / name for folder in folders for name in names)
    return next((path for path in candidates if path.is_file()), None)


def _unit_length(features: Tensor) -> Tensor:
    # In float32 and with a floor under the root: half precision would lose small norms, and the
    # derivative of the root at zero would be NaN wherever all channels are off.
    features = features.float()
    norm = features.square().sum(dim=1, keepdim=True).clamp_min(_EPSILON**2).sqrt()
    return features / (norm + _EPSILON)


def _read(path: Path) -> dict[str, Tensor]:
    try:
        content: object = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # damaged bytes make the reader raise almost anything
        raise WeightsError(
            f"{path}: expected a PyTorch file that holds tensors only, could not read it "
            f"({type(error).__name__}); delete it and fetch it again"
        ) from error
    if not isinstance(content, dict):
        raise WeightsError(
            f"{path}: expected a dictionary of tensors, got {type(content).__name__}; "
            "delete it and fetch it again"
        )
    return {str(k): v for k, v in content.items() if isinstance(v, Tensor)}


def _fill(target: nn.Module, tensors: dict[str, Tensor], pattern: str, path: Path) -> None:
    """Copy named tensors into frozen parameters; keys a classifier adds are left alone."""
    for name, parameter in target.named_parameters():
        key = pattern.format(name)
        value = tensors.get(key)
        # Heads are kept as vectors, the files hold them as 1 x 1 convolutions: singleton axes
        # do not count.
        fits = value is not None and value.squeeze().shape == parameter.squeeze().shape
        if value is None or not fits or not value.isfinite().all():
            found = "nothing" if value is None else f"shape {tuple(value.shape)}"
            raise WeightsError(
                f"{path}: expected finite weights {key!r} of shape {tuple(parameter.shape)}, "
                f"got {found}; is it the file of another network?"
            )
        parameter.data.copy_(value.reshape(parameter.shape))

"""Weights of losses as options, the same for both trainings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pcore.cli.options import Number, optional
from pcore.errors import InputError, WeightsError

if TYPE_CHECKING:
    from pcore.data.scene import View
    from pcore.training.config import FinetuneConfig, PretrainConfig, TrunkName


@dataclass(frozen=True, kw_only=True)
class LossOptions:
    """Weights of the losses beside the squared error; what is not given stays as in the preset."""

    lpips_weight: Number = None
    """Weight of LPIPS (files: `pcore doctor --weights`); 0 for none; default: the preset's."""

    lpips_trunk: Annotated[
        Literal["alex", "squeeze", "vgg"] | None, optional("{alex,squeeze,vgg}")
    ] = None
    """Network of the LPIPS loss; default: vgg."""

    opacity_weight: Number = None
    """Weight of the opacity's error against the images' alpha; default: the preset's."""

    front_weight: Number = None
    """Weight of attention behind a ray's first point: cleaner depth; default: the preset's."""

    def changes(self) -> dict[str, Any]:
        """Return the settings that are given, by the names of the configurations."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def check(self, config: PretrainConfig | FinetuneConfig, views: Iterable[View]) -> None:
        """Refuse options without effect: opacity of photos without alpha, a trunk without LPIPS.

        Args:
            config: the settings with the changes in them.
            views: training views.
        """
        if self.lpips_trunk is not None and config.lpips_weight == 0:
            raise InputError(
                f"--lpips-trunk {self.lpips_trunk}: expected an LPIPS loss, got the weight 0; give "
                "a positive --lpips-weight, or leave the option out"
            )
        if self.opacity_weight and not all(view.has_alpha for view in views):
            raise InputError(
                f"--opacity-weight {self.opacity_weight:g}: expected images with an alpha channel "
                "to compare the opacity with, got photos without one; leave the option out"
            )


def check_weights(weight: float, trunk: TrunkName) -> None:
    """Raise WeightsError, naming files and places, when a wanted LPIPS loss cannot be computed."""
    from pcore.metrics.perceptual import missing_weights

    advice = missing_weights(trunk) if weight > 0 else None
    if advice is not None:
        raise WeightsError(advice)

"""`pcore` whose preset `tiny` takes milliseconds and saves all the time; run it as a program."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pcore.cli.main import main
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig
from pcore.training import presets
from pcore.training.config import GrowConfig, PatchConfig, PruneConfig

MODEL = PaprConfig(
    neighbours=4,
    octaves=Octaves.all(2),
    feature_size=4,
    key=MlpConfig(layers=2, width=8, size=8),
    query=MlpConfig(layers=2, width=8, size=8),
    value=MlpConfig(layers=2, width=8, size=4),
    unet_channels=(4, 6, 8),
)


def small_presets() -> dict[str, Callable[[str], Any]]:
    """What takes the place of functions in `pcore.training.presets`.

    Pre-training has everything that a state must remember: random draws, points that come and go.
    """
    training = replace(
        presets.TINY,
        model=MODEL,
        patch=PatchConfig(side=12),
        background="random",
        prune=PruneConfig(every=15, first=15, last=120, threshold=0.98),
        grow=GrowConfig(every=10, first=10, last=100, count=15, limit=150),
        validate_every=50,
        save_every=6,
    )
    tuning = replace(
        presets.finetune_preset("tiny"),
        patch=PatchConfig(side=12),
        validate_every=40,
        save_every=4,
    )
    return {"preset": lambda name: training, "finetune_preset": lambda name: tuning}


if __name__ == "__main__":
    for name, function in small_presets().items():
        setattr(presets, name, function)
    sys.exit(main(sys.argv[1:]))

"""Scenes of the paper's models, by `pcore benchmark make`, of files that the user brings.

    python -m benchmarks.paper_models FOLDER DATA [--dry-run] [-- OPTIONS]

FOLDER holds NAME.glb for the names of paper_models.yaml (six of Objaverse, two realistic motions);
what is not there is left out, with what to bring. Scenes go to DATA/objaverse and DATA/realistic,
where `python -m benchmarks.paper` finds them. OPTIONS are those of `pcore benchmark make` and win
over the recipe: `--size 200 --test-views 20` for a small machine.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from benchmarks.commands import run_pcore
from pcore.benchmark.model import read_model
from pcore.errors import PcoreError

RECIPE = Path(__file__).with_name("paper_models.yaml")


def words_of(name: str, recipe: dict[str, Any], model: Path, data: Path) -> list[str]:
    """Words of `pcore benchmark make` for one model.

    Raises:
        PcoreError: the file cannot be read, or has other clips than the recipe says.
    """
    one = recipe["models"][name]
    clips = read_model(model).clips
    if len(clips) != 1 and one["clip"] == "only":
        known = ", ".join(clip.name for clip in clips) or "none"
        raise PcoreError(f"{model}: expected one clip, got {known}; name one in {RECIPE.name}")
    clip = next((c for c in clips if one["clip"] in ("only", c.name)), None)
    if clip is None:
        raise PcoreError(f"{model}: expected the clip {one['clip']}, got others")
    first, last = clip.span
    shares = (one["canonical"], *one["states"])
    canonical, *times = [f"{clip.name}@{first + (last - first) * share:g}" for share in shares]
    words = ["benchmark", "make", str(model), "-o", str(data / one["set"] / name)]
    words += ["--no-analytic", "--canonical", canonical]
    words += ["--clips", *times, "--state-train-views", str(one["state_train_views"])]
    sizes = {key: recipe[key] for key in ("size", "train_views", "test_views")}
    return words + [w for k, v in sizes.items() for w in (f"--{k.replace('_', '-')}", str(v))]


def main(words: Sequence[str] | None = None) -> int:
    """Make what can be made."""
    own = [*(sys.argv[1:] if words is None else words)]
    options = own[own.index("--") + 1 :] if "--" in own else []
    own = own[: own.index("--")] if "--" in own else own
    dry = "--dry-run" in own
    folders = [Path(word) for word in own if not word.startswith("-")]
    if len(folders) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    recipe = yaml.safe_load(RECIPE.read_text(encoding="utf-8"))
    failed = 0
    for name, one in recipe["models"].items():
        model, place = folders[0] / f"{name}.glb", folders[1] / one["set"] / name
        if not model.is_file():
            print(f"left out: {name}: no {model}; bring {one['bring']}")
            continue
        if (place / "meshes.npz").is_file():
            print(f"done: {place}")
            continue
        try:
            made = [*words_of(name, recipe, model, folders[1]), *options]
        except PcoreError as error:
            print(f"left out: {name}: {error}")
            failed += 1
            continue
        failed += run_pcore(*made, dry=dry) != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

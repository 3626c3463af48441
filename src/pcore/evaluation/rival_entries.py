"""What a comparison trains itself: Gaussians, Gaussians on a mesh, voxels, neural points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import torch
from torch import Tensor

from pcore.asset.asset import WHITE, Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.training import RunOptions, train
from pcore.data.scene import Scene
from pcore.evaluation.contest import Contestant, Cost, Entry, Setting
from pcore.evaluation.contestants import (
    FLAT,
    RULES,
    MethodName,
    point_entries,
    rule_entries,
)
from pcore.evaluation.equal_time import MOST, as_begun, with_seconds
from pcore.evaluation.gaussian_method import GaussianMethod
from pcore.evaluation.voxel_method import VoxelMethod
from pcore.files.run_record import begun, finished
from pcore.gaussians.gaussians import Gaussians
from pcore.rivals.bound_fit import fit_bound, sized_mesh
from pcore.rivals.cage_mesh import coarse_cage
from pcore.rivals.kept import Spent, kept_bound, kept_cost, kept_mesh, kept_voxels
from pcore.rivals.mesh_bound import PER_TRIANGLE
from pcore.rivals.voxel_fit import VoxelConfig, fit_voxels
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.pretrain import pretrain

BOUND = "mesh-bound 3DGS (ours), Mani-GS's binding"
VOXELS = "cage-warped voxel radiance field (ours), Deforming-NeRF's rule"
_TRIANGLES = 4000
"""Of the mesh for as long as asked for; three Gaussians each."""

Mesh = tuple[Tensor, Tensor, Tensor, Tensor]
"""Vertices and faces of a mesh of the object, and of its cage."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Workshop:
    """Where and how rivals are trained.

    Attributes:
        folder: for what was trained.
        scene: whose training views they see.
        config: of our Gaussians, from a preset.
        points: of neural points, which are trained for equal time only: given ones are what equal
            primitives are equal to.
        primitives: how many they have with equal primitives.
        seconds: of the processor for each with equal time.
        voxels: of voxel fields, whose steps end with their time.
        device: where.
        note: told what begins.
    """

    folder: Path
    scene: Scene
    config: GaussianConfig
    points: PretrainConfig
    primitives: int
    seconds: float
    voxels: VoxelConfig = field(default_factory=lambda: VoxelConfig(steps=MOST))
    device: str = "cpu"
    note: Callable[[str], None] = field(default=lambda text: None)

    def entries(
        self, wanted: Sequence[MethodName], settings: Sequence[Setting], seeds: Sequence[int]
    ) -> list[Entry]:
        """Entries of all rivals that are wanted; nothing is trained yet."""
        found: list[Entry] = []
        for setting in settings:
            for seed in seeds:
                found += self._of(wanted, setting, seed)
        return found

    def _of(self, wanted: Sequence[MethodName], setting: Setting, seed: int) -> list[Entry]:
        asked = self.primitives if setting == "primitives" else self.seconds
        stamp = [setting, seed, asked, self.config.steps]
        entry = partial(Entry, setting=setting, seed=seed, stamp=stamp, learns=True)
        found: list[Entry] = []
        if setting == "time" and "papr-time" in wanted:
            make = cache(partial(self.neural_points, seed))
            of = [stamp, self.points.steps]
            found += point_entries(setting, seed, of, make, self.scene)
        for flat in (False, True):
            names: list[MethodName] = [
                name for name in wanted if name in RULES and (name in FLAT) == flat
            ]
            make = cache(partial(self.gaussians, setting, seed, flat=flat))
            found += rule_entries(setting, seed, stamp, names, make, self.scene)
        if "mani-gs" in wanted:
            make = cache(lambda: self._bound(setting, seed))
            found.append(entry(name=BOUND, make=make))
        if "voxels" in wanted and setting == "time":
            make = cache(lambda: self._voxels(seed))
            found.append(entry(name=VOXELS, make=make))
        return found

    def gaussians(
        self, setting: Setting, seed: int, *, share: float = 1.0, flat: bool = False
    ) -> tuple[Asset, Spent | None]:
        """Train free Gaussians, or read them; in a part of the time where that is what counts.

        Raises:
            PcoreError: as `pcore.train`.
        """
        part = "" if share == 1.0 else "-stage-1"
        kind = "flat-gaussians" if flat else "gaussians"
        run = self.folder / f"{kind}-{self._tag(setting, seed)}{part}"
        if not finished(run):
            self.note(f"{'flat ' * flat}Gaussians, {setting}, seed {seed}{part}")
        config = self._config(setting, seed, share, run, flat=flat)
        return self._trained(config, run, light=share == 1.0)

    def neural_points(self, seed: int) -> tuple[Asset, Spent | None]:
        """Train PAPR for equal time, or read it.

        Raises:
            PcoreError: as `pcore.train`.
        """
        run = self.folder / f"points-{self._tag('time', seed)}"
        if not finished(run):
            self.note(f"PAPR, time, seed {seed}")
        config = replace(self.points, seed=seed)
        if begun(run):
            config = as_begun(config, run, "pretrain")
        else:
            fit = partial(pretrain, self.scene, device=self.device)
            config = with_seconds(config, self.seconds, fit)
        return self._trained(config, run, light=True)

    def _tag(self, setting: Setting, seed: int) -> str:
        asked = self.primitives if setting == "primitives" else self.seconds
        return f"{setting}-{asked:g}-{seed}"

    def mesh(self, setting: Setting, seed: int) -> tuple[Mesh, list[Spent | None]]:
        """A mesh of the object and its cage, from depth of Gaussians of ours, and what both took.

        Raises:
            InputError: there is no surface.
            DependencyError: scikit-image is not installed.
        """
        path = self.folder / f"mesh-{self._tag(setting, seed)}.safetensors"
        triangles = max(40, self.primitives // PER_TRIANGLE)
        triangles = triangles if setting == "primitives" else _TRIANGLES
        asset, first = self.gaussians(setting, seed, share=1.0 if setting != "time" else 0.5)

        def make() -> Mesh:
            with torch.no_grad():
                fused, *mesh = sized_mesh(
                    partial(asset.render, None), self.scene, asset.points, triangles
                )
            return mesh[0], mesh[1], *coarse_cage(fused)

        found, spent = kept_cost(path.with_suffix(".json"), partial(kept_mesh, path, make))
        return found, [first, spent]

    def _bound(self, setting: Setting, seed: int) -> Contestant:
        (vertices, faces, *_), first = self.mesh(setting, seed)
        path = self.folder / f"bound-{self._tag(setting, seed)}.safetensors"
        if not path.is_file():
            self.note(f"Gaussians on a mesh of {len(faces):,} triangles, {setting}, seed {seed}")
        config = replace(self.config, seed=seed)
        if setting == "time" and not path.is_file():
            fit = partial(fit_bound, self.scene, vertices, faces)
            config = with_seconds(config, self.seconds / 2, fit)
        make = partial(fit_bound, self.scene, vertices, faces, config)
        bound, spent = kept_cost(path.with_suffix(".json"), partial(kept_bound, path, make))
        content = GaussianContent(
            gaussians=bound.gaussians, footprint=bound.footprint, background=WHITE
        )
        method = GaussianMethod(
            name=BOUND,
            content=content,
            rule=lambda state: bound.carried(state.move(bound.vertices.double())),
        )
        return Contestant(method=method, cost=_cost(bound.gaussians, [*first, spent]))

    def _voxels(self, seed: int) -> Contestant:
        (_, _, *cage), first = self.mesh("time", seed)
        path = self.folder / f"voxels-{self._tag('time', seed)}.safetensors"
        if not path.is_file():
            self.note(f"voxels, seed {seed}")
        config = replace(self.voxels, seed=seed)
        make = partial(fit_voxels, self.scene, config, seconds=self.seconds)
        field_, spent = kept_cost(path.with_suffix(".json"), partial(kept_voxels, path, make))
        method = VoxelMethod(name=VOXELS, field=field_, cage=(cage[0], cage[1]))
        # The cage is made of the mesh; the field itself needs no Gaussians.
        both = [one for one in (first[1], spent) if one is not None]
        return Contestant(
            method=method,
            cost=Cost(
                seconds=sum(one.seconds for one in both),
                primitives=field_.grid.rows,
                parameters=field_.grid.rows * field_.values.shape[1],
                megabytes=max((one.megabytes or 0.0 for one in both), default=None),
            ),
        )

    def _config(
        self, setting: Setting, seed: int, share: float, run: Path, *, flat: bool
    ) -> GaussianConfig:
        footprint = replace(self.config.footprint, flat=flat)
        config = replace(self.config, seed=seed, footprint=footprint)
        if setting == "primitives":
            start = min(config.points, max(2, round(0.6 * self.primitives)))
            limit = replace(config.density, limit=self.primitives)
            return replace(config, points=start, density=limit)
        if begun(run):
            return as_begun(config, run, "gaussians")
        # Paid for at the end, so that growing is not counted as free.
        full = replace(config, points=config.density.limit)
        found = with_seconds(full, share * self.seconds, partial(fit_gaussians, self.scene))
        return replace(found, points=config.points)

    def _trained(
        self, config: GaussianConfig | PretrainConfig, run: Path, *, light: bool
    ) -> tuple[Asset, Spent | None]:
        learn = partial(
            train,
            self.scene,
            config,
            folder=run,
            device=self.device,
            options=RunOptions(resume=begun(run), light=light),
        )
        asset, spent = kept_cost(run.with_suffix(".json"), learn)
        return asset.over(WHITE), spent


def _cost(gaussians: Gaussians, spent: Sequence[Spent | None]) -> Cost:
    known = [one for one in spent if one is not None]
    numbers = [11, 3 * (gaussians.degree + 1) ** 2]
    return Cost(
        seconds=sum(one.seconds for one in known) if len(known) == len(spent) else None,
        primitives=len(gaussians),
        parameters=len(gaussians) * sum(numbers),
        megabytes=max((one.megabytes for one in known if one.megabytes is not None), default=None),
    )

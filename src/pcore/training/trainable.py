"""The working state of a training loop: networks, points, optimiser, draws."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor, nn

from pcore.contrib.learned_skinning import Skinning
from pcore.data.scene import View
from pcore.errors import CheckpointError
from pcore.files.provenance import provenance_of
from pcore.files.run_folder import RunFolder
from pcore.files.training_state import TrainingState, generator_states, restore_generators
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.render.surfel_fit import Observed, observe
from pcore.training.config import Background, Rates
from pcore.training.events import Listener, SurfaceReport
from pcore.training.held_out import validate
from pcore.training.near_origin import moved_trained
from pcore.training.schedule import Schedule
from pcore.training.trained import Trained

_CLOUD = ("positions", "features", "influence")
_ADAM_GUARD = 1e-8
"""Adam's usual one."""


@dataclass(kw_only=True)
class Trainable:
    """What a loop changes from step to step.

    Attributes:
        stage: "pretrain" or "finetune".
        papr: the networks.
        cloud: the points; its tensors are parameters.
        optimizer: Adam with one group per entry of `Rates`, and "skinning" where there is one.
        generator: source of every random draw of the loop.
        skinning: trained along with the renderer; None where nothing is.
        step: steps done.
        best: figures of the best validation, and its weights where they are kept.
        observed: what training views say about the points of the result, when it is complete.
        fits_exposure: whether figures are also given under a fitted map of colours.
        origin: (3,) float64 what the points' coordinates, and the views', count from, world units;
            None: they are the world's.
    """

    stage: str
    papr: Papr
    cloud: PointCloud
    optimizer: torch.optim.Optimizer
    generator: torch.Generator
    skinning: Skinning | None = None
    step: int = 0
    best: dict[str, Any] = field(default_factory=dict[str, Any])
    observed: Observed | None = None
    fits_exposure: bool = False
    origin: Tensor | None = None

    @property
    def points(self) -> int:
        """How many points there are."""
        return len(self.cloud)

    def weights(self) -> dict[str, Tensor]:
        """All weights by name, sharing memory with the training."""
        cloud = {f"cloud.{name}": getattr(self.cloud, name).detach() for name in _CLOUD}
        networks = {f"papr.{name}": t.detach() for name, t in self.papr.state_dict().items()}
        skinning = {f"skinning.{name}": t for name, t in self._skinning_state().items()}
        return {**cloud, **networks, **skinning}

    def _skinning_state(self) -> dict[str, Tensor]:
        if self.skinning is None:
            return {}
        return {name: t.detach() for name, t in self.skinning.network.state_dict().items()}

    def set_rates(self, rates: Mapping[str, Schedule], steps: float) -> None:
        """Set the learning rate of every group, by its name, for the coming step."""
        for group in self.optimizer.param_groups:
            group["lr"] = rates[group["name"]].at(self.step, steps)
        # The points' rate is in scaled units, the points themselves are in world units.
        config = self.papr.config
        self.optimizer.param_groups[0]["lr"] *= config.unit / config.coord_scale

    def result(self, weights: Mapping[str, Tensor] | None = None) -> Trained:
        """Networks and points to hand over, in the world: of `weights`, or as they are."""
        found = self._near(weights)
        if self.origin is not None:
            found = moved_trained(found, self.origin)
        if self.observed is None:
            return found
        return replace(found, surfels=self.observed.surfels(found.cloud), observed=self.observed)

    def _near(self, weights: Mapping[str, Tensor] | None) -> Trained:
        """Networks and points in the coordinates of the training."""
        return rebuild(self.papr, weights or self.weights(), self.step, skinning=self.skinning)

    def complete(self, views: Sequence[View], listener: Listener) -> None:
        """See, when all steps are done, what training views say of the points of the result."""
        listener(SurfaceReport(stage=self.stage, step=self.step, views=len(views)))
        found = self._near(self.best.get("weights"))
        self.observed = observe(found.papr, found.cloud, views)

    def scores(
        self,
        views: Sequence[View],
        background: Background,
        weights: Mapping[str, Tensor] | None = None,
    ) -> dict[str, float]:
        """Figures on held-out training views, see `held_out.validate`."""
        return validate(self._near(weights), views, background, fitted=self.fits_exposure)

    def save(self, folder: RunFolder, scene: str) -> list[str]:
        """Write the weights that validation accepted last, where those are kept, else the last."""
        result = self.result(self.best.get("weights"))
        config = result.papr.config
        provenance = provenance_of(
            result.cloud.positions,
            config.background,
            scene=scene,
            stage="pretrain" if self.stage == "pretrain" else "finetune",
            step=self.best.get("kept_step", self.step),
        )
        state = result.papr.state_dict()
        folder.save_model(state, result.cloud, config, provenance, result.surfels)
        if result.skinning is None:
            return [str(folder.model)]
        folder.save_skinning(result.skinning)
        return [str(folder.model), str(folder.skinning)]

    def state(self) -> TrainingState:
        """What `restore` needs to go on exactly."""
        return TrainingState(
            stage=self.stage,
            step=self.step,
            papr={name: t.detach() for name, t in self.papr.state_dict().items()},
            cloud={name: getattr(self.cloud, name).detach() for name in _CLOUD},
            optimisers={"adam": self.optimizer.state_dict()},
            generators=generator_states({"draws": self.generator}),
            best=self.best,
            skinning=self._skinning_state(),
        )

    def restore(self, state: TrainingState) -> None:
        """Put this into a saved state, exactly.

        Raises:
            CheckpointError: the state belongs to another stage or another architecture.
        """
        _restore(self, state)


def trainable(
    stage: str,
    papr: Papr,
    cloud: PointCloud,
    *,
    seed: int,
    train_points: bool = True,
    skinning: Skinning | None = None,
) -> Trainable:
    """Return networks and a cloud made ready to train, with Adam."""
    device = cloud.positions.device
    tensors = {name: nn.Parameter(getattr(cloud, name).detach().clone()) for name in _CLOUD}
    tensors["positions"].requires_grad_(train_points)
    papr.requires_grad_(True)
    parameters = [
        [tensors["positions"]],
        list(papr.attention.parameters()),
        [tensors["features"]],
        [tensors["influence"]],
        list(papr.unet.parameters()),
    ]
    groups: list[dict[str, Any]] = [
        {"params": group, "name": name}
        for name, group in zip(Rates.__dataclass_fields__, parameters, strict=True)
    ]
    # Gradients of the points are per world unit, and so must be what keeps Adam's steps finite.
    groups[0]["eps"] = _ADAM_GUARD / papr.config.unit
    if skinning is not None:
        network = skinning.network.requires_grad_(True)
        groups.append({"params": list(network.parameters()), "name": "skinning"})
    return Trainable(
        stage=stage,
        papr=papr,
        cloud=PointCloud.from_tensors(tensors),
        optimizer=torch.optim.Adam(groups, fused=device.type in ("cpu", "cuda")),
        generator=torch.Generator().manual_seed(seed),
        skinning=skinning,
    )


def _restore(work: Trainable, state: TrainingState) -> None:
    if state.stage != work.stage:
        raise CheckpointError(
            f"training state: expected one of stage {work.stage!r}, got {state.stage!r}; "
            "resume it with the command that made it"
        )
    device = work.cloud.positions.device
    _restore_networks(work, state)
    old = work.cloud
    tensors = {name: nn.Parameter(state.cloud[name].to(device)) for name in _CLOUD}
    tensors["positions"].requires_grad_(old.positions.requires_grad)
    work.cloud = PointCloud.from_tensors(tensors)
    swaps = {id(getattr(old, name)): tensors[name] for name in _CLOUD}
    for group in work.optimizer.param_groups:
        group["params"] = [swaps.get(id(p), p) for p in group["params"]]
    work.optimizer.load_state_dict(state.optimisers["adam"])
    restore_generators({"draws": work.generator}, state.generators)
    work.step = state.step
    work.best = dict(state.best)
    if "weights" in work.best:
        kept = work.best["weights"]
        work.best["weights"] = {name: tensor.to(device) for name, tensor in kept.items()}


def _restore_networks(work: Trainable, state: TrainingState) -> None:
    """Load the weights of all networks, which must be those of the state."""
    if (work.skinning is None) != (not state.skinning):
        with_it, without = ("with", "without") if state.skinning else ("without", "with")
        raise CheckpointError(
            f"training state: it was made {with_it} skinning, got a training {without} it; resume "
            "with the configuration that it was started with"
        )
    try:
        work.papr.load_state_dict(state.papr)
        if work.skinning is not None:
            work.skinning.network.load_state_dict(state.skinning)
    except RuntimeError as error:
        raise CheckpointError(
            f"training state: its networks have another architecture ({error}); resume with the "
            "configuration that it was started with"
        ) from error


def rebuild(
    like: Papr, weights: Mapping[str, Tensor], step: int, *, skinning: Skinning | None = None
) -> Trained:
    """Return networks like the given ones and a cloud from named weights, without gradients."""
    with torch.random.fork_rng(devices=[]):  # Its initial weights are drawn and overwritten.
        papr = Papr(like.config).to(next(iter(weights.values())).device)
    papr.load_state_dict(_under("papr.", weights))
    cloud = PointCloud.from_tensors(
        {name: weights[f"cloud.{name}"].detach().clone() for name in _CLOUD}
    )
    if skinning is not None:
        network = copy.deepcopy(skinning.network)
        network.load_state_dict(_under("skinning.", weights))
        skinning = replace(skinning, network=network.requires_grad_(False).eval())
    return Trained(
        papr=papr.requires_grad_(False).eval(), cloud=cloud, step=step, skinning=skinning
    )


def _under(prefix: str, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Those weights whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): t for name, t in weights.items() if name.startswith(prefix)}

"""The working state of a training of Gaussians: parameters, optimiser, draws, densities."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor, nn

from pcore.data.images import background_color, composite
from pcore.data.scene import View
from pcore.errors import CheckpointError
from pcore.files.gaussian_file import SavedGaussians, save_gaussians
from pcore.files.provenance import Provenance, Stage, provenance_of
from pcore.files.run_folder import RunFolder, write_guard
from pcore.files.training_state import TrainingState, generator_states, restore_generators
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, render
from pcore.gaussians.wide_pixels import pixel_width
from pcore.geometry.camera import Camera
from pcore.training.config import Background
from pcore.training.held_out import mean_scores
from pcore.training.near_origin import moved_gaussians
from pcore.training.population import replace_rows
from pcore.training.schedule import Schedule

GROUPS = ("means", "scales", "quats", "opacities", "colors", "harmonics")
_ADAM_GUARD = 1e-15
"""Gradients of single Gaussians in a mean over pixels are far below Adam's usual 1e-8."""


@dataclass(frozen=True, kw_only=True)
class TrainedGaussians:
    """What a training of Gaussians hands over.

    Attributes:
        gaussians: at rest, without gradients.
        footprint: how they were trained to meet pixels.
        background: colour that the photos lay on, (3,).
        step: steps of the stage that made them.
        stage: what made them.
    """

    gaussians: Gaussians
    footprint: Footprint
    background: tuple[float, float, float]
    step: int
    stage: Stage = "pretrain"


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """Gaussians that hang on something, such as the triangles of a mesh.

    Attributes:
        start: in the frames of what they hang on.
        place: gives them in the world, with gradients.
    """

    start: Gaussians
    place: Callable[[Gaussians], Gaussians]


@dataclass(kw_only=True)
class TrainableGaussians:
    """What a loop changes from step to step.

    Attributes:
        raw: parameters (N, ...) by group: means, logarithms of scales, quaternions of any length,
            logits of opacities, harmonics of degree 0 and the others.
        optimizer: Adam with one group per entry of `raw`.
        generator: source of the draws.
        distance: of the cameras from the scene's centre, world units.
        footprint: how Gaussians meet pixels.
        backdrop: behind photos with alpha.
        slopes: (N,) sums of the lengths of screen gradients since the number changed last.
        seen: (N,) how many pictures they are of.
        place: gives Gaussians in the world of what the parameters say; None where they are that.
        cameras: of the photos, which tell how wide their pixels are; none leaves that as it is in
            `footprint`.
        stage: "pretrain" or "finetune": in a run folder they stand in the place of PAPR's.
        step: steps done.
        best: figures of the best validation.
        fits_exposure: whether figures are also given under a fitted map of colours.
        origin: (3,) float64 what means and views count from, world units; None: the world's.
    """

    raw: dict[str, nn.Parameter]
    optimizer: torch.optim.Optimizer
    generator: torch.Generator
    distance: float
    footprint: Footprint
    backdrop: Background
    slopes: Tensor
    seen: Tensor
    place: Callable[[Gaussians], Gaussians] | None = None
    cameras: Sequence[Camera] = ()
    stage: str = "pretrain"
    step: int = 0
    best: dict[str, Any] = field(default_factory=dict[str, Any])
    fits_exposure: bool = False
    origin: Tensor | None = None

    @property
    def points(self) -> int:
        """How many Gaussians there are."""
        return len(self.raw["means"])

    def gaussians(
        self, degree: int | None = None, weights: Mapping[str, Tensor] | None = None
    ) -> Gaussians:
        """Gaussians with gradients to the parameters.

        Args:
            degree: of the harmonics that are used; None for all.
            weights: other parameters by name in the place of those that are trained.
        """
        raw = self.raw if weights is None else weights
        more = raw["harmonics"]
        if degree is not None:
            more = more[:, : (degree + 1) ** 2 - 1]
        found = Gaussians(
            means=raw["means"],
            quats=nn.functional.normalize(raw["quats"], dim=-1),
            scales=raw["scales"].exp(),
            opacities=raw["opacities"].sigmoid(),
            sh=torch.cat([raw["colors"], more], dim=1) if more.shape[1] else raw["colors"],
        )
        return found if self.place is None else self.place(found)

    def weights(self) -> dict[str, Tensor]:
        """All parameters by name, sharing memory with the training."""
        return {name: parameter.detach() for name, parameter in self.raw.items()}

    def set_rates(self, rates: Mapping[str, Schedule], steps: float) -> None:
        """Set the learning rate of every group, by its name, for the coming step."""
        for group in self.optimizer.param_groups:
            group["lr"] = rates[group["name"]].at(self.step, steps)
            if group["name"] == "means":
                group["lr"] *= self.distance

    def replace(self, keep: Tensor, new: Mapping[str, Tensor]) -> None:
        """Keep some Gaussians and append others; what was summed about all of them begins anew."""
        for name in GROUPS:
            self.raw[name] = replace_rows(self.optimizer, self.raw[name], keep, new[name])
        self.slopes, self.seen = torch.zeros(2, self.points, device=keep.device).unbind()

    def result(self, weights: Mapping[str, Tensor] | None = None) -> TrainedGaussians:
        """Gaussians to hand over, in the world."""
        with torch.no_grad():
            gaussians = self.gaussians(weights=weights).each(lambda tensor: tensor.detach().clone())
        footprint = self.footprint
        if self.cameras:
            widest = max(pixel_width(gaussians, camera) for camera in self.cameras)
            footprint = replace(footprint, pixel=widest)
        if self.origin is not None:
            gaussians = moved_gaussians(gaussians, self.origin)
        color = background_color("black" if self.backdrop == "black" else "white").tolist()
        return TrainedGaussians(
            gaussians=gaussians,
            footprint=footprint,
            background=(color[0], color[1], color[2]),
            step=self.step,
            stage="pretrain" if self.stage == "pretrain" else "finetune",
        )

    @torch.no_grad()
    def scores(
        self,
        views: Sequence[View],
        background: Background,
        weights: Mapping[str, Tensor] | None = None,
    ) -> dict[str, float]:
        """Figures on held-out training views, see `held_out.mean_scores`."""
        device = self.raw["means"].device
        posed = PosedGaussians(gaussians=self.gaussians(weights=weights))
        color = background_color("white" if background == "random" else background)

        def draw(view: View) -> Tensor:
            found = render(
                posed, [view.camera], footprint=self.footprint, background=color.to(device)
            )
            return found.rgb[0].cpu()

        return mean_scores(views, color, draw, fitted=self.fits_exposure)

    def save(self, folder: RunFolder, scene: str) -> list[str]:
        """Write what users load; return the paths."""
        found = self.result(self.best.get("weights"))
        saved = SavedGaussians(
            gaussians=found.gaussians,
            footprint=found.footprint,
            provenance=provenance_of_gaussians(found, scene),
        )
        with write_guard(folder.gaussians):
            save_gaussians(folder.gaussians, saved)
        return [str(folder.gaussians)]

    def state(self) -> TrainingState:
        """What `restore` needs to go on exactly."""
        return TrainingState(
            stage=self.stage,
            step=self.step,
            papr={},
            cloud=self.weights(),
            optimisers={
                "adam": self.optimizer.state_dict(),
                "density": {"slopes": self.slopes, "seen": self.seen},
            },
            generators=generator_states({"draws": self.generator}),
            best=self.best,
        )

    def restore(self, state: TrainingState) -> None:
        """Put this into a saved state, exactly.

        Raises:
            CheckpointError: the state is none of Gaussians.
        """
        if {*state.cloud} != {*GROUPS} or state.stage != self.stage:
            raise CheckpointError(
                "training state: expected one of Gaussians, got one of another kind of object; "
                "resume it with the command that made it"
            )
        device = self.raw["means"].device
        for group in self.optimizer.param_groups:
            self.raw[group["name"]] = nn.Parameter(state.cloud[group["name"]].to(device))
            group["params"] = [self.raw[group["name"]]]
        self.optimizer.load_state_dict(state.optimisers["adam"])
        restore_generators({"draws": self.generator}, state.generators)
        density = state.optimisers["density"]
        self.slopes, self.seen = (density[name].to(device) for name in ("slopes", "seen"))
        self.step, self.best = state.step, dict(state.best)


def trainable_gaussians(
    start: Gaussians,
    *,
    distance: float,
    footprint: Footprint,
    backdrop: Background,
    seed: int,
    place: Callable[[Gaussians], Gaussians] | None = None,
    cameras: Sequence[Camera] = (),
    stage: Stage = "pretrain",
    fits_exposure: bool = False,
    origin: Tensor | None = None,
) -> TrainableGaussians:
    """Return Gaussians made ready to train, with Adam, on the device where they are."""
    rows = {
        "means": start.means,
        "scales": start.scales.log(),
        "quats": start.quats,
        "opacities": start.opacities.logit(),
        "colors": start.sh[:, :1],
        "harmonics": start.sh[:, 1:],
    }
    raw = {name: nn.Parameter(tensor.detach().clone()) for name, tensor in rows.items()}
    device = start.means.device
    groups = [{"params": [raw[name]], "name": name} for name in GROUPS]
    slopes, seen = torch.zeros(2, len(start), device=device).unbind()
    return TrainableGaussians(
        raw=raw,
        optimizer=torch.optim.Adam(groups, eps=_ADAM_GUARD, fused=device.type in ("cpu", "cuda")),
        generator=torch.Generator().manual_seed(seed),
        distance=distance,
        footprint=footprint,
        backdrop=backdrop,
        slopes=slopes,
        seen=seen,
        place=place,
        cameras=cameras,
        stage=stage,
        fits_exposure=fits_exposure,
        origin=origin,
    )


def provenance_of_gaussians(found: TrainedGaussians, scene: str) -> Provenance:
    """Describe where trained Gaussians come from, as this version of pcore."""
    return provenance_of(
        found.gaussians.means, found.background, scene=scene, stage=found.stage, step=found.step
    )


def photo_on(view: View, color: Tensor, device: torch.device) -> Tensor:
    """(1, H, W, 3) the photo over a background colour (3,)."""
    return composite(view.rgba(), color).to(device).unsqueeze(0)


def valid_only(rgb: Tensor, photo: Tensor, valid: Tensor | None) -> Tensor:
    """(1, H, W, 3) a rendering, with the photo where that shows nothing: there nothing is wrong."""
    return rgb if valid is None else torch.where(valid.to(rgb.device)[..., None], rgb, photo)

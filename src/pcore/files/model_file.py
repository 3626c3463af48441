"""The model file `model.safetensors`: weights, points and all that is needed to use them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.files.headers import Companion
from pcore.files.provenance import Provenance, pcore_version
from pcore.files.records import from_dict, to_dict
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.model.papr_config import PaprConfig

_FILE = Companion(
    noun="model",
    version="6",
    mend="go back to an earlier checkpoint, or train again with lower learning rates",
)
MODEL_FILE = _FILE.name
_CLOUD = ("positions", "features", "influence")
_SURFELS = ("normals", "heights")


@dataclass(frozen=True, kw_only=True)
class SavedModel:
    """What a model file holds; tensors on the CPU.

    Attributes:
        config: architecture.
        papr_state: state dict of `Papr(config)`.
        cloud: the canonical points.
        provenance: where they come from.
        surfels: the surface over the points; None where nobody has estimated it.
    """

    config: PaprConfig
    papr_state: dict[str, Tensor]
    cloud: PointCloud
    provenance: Provenance
    surfels: Surfels | None = None

    def papr(self) -> Papr:
        """Build the networks with these weights, in evaluation mode and without gradients."""
        return networks(self.config, self.papr_state)


@dataclass(frozen=True, kw_only=True)
class ModelSummary:
    """What the header of a model file says, read without its tensors."""

    config: PaprConfig
    provenance: Provenance
    points: int
    parameters: int
    """Numbers in all tensors, the cloud's included."""
    surfels: bool
    """Whether the surface over the points is known."""


def networks(config: PaprConfig, state: Mapping[str, Tensor]) -> Papr:
    """Build networks with these weights, in evaluation mode and without gradients.

    Args:
        config: their architecture.
        state: state dict of `Papr(config)`.
    """
    with torch.random.fork_rng(devices=[]):  # Their initial weights are drawn and overwritten.
        papr = Papr(config)
    papr.load_state_dict(state)
    return papr.requires_grad_(False).eval()


def save_model(
    path: Path,
    papr_state: Mapping[str, Tensor],
    cloud: PointCloud,
    config: PaprConfig,
    provenance: Provenance,
    surfels: Surfels | None = None,
) -> None:
    """Write a model file; a crash at any moment leaves the old file or the new one.

    Args:
        path: where to, normally RUN/model.safetensors.
        papr_state: state dict of `Papr(config)`.
        cloud: the canonical points, world units.
        config: architecture of the networks.
        provenance: where the weights come from.
        surfels: the surface over the points at rest; None where it is not known.

    Raises:
        CheckpointError: a tensor is missing, misshaped or not finite; nothing is written, so that
            a model gone wrong never replaces a good one.
        OSError: the file cannot be written; the old one is untouched.
    """
    tensors = {f"papr.{name}": value for name, value in papr_state.items()}
    tensors |= {f"cloud.{name}": getattr(cloud, name).detach() for name in _CLOUD}
    if surfels is not None:
        tensors |= {f"surfels.{name}": getattr(surfels, name) for name in _SURFELS}
    _check_tensors(path, {name: _form(value) for name, value in tensors.items()}, config)
    _FILE.check_finite(path, tensors)
    _FILE.write(
        path,
        tensors,
        config=json.dumps(to_dict(config)),
        provenance=json.dumps(to_dict(provenance)),
    )


def load_model(path: Path | str) -> SavedModel:
    """Read a model file.

    Args:
        path: a model file or the run folder that holds one.

    Raises:
        CheckpointError: the file is missing, damaged, not ours, of another version, or its tensors
            are not those of its own configuration.
    """
    path = _model_path(path)
    config, provenance, _ = _read_header(path)
    with _open(path) as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    _FILE.check_finite(path, tensors)
    cloud = PointCloud.from_tensors({name: tensors[f"cloud.{name}"] for name in _CLOUD})
    return SavedModel(
        config=config,
        papr_state={
            name.removeprefix("papr."): value
            for name, value in tensors.items()
            if name.startswith("papr.")
        },
        cloud=cloud,
        provenance=provenance,
        surfels=_surfels(path, cloud, tensors),
    )


def describe_model(path: Path | str) -> ModelSummary:
    """Read what a model file (or its run folder) says about itself, fast.

    Raises:
        CheckpointError: as `load_model`, but values of tensors are not looked at.
    """
    config, provenance, forms = _read_header(_model_path(path))
    return ModelSummary(
        config=config,
        provenance=provenance,
        points=forms["cloud.positions"][0][0],
        parameters=sum(torch.Size(shape).numel() for shape, _ in forms.values()),
        surfels="surfels.normals" in forms,
    )


def _surfels(path: Path, cloud: PointCloud, tensors: Mapping[str, Tensor]) -> Surfels | None:
    """The surface over the points, if the file knows it."""
    if "surfels.normals" not in tensors:
        return None
    normals, heights = (tensors[f"surfels.{name}"] for name in _SURFELS)
    try:
        return Surfels.at_rest(cloud.positions, normals, heights)
    except InputError as error:
        raise CheckpointError(
            f"{path}: {error}; the file was edited, save the model again"
        ) from error


_Form = tuple[tuple[int, ...], str]


def _form(tensor: Tensor) -> _Form:
    return tuple(tensor.shape), _DTYPES.get(tensor.dtype, str(tensor.dtype))


_DTYPES = {torch.float32: "F32", torch.float64: "F64", torch.float16: "F16", torch.int64: "I64"}


def _model_path(given: Path | str) -> Path:
    path = _FILE.path(given)
    if not path.is_file():
        raise CheckpointError(
            f"no model at {path}: expected a {MODEL_FILE} written by `pcore train`, `pcore "
            "finetune` or `pcore import papr`; check the path, or let the training reach its "
            "first checkpoint"
        )
    return path


def _open(path: Path) -> Any:
    """Open a safetensors file; the library checks that its size is what the header says."""
    with path.open("rb") as file:
        start = file.read(9)
    # A safetensors file begins with the length of its header, whose bytes may look like anything.
    if start.startswith((b"PK\x03\x04", b"\x80")) and not start.endswith(b"{"):
        raise CheckpointError(
            f"{path} is a pickle file of PyTorch, not a model of pcore: expected a safetensors "
            "file; it was not executed. A checkpoint of the original PAPR comes in with "
            "`pcore import papr FILE --config FILE.yml -o RUN`"
        )
    try:
        return safe_open(path, framework="pt")
    except SafetensorError as error:
        raise CheckpointError(
            f"{path} is truncated, damaged or not a safetensors file: expected a "
            f"{MODEL_FILE} written by pcore; copy it again or save it anew with `--resume`"
        ) from error


def _read_header(path: Path) -> tuple[PaprConfig, Provenance, dict[str, _Form]]:
    """Return what the header says, after checking that it is ours and consistent."""
    with _open(path) as file:
        header: dict[str, str] = file.metadata() or {}
        slices = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118
        forms: dict[str, _Form] = {
            name: (tuple(part.get_shape()), part.get_dtype()) for name, part in slices.items()
        }
    if header.get("format") != _FILE.format:
        raise CheckpointError(
            f"{path} is a safetensors file but not a model of pcore: expected the format "
            f"'{_FILE.format}' in its header, got {header.get('format')!r}; give a file written by "
            "`pcore train`, `pcore finetune` or `pcore import papr`"
        )
    if header.get("version") != _FILE.version:
        raise CheckpointError(
            f"{path} has version {header.get('version')!r} of the model format: this pcore "
            f"({pcore_version()}) reads version {_FILE.version} alone; train the scene again "
            "(`pcore train`), import the original's checkpoint again (`pcore import papr`), or use "
            "the pcore that wrote it"
        )
    # What models that were made before there was such a setting do.
    settings = {"frame": None, "color_degree": 0, **_FILE.values(path, header, "config")}
    config = from_dict(PaprConfig, settings, where=f"{path}: config")
    provenance = from_dict(
        Provenance, _FILE.values(path, header, "provenance"), where=f"{path}: provenance"
    )
    _check_tensors(path, forms, config)
    return config, provenance, forms


def _check_tensors(path: Path, forms: Mapping[str, _Form], config: PaprConfig) -> None:
    """Raise unless names, shapes and types are those of `Papr(config)` and a cloud."""
    layers = (config.key.layers, config.query.layers, config.value.layers)
    # Every layer has tensors of its own: numbers beyond those of the file would take forever.
    if sum(layers) > len(forms):
        raise CheckpointError(
            f"{path}: the tensors are not those of its configuration: expected {sum(layers)} "
            f"layers, got {len(forms)} tensors; the file was edited, save the model again"
        )
    try:
        with torch.device("meta"):
            expected = {f"papr.{k}": _form(v) for k, v in Papr(config).state_dict().items()}
    except (RuntimeError, OverflowError, TypeError) as error:
        raise CheckpointError(
            f"{path}: expected a configuration of a network, got sizes that none can have; the "
            "file was edited, save the model again"
        ) from error
    points = next(iter(forms.get("cloud.positions", ((0,), ""))[0]), 0)
    expected["cloud.positions"] = ((points, 3), "F32")
    expected["cloud.features"] = ((points, config.feature_size), "F32")
    expected["cloud.influence"] = ((points,), "F32")
    if any(name.startswith("surfels.") for name in forms):
        expected["surfels.normals"] = ((points, 3), "F32")
        expected["surfels.heights"] = ((points,), "F32")
    problems = [f"missing tensor '{name}'" for name in expected if name not in forms]
    problems += [f"unexpected tensor '{name}'" for name in forms if name not in expected]
    problems += [
        f"'{name}': expected {_show(form)}, got {_show(forms[name])}"
        for name, form in expected.items()
        if name in forms and forms[name] != form
    ]
    if points == 0:
        problems.append("the cloud has no points")
    if problems:
        more = f" and {len(problems) - 4} more" if len(problems) > 4 else ""
        raise CheckpointError(
            f"{path}: the tensors are not those of its configuration: {', '.join(problems[:4])}"
            f"{more}; the file was made by another version or edited, save the model again"
        )


def _show(form: _Form) -> str:
    return f"{form[1]} {form[0]}"

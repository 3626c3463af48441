"""The plan of a sweep: a YAML file of scenes, settings, seeds and what a trial may take."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, ValidationError

from pcore.errors import InputError
from pcore.user_yaml import read_yaml
from pcore.validation import Strict, check_folder_names, describe_problem

ALL = "all"
"""Name of the mean over scenes; no scene may be called so."""
VerbName = Literal["train", "finetune", "eval", "compare"]
VERB_NAMES: tuple[VerbName, ...] = get_args(VerbName)
"""What a trial may do, in this order."""

Seed = Annotated[int, Field(ge=0, lt=2**63)]


class TrialResources(Strict):
    """What one trial may take."""

    processes: int = Field(default=1, ge=1)
    """That share the work of a trial, on one machine."""
    cpus: int = Field(default=1, ge=1)
    """Threads of each process, and cores that its machine must have for it."""
    gpus: float = Field(default=0, ge=0)
    """Of all processes. 0: trials compute on the CPU; as many as processes: each process has one;
    less than 1: several trials of one process share one."""
    memory_gb: float | None = Field(default=None, gt=0)
    """Memory that a machine must have free for it."""

    @property
    def cores(self) -> int:
        """That a machine must have for a trial."""
        return self.cpus * self.processes


class SweepSetting(Strict):
    """Which verbs a trial runs, each with options as on the command line."""

    train: dict[str, Any] | None
    finetune: dict[str, Any] | None = None
    eval: dict[str, Any] | None = None
    compare: dict[str, Any] | None = None

    def verbs(self) -> dict[VerbName, Mapping[str, Any]]:
        """Options by verb, in the order in which they run; a verb without any has none."""
        found: dict[VerbName, Mapping[str, Any]] = {}
        for name in VERB_NAMES:
            if name in self.model_fields_set:
                found[name] = getattr(self, name) or {}
        return found


class SweepPlan(Strict):
    """Every scene with every setting and every seed is one trial."""

    version: Literal[1]
    scenes: dict[str, str] = Field(min_length=1)
    """Name -> folder, seen from the plan's own folder."""
    settings: dict[str, SweepSetting] = Field(min_length=1)
    """Name -> verbs; the first setting is what the others are compared with."""
    seeds: list[Seed] = Field(min_length=1)
    resources: TrialResources = TrialResources()


def read_plan(path: Path) -> SweepPlan:
    """Read a plan.

    Raises:
        InputError: there is no file, it is no YAML, or it holds what a plan does not.
    """
    where = f"plan {path}"
    found = read_yaml(path, where=where, error=InputError)
    if not isinstance(found, dict):
        got = "an empty file" if found is None else f"one {type(found).__name__}"
        raise InputError(
            f"{where}: expected keys with values in YAML (version, scenes, settings, seeds), got "
            f'{got}; the guide "Sweeps" has a plan to begin with'
        )
    try:
        # JSON's rules let lists be lists of any kind and numbers be nothing but numbers.
        plan = SweepPlan.model_validate_json(json.dumps(found))
    except ValidationError as error:
        raise InputError(f"{where}: {describe_problem(error)}") from error
    _check_names(plan, where)
    _check_gpus(plan.resources, where)
    return plan


def _check_gpus(wanted: TrialResources, where: str) -> None:
    if wanted.gpus > 1 or wanted.processes > 1:
        if wanted.gpus in (0, wanted.processes):
            return
        raise InputError(
            f"{where}: 'resources': expected one GPU for each process or none at all, got "
            f"{wanted.gpus:g} for {wanted.processes}; give processes: N and gpus: N together"
        )


def _check_names(plan: SweepPlan, where: str) -> None:
    if len({*plan.seeds}) < len(plan.seeds):
        raise InputError(f"{where}: 'seeds': expected each seed once, got {plan.seeds}")
    if ALL in plan.scenes:
        raise InputError(
            f"{where}: 'scenes': expected another name than {ALL!r}, which stands for the mean "
            "over scenes; rename the scene"
        )
    for kind, names in (("scenes", plan.scenes), ("settings", plan.settings)):
        check_folder_names(f"{where}: '{kind}'", names)

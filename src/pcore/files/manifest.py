"""`run.json`: what a run folder says about itself."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pcore.errors import CheckpointError, InputError
from pcore.files.provenance import Stage, pcore_version
from pcore.files.records import differing_keys

MANIFEST_FILE = "run.json"
_FORMAT = "pcore-run"
_VERSION = 1
_KINDS: dict[str, tuple[type, str]] = {
    "stage": (str, "a text"),
    "scene": (str, "a text"),
    "config": (dict, "a JSON object { ... }"),
    "notes": (dict, "a JSON object { ... }"),
}


def new_manifest(stage: Stage, scene: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """Describe a run that begins; `config` as JSON values."""
    return {
        "format": _FORMAT,
        "version": _VERSION,
        "pcore": pcore_version(),
        "stage": stage,
        "scene": scene,
        "config": json.loads(json.dumps(dict(config), allow_nan=False)),
        "notes": {},
    }


def read_manifest(path: Path) -> dict[str, Any]:
    """Read the `run.json` in the folder `path`; raises CheckpointError when it is not ours."""
    file = path / MANIFEST_FILE
    if not file.is_file():
        raise CheckpointError(
            f"no run at {path}: expected a folder with a {MANIFEST_FILE}, as `pcore train -o RUN` "
            "and `pcore import papr -o RUN` make it; check the path"
        )
    try:
        data = json.loads(file.read_bytes())
    except (ValueError, RecursionError) as error:
        raise CheckpointError(
            f"{file}: expected JSON, got something else; the file is damaged, take it from a copy "
            "of the run"
        ) from error
    manifest = cast("dict[str, Any]", data) if isinstance(data, dict) else {}
    if manifest.get("format") != _FORMAT:
        raise CheckpointError(
            f"{file} does not describe a run of pcore: expected the format '{_FORMAT}', got "
            f"{manifest.get('format')!r}; give another folder"
        )
    if manifest.get("version") != _VERSION:
        raise CheckpointError(
            f"{file} has version {manifest.get('version')!r} of the run format: this pcore "
            f"({pcore_version()}) reads version {_VERSION}; use the pcore that wrote it"
        )
    missing = sorted({"stage", "scene", "config", "notes"} - {*manifest})
    if missing:
        raise CheckpointError(f"{file}: missing key {', '.join(missing)}; the file was edited")
    for key, (kind, what) in _KINDS.items():
        if not isinstance(manifest[key], kind):
            raise CheckpointError(
                f"{file}: '{key}': expected {what}, got {json.dumps(manifest[key])[:60]}; the file "
                "was edited, take it from a copy of the run"
            )
    return manifest


def same_run(path: Path, manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest that is there; raise when it belongs to another training."""
    old = read_manifest(path)
    keys = ("stage", "scene", "config")
    lines = differing_keys({k: old[k] for k in keys}, {k: manifest[k] for k in keys})
    if lines:
        raise InputError(
            f"cannot resume {path} with other settings, it would not be the same training: "
            f"{'; '.join(line.removeprefix('config.') for line in lines)}; use the settings it "
            "was started with (they stand in run.json), or start a new run with another -o"
        )
    return old

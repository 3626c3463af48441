"""Data sets of the paper, and those at hand: where they lie below DATA, at which resolution.

Splits: rendered sets bring their own; of captures every 8th photo is held out, as is usual for both
(the paper names no splits). Widths are those of the published pictures; the paper halves the
pictures of Mip-NeRF 360 once more, for its own method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pcore.capture.layouts import layouts_of
from pcore.capture.load import load_scene
from pcore.errors import PcoreError
from pcore.evaluation.motion_method import end_views
from pcore.evaluation.states import SceneStates, open_states

AT_HAND = "at hand"
MIP_OUTDOOR = ("bicycle", "flowers", "garden", "stump", "treehill")
MIP_INDOOR = ("bonsai", "counter", "kitchen", "room")
DTU_SCANS = (24, 37, 40, 55, 63, 65, 69, 83, 97, 105, 106, 110, 114, 118, 122)
_IDR = "cameras_sphere.npz"


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """A data set.

    Attributes:
        name: as the paper's tables call it.
        folders: patterns below DATA of the folder of a scene.
        scenes: their names; none: every folder that fits.
        width: of its pictures in the paper, pixels; None where any will do.
        factors: scenes whose down-scaling is said instead of a width.
    """

    name: str
    folders: tuple[str, ...]
    scenes: tuple[str, ...] = ()
    width: int | None = None
    factors: tuple[tuple[str, int], ...] = ()

    def run(self, scene: str) -> str:
        """Name of the run of a scene."""
        return scene if self.name == AT_HAND else f"{self.name.lower().replace(' ', '_')}-{scene}"


SETS = {
    one.name: one
    for one in (
        DataSet(name=AT_HAND, folders=("deformed/{}", "bench/{}")),
        DataSet(
            name="Neural Editor",
            folders=("neural_editor/{}", "neural_editor/ns_{}", "Scratch/ns_{}"),
            scenes=("chair", "drums", "ficus", "hotdog", "lego", "materials", "mic", "ship"),
            width=800,
        ),
        DataSet(
            name="Objaverse",
            folders=("objaverse/{}", "papr_in_motion/{}"),
            scenes=("butterfly", "crab", "dolphin", "giraffe", "lego", "legoman"),
            width=800,
        ),
        DataSet(name="Objaverse hand", folders=("realistic/{}",), scenes=("hand",), width=800),
        DataSet(name="Mixamo running", folders=("realistic/{}",), scenes=("running",), width=800),
        DataSet(
            name="DTU",
            folders=("dtu/{}", "DTU/{}", "dtu/dtu_{}", "captures/dtu_{}"),
            scenes=tuple(f"scan{number}" for number in DTU_SCANS),
            width=800,
        ),
        DataSet(
            name="Mip-NeRF 360",
            folders=("mipnerf360/{}", "360_v2/{}"),
            scenes=(*MIP_OUTDOOR, *MIP_INDOOR),
            # Published at a quarter outdoors and a half indoors; P-CORE at half of that.
            factors=(*((name, 8) for name in MIP_OUTDOOR), *((name, 4) for name in MIP_INDOOR)),
        ),
        DataSet(name="NeRF-Synthetic", folders=("nerf_synthetic/{}",), width=800),
    )
}


@dataclass(frozen=True, kw_only=True)
class Found:
    """A scene that is there.

    Attributes:
        data: its data set.
        name: of the scene in it.
        path: what `load_scene` takes.
        factor: down-scaling that gives the paper's resolution, as near as it can.
        size: width and height of the pictures then.
    """

    data: DataSet
    name: str
    path: Path
    factor: int
    size: tuple[int, int]

    @property
    def run(self) -> str:
        """Name of its run."""
        return self.data.run(self.name)

    @property
    def note(self) -> str:
        """In what its resolution differs from the paper's, or ""."""
        width = self.data.width
        if width is None or self.size[0] == width:
            return ""
        return f"{self.run}: {self.size[0]} x {self.size[1]}, the paper's are {width} wide"


@dataclass(frozen=True, kw_only=True)
class Skipped:
    """A scene or data set that is not there or cannot be used, and why."""

    name: str
    reason: str


def find(
    data: Path, names: Sequence[str], factor: int | None, only: Sequence[str]
) -> tuple[list[Found], list[Skipped]]:
    """Scenes of data sets below a folder.

    Args:
        data: the folder.
        names: of the data sets.
        factor: down-scaling of all of them; None: that of the paper's resolutions.
        only: names of scenes or runs; none: all.
    """
    found: list[Found] = []
    skipped: list[Skipped] = []
    for name in names:
        here = SETS[name]
        places = _places(data, here)
        missing = [scene for scene in here.scenes if scene not in places]
        if missing or not places:
            tried = ", ".join(str(data / one.format("NAME")) for one in here.folders)
            gone = f"no {', '.join(missing)}" if places else "none of its scenes"
            skipped.append(Skipped(name=name, reason=f"{gone} (looked for {tried})"))
        for scene, path in places.items():
            if only and not {scene, here.run(scene)} & {*only}:
                continue
            try:
                found.append(_opened(here, scene, path, factor))
            except PcoreError as error:
                skipped.append(Skipped(name=f"{name}, {scene}", reason=str(error)))
    return found, skipped


def states_of(scene: Found, kinds: Sequence[str], *, trained: bool) -> list[str]:
    """Names of its states of some kinds that can be scored.

    Args:
        scene: the scene.
        kinds: of the states of what is at hand; published sets give all of theirs.
        trained: only states with training photos.

    Raises:
        PcoreError: the scene, its meshes or a state's files cannot be read.
    """
    places = open_states(scene.path, factor=scene.factor)
    every = scene.data.name != AT_HAND
    names = [s.name for s in places.select(["all"])[1:] if every or s.kind in kinds]
    return [name for name in names if not trained or _has_photos(places, name)]


def _has_photos(places: SceneStates, name: str) -> bool:
    try:
        return bool(end_views(places, name))
    except PcoreError:
        return False


def _places(data: Path, here: DataSet) -> dict[str, Path]:
    places: dict[str, Path] = {}
    for pattern in here.folders:
        for scene in here.scenes:
            path = data / pattern.format(scene)
            if path.is_dir():
                places.setdefault(scene, path)
        above = data / pattern.partition("{")[0]
        if not here.scenes and above.is_dir():
            for path in sorted(one for one in above.iterdir() if one.is_dir()):
                places.setdefault(path.name, path)
    return places


def _opened(here: DataSet, scene: str, path: Path, factor: int | None) -> Found:
    # Scans are passed on with IDR's cameras beside a model of COLMAP: the first know the sphere.
    if len(layouts_of(path)) > 1 and (path / _IDR).is_file():
        path = path / _IDR
    view = load_scene(path).split("train")[0]
    width, height = view.camera.width, view.camera.height
    if factor is None:
        wanted = max(1, round(width / here.width)) if here.width else 1
        factor = dict(here.factors).get(scene, wanted)
    if factor > 1:
        camera = load_scene(path, factor=factor).split("train")[0].camera
        width, height = camera.width, camera.height
    return Found(data=here, name=scene, path=path, factor=factor, size=(width, height))

"""`pcore import gaussians` and `pcore export`: files of Gaussians and runs."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import tyro
from rich.console import Console
from tests.asset.test_lit_gaussians import TURN, lit_asset
from tests.data.splat_files import write_ply
from tests.gaussians.some import some_gaussians

import tiny_scene
from pcore.asset.importing import save_imported
from pcore.asset.saving import load
from pcore.capture.load import load_scene
from pcore.cli.deform import DeformCommand
from pcore.cli.deform_gaussians import deform
from pcore.cli.export import ExportCommand, export
from pcore.cli.import_gaussians import ImportGaussiansCommand, import_gaussians
from pcore.data.pictures import write_rgba
from pcore.data.splat_file import splats_of
from pcore.data.splat_formats import read_splats, save_splats
from pcore.errors import CheckpointError, InputError
from pcore.files.gaussian_file import load_gaussians
from pcore.files.run_folder import RunFolder
from pcore.gaussians.render import Footprint
from pcore.gaussians.spherical_harmonics import colors


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_ply(tmp_path / "gs.ply", some_gaussians(40))
    return tmp_path


def imported(folder: Path, **options) -> Path:
    run = folder / "run"
    command = ImportGaussiansCommand(file=folder / "gs.ply", output=run, threads=1, **options)
    import_gaussians(command, Console(quiet=True))
    return run


def exported(run: Path, name: str, **options) -> Path:
    output = run.parent / name
    export(ExportCommand(run_folder=run, output=output, threads=1, **options), Console(quiet=True))
    return output


def test_parse_as_command_lines():
    words = ["gs.ply", "-o", "run", "--variance", "0.1", "--antialiased"]
    command = tyro.cli(ImportGaussiansCommand, args=words)
    assert (command.variance, command.antialiased, command.output) == (0.1, True, Path("run"))
    assert tyro.cli(ExportCommand, args=["run", "--to", "splats", "-o", "a.ply"]).to == "splats"


def test_a_run_holds_what_the_file_holds(folder: Path):
    run = imported(folder)
    saved = load_gaussians(run)
    expected = read_splats(folder / "gs.ply").gaussians
    for name, value in vars(expected).items():
        torch.testing.assert_close(getattr(saved.gaussians, name), value.float(), msg=name)
    assert saved.footprint.variance == 0.3  # Of other trainers.
    assert not saved.footprint.antialiased
    opened = RunFolder.open(run)
    assert (opened.stage, opened.notes["status"]) == ("import", "finished")


def test_the_world_that_a_trainer_moved_comes_back(folder: Path):
    rows = [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]
    (folder / "t.json").write_text(json.dumps({"transform": rows, "scale": 2.0}))
    own = read_splats(folder / "gs.ply").gaussians
    saved = load_gaussians(imported(folder, transform=folder / "t.json")).gaussians
    torch.testing.assert_close(saved.means[:, 0], (own.means[:, 0] / 2 - 5).float())
    torch.testing.assert_close(saved.scales, (own.scales / 2).float())


def test_what_goes_out_is_what_came_in(folder: Path):
    run = imported(folder)
    again = read_splats(exported(run, "out.ply")).gaussians
    for name, value in vars(read_splats(folder / "gs.ply").gaussians).items():
        got = getattr(again, name)
        torch.testing.assert_close(got, value, atol=1e-6, rtol=1e-5, msg=name)
    assert len(exported(run, "out.splat").read_bytes()) == 40 * 32
    assert exported(run, "out.glb").read_bytes()[:4] == b"glTF"


def test_flat_ones_come_in_as_discs_and_go_out_with_two_scales(folder: Path):
    gaussians = some_gaussians(40)
    flat = replace(splats_of(gaussians, "flat"), flat=True)
    save_splats(folder / "gs.ply", flat)
    run = imported(folder)
    saved = load_gaussians(run)
    assert saved.footprint == Footprint(variance=0.5, antialiased=False, flat=True)
    torch.testing.assert_close(saved.gaussians.scales[:, :2], gaussians.scales[:, :2])
    back = exported(run, "back.ply", to="splats")
    assert b"scale_1" in back.read_bytes()
    assert b"scale_2" not in back.read_bytes()
    assert read_splats(back).flat


def test_an_edited_run_is_exported_as_the_file_is_deformed(folder: Path):
    twist = {"type": "twist", "axis": "z", "angle_deg": {"keyframes": [[0, 0], [1, 50]]}}
    edit = folder / "edit.json"
    edit.write_text(json.dumps({"version": 2, "edits": [twist]}))
    out = exported(imported(folder), "out.ply", edit=edit, time=0.5)
    other = folder / "other.ply"
    deform(DeformCommand(input=folder / "gs.ply", edit=edit, output=other, time=0.5))
    one, two = (read_splats(path).gaussians for path in (out, other))
    for name, value in vars(one).items():
        torch.testing.assert_close(getattr(two, name), value, atol=2e-6, rtol=2e-5, msg=name)


def test_what_cannot_be_is_refused_and_leaves_nothing(folder: Path):
    with pytest.raises(InputError, match="no such file"):
        import_gaussians(
            ImportGaussiansCommand(file=folder / "no.ply", output=folder / "run", threads=1),
            Console(quiet=True),
        )
    assert not (folder / "run").exists()
    with pytest.raises(CheckpointError):
        exported(folder / "nowhere", "out.ply")
    run = imported(folder)
    with pytest.raises(InputError, match="run already"):
        imported(folder)
    with pytest.raises(InputError, match="ends in"):
        exported(run, "out.obj")
    load_gaussians(run)
    (run / "gaussians.safetensors").unlink()
    with pytest.raises(CheckpointError, match="no model"):
        exported(run, "out.ply")


def test_a_run_remembers_the_scene_that_it_was_shown(tmp_path: Path):
    scene = tiny_scene.write_scene(tmp_path / "scene", states=False, meshes=False)
    gaussians = some_gaussians(40)
    run = save_imported(
        gaussians.to(dtype=torch.float32),
        Footprint(),
        tmp_path / "run",
        file=tmp_path / "gs.ply",
        scene=scene,
        factor=2,
    )
    assert run.record.scene_or(None).resolve() == scene.resolve()
    assert run.record.factor == 2
    assert run.scene().split("train")[0].camera.width == tiny_scene.SIZE // 2
    # Both may move together; without photos a file of that name is no scene.
    (tmp_path / "run").rename(tmp_path / "other")
    assert load(tmp_path / "other").record.scene_folder is not None
    (tmp_path / "gs.ply").write_bytes(b"")
    bare = save_imported(
        gaussians.to(dtype=torch.float32), Footprint(), tmp_path / "b", file=tmp_path / "gs.ply"
    )
    assert bare.record.scene_folder is None


def test_the_screen_filter_of_a_file_that_tells_none_is_that_of_the_photos(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    scene = tiny_scene.write_scene(folder / "scene", states=False, meshes=False)
    one = some_gaussians(300).to(dtype=torch.float32)
    # Colours that a picture can hold.
    shown = replace(one, opacities=torch.full((300,), 0.9), scales=one.scales / 2, sh=one.sh / 9)
    asset = load(save_imported(shown, Footprint(), folder / "ours", file=folder / "gs.ply").path)
    for view in load_scene(scene).split("train"):
        seen = asset.over((0.0, 0.0, 0.0)).render(None, view.camera)
        write_rgba(scene / "train" / f"{view.name}.png", seen.rgb, seen.alpha)
    # Other programs keep no comments.
    save_splats(folder / "gs.ply", splats_of(shown, "gs.ply"))
    command = ImportGaussiansCommand(file=folder / "gs.ply", output=folder / "run", scene=scene)
    import_gaussians(command, Console())
    saved = load_gaussians(folder / "run").footprint
    assert (saved.variance, saved.antialiased) == (pytest.approx(1 / 12), True)
    assert "than --variance 0.3: --variance 0.0833 --antialiased" in capsys.readouterr().out
    with pytest.raises(InputError, match="another screen filter"):
        imported(folder, scene=scene, variance=20.0)


@pytest.mark.parametrize("flat", [False, True])
def test_a_file_of_ours_tells_its_screen_filter(folder: Path, flat: bool):
    run = folder / "own"
    own = Footprint(flat=flat)
    save_imported(some_gaussians(40).to(dtype=torch.float32), own, run, file=folder / "gs.ply")
    out = exported(run, "gs.ply", to="splats")
    assert f"variance={own.variance:.9g} antialiased=1".encode() in out.read_bytes()
    again = load_gaussians(imported(folder)).footprint
    assert (again.antialiased, again.flat) == (True, flat)
    assert again.variance == pytest.approx(own.variance, rel=1e-8)
    # It stays through an edit, and a split.
    bend = {"type": "bend", "axis": "x", "angle_deg": 60}
    (folder / "e.json").write_text(json.dumps({"version": 2, "edits": [bend]}))
    moved = folder / "moved.ply"
    deform(DeformCommand(input=out, edit=folder / "e.json", output=moved, split=0.1))
    told = read_splats(moved)
    assert len(told.gaussians) > 40
    assert told.footprint == again
    # Options are for files of others, and mean what they say.
    shutil.rmtree(folder / "run")
    assert load_gaussians(imported(folder, variance=0.2)).footprint.variance == 0.2
    shutil.rmtree(folder / "run")
    with pytest.raises(InputError, match="variance above 0, got 0"):
        imported(folder, variance=0.0)


def test_edited_splats_are_lit_as_the_run_is(folder: Path):
    asset = lit_asset().save(folder / "lit")
    (folder / "turn.json").write_text(json.dumps(TURN))
    out = exported(folder / "lit", "lit.ply", to="splats", edit=folder / "turn.json")
    posed = asset.pose(TURN)
    gains = asset.content.gains_of(posed.content)
    assert gains is not None
    assert float(gains.max() - gains.min()) > 0.2
    drawn, eye = asset.splats(posed, torch.tensor([0.0, 0.0, 4.0]), gains=gains), 4.0
    found = read_splats(out).gaussians.to(dtype=torch.float32)
    seen = torch.nn.functional.normalize(found.means - torch.tensor([0.0, 0.0, eye]), dim=1)
    expected = torch.from_numpy(drawn.rgb)
    torch.testing.assert_close(colors(found.sh, seen).clamp(0, 1), expected, atol=2e-5, rtol=0)

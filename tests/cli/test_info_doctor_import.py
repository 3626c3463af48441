"""`pcore info`, `pcore doctor` and `pcore import papr`."""

from pathlib import Path

import pytest
import torch
import yaml

from pcore.cli import doctor
from pcore.cli.main import main
from pcore.files.model_file import load_model
from pcore.files.official import to_official_state
from pcore.files.provenance import provenance_of
from pcore.files.run_folder import RunFolder
from pcore.files.training_state import TrainingState
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels import backends
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig, ReferenceOrigin
from pcore.render.trace import trace

CONFIG = PaprConfig(
    neighbours=3,
    octaves=Octaves.all(2),
    feature_size=5,
    key=MlpConfig(layers=2, width=8, size=8),
    query=MlpConfig(layers=2, width=8, size=8),
    value=MlpConfig(layers=2, width=8, size=4),
    unet_channels=(4, 6, 8),
)


@pytest.fixture
def cloud() -> PointCloud:
    return PointCloud(
        positions=torch.randn(6, 3), features=torch.randn(6, 5), influence=torch.rand(6)
    )


def test_info_tells_stage_points_settings_and_scores(
    tmp_path: Path, cloud: PointCloud, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run"
    with RunFolder.create(path, stage="finetune", scene="lego", config={"lambda_geo": 3}) as run:
        came = provenance_of(
            cloud.positions, CONFIG.background, scene="lego", stage="finetune", step=500
        )
        run.save_model(Papr(CONFIG).state_dict(), cloud, CONFIG, came)
        run.update(status="finished", scores={"psnr": 25.5})
    assert main(["info", str(path), "--settings"]) == 0
    rows = {line.split(maxsplit=1)[0]: line for line in capsys.readouterr().out.splitlines()}
    assert rows["stage"].split() == ["stage", "finetune"]
    assert rows["status"].split() == ["status", "finished"]
    assert rows["scores.psnr"].split() == ["scores.psnr", "25.5"]
    assert rows["points"].split() == ["points", "6"]
    assert rows["config.lambda_geo"].split() == ["config.lambda_geo", "3"]
    assert rows["papr.neighbours"].split() == ["papr.neighbours", "3"]
    assert "500 steps" in rows["made"]
    assert main(["info", str(path / "model.safetensors")]) == 0
    assert "trained on" in capsys.readouterr().out


def test_info_of_a_run_that_has_just_begun(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    RunFolder.create(tmp_path, stage="pretrain", scene="lego", config={}).close()
    assert main(["info", str(tmp_path)]) == 0
    assert "none saved yet" in capsys.readouterr().out


def test_info_of_a_run_whose_process_lives_or_was_killed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def status() -> str:
        assert main(["info", str(tmp_path)]) == 0
        lines = capsys.readouterr().out.splitlines()
        return next(line for line in lines if line.startswith("status")).split(maxsplit=1)[1]

    with RunFolder.create(tmp_path, stage="pretrain", scene="lego", config={}) as run:
        assert status() == "running"
        run.save_state(tiny_state(7))
        assert status() == "running; step 7 is saved"
    # Nobody wrote down that it ended.
    assert run.notes["status"] == "running"
    assert status() == "stopped; go on from step 7 with the same command and --resume"
    (tmp_path / "state.pt").unlink()
    assert status() == "stopped before anything was saved; give the same command again"


def tiny_state(step: int) -> TrainingState:
    return TrainingState(
        stage="pretrain", step=step, papr={}, cloud={}, optimisers={}, generators={}
    )


def test_info_of_an_edit_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "edit.json"
    path.write_text('{"version": 2, "edits": [{"type": "scale", "factor": 2}]}')
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "edit file" in shown
    assert "1. scale:" in shown
    assert "pcore render RUN --edit" in shown
    assert "--picture" in shown
    path.write_text(
        '{"version": 2, "edits": [{"type": "scale", "factor": {"keyframes": [[0, 1], [2, 3]]}}]}'
    )
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "from time 0 to 2" in shown
    assert "pcore animate RUN --edit" in shown
    path.write_text("[]")
    assert main(["info", str(path)]) == 2


def test_info_of_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(tmp_path)]) == 2
    assert "no run at" in capsys.readouterr().err
    assert main(["info", str(tmp_path / "absent")]) == 2
    assert "no model at" in capsys.readouterr().err


def test_doctor_reports_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PCORE_LPIPS_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    for name in (
        "torch",
        "device",
        "threads",
        "memory",
        "disk",
        "search",
        "attention",
        "tensorboard",
    ):
        assert name in shown
    assert torch.__version__ in shown
    assert "LPIPS      no weights of alex, squeeze, vgg" in shown
    assert "`pcore doctor --weights` says which files go where" in shown
    assert main(["doctor", "--weights"]) == 0
    shown = capsys.readouterr().out
    assert "LPIPS vgg      missing" in shown
    assert "PCORE_LPIPS_DIR" in shown


def test_doctor_finds_weights(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_LPIPS_DIR", str(shared_data / "lpips"))
    assert any(item.good and str(shared_data) in item.value for item in doctor.weight_files())
    (found,) = [item for item in doctor.examine() if item.name == "LPIPS"]
    assert "no weights" not in found.value.split(", ")[0]


def test_doctor_names_the_extra_of_a_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda _: None)
    missing = {item.name: item for item in doctor._packages()}
    assert not missing["tensorboard"].good
    assert "pip install 'pcore-edit[log]'" in missing["tensorboard"].advice


def test_doctor_says_what_would_be_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(doctor, "usable_cores", lambda: 64)
    found = {item.name: item for item in doctor.examine()}
    assert "unset PCORE_KERNELS" in found["attention"].advice
    assert "use `tiny`" in found["device"].advice
    assert "of 64 usable cores" in found["threads"].value
    assert "slower than it could be" in found["threads"].advice


def test_doctor_says_which_kernels_are_used_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PCORE_KERNELS", raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for found in kernels().values():
        assert found.value.startswith("cpu for cpu (numba ")
    monkeypatch.setenv("PCORE_KERNELS", "cpu")
    assert "chosen by PCORE_KERNELS" in kernels()["search"].value
    monkeypatch.delenv("PCORE_KERNELS")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(backends, "has_triton", lambda: True)
    for found in kernels().values():
        assert found.value.startswith("triton for cuda (triton ")
    assert "reference beyond 256 wide layers" in kernels()["attention"].value
    monkeypatch.setattr(backends, "has_triton", lambda: False)
    for missing in kernels().values():
        assert missing.value == "reference for cuda (plain PyTorch)"
        assert not missing.good
        assert "pip install triton" in missing.advice


def test_doctor_reports_a_backend_that_cannot_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    for name, said in (("triton", "tensors on cpu, got 'triton'; unset it"), ("x", "got 'x'")):
        monkeypatch.setenv("PCORE_KERNELS", name)
        assert main(["doctor"]) == 0
        shown = capsys.readouterr().out
        assert said in shown
        assert "none for cpu" in shown
        assert not kernels()["search"].good
        assert "LPIPS" in shown, "the report goes on"


def kernels() -> dict[str, doctor.Finding]:
    return {found.name: found for found in doctor._kernels()}


def test_a_container_with_less_memory_than_the_machine(tmp_path: Path) -> None:
    limit = tmp_path / "memory.max"
    total = doctor.memory_bytes(tmp_path / "absent")
    assert total is not None
    limit.write_text("1000000\n")
    assert doctor.memory_bytes(limit) == 1_000_000
    limit.write_text("max\n")
    assert doctor.memory_bytes(limit) == total


def write_official(folder: Path, cloud: PointCloud) -> tuple[Papr, list[str]]:
    """Write an original checkpoint; return the networks and the arguments to import it."""
    papr = Papr(CONFIG)
    torch.save({"1234": to_official_state(papr, cloud)}, folder / "model.pth")
    tree = {"index": "toy", "dataset": {"coord_scale": 10.0}, "geoms": {}}
    (folder / "toy.yml").write_text(yaml.safe_dump(tree))
    files = [str(folder / "model.pth"), "--config", str(folder / "toy.yml")]
    return papr, ["import", "papr", *files, "-o", str(folder / "run")]


def test_import_makes_a_run_that_loads(
    tmp_path: Path, cloud: PointCloud, capsys: pytest.CaptureFixture[str]
) -> None:
    papr, args = write_official(tmp_path, cloud)
    assert main(args) == 0
    assert "toy, 6 points, 1,234 steps" in capsys.readouterr().out
    loaded = load_model(tmp_path / "run")
    state = loaded.papr().state_dict()
    assert all(torch.equal(state[name], value) for name, value in papr.state_dict().items())
    torch.testing.assert_close(loaded.cloud.positions, cloud.positions)
    assert (loaded.provenance.stage, loaded.provenance.step) == ("import", 1234)
    assert RunFolder.open(tmp_path / "run").stage == "import"
    assert main(args) == 2
    assert "holds a run already" in capsys.readouterr().err


def test_an_import_that_fails_makes_no_run(
    tmp_path: Path, cloud: PointCloud, capsys: pytest.CaptureFixture[str]
) -> None:
    _, args = write_official(tmp_path, cloud)
    (tmp_path / "model.pth").write_bytes(b"no checkpoint")
    assert main(args) == 2
    assert "model.pth" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_an_import_may_slide_all_origins(tmp_path: Path, cloud: PointCloud) -> None:
    """With a reference a ray that begins farther back sees the same; without it does not."""
    _, args = write_official(tmp_path, cloud)
    assert main(args) == 0
    far = ["--reference-distance", "3", "--reference-center", "0", "0", "0.5"]
    assert main([*args[:-1], str(tmp_path / "slid"), *far]) == 0
    slid = load_model(tmp_path / "slid")
    assert slid.config.reference == ReferenceOrigin(center=(0.0, 0.0, 0.5), distance=3.0)
    ray = torch.nn.functional.normalize(torch.tensor([[0.1, -0.2, -1.0]]), dim=-1)
    for run, same in (("slid", True), ("run", False)):
        saved = load_model(tmp_path / run)
        near, away = (
            trace(
                saved.papr(),
                PosedCloud.at_rest(saved.cloud),
                RayBundle(origins=-distance * ray, directions=ray),
            ).features
            for distance in (3.0, 6.0)
        )
        assert torch.allclose(near, away, atol=1e-4) == same


def test_a_reference_center_needs_its_distance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["model.pth", "--config", "lego.yml", "--reference-center", "0", "0", "1"]
    assert main(["import", "papr", *words, "-o", str(tmp_path / "run")]) != 0
    assert "--reference-center is for --reference-distance" in capsys.readouterr().err
    words = ["model.pth", "--config", "lego.yml", "--reference-distance", "-1"]
    assert main(["import", "papr", *words, "-o", str(tmp_path / "run")]) != 0
    assert "positive distance of the reference origin" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_doctor_says_what_draws_gaussians(monkeypatch: pytest.MonkeyPatch) -> None:
    found = doctor._gaussians()
    assert found.good
    assert found.value.startswith("cpu (numba")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    assert "pcore-edit[gsplat]" in doctor._gaussians().advice
    monkeypatch.setattr(doctor, "find_spec", lambda name: name)
    monkeypatch.setattr(doctor, "_built", lambda: False)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    assert "nvcc is not found" in doctor.gaussian_report(lambda name: "1")[1]

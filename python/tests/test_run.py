"""Whole recordings, as the command runs them."""

import shutil
import signal
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

import fgs_slam


def test_the_files_are_those_of_the_command(fgs: Path, room: Path, finished: fgs_slam.Run, tmp_path: Path) -> None:
    out = tmp_path / "run"
    subprocess.run([fgs, "run", room, "--out", out, "--backend", "cpu", "--eval"], check=True, capture_output=True)
    for name in ["trajectory.txt", "map.ply", "reference.txt"]:
        assert (out / name).read_bytes() == (finished.path / name).read_bytes(), name
    expected = fgs_slam.Run(out).metrics()
    for key in ["num_gaussians", "psnr_valid_depth_db", "ate_rmse_m"]:
        assert finished.metrics()[key] == expected[key], key


def test_what_a_run_leaves(finished: fgs_slam.Run, recording: fgs_slam.Recording) -> None:
    trajectory, truth = finished.trajectory(), recording.ground_truth
    assert truth is not None
    assert len(trajectory) == 12 and trajectory.timestamps.shape == (12,)
    ate = fgs_slam.evaluate.ate(trajectory, truth)
    metrics = finished.metrics()
    assert ate.pairs == 12
    assert ate.rmse_m == pytest.approx(metrics["ate_rmse_m"], rel=1e-6)
    reference = finished.reference()
    assert reference is not None and len(reference) == 12
    assert len(finished.gaussians()) == metrics["num_gaussians"]


def test_progress_is_told(room: Path, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    fgs_slam.run(
        room,
        out=tmp_path / "run",
        backend="cpu",
        frames=(2, 8),
        refine=3,
        evaluate=True,
        progress=lambda *progress: told.append(progress),
    )
    stages: dict[str, list[int]] = {}
    for what, done, _ in told:
        stages.setdefault(what, []).append(done)
    assert stages["frames"] == list(range(1, 7))
    assert stages["refinement"] == [1, 2, 3]
    assert stages["evaluation"]
    assert {total for what, _, total in told if what == "frames"} == {6}


def test_ctrl_c_saves_the_run(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    timer = threading.Timer(0.5, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        fgs_slam.run(room, out=out, backend="cpu", refine=1_000_000)
    timer.join()
    metrics = fgs_slam.Run(out).metrics()
    assert metrics["interrupted"] and metrics["num_gaussians"] > 0


def test_an_exception_of_the_callback_saves_the_run(room: Path, tmp_path: Path) -> None:
    class Enough(Exception):
        pass

    def stop(what: str, done: int, total: int) -> None:
        if what == "refinement":
            raise Enough

    out = tmp_path / "run"
    with pytest.raises(Enough):
        fgs_slam.run(room, out=out, backend="cpu", refine=1_000_000, progress=stop)
    assert fgs_slam.Run(out).metrics()["interrupted"]


def test_settings_go_over_those_of_the_configuration(room: Path, tmp_path: Path) -> None:
    def seed_and_pruning(run: fgs_slam.Run) -> tuple[str, bool]:
        text = (run.path / "config.effective.toml").read_text()
        return text.splitlines()[0], "prune_every = 70\n" in text

    file = tmp_path / "settings.toml"
    file.write_text("seed = 3\n[mapping]\nprune_every = 70\n")
    config = fgs_slam.Config(file, seed=4)
    given: fgs_slam.Config | Path
    for given, seed in ((file, 3), (config, 4)):
        out = tmp_path / f"run{seed}"
        run = fgs_slam.run(room, out=out, config=given, backend="cpu", frames=(0, 2))
        assert seed_and_pruning(run) == (f"seed = {seed}", True)
    run = fgs_slam.run(room, out=out, config=config, backend="cpu", frames=(0, 2), mapping={"prune_every": 80})
    assert seed_and_pruning(run) == ("seed = 4", False)


def test_what_cannot_be_run(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.raises(fgs_slam.DatasetError, match="nowhere"):
        fgs_slam.run(tmp_path / "nowhere", out=out)
    with pytest.raises(fgs_slam.SettingError, match="prune_evry"):
        fgs_slam.run(room, out=out, mapping={"prune_evry": 3})
    with pytest.raises(fgs_slam.SettingError, match=r"10\.\.20"):
        fgs_slam.run(room, out=out, frames=(10, 20))
    with pytest.raises(fgs_slam.SettingError, match="eval_holdout: one frame in 1"):
        fgs_slam.run(room, out=out, eval_holdout=1)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(fgs_slam.FileError, match="mine"):
        fgs_slam.run(room, out=tmp_path / "mine", backend="cpu")
    with pytest.raises(fgs_slam.FileError, match="not the folder of a run"):
        fgs_slam.Run(room)
    assert not out.exists()


def test_recordings(recording: fgs_slam.Recording, room: Path) -> None:
    assert len(recording) == 12
    color, depth_m, timestamp = recording[-1]
    assert color.dtype == np.uint8 and color.shape == (120, 160, 3)
    assert depth_m.dtype == np.float32 and depth_m.shape == (120, 160)
    assert timestamp == recording[11][2] > recording[10][2]
    frames = list(recording)
    assert [frame[2] for frame in frames] == [recording[i][2] for i in range(12)]
    for array, expected in zip(frames[3][:2], recording[3][:2], strict=True):
        np.testing.assert_array_equal(array, expected)
    for index in (12, -13):
        with pytest.raises(IndexError):
            recording[index]
    with pytest.raises(fgs_slam.DatasetError, match="holds no recording"):
        fgs_slam.Recording(room.parent)


def test_a_damaged_image_is_an_exception(room: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "room"
    shutil.copytree(room, damaged)
    image = sorted((damaged / "rgb").iterdir())[1]
    image.write_bytes(b"none")
    frames = iter(fgs_slam.Recording(damaged))
    next(frames)
    with pytest.raises(fgs_slam.DatasetError, match=image.name):
        next(frames)
    assert next(frames)[2] == fgs_slam.Recording(room)[2][2]


def test_a_synthetic_recording_never_replaces_anything(room: Path, tmp_path: Path) -> None:
    with pytest.raises(fgs_slam.FileError):
        fgs_slam.synth(room, frames=1)
    with pytest.raises(fgs_slam.SettingError, match="noise: 'some'"):
        fgs_slam.synth(tmp_path / "a", noise="some")  # type: ignore[arg-type]
    for size in [(0, 10), (70000, 10), (65536, 65536)]:
        with pytest.raises(fgs_slam.SettingError):
            fgs_slam.synth(tmp_path / "a", size=size)
    with pytest.raises(fgs_slam.SettingError, match="frames"):
        fgs_slam.synth(tmp_path / "a", frames=0)
    timer = threading.Timer(0.5, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        fgs_slam.synth(tmp_path / "a", frames=100_000)
    timer.join()
    assert not (tmp_path / "a").exists()

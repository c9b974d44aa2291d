"""Parts that can be used on their own."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fgs_slam


def turn(angle: float) -> NDArray[np.float64]:
    """A rotation about y, with a shift."""
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0.02, -0.01, 0.015]
    return pose


def corner(seed: int, number: int) -> NDArray[np.float64]:
    """Points on three walls of a metre."""
    points = np.random.default_rng(seed).uniform(0, 1, (number, 3))
    points[np.arange(number), np.arange(number) % 3] = 0
    return points


def test_gicp_finds_a_motion() -> None:
    target_from_source = turn(0.03)
    target = corner(1, 20_000)
    points = corner(2, 3_000)
    source = (points - target_from_source[:3, 3]) @ target_from_source[:3, :3]
    alignment = fgs_slam.gicp.align(source, target)
    assert alignment.converged and alignment.inliers > 2_800
    np.testing.assert_allclose(alignment.target_from_source, target_from_source, atol=1e-3)
    assert alignment.rms_residual_m < 1e-3 and alignment.conditioning > 0.01
    again = fgs_slam.gicp.align(source.astype(np.float32), target, initial=target_from_source)
    np.testing.assert_allclose(again.target_from_source, target_from_source, atol=1e-3)
    information = again.information(0.001)
    assert information.shape == (6, 6)
    np.testing.assert_allclose(information, information.T)
    assert np.linalg.eigvalsh(information).min() > 0


def test_gicp_refuses() -> None:
    points = corner(1, 1_000)
    align = fgs_slam.gicp.align
    with pytest.raises(fgs_slam.AlignmentError, match="source has no points"):
        align(points[:0], points)
    with pytest.raises(fgs_slam.AlignmentError, match="target has no points"):
        align(points, points[:2])
    with pytest.raises(fgs_slam.AlignmentError, match="only 0 of"):
        align(points + 10, points)
    with pytest.raises(fgs_slam.AlignmentError):
        align(np.full((50, 3), np.nan), points)
    with pytest.raises(fgs_slam.ShapeError, match="source: expected"):
        align(points[:, :2], points)
    with pytest.raises(fgs_slam.ShapeError, match="pose: "):
        align(points, points, initial=np.zeros((4, 4)))
    for distance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(fgs_slam.SettingError, match="max_distance_m"):
            align(points, points, max_distance_m=distance)
    with pytest.raises(fgs_slam.SettingError, match="neighbors = 2"):
        align(points, points, neighbors=2)


def test_detail_is_found_where_it_is() -> None:
    image = np.full((90, 120), 100, np.uint8)
    image[45:, 60:] += (80 * (np.indices((45, 60)).sum(axis=0) % 2 == 0)).astype(np.uint8)
    mask = fgs_slam.frequency.detail_mask(image, clahe=False)
    assert mask.dtype == np.bool_ and mask.shape == (90, 120)
    assert mask[55:80, 70:110].all() and not mask[:30].any() and not mask[:, :40].any()
    colored = np.repeat(image[..., None], 3, axis=2)
    np.testing.assert_array_equal(fgs_slam.frequency.detail_mask(colored, clahe=False), mask)
    assert not fgs_slam.frequency.detail_mask(np.zeros((1, 1), np.uint8)).any()
    assert fgs_slam.frequency.detail_mask(np.zeros((0, 5), np.uint8)).shape == (0, 5)
    for other in (image.astype(float), image[None, None], "image"):
        with pytest.raises(fgs_slam.ShapeError, match="image: expected uint8"):
            fgs_slam.frequency.detail_mask(other)  # type: ignore[arg-type]


def line(offsets: list[float]) -> NDArray[np.float64]:
    """Poses in the corners of a square, lifted."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :2, 3] = [[0, 0], [1, 0], [1, 1], [0, 1]]
    poses[:, 2, 3] = offsets
    return poses


def test_ate() -> None:
    flat, lifted = line([0, 0, 0, 0]), line([0.1, -0.1, 0.1, -0.1])
    for error in (fgs_slam.evaluate.ate(lifted, flat), fgs_slam.evaluate.ate(turn(1.0) @ lifted, flat)):
        assert error.rmse_m == pytest.approx(0.1) and error.mean_m == pytest.approx(0.1)
        assert error.median_m == pytest.approx(0.1) and error.max_m == pytest.approx(0.1)
        assert error.std_m == pytest.approx(0, abs=1e-9) and error.pairs == 4
    error = fgs_slam.evaluate.ate(turn(1.0) @ flat, flat)
    np.testing.assert_allclose(error.reference_from_estimated @ turn(1.0), np.eye(4), atol=1e-12)

    times = np.arange(4.0)
    estimated = fgs_slam.Trajectory(times[1:] + 0.01, lifted[1:])
    reference = fgs_slam.Trajectory(times, flat)
    assert fgs_slam.evaluate.ate(estimated, reference).pairs == 3
    with pytest.raises(fgs_slam.EvaluationError, match="0 poses are too few"):
        fgs_slam.evaluate.ate(estimated, reference, max_difference_secs=0.001)
    with pytest.raises(fgs_slam.EvaluationError, match="4 .* 3"):
        fgs_slam.evaluate.ate(flat, flat[:3])
    with pytest.raises(fgs_slam.ShapeError, match=r"reference\[2\]: not a rotation"):
        broken = flat.copy()
        broken[2] = 0
        fgs_slam.evaluate.ate(flat, broken)
    with pytest.raises(fgs_slam.ShapeError):
        fgs_slam.evaluate.ate(flat, reference)


def test_trajectories(tmp_path: Path) -> None:
    poses = line([0, 1, 2, 3]) @ turn(0.3)
    trajectory = fgs_slam.Trajectory(np.arange(4.0), poses)
    np.testing.assert_allclose(trajectory.poses, poses, atol=1e-15)
    trajectory.write(tmp_path / "poses.txt")
    again = fgs_slam.Trajectory.read(tmp_path / "poses.txt")
    np.testing.assert_array_equal(again.timestamps, np.arange(4.0))
    np.testing.assert_allclose(again.poses, poses, atol=1e-15)
    with pytest.raises(fgs_slam.ShapeError, match="timestamps and poses differ in length: 3 and 4"):
        fgs_slam.Trajectory(np.arange(3.0), poses)
    with pytest.raises(fgs_slam.DatasetError):
        fgs_slam.Trajectory(np.zeros(4), poses)
    with pytest.raises(fgs_slam.DatasetError, match="nowhere"):
        fgs_slam.Trajectory.read(tmp_path / "nowhere")


def test_exports(finished: fgs_slam.Run, tmp_path: Path) -> None:
    assert fgs_slam.export(finished, "spz") == finished.path / "export" / "map.spz"
    raw = fgs_slam.export(str(finished.path), "ply", out=tmp_path / "a" / "map.ply", raw_axes=True)
    own = finished.gaussians()
    np.testing.assert_array_equal(fgs_slam.Gaussians.read(raw).means, own.means)
    level = fgs_slam.export(finished, "ply", out=tmp_path / "level.ply")
    assert not np.array_equal(fgs_slam.Gaussians.read(level).means, own.means)
    told: list[tuple[str, int, int]] = []
    mesh = fgs_slam.export(finished, "mesh-obj", voxel_m=0.1, progress=lambda *step: told.append(step))
    assert mesh.read_text().count("\nf ") > 100
    assert told and told[-1][1] == told[-1][2]
    with pytest.raises(fgs_slam.SettingError, match="to: 'png' is no format"):
        fgs_slam.export(finished, "png")  # type: ignore[arg-type]
    with pytest.raises(fgs_slam.SettingError, match="0.001 to 1 m"):
        fgs_slam.export(finished, "mesh-obj", voxel_m=0)
    with pytest.raises(fgs_slam.FileError, match="belongs to the run"):
        fgs_slam.export(finished, "ply", out=finished.path / "map.ply")
    with pytest.raises(fgs_slam.FileError, match="not the folder of a run"):
        fgs_slam.export(tmp_path, "ply")


def test_every_exception_is_of_the_package() -> None:
    names = [name for name in fgs_slam.__all__ if name.endswith("Error")]
    assert len(names) == 11
    for name in names:
        assert issubclass(getattr(fgs_slam, name), fgs_slam.FgsError)
        assert getattr(fgs_slam.errors, name) is getattr(fgs_slam, name)


def test_poses_of_a_device_are_not_the_truth(room: Path, tmp_path: Path) -> None:
    assert fgs_slam.Recording(room).device_poses is None
    copy = tmp_path / "room"
    shutil.copytree(room, copy)
    (copy / "groundtruth.txt").rename(copy / "device_poses.txt")
    recording = fgs_slam.Recording(copy)
    assert recording.ground_truth is None
    assert recording.device_poses is not None
    assert len(recording.device_poses) == len(recording)

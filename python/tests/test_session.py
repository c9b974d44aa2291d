"""Frames in, poses and maps out."""

import signal
import threading
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import fgs_slam


def test_poses_are_matrices_with_verdicts(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    poses = [slam.push(*frame) for frame in recording]
    assert [pose.index for pose in poses] == list(range(12))
    assert [pose.timestamp for pose in poses] == [frame[2] for frame in recording]
    assert {pose.verdict for pose in poses} == {"tracked"}
    assert poses[0].is_keyframe
    first, last = poses[0], poses[-1]
    assert first.uncertainty_m is None  # it defines the world
    assert last.uncertainty_m is not None and 0 < last.uncertainty_m < 0.01
    assert first.world_from_camera is not None and last.world_from_camera is not None
    np.testing.assert_array_equal(first.world_from_camera, np.eye(4))
    pose = last.world_from_camera
    assert pose.dtype == np.float64 and pose.shape == (4, 4)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    truth = recording.ground_truth
    assert truth is not None
    expected = np.linalg.inv(truth.poses[0]) @ truth.poses[-1]
    assert np.linalg.norm(pose[:3, 3] - expected[:3, 3]) < 0.01 < np.linalg.norm(expected[:3, 3])


def test_the_result_is_that_of_a_run(
    slam: fgs_slam.Slam, recording: fgs_slam.Recording, finished: fgs_slam.Run, tmp_path: Path
) -> None:
    for frame in recording:
        slam.push(*frame)
    result = slam.finish()
    result.trajectory.write(tmp_path / "trajectory.txt")
    result.gaussians.write(tmp_path / "map.ply")
    for name in ["trajectory.txt", "map.ply"]:
        assert (tmp_path / name).read_bytes() == (finished.path / name).read_bytes(), name
    assert result.verdicts == finished.verdicts() == ["tracked"] * 12
    assert len(result.keyframes) == finished.metrics()["keyframes"]
    assert result.keyframes[0] == 0 and result.keyframes[-1] == 11
    assert result.refined is None and result.failure is None and result.loops == 0


def test_a_refined_map_is_another(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    for frame in recording:
        slam.push(*frame)
    result = slam.finish(refine=5)
    assert result.refined is not None
    assert not np.array_equal(result.gaussians.sh, result.refined.sh)


def test_ctrl_c_ends_a_refinement(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    for frame in recording:
        slam.push(*frame)
    timer = threading.Timer(0.5, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        slam.finish(refine=1_000_000)
    timer.join()
    assert slam.finish().refined is not None


def test_a_finished_session_says_so(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    frame = recording[0]
    slam.push(*frame)
    result = slam.finish()
    assert slam.finish() is result
    calls: list[Callable[[], object]] = [
        slam.snapshot,
        slam.gaussians,
        lambda: slam.push(*frame),
        lambda: slam.render(np.eye(4)),
    ]
    for call in calls:
        with pytest.raises(fgs_slam.SessionError, match="finished"):
            call()


def test_an_empty_session_can_be_finished(slam: fgs_slam.Slam) -> None:
    assert len(slam.snapshot()) == 0
    assert not slam.render(np.eye(4)).color.any()
    result = slam.finish()
    assert len(result.trajectory) == 0 and result.trajectory.poses.shape == (0, 4, 4)
    assert result.gaussians.means.shape == (0, 3)


def test_a_render_shows_what_the_camera_sees(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    for frame in recording:
        pose = slam.push(*frame)
    color, depth_m, _ = frame
    render = slam.render(pose)
    assert render.color.dtype == np.uint8 and render.color.shape == (120, 160, 3)
    assert render.depth_m.dtype == render.alpha.dtype == np.float32
    assert np.mean(np.abs(render.color.astype(float) - color)) < 12
    seen = (depth_m > 0) & (render.depth_m > 0)
    assert np.median(np.abs(render.depth_m - depth_m)[seen]) < 0.05
    assert 0 <= render.alpha.min() and 0.9 < render.alpha.mean() <= 1

    assert pose.world_from_camera is not None
    smaller = slam.render(pose.world_from_camera, recording.camera.resized(80, 60))
    assert smaller.color.shape == (60, 80, 3)
    again = slam.snapshot().render(pose, recording.camera)
    np.testing.assert_array_equal(again.color, render.color)


def test_other_threads_go_on_while_it_computes(recording: fgs_slam.Recording) -> None:
    config = fgs_slam.Config(mapping={"iterations_per_frame": 100})
    slam = fgs_slam.Slam(config, recording.camera, backend="cpu")
    ticks: list[float] = []
    ended = threading.Event()

    def tick() -> None:
        while not ended.wait(0.001):
            ticks.append(time.perf_counter())

    ticker = threading.Thread(target=tick)
    ticker.start()
    start = time.perf_counter()
    slam.push(*recording[0])
    end = time.perf_counter()
    ended.set()
    ticker.join()
    # Were it not so, at most one tick could come between two instructions.
    assert sum(start < tick < end for tick in ticks) >= 5, end - start


def test_calls_of_several_threads_take_turns(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    slam.push(*recording[0])
    lengths: list[int] = []
    threads = [threading.Thread(target=lambda: lengths.append(len(slam.snapshot()))) for _ in range(4)]
    for thread in threads:
        thread.start()
    slam.push(*recording[1])
    for thread in threads:
        thread.join()
    assert len(lengths) == 4 and min(lengths) > 0


def test_maps_and_frames_are_not_copied_by_numpy(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    """What NumPy allocates is traced, what Rust allocates is not."""
    color, depth_m, timestamp = recording[0]
    tracemalloc.start()
    slam.push(color, depth_m, timestamp)
    pushed = tracemalloc.get_traced_memory()[1]
    gaussians = slam.snapshot()
    arrays = gaussians.arrays()
    taken = tracemalloc.get_traced_memory()[1]
    copied = gaussians.means.copy()
    copying = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert pushed < min(color.nbytes, depth_m.nbytes) / 2
    assert taken < gaussians.means.nbytes / 2 < copied.nbytes <= copying
    assert gaussians.means is gaussians.means is arrays["means"]


def test_realtime_and_parallel_sessions(recording: fgs_slam.Recording) -> None:
    for mode in ("parallel", "realtime"):
        slam = fgs_slam.Slam(fgs_slam.Config(), recording.camera, mode=mode, backend="cpu")
        for frame in recording:
            slam.push(*frame)
        assert len(slam.finish().trajectory) == 12


def test_choices_are_checked(recording: fgs_slam.Recording) -> None:
    with pytest.raises(fgs_slam.SettingError, match="mode: 'fast' is none of lockstep"):
        fgs_slam.Slam(fgs_slam.Config(), recording.camera, mode="fast")  # type: ignore[arg-type]
    with pytest.raises(fgs_slam.SettingError, match="backend: "):
        fgs_slam.Slam(fgs_slam.Config(), recording.camera, backend="abacus")  # type: ignore[arg-type]


def test_a_device_that_proves_right_starts_tracking(tmp_path: Path) -> None:
    fgs_slam.synth(tmp_path / "room", frames=24, size=(160, 120))
    recording = fgs_slam.Recording(tmp_path / "room")
    truth = recording.ground_truth
    assert truth is not None

    def poses(device: bool) -> list[np.ndarray]:
        slam = fgs_slam.Slam(fgs_slam.Config(), recording.camera, backend="cpu")
        for frame, pose in zip(recording, truth.poses, strict=True):
            slam.push(*frame, device_pose=pose if device else None)
        return list(slam.finish().trajectory.poses)

    alone, helped = poses(False), poses(True)
    # The first frames judge the device.
    assert all(np.array_equal(a, b) for a, b in zip(alone[:14], helped, strict=False))
    assert not np.array_equal(alone[-1], helped[-1])
    assert np.allclose(alone[-1], helped[-1], atol=0.01)


def test_a_device_pose_is_a_rigid_motion(slam: fgs_slam.Slam, recording: fgs_slam.Recording) -> None:
    frame = next(iter(recording))
    with pytest.raises(fgs_slam.ShapeError):
        slam.push(*frame, device_pose=np.eye(3))

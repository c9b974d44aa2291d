"""What is no frame or no pose is refused in words; unusual memory layouts are not."""

import re
from typing import Any

import numpy as np
import pytest

import fgs_slam

Array = np.ndarray[Any, Any]


@pytest.fixture
def frame(recording: fgs_slam.Recording) -> tuple[Array, Array]:
    color, depth_m, _ = recording[0]
    return color, depth_m


def refuse(slam: fgs_slam.Slam, color: Any, depth_m: Any, words: str) -> None:
    with pytest.raises(fgs_slam.ShapeError, match=re.escape(words)):
        slam.push(color, depth_m, 0.0)


def test_shapes_and_types(slam: fgs_slam.Slam, frame: tuple[Array, Array]) -> None:
    color, depth_m = frame
    expected = "color: expected uint8 of shape (H, W, 3), got "
    refuse(slam, color[..., :2], depth_m, expected + "uint8 of shape [120, 160, 2]")
    refuse(slam, color[..., 0], depth_m, expected + "uint8 of shape [120, 160]")
    refuse(slam, color / 255, depth_m, expected + "float64 of shape [120, 160, 3]")
    refuse(slam, None, depth_m, expected + "object of shape []")
    expected = "depth_m: expected metres as float32 or float64 of shape (H, W), got "
    millimetres = (1000 * depth_m).astype(np.uint16)
    refuse(slam, color, millimetres, expected + "uint16 of shape [120, 160]")
    refuse(slam, color, depth_m[None], expected + "float32 of shape [1, 120, 160]")
    with pytest.raises(TypeError):
        slam.push(color, depth_m, "now")  # type: ignore[arg-type]


def test_frames_of_another_kind(slam: fgs_slam.Slam, frame: tuple[Array, Array]) -> None:
    color, depth_m = frame
    with pytest.raises(fgs_slam.FrameError, match="colour is 80x120, but the camera is 160x120"):
        slam.push(color[:, :80], depth_m, 0.0)
    with pytest.raises(fgs_slam.FrameError, match="depth is 160x60, but"):
        slam.push(color, depth_m[:60], 0.0)
    with pytest.raises(fgs_slam.FrameError, match=r"depth at pixel \(0, 0\) is negative: -9"):
        slam.push(color, depth_m - 100 * (depth_m > 0), 0.0)
    for timestamp in (np.nan, np.inf):
        with pytest.raises(fgs_slam.FrameError, match="not finite"):
            slam.push(color, depth_m, timestamp)
    slam.push(color, depth_m, 2.0)
    with pytest.raises(fgs_slam.FrameError, match="timestamp 2 s is not later than the frame before, at 2 s"):
        slam.push(color, depth_m, 2.0)
    # What was refused is not counted.
    assert slam.push(color, depth_m, 3.0).index == 1


def test_memory_layouts(recording: fgs_slam.Recording, frame: tuple[Array, Array]) -> None:
    color, depth_m = frame

    def map_of(color: Array, depth_m: Array) -> dict[str, Array]:
        slam = fgs_slam.Slam(fgs_slam.Config(), recording.camera, backend="cpu")
        slam.push(color, depth_m, 0.0)
        return slam.gaussians()

    expected = map_of(color, depth_m)
    assert expected["means"].size
    wide = np.zeros((120, 320, 3), np.uint8)
    wide[:, ::2] = color
    read_only = color.copy()
    read_only.flags.writeable = False
    layouts = [
        (color[..., ::-1].copy()[..., ::-1], depth_m.astype(np.float64)),
        (np.asfortranarray(color), np.asfortranarray(depth_m)),
        (wide[:, ::2], np.where(depth_m == 0, np.nan, depth_m)),
        (read_only, depth_m[::-1].copy()[::-1]),
    ]
    for color, depth_m in layouts:
        for name, array in map_of(color, depth_m).items():
            np.testing.assert_array_equal(array, expected[name], name)


def test_poses(slam: fgs_slam.Slam, frame: tuple[Array, Array]) -> None:
    slam.push(*frame, 0.0)
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    projective = np.eye(4)
    projective[3, 0] = 0.1
    for pose in [np.eye(3), np.zeros((4, 4)), mirror, projective, np.full((4, 4), np.nan), "here", None]:
        with pytest.raises(fgs_slam.ShapeError, match="pose: "):
            slam.render(pose)  # type: ignore[arg-type]
    for dtype in (np.float32, np.int64):
        assert slam.render(np.eye(4, dtype=dtype).tolist()).color.any()


def test_maps_are_made_of_arrays(slam: fgs_slam.Slam, frame: tuple[Array, Array]) -> None:
    slam.push(*frame, 0.0)
    gaussians = slam.snapshot()
    arrays = gaussians.arrays()
    near = gaussians.means[:, 2] < 2.5
    assert 0 < near.sum() < len(gaussians)
    part = fgs_slam.Gaussians(**{name: array[near] for name, array in arrays.items()})
    assert len(part) == near.sum()
    with pytest.raises(fgs_slam.ShapeError, match="differ in length"):
        fgs_slam.Gaussians(**{**arrays, "quats": arrays["quats"][1:]})
    with pytest.raises(fgs_slam.ShapeError, match=r"means: expected float32 or float64 of shape \(N, 3\)"):
        fgs_slam.Gaussians(**{**arrays, "means": arrays["quats"]})


def test_changed_arrays_are_rendered(
    slam: fgs_slam.Slam, recording: fgs_slam.Recording, frame: tuple[Array, Array]
) -> None:
    slam.push(*frame, 0.0)
    gaussians = slam.snapshot()
    assert gaussians.render(np.eye(4), recording.camera).alpha.mean() > 0.5
    gaussians.opacity_logits[:] = -20
    assert gaussians.render(np.eye(4), recording.camera).alpha.max() == 0
    gaussians.means[0] = np.nan
    assert gaussians.render(np.eye(4), recording.camera).alpha.max() == 0


def test_images_that_do_not_fit_in_memory() -> None:
    with pytest.raises(fgs_slam.SettingError, match="fx = 1"):
        fgs_slam.Camera(640, 480, 1, 500, 320, 240)
    with pytest.raises(OverflowError):
        fgs_slam.Camera(-1, 480, 500, 500, 320, 240)
    huge = fgs_slam.Camera(65536, 65536, 65536, 65536, 100, 100)
    empty = np.zeros((0, 3))
    gaussians = fgs_slam.Gaussians(empty, np.zeros((0, 4)), empty, np.zeros(0), empty)
    with pytest.raises(fgs_slam.SettingError, match="at most 33177600 pixels"):
        gaussians.render(np.eye(4), huge)
    with pytest.raises(fgs_slam.SettingError, match="at most 33177600 pixels"):
        fgs_slam.Slam(fgs_slam.Config(), huge)

"""Stages of the system beside small_gicp's and SciPy's, on the same frames in the same run.

Runs `fgs bench RECORDING` (target/release/fgs; build it first) and then the peers on what it used: registration of
neighbouring frames and to a map of ten frames, the error of up to 50 pairs of neighbours against the known poses, and the
Fourier segmentation with SciPy and OpenCV. README.md beside this file has the command.
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import time

import cv2
import numpy as np
import scipy.fft
import small_gicp

from odometry import (
    MAX_CORRESPONDENCE_DISTANCE_M, MAX_ITERATIONS, NEIGHBORS, ROTATION_EPSILON_RAD, TRANSLATION_EPSILON_M,
    prepare, read_camera, read_points, read_sequence,
)

FGS = pathlib.Path(__file__).parents[2] / "target/release/fgs"
RUNS = 15
STRIDE = 5
PAIRS, MAP_FRAMES, VOXEL_M = 50, 10, 0.01  # as in fgs bench
PADDING = 10


def times_ms(work):
    """Median and best wall time, after one run that warms up."""
    times = []
    for _ in range(RUNS + 1):
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[1:]), min(times[1:])


def register(target, source_points, start, threads):
    source, _ = prepare(source_points, threads)
    return small_gicp.align(
        target[0], source, target[1], start, "GICP", max_correspondence_distance=MAX_CORRESPONDENCE_DISTANCE_M,
        num_threads=threads, max_iterations=MAX_ITERATIONS, rotation_epsilon=ROTATION_EPSILON_RAD,
        translation_epsilon=TRANSLATION_EPSILON_M,
    ).T_target_source


def moved(pose, points):
    return points @ pose[:3, :3].T + pose[:3, 3]


def segment(gray):
    height, width = gray.shape
    padded = cv2.copyMakeBorder(gray, *[PADDING] * 4, cv2.BORDER_REFLECT_101)
    padded = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(32, 32)).apply(padded)
    response = np.abs(scipy.fft.irfft2(scipy.fft.rfft2(padded.astype(np.float32)) * segment.high_pass, padded.shape))
    response = response[PADDING:-PADDING, PADDING:-PADDING]
    low, high = response.min(), response.max()
    level = np.rint((response - low) * (255 / (high - low))).astype(np.uint8)
    return cv2.threshold(level, 0, 255, cv2.THRESH_TRIANGLE)[1]


def plan_segmentation(height, width):
    rows, columns = height + 2 * PADDING, width + 2 * PADDING
    distance2 = np.fft.fftfreq(rows, 1 / rows)[:, None] ** 2 + np.fft.rfftfreq(columns, 1 / columns) ** 2
    segment.high_pass = (1 - np.exp(-distance2 / (2 * (min(height, width) // 20) ** 2))).astype(np.float32)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", type=pathlib.Path, help="folder in the TUM or the Replica layout, with known poses")
    parser.add_argument("--camera", type=pathlib.Path, help="default: RECORDING/camera.toml")
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    options.intrinsics = None

    command = [FGS, "bench", options.sequence, "--first", str(options.first), "--json"]
    command += ["--camera", options.camera] if options.camera else []
    events = [json.loads(line) for line in subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()]
    ours = {(row["stage"], row["threads"]): (row["median_ms"], row["best_ms"]) for row in events if row["event"] == "stage"}
    our_error_mm = next(row["median_mm"] for row in events if row["event"] == "registration_error")

    intrinsics, depth_scale = read_camera(options)
    times, paths, reference = read_sequence(options.sequence)
    frames = range(options.first, min(len(paths), options.first + PAIRS + 1))
    points = [read_points(paths[i], intrinsics, depth_scale, STRIDE) for i in frames]
    nearest = [int(np.argmin(np.abs(reference.timestamps - times[i]))) for i in frames]
    poses = [np.asarray(reference.poses_se3[i]) for i in nearest]

    def print_row(name, threads, peer, our):
        print(f"{name:26} {threads:7}   {peer[0]:8.2f} {peer[1]:8.2f}   {our[0]:8.2f} {our[1]:8.2f}   {peer[0] / our[0]:6.1f} {peer[1] / our[1]:6.1f}")

    print(f"{'':26} threads   peer: median, best   ours: median, best    ratio of either (ms)")
    last = min(len(points) - 1, MAP_FRAMES)
    merged = np.concatenate([moved(poses[i], points[i]) for i in range(last)])
    for threads in (1, 2):
        frame_target = prepare(points[last - 1], threads)
        relative = np.eye(4)
        peer = times_ms(lambda: register(frame_target, points[last], relative, threads))
        print_row("registration to a frame", threads, peer, ours["registration to a frame", threads])
        thinned = small_gicp.voxelgrid_sampling(merged, VOXEL_M, threads).points()[:, :3]
        map_target = prepare(thinned, threads)
        peer = times_ms(lambda: register(map_target, points[last], poses[last - 1], threads))
        print_row("registration to a map", threads, peer, ours["registration to a map", threads])
    print(f"points, peer: {len(points[last])} to {len(points[last - 1])} and to {len(thinned)} ({NEIGHBORS} neighbours a covariance)")
    works = sorted({row["work"] for row in events if row["event"] == "stage" and row["stage"].startswith("registration")})
    print(f"points, ours: {'; '.join(works)}")

    errors_mm = []
    for i in range(1, len(points)):
        found = poses[i - 1] @ register(prepare(points[i - 1], 1), points[i], np.eye(4), 1)
        error = moved(found, points[i]) - moved(poses[i], points[i])
        errors_mm.append(1e3 * np.sqrt(np.mean(np.sum(error**2, axis=1))))
    print(f"median error of {len(errors_mm)} pairs: peer {statistics.median(errors_mm):.3f} mm, ours {our_error_mm:.3f} mm")

    color_paths = sorted((options.sequence / "results").glob("frame*.jpg")) or sorted((options.sequence / "rgb").iterdir())
    color = cv2.imread(str(color_paths[options.first]))
    plan_segmentation(*color.shape[:2])
    cv2.setNumThreads(1)
    peer = times_ms(lambda: segment(cv2.cvtColor(color, cv2.COLOR_BGR2GRAY)))
    print_row("segmentation (SciPy)", 1, peer, ours["segmentation", 1])


if __name__ == "__main__":
    main()

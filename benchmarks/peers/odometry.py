"""Odometry by small_gicp, frame to keyframe, as a peer to compare trajectories with.

Reads an RGB-D sequence in the TUM or the Replica layout, registers the depth of every frame to that of the
last keyframe, and prints ATE and RPE as `evo` computes them; with --ours also those of another trajectory of
the same sequence. README.md beside this file has the commands.
"""
import argparse
import pathlib
import time
import tomllib

import cv2
import numpy as np
import small_gicp
from evo.core import lie_algebra, metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

NEIGHBORS = 20  # of which a point's covariance is made
MAX_ITERATIONS = 64
ROTATION_EPSILON_RAD, TRANSLATION_EPSILON_M = 2e-3, 5e-4
MAX_CORRESPONDENCE_DISTANCE_M = 0.03
MAX_DEPTH_M = 12.0
# Having moved so far from the last keyframe, a frame becomes the next. (The share of points with a partner is no
# measure here: at wide strides the points lie further apart than the correspondence distance.)
KEYFRAME_DISTANCE_M, KEYFRAME_ANGLE_RAD = 0.5, np.radians(30)
REPLICA_FRAMES_PER_SECOND = 30.0  # the layout has no times
MAX_TIME_DIFFERENCE_SECS = 0.02


def read_camera(options):
    """fx, fy, cx, cy and depth units per metre."""
    if options.intrinsics:
        return options.intrinsics, options.depth_scale
    path = options.camera or options.sequence / "camera.toml"
    camera = tomllib.loads(path.read_text())
    return [camera[key] for key in ("fx", "fy", "cx", "cy")], camera["depth_scale"]


def read_sequence(folder):
    """Times and paths of the depth images, and the reference trajectory."""
    if (folder / "depth.txt").exists():
        lines = [line.split() for line in (folder / "depth.txt").read_text().splitlines() if line[0] != "#"]
        reference = file_interface.read_tum_trajectory_file(folder / "groundtruth.txt")
        return [float(line[0]) for line in lines], [folder / line[1] for line in lines], reference
    paths = sorted((folder / "results").glob("depth*.png"))
    times = np.arange(len(paths)) / REPLICA_FRAMES_PER_SECOND
    poses = np.loadtxt(folder / "traj.txt").reshape(-1, 4, 4)[: len(paths)]
    return times, paths, PoseTrajectory3D(poses_se3=list(poses), timestamps=times)


def read_points(path, intrinsics, depth_scale, stride):
    """The points of every stride-th pixel in either direction, in camera axes, metres."""
    fx, fy, cx, cy = intrinsics
    depth_m = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::stride, ::stride] / depth_scale
    v, u = stride * np.mgrid[0 : depth_m.shape[0], 0 : depth_m.shape[1]]
    points = np.stack([(u - cx) / fx * depth_m, (v - cy) / fy * depth_m, depth_m], -1)
    return points[(depth_m > 0) & (depth_m <= MAX_DEPTH_M)]


def prepare(points, threads):
    cloud = small_gicp.PointCloud(points)
    tree = small_gicp.KdTree(cloud, num_threads=threads)
    small_gicp.estimate_covariances(cloud, tree, NEIGHBORS, threads)
    return cloud, tree


def is_far(motion):
    angle_rad = np.linalg.norm(lie_algebra.so3_log(motion[:3, :3]))
    return np.linalg.norm(motion[:3, 3]) > KEYFRAME_DISTANCE_M or angle_rad > KEYFRAME_ANGLE_RAD


def run_odometry(clouds, threads):
    """Poses in the first camera's axes, number of keyframes, CPU seconds of registration."""
    poses, keyframes, cpu_secs = [np.eye(4)], 1, 0.0
    start = time.process_time()
    keyframe, keyframe_pose = prepare(next(clouds), threads), np.eye(4)
    cpu_secs += time.process_time() - start
    for points in clouds:
        start = time.process_time()
        cloud, tree = prepare(points, threads)
        result = small_gicp.align(
            keyframe[0], cloud, keyframe[1], np.linalg.inv(keyframe_pose) @ poses[-1], "GICP",
            max_correspondence_distance=MAX_CORRESPONDENCE_DISTANCE_M, num_threads=threads,
            max_iterations=MAX_ITERATIONS, rotation_epsilon=ROTATION_EPSILON_RAD,
            translation_epsilon=TRANSLATION_EPSILON_M,
        )
        poses.append(keyframe_pose @ result.T_target_source)
        if is_far(result.T_target_source):
            keyframe, keyframe_pose, keyframes = (cloud, tree), poses[-1], keyframes + 1
        cpu_secs += time.process_time() - start
    return poses, keyframes, cpu_secs


def print_errors(name, reference, estimated):
    """ATE after alignment without scale, RPE from each estimated pose to the next."""
    reference, estimated = sync.associate_trajectories(reference, estimated, max_diff=MAX_TIME_DIFFERENCE_SECS)
    relative = metrics.RPE(metrics.PoseRelation.translation_part)
    rotation = metrics.RPE(metrics.PoseRelation.rotation_angle_deg)
    for metric in (relative, rotation):
        metric.process_data((reference, estimated))
    estimated.align(reference, correct_scale=False)
    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data((reference, estimated))
    ate, rpe, rpe_deg = (metric.get_all_statistics() for metric in (absolute, relative, rotation))
    print(
        f"{name:12} {estimated.num_poses:6} {100 * ate['rmse']:12.4f} {100 * ate['mean']:12.4f}"
        f" {1000 * rpe['rmse']:12.4f} {1000 * rpe['mean']:12.4f} {rpe_deg['rmse']:13.5f}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", type=pathlib.Path, help="folder in the TUM or the Replica layout")
    parser.add_argument("--camera", type=pathlib.Path, help="default: SEQUENCE/camera.toml")
    parser.add_argument("--intrinsics", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"), help="instead of a camera file")
    parser.add_argument("--depth-scale", type=float, default=6553.5, help="units per metre, with --intrinsics")
    parser.add_argument("--stride", type=int, default=5, help="pixels from point to point")
    parser.add_argument("--frames", type=int, help="only the first so many")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--ours", type=pathlib.Path, help="a TUM trajectory of the same sequence to print as well")
    parser.add_argument("--write", type=pathlib.Path, help="where to write the peer's trajectory (TUM format)")
    options = parser.parse_args()

    intrinsics, depth_scale = read_camera(options)
    times, paths, reference = read_sequence(options.sequence)
    times, paths = times[: options.frames], paths[: options.frames]
    clouds = (read_points(path, intrinsics, depth_scale, options.stride) for path in paths)
    poses, keyframes, cpu_secs = run_odometry(clouds, options.threads)
    estimated = PoseTrajectory3D(poses_se3=poses, timestamps=np.asarray(times, dtype=float))
    if options.write:
        file_interface.write_tum_trajectory_file(options.write, estimated)

    print(f"small_gicp: {keyframes} keyframes, {1000 * cpu_secs / len(paths):.1f} CPU ms a frame, {options.threads} thread(s)")
    print(f"{'':12} {'poses':>6} {'ATE rmse cm':>12} {'ATE mean cm':>12} {'RPE rmse mm':>12} {'RPE mean mm':>12} {'RPE rmse deg':>13}")
    print_errors("small_gicp", reference, estimated)
    if options.ours:
        print_errors("ours", reference, file_interface.read_tum_trajectory_file(options.ours))


if __name__ == "__main__":
    main()

"""Trajectories with their ATE and RPE computed by evo.

usage: python make_trajectory.py        (pip install evo)

Writes estimated.txt and reference.txt (TUM format: time, position, quaternion xyzw) and expected.txt
(pairs associated within 0.02 s, ATE, RPE) here. The estimate lacks frames, its clock is a little off, one
stretch is far off (so that mean and rmse differ) and it stands in another coordinate frame.
"""
import pathlib

import numpy as np
from evo.core import lie_algebra, metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

HERE = pathlib.Path(__file__).parent
STATISTICS = ("rmse", "mean", "median", "max", "std")


def poses():
    rng = np.random.default_rng(7)
    pose, reference = np.eye(4), []
    for i in range(60):
        turn = lie_algebra.so3_exp(np.array([0.03 * np.sin(i / 5), 0.05, 0.02 * np.cos(i / 9)]))
        pose = pose @ lie_algebra.se3(turn, np.array([0.02, 0.01 * np.sin(i), 0.03]))
        reference.append(pose)
    frame = lie_algebra.se3(lie_algebra.so3_exp(np.array([1.0, -0.7, 2.0])), np.array([5.0, -3.0, 1.0]))
    estimated = []
    for i, pose in enumerate(reference):
        slip = 0.3 if 20 <= i < 26 else 0.005
        noise = lie_algebra.se3(lie_algebra.so3_exp(rng.normal(0, 0.01, 3)), rng.normal(0, slip, 3))
        estimated.append(frame @ pose @ noise)
    times = np.arange(60) / 30
    kept = [i for i in range(60) if i not in (3, 4, 31, 58)]
    reference = PoseTrajectory3D(poses_se3=reference, timestamps=times)
    estimated = PoseTrajectory3D(
        poses_se3=[estimated[i] for i in kept], timestamps=times[kept] + rng.uniform(-0.005, 0.005, len(kept))
    )
    return reference, estimated


def read_back(name, trajectory):
    """What is compared is what is in the file."""
    file_interface.write_tum_trajectory_file(HERE / name, trajectory)
    return file_interface.read_tum_trajectory_file(HERE / name)


def main():
    reference, estimated = poses()
    reference, estimated = read_back("reference.txt", reference), read_back("estimated.txt", estimated)
    lines = []
    for i, j in zip(*sync.matching_time_indices(estimated.timestamps, reference.timestamps, 0.02)):
        lines.append(f"pair {i} {j}")
    reference, estimated = sync.associate_trajectories(reference, estimated, max_diff=0.02)
    relations = (("translation_m", metrics.PoseRelation.translation_part),
                 ("rotation_deg", metrics.PoseRelation.rotation_angle_deg))
    for delta in (1, 10):
        for name, relation in relations:
            metric = metrics.RPE(relation, delta, metrics.Unit.frames, all_pairs=True)
            metric.process_data((reference, estimated))
            values = metric.get_all_statistics()
            lines += [f"rpe_{delta}_{name}_{key} {values[key]:.17g}" for key in STATISTICS]
    estimated.align(reference, correct_scale=False)
    metric = metrics.APE(metrics.PoseRelation.translation_part)
    metric.process_data((reference, estimated))
    values = metric.get_all_statistics()
    lines += [f"ate_{key} {values[key]:.17g}" for key in STATISTICS]
    (HERE / "expected.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(line for line in lines if not line.startswith("pair")))


main()

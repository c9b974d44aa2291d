"""Makes the golden graphs of this folder with GTSAM (pip install gtsam numpy).

Each file holds poses before (`pose`) and after (`best`) optimisation, and edges:

    pose ID tx ty tz qw qx qy qz
    edge FROM TO tx ty tz qw qx qy qz i11 i12 .. i66   (upper triangle, tangent rotation first)
    best ID tx ty tz qw qx qy qz
"""
import pathlib

import gtsam
import numpy as np

HERE = pathlib.Path(__file__).parent


def numbers(pose):
    q = pose.rotation().toQuaternion()
    return " ".join(repr(float(x)) for x in (*pose.translation(), q.w(), q.x(), q.y(), q.z()))


def circle():
    """Once round and back to the start, looking inwards, climbing a little."""
    angles = np.linspace(0, 2 * np.pi, 41)[:-1]
    poses = [gtsam.Pose3(gtsam.Rot3.Ypr(a, 0.2 * np.sin(2 * a), 0.1), np.array([3 * np.cos(a), 3 * np.sin(a), 0.2 * a])) for a in angles]
    pairs = [(i, i + 1) for i in range(39)] + [(39, 0), (20, 3)]
    return poses, pairs


def sphere():
    """Rings from pole to pole, each pose tied to the next and to the one a ring above."""
    rings, ring = 6, 10
    poses = []
    for i in range(rings * ring):
        latitude, longitude = np.pi * (i / (rings * ring) - 0.5) * 0.9, 2 * np.pi * i / ring
        direction = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
        poses.append(gtsam.Pose3(gtsam.Rot3.Ypr(longitude, -latitude, 0.3), 2.0 * direction))
    count = len(poses)
    return poses, [(i, i + 1) for i in range(count - 1)] + [(i, i + ring) for i in range(count - ring)]


def make(name, poses, pairs, seed):
    rng = np.random.default_rng(seed)
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.NonlinearEqualityPose3(0, poses[0]))
    lines, measured = [], {}
    for a, b in pairs:
        root = rng.normal(size=(6, 6)) * 0.2 + np.eye(6)
        scale = np.diag([0.02] * 3 + [0.05] * 3) @ root
        noise = scale @ rng.normal(size=6)
        covariance = scale @ scale.T
        information = np.linalg.inv(covariance)
        information = 0.5 * (information + information.T)
        between = poses[a].between(poses[b]).compose(gtsam.Pose3.Expmap(noise))
        measured[a, b] = between
        graph.add(gtsam.BetweenFactorPose3(a, b, between, gtsam.noiseModel.Gaussian.Information(information)))
        upper = " ".join(repr(float(x)) for x in information[np.triu_indices(6)])
        lines.append(f"edge {a} {b} {numbers(between)} {upper}")
    pose = poses[0]
    initial.insert(0, pose)
    starts = [pose]
    for i in range(1, len(poses)):
        pose = pose.compose(measured[i - 1, i])
        starts.append(pose)
        initial.insert(i, pose)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-15)
    parameters.setAbsoluteErrorTol(1e-15)
    parameters.setMaxIterations(200)
    best = gtsam.LevenbergMarquardtOptimizer(graph, initial, parameters).optimize()
    print(name, "chi2", 2 * graph.error(initial), "->", 2 * graph.error(best))
    head = [f"pose {i} {numbers(pose)}" for i, pose in enumerate(starts)]
    tail = [f"best {i} {numbers(best.atPose3(i))}" for i in range(len(poses))]
    (HERE / f"{name}.txt").write_text("\n".join(head + lines + tail) + "\n")


make("circle", *circle(), seed=1)
make("sphere", *sphere(), seed=2)

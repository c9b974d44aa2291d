"""Noisy pose graphs and their optima by GTSAM, an independent optimiser.

    pip install gtsam numpy && python make_golden.py

writes circle.txt and sphere.txt beside this file, one item a line:
    pose id  w x y z  tx ty tz             start (world_from_keyframe, metres)
    edge from to  w x y z  tx ty tz  ...   from_from_to and the upper triangle of its information
                                           matrix, row by row, tangent [omega, v]
    optimum id  w x y z  tx ty tz
    cost value                             sum of r^T information r at the optimum

GTSAM's own BetweenFactor leaves the logarithm's derivative out, which moves the optimum, so the
factors here are custom ones with it.
"""

from pathlib import Path

import gtsam
import numpy as np

UPPER = np.triu_indices(6)


def pose_text(pose):
    return rounded(list(pose.rotation().toQuaternion().coeffs()), pose.translation())


def rounded(xyzw, translation, digits=6):
    x, y, z, w = xyzw
    return " ".join(f"{value:.{digits}f}" for value in [w, x, y, z, *translation])


def parse_pose(text):
    w, x, y, z, *translation = [float(word) for word in text.split()]
    quaternion = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    return gtsam.Pose3(gtsam.Rot3.Quaternion(*quaternion), translation)


def factor(edge):
    a, b, measured, information = edge

    def error(this, values, jacobians):
        pose_a, pose_b = values.atPose3(a), values.atPose3(b)
        between = pose_a.between(pose_b)
        residual = gtsam.Pose3.Logmap(measured.inverse().compose(between))
        if jacobians is not None:
            d_b = np.linalg.inv(gtsam.Pose3.ExpmapDerivative(residual))
            jacobians[0] = -d_b @ between.inverse().AdjointMap()
            jacobians[1] = d_b
        return residual

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Information(information), [a, b], error)


def write(name, truth, pairs, rng, noise):
    lines, edges, starts = [], [], []
    for id, pose in enumerate(truth):
        # Drift: the further from the first, the worse the start.
        spread = 0.0 if id == 0 else 0.05 + 0.1 * id / len(truth)
        text = pose_text(pose.retract(rng.normal(size=6) * spread))
        lines.append(f"pose {id} {text}")
        starts.append(parse_pose(text))
    for a, b in pairs:
        # Whole numbers, neither isotropic nor diagonal.
        root = rng.integers(-3, 4, size=(6, 6)) + np.diag([20, 30, 25, 8, 10, 12])
        information = root @ root.T
        covariance_root = np.linalg.inv(root).T
        error = covariance_root @ rng.normal(size=6) * noise
        text = pose_text(truth[a].between(truth[b]).compose(gtsam.Pose3.Expmap(error)))
        upper = " ".join(str(value) for value in information[UPPER])
        lines.append(f"edge {a} {b} {text} {upper}")
        edges.append((a, b, parse_pose(text), information.astype(float)))

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.NonlinearEqualityPose3(0, starts[0]))
    for edge in edges:
        graph.add(factor(edge))
    for id, pose in enumerate(starts):
        values.insert(id, pose)
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    # It stops by the cost, which is flat there: some Gauss-Newton steps more, to rounding.
    polish = gtsam.GaussNewtonOptimizer(graph, optimum)
    for _ in range(10):
        polish.iterate()
    optimum = polish.values()
    for id in range(len(truth)):
        pose = optimum.atPose3(id)
        text = rounded(pose.rotation().toQuaternion().coeffs(), pose.translation(), 11)
        lines.append(f"optimum {id} {text}")
    lines.append(f"cost {2.0 * graph.error(optimum):.9f}")
    (Path(__file__).parent / name).write_text("\n".join(lines) + "\n")
    print(name, len(truth), len(pairs), 2 * graph.error(values), 2 * graph.error(optimum))


def circle(count, radius):
    angles = 2 * np.pi * np.arange(count) / count
    for angle in angles:
        rotation = gtsam.Rot3.Rz(angle).compose(gtsam.Rot3.Rx(0.3))
        yield gtsam.Pose3(rotation, radius * np.array([np.cos(angle), np.sin(angle), 0.1 * angle]))


def sphere(rings, per_ring, radius):
    for ring in range(rings):
        latitude = np.pi * (ring + 0.5) / rings - np.pi / 2
        for step in range(per_ring):
            longitude = 2 * np.pi * step / per_ring
            rotation = gtsam.Rot3.Rz(longitude).compose(gtsam.Rot3.Ry(-latitude))
            yield gtsam.Pose3(rotation, rotation.matrix() @ np.array([radius, 0, 0]))


def main():
    rng = np.random.default_rng(7)
    count = 40
    pairs = [(i, i + 1) for i in range(count - 1)] + [(count - 1, 0), (30, 5), (12, 37)]
    write("circle.txt", list(circle(count, 2.0)), pairs, rng, 1.0)
    rings, per_ring = 8, 12
    total = rings * per_ring
    pairs = [(i, i + 1) for i in range(total - 1)]
    pairs += [(i, i + per_ring) for i in range(total - per_ring)]
    write("sphere.txt", list(sphere(rings, per_ring, 3.0)), pairs, rng, 2.0)


main()

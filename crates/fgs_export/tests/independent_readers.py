"""Reads what `fgs export` wrote with other people's software and compares it with the run's map.

    for f in ply compressed-ply splat spz glb points mesh-ply mesh-obj mesh-glb tum kitti colmap nerfstudio
    do fgs export RUN --to $f; done
    pip install numpy scipy pillow plyfile trimesh pygltflib pycolmap open3d evo
    npm install @playcanvas/splat-transform
    python independent_readers.py RUN node_modules/.bin/splat-transform

Packages that are not installed are skipped, and said so.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from plyfile import PlyData
from scipy.spatial import cKDTree

SH0 = 0.28209479177387814


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(float)))


def gaussians(path):
    """Positions, colours, opacities, log-scales and wxyz of a PLY file of gaussians."""
    v = PlyData.read(path)["vertex"]
    columns = lambda names: np.stack([v[name] for name in names.split()], 1).astype(float)
    quats = columns("rot_0 rot_1 rot_2 rot_3")
    return {
        "mean": columns("x y z"),
        "rgb": 0.5 + SH0 * columns("f_dc_0 f_dc_1 f_dc_2"),
        "opacity": sigmoid(v["opacity"]),
        "log_scale": columns("scale_0 scale_1 scale_2"),
        "quat": quats / np.linalg.norm(quats, axis=1, keepdims=True),
    }


def covariances(g):
    w, x, y, z = g["quat"].T
    rotation = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)
    scaled = rotation * np.exp(g["log_scale"])[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)


def compare(name, read, expected):
    """Both in any order: matched by position."""
    count = len(expected["mean"])
    assert len(read["mean"]) == count, f"{name}: {len(read['mean'])} of {count}"
    distance, match = cKDTree(expected["mean"]).query(read["mean"])
    rgb = np.abs(np.clip(read["rgb"], 0, 1) - np.clip(expected["rgb"][match], 0, 1))
    opacity = np.abs(read["opacity"] - expected["opacity"][match])
    truth = covariances(expected)[match]
    spread = np.abs(covariances(read) - truth).max((1, 2)) / np.trace(truth, axis1=1, axis2=2)
    worst = lambda values: f"{np.median(values):.2g} / {np.quantile(values, 0.99):.2g}"
    print(f"{name}: {count} gaussians; median / 99 % of errors: position {worst(distance)} m, "
          f"colour {worst(rgb * 255)} and opacity {worst(opacity * 255)} of 255, "
          f"covariance {worst(spread)}")


def turned(g):
    """Half a turn about x."""
    flip = lambda values, signs: values * np.array(signs)
    return g | {"mean": flip(g["mean"], [1, -1, -1]), "quat": flip(g["quat"], [1, 1, -1, -1])}


def splat_transform(program, export, expected):
    """Its results are in the axes of PLY files, y down."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ["map.ply", "map.compressed.ply", "map.splat", "map.spz"]:
            out = Path(folder) / f"{name}.ply"
            subprocess.run([program, "-q", export / name, out], check=True)
            compare(f"{name} by splat-transform", gaussians(out), expected)


def glb(export, expected):
    import pygltflib

    file = pygltflib.GLTF2().load(str(export / "map.glb"))
    primitive = file.meshes[0].primitives[0]

    def rows(attribute):
        accessor = file.accessors[getattr(primitive.attributes, attribute)]
        view = file.bufferViews[accessor.bufferView]
        data = file.binary_blob()[view.byteOffset:][:view.byteLength]
        return np.frombuffer(data, np.float32).reshape(accessor.count, -1).astype(float)

    splatting = "KHR_gaussian_splatting:"
    read = {
        "mean": rows("POSITION"),
        "rgb": 0.5 + SH0 * rows(splatting + "SH_DEGREE_0_COEF_0"),
        "opacity": rows(splatting + "OPACITY")[:, 0],
        "log_scale": np.log(rows(splatting + "SCALE")),
        "quat": rows(splatting + "ROTATION")[:, [3, 0, 1, 2]],
    }
    compare("map.glb by pygltflib", read, turned(expected))


def meshes(export):
    import trimesh

    for name in ["mesh.ply", "mesh.obj", "mesh.glb"]:
        options = {"process": False, "skip_materials": True}
        mesh = trimesh.load(export / name, force="mesh", **options)
        color = mesh.visual.vertex_colors[:, :3].mean(0).round(1)
        print(f"{name} by trimesh: {len(mesh.vertices)} vertices, {len(mesh.faces)} triangles, "
              f"bounds {mesh.bounds.round(2).tolist()}, mean colour {color.tolist()}")


def with_open3d(export):
    import open3d

    points = open3d.io.read_point_cloud(str(export / "points.ply"))
    print(f"points.ply by open3d: {len(points.points)} points, colours {points.has_colors()}")
    for name in ["mesh.ply", "mesh.obj", "mesh.glb"]:
        mesh = open3d.io.read_triangle_mesh(str(export / name))
        print(f"{name} by open3d: {len(mesh.vertices)} vertices, {len(mesh.triangles)} triangles, "
              f"colours {mesh.has_vertex_colors()}, normals {mesh.has_vertex_normals()}")


def colmap(export, expected):
    import pycolmap

    model = pycolmap.Reconstruction(export / "colmap" / "sparse" / "0")
    camera = next(iter(model.cameras.values()))
    print(f"colmap by pycolmap: {camera.model.name} {camera.params.tolist()}, "
          f"{len(model.images)} images, {len(model.points3D)} points")
    # The points that project into an image have its colour there, where nothing hides them.
    from PIL import Image

    points = list(model.points3D.values())
    xyz = np.array([p.xyz for p in points])
    rgb = np.array([p.color for p in points])
    image = list(model.images.values())[len(model.images) // 2]
    pose = image.cam_from_world()
    camera_points = xyz @ pose.rotation.matrix().T + pose.translation
    fx, fy, cx, cy = camera.params
    x, y, z = camera_points.T
    u, v = (fx * x / z + cx).astype(int), (fy * y / z + cy).astype(int)
    inside = (z > 0.2) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    nearest = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(nearest, (v[inside], u[inside]), z[inside])
    front = inside.copy()
    front[inside] = z[inside] <= nearest[v[inside], u[inside]] + 0.02
    pixels = np.array(Image.open(export / "colmap" / "images" / image.name)).astype(float)
    error = np.abs(pixels[v[front], u[front]] - rgb[front]).mean(1)
    print(f"colmap: {front.sum()} points in {image.name}, "
          f"median colour error {np.median(error):.1f} of 255")


def nerfstudio(export):
    """nerfstudio's poses times OpenGL's axes are COLMAP's."""
    import pycolmap

    model = pycolmap.Reconstruction(export / "colmap" / "sparse" / "0")
    images = {image.name: image for image in model.images.values()}
    transforms = json.loads((export / "nerfstudio" / "transforms.json").read_text())
    worst = 0
    for frame in transforms["frames"]:
        image = images[Path(frame["file_path"]).name]
        pose = image.cam_from_world()
        matrix = np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        worst = max(worst, np.abs(np.linalg.inv(matrix)[:3] - pose.matrix()).max())
    print(f"nerfstudio: {len(transforms['frames'])} frames, poses as COLMAP's to {worst:.1g}")


def trajectories(export):
    from evo.core.metrics import APE, PoseRelation
    from evo.tools import file_interface

    tum = file_interface.read_tum_trajectory_file(export / "trajectory.tum.txt")
    kitti = file_interface.read_kitti_poses_file(export / "trajectory.kitti.txt")
    metric = APE(PoseRelation.full_transformation)
    metric.process_data((tum, kitti))
    print(f"trajectories by evo: {tum.num_poses} poses, {tum.path_length:.3f} m, "
          f"TUM and KITTI differ by {metric.get_all_statistics()['max']:.1g}")


def main():
    run, program = Path(sys.argv[1]), sys.argv[2]
    export = run / "export"
    refined = run / "refined.ply"
    expected = gaussians(refined if refined.exists() else run / "map.ply")
    names = [p.name for p in PlyData.read(export / "map.ply")["vertex"].properties]
    print("map.ply by plyfile:", *names)
    compare("map.ply by plyfile", gaussians(export / "map.ply"), expected)
    for check in [
        lambda: splat_transform(program, export, expected),
        lambda: glb(export, expected),
        lambda: meshes(export),
        lambda: with_open3d(export),
        lambda: colmap(export, expected),
        lambda: nerfstudio(export),
        lambda: trajectories(export),
    ]:
        try:
            check()
        except ImportError as missing:
            print("skipped:", missing)


main()

"""Writes a plain recording in other programs' formats, with other people's software, and compares the
trajectories that `fgs run` finds in each: they are to be the same to the last digit.

    fgs synth room --frames 60 --size 320x240
    pip install numpy pillow pyliblzfse rosbags
    python independent_writers.py room fgs

`room` is a folder in TUM's layout. Everything is written to a temporary folder.
"""

import io
import json
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

import liblzfse
import numpy as np
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
FRAME = "camera_color_optical_frame"


def read(room):
    """Frames as (nanoseconds, JPEG bytes, depth in millimetres), and the camera."""
    camera = tomllib.loads((room / "camera.toml").read_text())
    pairs = [
        [line.split()[1] for line in (room / name).read_text().splitlines() if line[0] != "#"]
        for name in ("rgb.txt", "depth.txt")
    ]
    frames = []
    for index, (color, depth) in enumerate(zip(*pairs)):
        jpeg = io.BytesIO()
        Image.open(room / color).convert("RGB").save(jpeg, "JPEG", quality=95)
        raw = np.array(Image.open(room / depth)).astype(float)
        millimetres = np.round(raw * 1000 / camera["depth_scale"]).astype(np.uint16)
        # 1/32 s: exact in seconds too.
        frames.append((100 * 10**9 + index * 31_250_000, jpeg.getvalue(), millimetres))
    return frames, camera


def write_plain(frames, camera, folder, as_png):
    """JPEG as it is, or what this decoder makes of it: decoders differ in the last digit."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    lists = {"rgb": "", "depth": ""}
    for index, (ns, jpeg, depth) in enumerate(frames):
        name = f"rgb/{index}.{'png' if as_png else 'jpg'}"
        if as_png:
            Image.open(io.BytesIO(jpeg)).save(folder / name)
        else:
            (folder / name).write_bytes(jpeg)
        Image.fromarray(depth).save(folder / f"depth/{index}.png")
        lists["rgb"] += f"{ns / 1e9!r} {name}\n"
        lists["depth"] += f"{ns / 1e9!r} depth/{index}.png\n"
    for name, text in lists.items():
        (folder / f"{name}.txt").write_text(text)
    keys = {k: v for k, v in camera.items() if k in ("width", "height", "fx", "fy", "cx", "cy")}
    keys["depth_scale"] = 1000.0
    (folder / "camera.toml").write_text("".join(f"{k} = {v!r}\n" for k, v in keys.items()))


def write_record3d(frames, camera, path):
    fx, fy, cx, cy = (camera[k] for k in ("fx", "fy", "cx", "cy"))
    height, width = frames[0][2].shape
    metadata = {
        "w": width, "h": height, "dw": width, "dh": height, "fps": 30,
        "K": [fx, 0, 0, 0, fy, 0, cx, cy, 1],
        "perFrameIntrinsicCoeffs": [[fx, fy, cx, cy]] * len(frames),
        "frameTimestamps": [ns / 1e9 for ns, _, _ in frames],
    }
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(metadata))
        for index, (_, jpeg, depth) in enumerate(frames):
            metres = (depth.astype(np.float32) / np.float32(1000)).astype("<f4")
            archive.writestr(f"rgbd/{index}.jpg", jpeg)
            archive.writestr(f"rgbd/{index}.depth", liblzfse.compress(metres.tobytes()))
            sure = np.where(depth > 0, 2, 0).astype(np.uint8)
            archive.writestr(f"rgbd/{index}.conf", liblzfse.compress(sure.tobytes()))


def write_bag(frames, camera, folder, is_raw, compression):
    """Raw colour and depth as bytes, or JPEG and depth in PNG."""
    types = STORE.types
    fx, fy, cx, cy = (camera[k] for k in ("fx", "fy", "cx", "cy"))
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if compression:
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag:
        kind = "Image" if is_raw else "CompressedImage"
        connect = lambda topic, kind: (
            bag.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=STORE),
            f"sensor_msgs/msg/{kind}",
        )
        suffix = ("", "") if is_raw else ("/compressed", "/compressedDepth")
        color = connect("/camera/camera/color/image_raw" + suffix[0], kind)
        depth_topic = "/camera/camera/aligned_depth_to_color/image_raw"
        depth = connect(depth_topic + suffix[1], kind)
        info = connect("/camera/camera/color/camera_info", "CameraInfo")
        for ns, jpeg, millimetres in frames:
            header = types["std_msgs/msg/Header"](
                stamp=types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9),
                frame_id=FRAME,
            )
            height, width = millimetres.shape
            if is_raw:
                make = types["sensor_msgs/msg/Image"]
                pixels = np.array(Image.open(io.BytesIO(jpeg)))
                messages = [
                    make(header, height, width, "rgb8", 0, 3 * width, pixels.reshape(-1)),
                    make(
                        header, height, width, "16UC1", 0, 2 * width,
                        np.frombuffer(millimetres.astype("<u2").tobytes(), np.uint8),
                    ),
                ]
            else:
                make = types["sensor_msgs/msg/CompressedImage"]
                png = io.BytesIO()
                Image.fromarray(millimetres).save(png, "PNG")
                as_bytes = lambda data: np.frombuffer(data, np.uint8)
                messages = [
                    make(header, "rgb8; jpeg compressed bgr8", as_bytes(jpeg)),
                    make(
                        header, "16UC1; compressedDepth png",
                        as_bytes(bytes(12) + png.getvalue()),
                    ),
                ]
            calibration = types["sensor_msgs/msg/CameraInfo"](
                header, height, width, "plumb_bob", np.zeros(5),
                np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]), np.eye(3).reshape(-1),
                np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]), 0, 0,
                types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            )
            sent = zip([color, depth, info], [*messages, calibration])
            for delay, ((connection, name), message) in enumerate(sent):
                bag.write(connection, ns + 1000 * delay, STORE.serialize_cdr(message, name))


def trajectory(fgs, recording, out):
    command = [fgs, "run", recording, "--out", out, "--backend", "cpu"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return (out / "trajectory.txt").read_text()


def main(room, fgs):
    frames, camera = read(Path(room))
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write_plain(frames, camera, folder / "jpeg", False)
        write_plain(frames, camera, folder / "png", True)
        write_record3d(frames, camera, folder / "walk.r3d")
        write_bag(frames, camera, folder / "raw", True, False)
        write_bag(frames, camera, folder / "raw-zstd", True, True)
        write_bag(frames, camera, folder / "compressed", False, False)
        for plain, names in [
            ("jpeg", ["walk.r3d", "compressed"]),
            ("png", ["raw", "raw-zstd"]),
        ]:
            expected = trajectory(fgs, folder / plain, folder / f"out-{plain}")
            for name in names:
                found = trajectory(fgs, folder / name, folder / f"out-{name}")
                assert found == expected, name
                print(f"{name}: the same {len(frames)} poses")


if __name__ == "__main__":
    main(*sys.argv[1:])

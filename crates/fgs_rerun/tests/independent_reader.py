"""Compares a file of `fgs run --save-rrd` with the run's own, by Rerun's package for Python.

    pip install rerun-sdk==0.36.3 numpy
    fgs run room --out run --save-rrd run.rrd
    python independent_reader.py run.rrd run
"""

import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from rerun.experimental import RrdReader

rrd, run = sys.argv[1], Path(sys.argv[2])
metrics = json.loads((run / "metrics.json").read_text())
poses = np.loadtxt(run / "trajectory.txt", ndmin=2)

entities = defaultdict(list)
for chunk in RrdReader(rrd).stream().to_chunks():
    entities[chunk.entity_path].append(chunk)


def column(entity, name):
    """The values of a column whose name ends so, in the order of frames."""
    rows = []
    for chunk in entities[entity]:
        batch = chunk.to_record_batch()
        found = [field for field in batch.schema.names if field.endswith(name)]
        if found:
            frames = batch["frame"].to_pylist() if "frame" in batch.schema.names else [0] * len(batch)
            ids = [str(batch[0][i].as_py()) for i in range(len(batch))]
            rows += zip(frames, ids, batch[found[0]].to_pylist())
    return [(frame, value) for frame, _, value in sorted(rows, key=lambda row: row[:2])]


frames = {frame for frame, _ in column("/plots/gaussians", "scalars")}
assert len(frames) == metrics["frames"], (len(frames), metrics["frames"])

size = metrics.get("refined", metrics)["num_gaussians"]
shown = len(column("/world/map", "centers")[-1][1])
assert shown == size, (shown, size)

cameras = column("/world/camera", "translation")
assert len(cameras) == len(poses), (len(cameras), len(poses))

way = np.array(column("/world/trajectory", "strips")[-1][1][0])
assert way.shape == (len(poses), 3), way.shape
assert np.abs(way - poses[:, 1:4]).max() < 1e-5

keyframes = [entity for entity in entities if entity.startswith("/world/keyframes/")]
assert len(keyframes) == metrics["keyframes"], (len(keyframes), metrics["keyframes"])

pictures = {entity: len(column(entity, "blob")) for entity in entities if "/pictures/" in entity}
assert pictures and all(pictures.values()), pictures
print(f"{len(frames)} frames, {len(poses)} poses, {size} gaussians, {len(keyframes)} keyframes, pictures {pictures}")

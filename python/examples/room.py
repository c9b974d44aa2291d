"""A synthetic room, from images to a map: run it as a program, or cell by cell in an editor that knows ``# %%``."""

# %% A recording: twenty frames of a furnished room as a Kinect would see them. Yours do as well.
import numpy as np

import fgs_slam

fgs_slam.synth("room", frames=20, size=(320, 240))
recording = fgs_slam.Recording("room")
print(recording, recording.camera)

# %% Track and map, frame by frame, as beside a camera.
slam = fgs_slam.Slam(fgs_slam.Config(mapping={"iterations_per_frame": 2}), recording.camera)
for color, depth_m, timestamp in recording:
    pose = slam.push(color, depth_m, timestamp)
    print(pose, "±", pose.uncertainty_m, "m")

# %% What the map shows at the last frame, beside the photograph.
render = slam.render(pose)
both = np.hstack([color, render.color])
difference = np.abs(color.astype(float) - render.color).mean()
print(f"mean difference {difference:.1f} of 255; {both.shape=}")  # plt.imshow(both) shows them

# %% A view that no photograph has: half a metre to the left.
assert pose.world_from_camera is not None
beside = pose.world_from_camera.copy()
beside[:3, 3] -= 0.5 * beside[:3, 0]
print(f"{slam.render(beside).alpha.mean():.0%} of the view from beside is mapped")

# %% The map as arrays: the share of gaussians that are nearly opaque.
result = slam.finish()
opacity = 1 / (1 + np.exp(-result.gaussians.opacity_logits))
print(f"{len(result.gaussians)} gaussians, {np.mean(opacity > 0.9):.0%} of them nearly opaque")

# %% How far the trajectory is from the truth.
assert recording.ground_truth is not None
print(fgs_slam.evaluate.ate(result.trajectory, recording.ground_truth))

# %% Only what lies below the camera, as a file for splat viewers (y points down).
low = result.gaussians.means[:, 1] > 0
part = {name: array[low] for name, array in result.gaussians.arrays().items()}
fgs_slam.Gaussians(**part).write("floor.ply")

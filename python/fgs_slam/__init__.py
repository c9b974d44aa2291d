"""RGB-D gaussian-splatting SLAM.

Move an RGB-D camera through a room: :class:`Slam` tells, frame by frame, where it is, and builds a map of 3-D
gaussians that renders like the photographs. :func:`run` does so for a whole recording on disk.

Colour is sRGB, uint8 (H, W, 3); depth is metres, float32 (H, W), 0 or NaN where nothing was measured; times are
seconds. Poses are ``world_from_camera``: float64 (4, 4) matrices that map points of the camera's axes (x right, y
down, z forward) into the world, metres. Pixel centres lie at integer coordinates.

Whatever computes lets other Python threads run, on all cores; the environment variable ``RAYON_NUM_THREADS`` sets
how many. Results do not depend on it.
"""

from fgs_slam import errors, evaluate, frequency, gicp
from fgs_slam._fgs_slam import (
    Camera,
    Config,
    Gaussians,
    Pose,
    Recording,
    Render,
    Run,
    Slam,
    SlamResult,
    Trajectory,
    __version__,
    export,
    run,
    synth,
)
from fgs_slam.errors import (
    AlignmentError,
    DatasetError,
    DeviceError,
    EvaluationError,
    FgsError,
    FileError,
    FrameError,
    RunError,
    SessionError,
    SettingError,
    ShapeError,
)

__all__ = [
    "AlignmentError",
    "Camera",
    "Config",
    "DatasetError",
    "DeviceError",
    "EvaluationError",
    "FgsError",
    "FileError",
    "FrameError",
    "Gaussians",
    "Pose",
    "Recording",
    "Render",
    "Run",
    "RunError",
    "SessionError",
    "SettingError",
    "ShapeError",
    "Slam",
    "SlamResult",
    "Trajectory",
    "__version__",
    "errors",
    "evaluate",
    "export",
    "frequency",
    "gicp",
    "run",
    "synth",
]

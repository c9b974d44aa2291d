"""A synthetic recording and a run of it, shared by all tests."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

import fgs_slam


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve frames of 160x120 as a Kinect would see them."""
    path = tmp_path_factory.mktemp("recordings") / "room"
    fgs_slam.synth(path, frames=12, size=(160, 120))
    return path


@pytest.fixture(scope="session")
def recording(room: Path) -> fgs_slam.Recording:
    return fgs_slam.Recording(room)


@pytest.fixture(scope="session")
def finished(room: Path, tmp_path_factory: pytest.TempPathFactory) -> fgs_slam.Run:
    """A run of the recording on the CPU."""
    out = tmp_path_factory.mktemp("runs") / "room"
    return fgs_slam.run(room, out=out, backend="cpu", evaluate=True)


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """A shell starts what runs in its background with Ctrl-C ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def slam(recording: fgs_slam.Recording) -> fgs_slam.Slam:
    return fgs_slam.Slam(fgs_slam.Config(), recording.camera, backend="cpu")


@pytest.fixture(scope="session")
def fgs() -> Path:
    """The command, to compare with."""
    path = os.environ.get("FGS")
    if path is None:
        pytest.skip("the environment variable FGS does not name the fgs command")
    return Path(path)

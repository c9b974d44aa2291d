"""What the package raises. Messages name the file, setting, array or value at fault."""


class FgsError(Exception):
    """Anything that the package raises of its own."""


class SettingError(FgsError, ValueError):
    """A setting, an option or a camera's parameter is unknown or impossible."""


class ShapeError(FgsError, ValueError):
    """An array has another shape or type than is expected, or a matrix is no pose."""


class FrameError(FgsError, ValueError):
    """A frame is not of the session's camera, holds a negative depth, or comes too early."""


class DatasetError(FgsError):
    """A recording, camera file or trajectory cannot be read, or is not the one that belongs there."""


class FileError(FgsError):
    """A result, map or folder cannot be read or written."""


class DeviceError(FgsError):
    """A graphics device was asked for, but none can be used."""


class SessionError(FgsError):
    """The session is finished, or has failed."""


class RunError(FgsError):
    """A run or an export failed on its way."""


class AlignmentError(FgsError):
    """Two point clouds cannot be registered."""


class EvaluationError(FgsError, ValueError):
    """Two trajectories cannot be compared."""

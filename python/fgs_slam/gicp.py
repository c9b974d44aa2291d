"""Registration of point clouds; can be used on its own."""

from fgs_slam._fgs_slam import Alignment, align

__all__ = ["Alignment", "align"]

"""Where an image is rich in detail; can be used on its own."""

from fgs_slam._fgs_slam import detail_mask

__all__ = ["detail_mask"]

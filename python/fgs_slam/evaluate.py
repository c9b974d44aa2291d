"""How far an estimated trajectory is from the true one; can be used on its own."""

from fgs_slam._fgs_slam import Ate, ate

__all__ = ["Ate", "ate"]

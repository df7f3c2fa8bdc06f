"""udflow: raw point clouds to meshes and unsigned distances by Trajectory Flow."""

__version__ = "0.1.0"

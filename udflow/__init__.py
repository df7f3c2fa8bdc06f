"""udflow: raw point clouds to meshes and unsigned distances by Trajectory Flow."""

import os

# Threads that wait by spinning take the cores from those that work: on a machine with anything
# else to do a reconstruction took three times as long. Read by OpenMP when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"

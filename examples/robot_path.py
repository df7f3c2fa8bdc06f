"""How close does a robot come to the scanned world? Distances along a path, as in a notebook.

    python examples/robot_path.py job_01... --url http://127.0.0.1:8000

The path is a circle above the scan; replace it by your own. UDFLOW_KEY holds the key of a service
that asks for one.
"""

import argparse

import numpy as np

from udflow.client import Client

parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
parser.add_argument("job")
parser.add_argument("--url", default="http://127.0.0.1:8000")
options = parser.parse_args()
service = Client(options.url)

# %% where the scan is, and a path around it at one and a half times its radius
scan = service.job(options.job)["scan_id"]
about = service.scan(scan)
low, high = np.array(about["low"]), np.array(about["high"])
centre, radius = (low + high) / 2, (high - low).max() / 2
turn = np.linspace(0, 2 * np.pi, 2_000)
path = centre + 1.5 * radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)

# %% how much room there is, and in which direction
answer = service.query(options.job, path, gradients=True, closest=True)
nearest = int(answer.distance.argmin())
print(f"{len(path)} positions, closest approach: {answer.distance[nearest]:.4f}")
print(f"at {path[nearest].round(3)}, to {answer.closest[nearest].round(3)}")

# %% push the path away where it is closer than a margin: one step along the gradient
margin = 0.55 * radius
short = np.clip(margin - answer.distance, 0, None)
safer = path + short[:, None] * answer.gradient
after = service.query(options.job, safer)
print(f"after one push: {after.distance.min():.4f} (wanted {margin:.4f})")
service.close()

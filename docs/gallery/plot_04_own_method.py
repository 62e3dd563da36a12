"""
A method of your own
====================

A method is a function of two gray frames and a frozen dataclass of parameters. An entry point of your
package makes it known to every command; here we call it directly, beside a method of this package.
"""

# %%
# The method: one motion for the whole frame, by least squares on the linearised brightness constancy.

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

import fracbench


@dataclass(frozen=True)
class Params:
    strength: float = 1.0  # weight of the squared motion


def estimate(frame0, frame1, params):
    gy, gx = np.gradient(frame1)
    gradient = np.stack([gx.ravel(), gy.ravel()])
    normal = gradient @ gradient.T + params.strength * np.eye(2)
    motion = np.linalg.solve(normal, gradient @ (frame0 - frame1).ravel())
    return np.broadcast_to(motion[:, None, None], (2, *frame0.shape))


METHOD = fracbench.Method(
    name="my_flow",
    label="My flow",
    summary="one motion for the whole frame",
    estimate=estimate,
    params=Params,
    version="1",
)

# %%
# `compute` copies the frames, checks the flow's shape and values, and takes the time.

pair = fracbench.load_sequence("flat", "synthetic")
mine = METHOD.compute(pair.frame0.astype(np.float32), pair.frame1.astype(np.float32), Params())
ours = fracbench.estimate_flow(pair.frame0, pair.frame1)
fig, axes = plt.subplots(1, 2, figsize=(7, 3), layout="constrained")
reach = float(np.hypot(*pair.truth).max())
for ax, result in zip(axes, (mine, ours), strict=True):
    errors = fracbench.flow_errors(result.flow, pair.truth)
    ax.imshow(fracbench.flow_to_color(result.flow, reach))
    ax.set_title(f"{result.method}: AEPE {errors.aepe:.3f} px")
    ax.set_axis_off()
plt.show()

# %%
# With these two lines in the `pyproject.toml` of your package, `fracbench sweep method=my_flow,tvl1_sb
# strength=0.5:2:0.5` sweeps it as one of its own:
#
# .. code-block:: toml
#
#     [project.entry-points."fracbench.methods"]
#     my_flow = "my_package:METHOD"

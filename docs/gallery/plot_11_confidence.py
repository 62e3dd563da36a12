"""
Trust in a pixel
================

The flow back from frame 1 to frame 0 should lead each pixel to where it came from. Where it does not, the
flow is wrong or the pixel is hidden in one of the frames.
"""

# %%
# One texture passes in front of another.

import matplotlib.pyplot as plt
import numpy as np

import fracbench
from fracbench.evaluation.sparsification import remaining_error

pair = fracbench.load_sequence("occlusion", "synthetic")
result = fracbench.estimate_flow(pair.frame0, pair.frame1, confidence=True)
distance = result.confidence.distance

fig, axes = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
result.plot(axes[0])
axes[1].imshow(np.minimum(distance, 2.0), cmap="magma")
axes[1].set_title("distance forward and back, 0 to 2 px")
axes[2].imshow(np.minimum(np.hypot(*(result.flow - pair.truth)), 2.0), cmap="magma")
axes[2].set_title("true error, 0 to 2 px")
for ax in axes:
    ax.set_axis_off()
plt.show()

# %%
# The error that is left after dropping the pixels of the largest distance:

errors = np.hypot(*(result.flow - pair.truth))
left = remaining_error(errors, distance, (0.1, 0.2, 0.5))
for share, error in zip((0.1, 0.2, 0.5), left, strict=True):
    print(f"without the worst {share:.0%}: {error:.3f} of the error")

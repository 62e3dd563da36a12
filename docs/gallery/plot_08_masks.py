"""
Pixels that do not count
========================

A logo, a dead part of the sensor, the wall of a channel: their values say nothing about the motion. A mask
leaves them out.
"""

# %%
# We paint a block into both frames, at the same place, as a logo would be.

import matplotlib.pyplot as plt
import numpy as np

import fracbench

pair = fracbench.load_sequence("rotation", "synthetic")
logo = np.zeros(pair.shape, bool)
logo[20:50, 90:140] = True
frame0, frame1 = (np.where(logo, 255.0, frame) for frame in (pair.frame0, pair.frame1))

without = fracbench.estimate_flow(frame0, frame1)
masked = fracbench.estimate_flow(frame0, frame1, mask=logo)

# %%
# Without the mask the logo stands still; with it, the regulariser fills the motion in from around.

fig, axes = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
axes[0].imshow(frame0, cmap="gray")
axes[0].set_title("frame 0")
axes[0].set_axis_off()
reach = float(np.hypot(*pair.truth).max())
for ax, name, result in zip(axes[1:], ("no mask", "mask"), (without, masked), strict=True):
    result.plot(ax, max_motion=reach)
    error = np.hypot(*(result.flow - pair.truth))[logo].mean()
    ax.set_title(f"{name}: {error:.2f} px off in the block")
plt.show()

# %%
# Pixels of a float frame that are NaN are masked without being asked for, and a notice says so.

frame1[logo] = np.nan
print(*fracbench.estimate_flow(frame0, frame1).notices, sep="\n")

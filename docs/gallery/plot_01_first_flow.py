"""
First flow
==========

Two frames, one call, one picture. The frames are rendered: a texture that turns about the centre.
"""

# %%
# A pair of frames comes with its true flow. With images of your own, `frame0` and `frame1` are arrays of
# shape (H, W) or (H, W, 3), of any integer or floating type.

import matplotlib.pyplot as plt

import fracbench

pair = fracbench.load_sequence("rotation", "synthetic", noise=1.0)
result = fracbench.estimate_flow(pair.frame0, pair.frame1)
print(result.flow.shape, result.ending)

# %%
# `flow[0]` is the motion to the right and `flow[1]` the motion down, in pixels. In the picture the hue is
# the direction and the saturation the speed; the wheel in the corner is the legend.

fig, axes = plt.subplots(1, 2, figsize=(8, 3.3), layout="constrained")
axes[0].imshow(pair.frame0, cmap="gray")
axes[0].set_title("frame 0")
axes[0].set_axis_off()
result.plot(axes[1])
plt.show()

# %%
# Where the true flow is known, so are the errors: the mean distance to the true end point (AEPE, pixels)
# and the mean angle (AAE, radians).

errors = fracbench.flow_errors(result.flow, pair.truth)
print(f"AEPE {errors.aepe:.3f} px, AAE {errors.aae:.4f} rad")

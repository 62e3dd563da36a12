"""
The best order depends on the motion
====================================

The order alpha of the derivative decides which flow is smooth. We compute three kinds of motion with orders
from 0.4 to 2.
"""

# %%
# The scenes are textures with noise of one gray level. In the first, a square moves over a ground that
# moves otherwise; in the second, the motion grows evenly across a disc; in the third, a disc turns.

import matplotlib.pyplot as plt

import fracbench

kinds = {"lone_edge": "an edge of motion", "lone_affine": "affine motion", "lone_curl": "a disc that turns"}
table = fracbench.sweep(
    f"sequence={','.join(f'synthetic_{kind}' for kind in kinds)}",
    "alpha=0.4:2:0.2",
    "boundary=reflect",
    "noise=1",
    "margin=24",  # errors in the middle, where the structure is
    jobs=1,
)

# %%
# Each curve is divided by its value at alpha = 1, which is total variation.

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for kind, name in kinds.items():
    curve = table[table["sequence"] == f"synthetic_{kind}"].set_index("alpha")["aepe"]
    ax.plot(curve.index, curve / curve[1.0], marker="o", label=name)
ax.set(xlabel="order alpha", ylabel="AEPE / AEPE at alpha = 1", yscale="log")
ax.axhline(1.0, color="gray", linewidth=0.8)
ax.legend()
plt.show()

# %%
# Edges of motion want an order near 1, smooth motion a higher one.

best = table.loc[table.groupby("sequence")["aepe"].idxmin(), ["sequence", "alpha", "aepe"]]
print(best.to_string(index=False))

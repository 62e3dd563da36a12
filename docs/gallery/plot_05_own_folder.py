"""
A folder of your own pairs
==========================

`dataset=folder` reads pairs of frames from the sub-folders of a folder. Those with a true flow get errors.
"""

# %%
# We write two pairs as anyone would have them: pictures, and the true flow as a `.flo` file.

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import fracbench

folder = Path("pairs")
for name in ("parallax", "zoom"):
    pair = fracbench.load_sequence(name, "synthetic")
    (folder / name).mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate((pair.frame0, pair.frame1)):
        Image.fromarray(np.rint(frame).astype(np.uint8)).save(folder / name / f"frame{number}.png")
    fracbench.write_flow(folder / name / "flow.flo", pair.truth)
print(*sorted(path.as_posix() for path in folder.rglob("*.*")), sep="\n")

# %%
# The same words work on the command line, in `table`, `bench` and every experiment.

table = fracbench.sweep(
    "dataset=folder",
    "paths.data=pairs",
    "sequence=all",
    "method=tvl1,tvl1_sb_alpha",
    "protocol=recommended",
    jobs=2,
)
print(table[["sequence", "method", "aae", "aepe", "fl_all"]].round(4).to_string(index=False))

# %%
# The true flow of a pair may be missing: its row then has no errors, and the command line draws its flow
# instead.

fig, ax = plt.subplots(figsize=(6, 3), layout="constrained")
table.pivot(index="sequence", columns="method", values="aepe").plot.barh(ax=ax)
ax.set(xlabel="AEPE [px]", ylabel="")
plt.show()

"""
A sweep in Python
=================

A sweep computes all combinations of the values of some keys, on several processes, and stores every
finished point.
"""

# %%
# The grid is written as on the command line: `fracbench sweep sequence=synthetic_flat lambda=log(0.03:3:7)
# theta=0.1,0.3`.

import time

import matplotlib.pyplot as plt

import fracbench

grid = ["sequence=synthetic_edge", "method=tvl1_sb", "lambda=log(0.03:3:7)", "theta=0.1,0.3", "noise=2"]
table = fracbench.sweep(*grid, jobs=2)
print(table[["lambda", "theta", "aepe", "iterations", "status"]].to_string(index=False))

# %%
# The table is a pandas DataFrame, so that a picture takes a few lines.

fig, ax = plt.subplots(figsize=(7, 3.5), layout="constrained")
for theta, curve in table.groupby("theta"):
    ax.plot(curve["lambda"], curve["aepe"], marker="o", label=f"theta = {theta:g}")
ax.set(xlabel="lambda", ylabel="AEPE [px]", xscale="log")
ax.legend()
plt.show()

# %%
# The second call computes nothing: all points are in `results/runs/store.sqlite`.

started = time.perf_counter()
again = fracbench.sweep(*grid, jobs=2)
assert again.equals(table)
print("the same table, from the store:", time.perf_counter() - started < 5)

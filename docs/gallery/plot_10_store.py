"""
Reading the store with pandas
=============================

Every finished point is a row of a SQLite file, with its parameters, errors, versions and time. Any tool
that reads SQLite can read it.
"""

# %%
# A small sweep fills the store.

import json
import sqlite3

import matplotlib.pyplot as plt
import pandas as pd

import fracbench

fracbench.sweep(
    "sequence=synthetic_corner",
    "method=tvl1,tvl1_sb,tvl1_sb_alpha",
    "n_warps=1:3:1",
    "paths.results=mine",  # a folder of its own; `results` by default
    jobs=2,
)

with sqlite3.connect("mine/runs/store.sqlite") as connection:
    tables = pd.read_sql("select name from sqlite_master where type = 'table'", connection)
    rows = pd.read_sql("select * from points", connection)
print(*tables["name"], "|", *rows.columns)

# %%
# The columns `spec`, `result` and `provenance` are JSON: the parameters in the key, the errors, and where
# they come from.

spec = pd.json_normalize(rows["spec"].map(json.loads).tolist())
result = pd.json_normalize(rows["result"].map(json.loads).tolist())
view = pd.concat([spec[["method", "params.n_warps"]], result[["aepe", "aae"]], rows["status"]], axis=1)
print(view.sort_values(["method", "params.n_warps"]).to_string(index=False))

# %%
# Errors against the number of warps:

fig, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
for method, rows in view.groupby("method"):
    rows = rows.astype({"params.n_warps": int}).sort_values("params.n_warps")
    ax.plot(rows["params.n_warps"], rows["aepe"], marker="o", label=method)
ax.set(xlabel="warps", ylabel="AEPE [px]", xticks=[1, 2, 3])
ax.legend()
plt.show()

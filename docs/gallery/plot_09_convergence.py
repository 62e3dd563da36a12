"""
Convergence of the solvers
==========================

The u-step of split Bregman can be solved exactly, by cosine transforms, or approximately, by sweeps of
Gauss-Seidel as the paper does. `trace=True` records the energy after each iteration.
"""

# %%
# One scale and one warp, so that there is one energy to minimise. The paper's coupling by a penalty is
# beside ours, which adds a multiplier.

import matplotlib.pyplot as plt
import numpy as np

import fracbench

pair = fracbench.load_sequence("edge", "synthetic", noise=1.0)
settings = {"n_scales": 1, "n_warps": 1, "max_iter": 150, "epsilon": 0.0, "boundary": "zero", "alpha": 1.2}
variants = {
    "exact, multiplier": {},
    "exact, penalty": {"coupling": "penalty"},
    "one Gauss-Seidel sweep, penalty": {"u_solver": "gauss_seidel", "coupling": "penalty"},
}
traces = {}
for name, changes in variants.items():
    result = fracbench.estimate_flow(pair.frame0, pair.frame1, trace=True, **settings, **changes)
    traces[name] = np.concatenate(result.levels[0].energy)

# %%
# The distance to the energy of a run with ten times as many iterations:

longer = {**settings, "max_iter": 10 * settings["max_iter"], "dtype": "float64"}
final = fracbench.estimate_flow(pair.frame0, pair.frame1, trace=True, **longer)
least = final.levels[0].energy[0][-1]
fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for name, trace in traces.items():
    ax.plot(np.arange(1, len(trace) + 1), (trace - least) / least, label=name)
ax.set(xlabel="iteration", ylabel="relative distance to the least energy", xscale="log", yscale="log")
ax.legend()
plt.show()

"""A Dask cluster of two worker processes: ``python dask_cluster.py`` prints its address and its workers' pids.

Tests kill many workers, and most of a worker's time is its start: workers are forked from a process that has
imported all modules.
"""

from __future__ import annotations

import os
import sys
from multiprocessing import forkserver, get_context

import dask
from distributed import Client, LocalCluster

if __name__ == "__main__":
    get_context("forkserver").set_forkserver_preload(["distributed", "fracbench.harness.run.compute_point"])
    forkserver.ensure_running()
    with (
        dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}),
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        print(cluster.scheduler_address, *client.run(os.getpid).values(), flush=True)
        sys.stdin.readline()

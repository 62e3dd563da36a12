"""``python logged_sweep.py LOG SECONDS ARGUMENTS...``: the command line, whose workers keep a log behind its back.

A line ``start KEY PID`` comes before a point is computed, a line ``end KEY PID`` after its row is in the store;
each point takes SECONDS. Its errors are made up from its key: to import the solver takes a worker longer than all
that is tested here.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from fracbench.commands.cli import main
from fracbench.harness.run import pool


def install(log: Path, seconds: float) -> None:
    real = pool._compute

    def compute(job, store, marks, parent):  # reaches the workers by value
        import os
        import sys
        import time
        from types import SimpleNamespace

        from fracbench.harness.run.point import Outcome

        def say(what):
            with log.open("a") as file:
                file.write(f"{what} {job.key} {os.getpid()}\n")

        def run_point(point, folder, guard):
            with guard():
                time.sleep(seconds)
            error = int(point.key[:8], 16) / 16**8
            made_up = {
                "aae": error,
                "aepe": 2 * error,
                "sdae": error,
                "n_pixels": 9,
                "n_unknown": 0,
                "n_nonfinite": 0,
            }
            made_up |= {"iterations": [[1]], "inner_iterations": [[2]], "stop": "max_iter"}
            return Outcome("done", None, made_up, 0.1, None, {"host": "here"})

        sys.modules["fracbench.harness.run.compute_point"] = SimpleNamespace(run_point=run_point)
        say("start")
        row = real(job, store, marks, parent)
        say("end")
        return row

    pool._compute = compute


if __name__ == "__main__":
    # Tests that were started in the background inherit a Ctrl-C that is ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    install(Path(sys.argv[1]), float(sys.argv[2]))
    sys.exit(main(sys.argv[3:]))

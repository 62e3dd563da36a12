"""``python logged.py LOG SECONDS ARGUMENTS...``: the command line, whose workers keep a log behind its back.

A line ``start KEY PID`` comes before a point is computed, a line ``end KEY PID`` after its row is in the spool;
each point takes SECONDS longer than it would.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from fracbench.cli import main
from fracbench.harness import workers


def install(log: Path, seconds: float) -> None:
    real = workers._compute

    def compute(job, folder, parent):  # reaches the workers by value
        import os
        import time

        def say(what):
            with log.open("a") as file:
                file.write(f"{what} {job.key} {os.getpid()}\n")

        say("start")
        time.sleep(seconds)
        real(job, folder, parent)
        say("end")

    workers._compute = compute


if __name__ == "__main__":
    # Tests that were started in the background inherit a Ctrl-C that is ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    install(Path(sys.argv[1]), float(sys.argv[2]))
    sys.exit(main(sys.argv[3:]))

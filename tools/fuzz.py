"""Fuzz the doors for files and words of others: ``python tools/fuzz.py --minutes 10 [flo kitti ...]``.

atheris, which is guided by the coverage of the code, starts from the corpus in ``tests/fuzz/corpus``; its own
inputs go to ``build/fuzz``. An input that ends in anything but an answer or one line of refusal is kept there as
``TARGET-crash-*``: fix its cause and move it to the corpus, which the ordinary tests replay.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOUND = ROOT / "build" / "fuzz"
HELPERS = ROOT / "tests" / "helpers"
MOST_BYTES = 20_000
SLOW_SECONDS = 60  # an input that takes longer is a finding; instrumented code takes ten times as long


def main(argv: Sequence[str] | None = None) -> int:
    """Fuzz each target in a process of its own; return 1 where one has found something."""
    sys.path[:0] = [str(HELPERS), str(ROOT)]
    from fuzz_targets import TARGETS

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(TARGETS)} (default: all)")
    parser.add_argument("--minutes", type=float, default=10.0, help="for each target (default: 10)")
    given = parser.parse_args(argv)
    if unknown := set(given.targets) - set(TARGETS):
        parser.error(f"unknown target {min(unknown)}; there are {', '.join(TARGETS)}")
    bad = 0
    for name in given.targets or TARGETS:
        found = FOUND / name
        found.mkdir(parents=True, exist_ok=True)
        options = {
            "max_total_time": round(60 * given.minutes),
            "max_len": MOST_BYTES,
            "timeout": SLOW_SECONDS,
            "rss_limit_mb": 4096,
            "artifact_prefix": f"{found}-",
            "print_final_stats": 1,
        }
        words = [f"-{key}={value}" for key, value in options.items()]
        corpus = [str(found), str(ROOT / "tests" / "fuzz" / "corpus" / name)]
        code = f"import sys; sys.path[:0] = {[str(ROOT / 'tools')]!r}; import fuzz; fuzz.one({name!r})"
        print(f"{name}: {given.minutes:g} minutes", flush=True)
        cache = os.environ | {"XDG_CACHE_HOME": str(ROOT / "build" / "fuzz-cache")}
        bad += (
            subprocess.run([sys.executable, "-c", code, *words, *corpus], env=cache, check=False).returncode != 0
        )
    return int(bad > 0)


def one(name: str) -> None:
    """Fuzz one target in this process, by the words of libFuzzer on the command line."""
    import atheris

    sys.path[:0] = [str(HELPERS), str(ROOT)]
    with atheris.instrument_imports(include=["fracbench", "png", "yaml", "PIL"]):
        import fuzz_targets

        for seed in (ROOT / "tests" / "fuzz" / "corpus" / name).iterdir():  # many imports are made in functions
            fuzz_targets.run(name, seed.read_bytes())

    def run(data: bytes) -> None:
        fuzz_targets.run(name, data)

    atheris.Setup(sys.argv, run)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())

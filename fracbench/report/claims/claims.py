"""The paper's testable sentences and their verdicts: computed from stored points, never typed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fracbench.data.files import write_text
from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.paths import asset
from fracbench.harness.config.records import read_yaml
from fracbench.report.claims import region_rules, table_rules
from fracbench.report.claims.judging import RULES, UNKNOWN, VERDICTS, Tables, UnjudgeableError

if TYPE_CHECKING:
    import pandas as pd

#: The experiments that the rules read.
EXPERIMENTS = ("table2", "fig2", "fig3", "fig4", "fig6", "fig7", "regions_lambda_sb")
_MODULES = (table_rules, region_rules)  # imported for the rules they register
_KEYS = {"id", "quote", "place", "test", "rule", "args"}
_INTRODUCTION = (
    "Each sentence of the paper that a computation can judge, with its verdicts. Verdicts are computed by "
    "`fracbench claims` from stored points; a sentence about several cases holds in part if it does so in at "
    "least half of them, and cannot be judged where points are missing or failed. Protocols: conf/protocol and "
    "docs/protocol.md; under `published` and `as_printed` the fractional u-step is solved exactly, so that the "
    "verdicts are about the model and not about a sweep that diverges (experiment `solver_study`). The regions' "
    "boxes are ours: the paper shows its own in a picture only."
)


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, its test in words, and the rule with its arguments that performs the test.

    The place is section, figure or table, and line of the LaTeX source.
    """

    id: str
    quote: str
    place: str
    test: str
    rule: str
    args: Mapping[str, Any]


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim under one protocol (or variant), one of `VERDICTS`, and the numbers behind it."""

    protocol: str
    verdict: str
    evidence: str


@dataclass(frozen=True)
class Judged:
    """A claim with its verdicts, the reference's first."""

    claim: Claim
    verdicts: tuple[Verdict, ...]

    @property
    def words(self) -> dict[str, str]:
        """The verdicts' words by protocol."""
        return {verdict.protocol: verdict.verdict for verdict in self.verdicts}


def load_claims(path: Path | None = None) -> list[Claim]:
    """Read the claims: the project's ``results/claims.yaml``, or a file like it."""
    path = path or asset("results/claims.yaml")
    raw, _ = read_yaml(path)
    if not isinstance(raw, list) or not all(isinstance(row, dict) for row in raw):
        raise InputError(f"{path}: must be a list of claims, each with the keys {', '.join(sorted(_KEYS))}")
    claims = [_claim(row, f"{path}: claim {i}") for i, row in enumerate(raw, 1)]
    for name, count in Counter(claim.id for claim in claims).items():
        if count > 1:
            raise InputError(f"{path}: the id {name!r} is given {count} times")
    return claims


def _claim(row: Mapping[Any, Any], where: str) -> Claim:
    for key in row:
        if key not in _KEYS:
            raise unknown_name("key", str(key), _KEYS, where)
    if missing := sorted(_KEYS - {"args"} - set(row)):
        raise InputError(f"{where}: {', '.join(missing)} is missing")
    if row["rule"] not in RULES:
        raise unknown_name("rule", str(row["rule"]), RULES, where)
    texts = {key: str(row[key]) for key in _KEYS - {"args"}}
    return Claim(**texts, args=dict(row.get("args") or {}))


def evaluate(
    load: Callable[[str], pd.DataFrame | None],
    claims: Sequence[Claim] | None = None,
    settings: Sequence[str] | None = None,
) -> list[Judged]:
    """Judge claims, the project's by default, under each protocol that their rules can judge, or under `settings`.

    `load` gives the tidy table of an experiment by name, None if there is none; it is asked for `EXPERIMENTS`.
    """
    tables = Tables(load)
    return [
        Judged(claim, tuple(_judge(claim, tables, setting) for setting in settings or RULES[claim.rule].settings))
        for claim in (load_claims() if claims is None else claims)
    ]


def _judge(claim: Claim, tables: Tables, setting: str) -> Verdict:
    try:
        verdict, evidence = RULES[claim.rule].judge(tables, setting, **claim.args)
    except UnjudgeableError as exc:
        return Verdict(setting, UNKNOWN, f"{str(exc)[0].upper()}{str(exc)[1:]}.")
    return Verdict(setting, verdict, evidence)


def render_claims(judged: Sequence[Judged]) -> tuple[str, str]:
    """Return verdicts as Markdown, with the evidence below the table, and as CSV, a row a claim and protocol."""
    import pandas as pd

    table = overview_table(judged).to_markdown(index=False, disable_numparse=True)
    parts = [
        "# The paper's claims\n",
        _INTRODUCTION + "\n",
        "\n".join(f"- {line}" for line in count_lines(judged)),
        f"\n{table}\n",
        "## Evidence\n",
    ]
    for item in judged:
        parts.append(
            f"### {item.claim.id}\n\n> {item.claim.quote}\n\n{item.claim.place}. Test: {item.claim.test}\n"
        )
        parts.append("\n".join(f"- {v.protocol}: **{v.verdict}**. {v.evidence}" for v in item.verdicts) + "\n")
    records = [
        {
            **{name: getattr(item.claim, name) for name in ("id", "quote", "place", "test")},
            **{name: getattr(verdict, name) for name in ("protocol", "verdict", "evidence")},
        }
        for item in judged
        for verdict in item.verdicts
    ]
    return "\n".join(parts), str(pd.DataFrame(records).to_csv(index=False, lineterminator="\n"))


def overview_table(judged: Sequence[Judged]) -> pd.DataFrame:
    """Return a row a claim: quotation, place, and the verdict under each protocol (empty where none applies)."""
    import pandas as pd

    protocols = count_verdicts(judged)
    rows = []
    for item in judged:
        words = {"claim": item.claim.id, "quotation": item.claim.quote, "place": item.claim.place}
        rows.append(words | {protocol: item.words.get(protocol, "") for protocol in protocols})
    return pd.DataFrame(rows)


def count_verdicts(judged: Sequence[Judged]) -> dict[str, Counter[str]]:
    """Return how often each verdict was given, by protocol."""
    counts: dict[str, Counter[str]] = {}
    for item in judged:
        for protocol, word in item.words.items():
            counts.setdefault(protocol, Counter())[word] += 1
    return counts


def count_lines(judged: Sequence[Judged]) -> list[str]:
    """Say for each protocol how many claims got which verdict."""
    return [
        f"{protocol}: of {count.total()} claims "
        + ", ".join(f"{count[verdict]} {_PLURALS[verdict]}" for verdict in VERDICTS if count[verdict])
        for protocol, count in count_verdicts(judged).items()
    ]


_PLURALS = dict(zip(VERDICTS, ("hold", "hold in part", "do not hold", "cannot be judged"), strict=True))


def write_claims(judged: Sequence[Judged], stem: Path) -> list[Path]:
    """Write verdicts as ``stem.csv`` and ``stem.md``, atomically; return the files."""
    markdown, csv = render_claims(judged)
    return [
        write_text(csv, stem.with_name(f"{stem.name}.csv")),
        write_text(markdown, stem.with_name(f"{stem.name}.md")),
    ]

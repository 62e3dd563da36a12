"""The documents: numbers agree with the stored tables; paths, tests and rooms that they name exist."""

from __future__ import annotations

import gzip
import math
import re
import shlex
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fracbench import load_sequence
from fracbench.commands.options import build_parser
from fracbench.errors import InputError
from fracbench.harness.config.compose import load_config
from fracbench.harness.config.grid import parse_overrides
from fracbench.harness.config.paths import checkout

HALF = 0.006  # documents give two digits

ROOT = checkout()
TABLES = (ROOT or Path()) / "results/committed/tables"
pytestmark = pytest.mark.skipif(ROOT is None, reason="documents and tables are those of a checkout")


def rows(text: str) -> list[list[str]]:
    """The cells of every row of a Markdown file's tables."""
    return [
        [cell.strip() for cell in line.strip("|\n").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]


def numbers(cell: str) -> list[float]:
    return [float(found) for found in re.findall(r"\d*\.?\d+", cell.replace(" of 8", ""))]


def test_the_switches_of_the_protocols_are_those_of_the_stored_study():
    study = pd.read_csv(ROOT / "results/committed/tables/protocol_study.csv").fillna({"switch": ""})
    study = study.set_index(["protocol", "switch"])
    told = {
        row[0].split("`")[1] if "`" in row[0] else row[0]: row[1:] for row in rows(document()) if len(row) == 3
    }
    switches = [switch for switch in study.loc["published"].index if switch]
    assert {"none", *switches} <= set(told)
    for switch in ("", *switches):
        for protocol, cell in zip(("reference", "published"), told[switch or "none"], strict=True):
            assert numbers(cell) == [pytest.approx(study.loc[(protocol, switch), "distance"], abs=HALF)]


def test_the_protocols_are_those_of_the_stored_tables():
    study = pd.read_csv(ROOT / "results/committed/tables/protocol_study.csv").fillna({"switch": ""})
    told = {row[0].strip("`"): row[2:] for row in rows(document()) if len(row) == 7}
    for protocol in ("reference", "published"):
        found = study[(study["protocol"] == protocol) & (study["switch"] == "")].iloc[0]
        distance, five, ten, better, errors = map(numbers, told[protocol])
        assert distance == [pytest.approx(found["distance"], abs=HALF)]
        assert [*five, *ten] == [found["within 5 %"], found["within 10 %"]]
        assert better == [found["SB better, AAE"], found["SB better, AEPE"]]
        assert errors == [pytest.approx(found[f"AEPE {method}"], abs=HALF) for method in ("tvl1", "tvl1_sb")]


def test_the_scenes_of_two_parts_are_those_of_the_stored_table():
    table = pd.read_csv(ROOT / "results/committed/tables/order_from_flow.csv").query("metric == 'aepe'")
    table["scene"] = table["scene"].str.removeprefix("lone_")
    stored = table.set_index(["scene", "noise"])[["one", "own", "parts"]]
    text = (ROOT / "docs/beyond.md").read_text(encoding="utf-8")
    told = {row[0]: row[1:] for row in rows(text) if len(row) == 7 and row[0] in stored.index.levels[0]}
    assert set(told) == set(stored.index.levels[0])
    for scene, cells in told.items():
        first = [numbers(cell)[0] for cell in cells]
        assert first == pytest.approx([*stored.loc[(scene, 1)], *stored.loc[(scene, 3)]], abs=HALF), scene


def test_the_switches_of_the_search_are_those_of_the_stored_search():
    stored = pd.read_csv(TABLES / "protocol_search_switches.csv", dtype={"best value": str})
    both = stored[stored["methods"] == "tvl1+tvl1_sb"].set_index("switch")
    alone = stored[stored["methods"] != "tvl1+tvl1_sb"].drop_duplicates("switch").set_index("switch")
    told = {row[0].strip("`"): row[1:] for row in rows(document()) if len(row) == 5 and row[0].startswith("`")}
    assert set(both.index[both["verdict"] == "told"]) <= set(told)
    for switch, (value, with_both, with_one, verdict) in told.items():
        assert (value, verdict) == (both.loc[switch, "best value"], both.loc[switch, "verdict"])
        for cell, table in ((with_both, both), (with_one, alone)):
            distance = table.loc[switch, "least distance with another"]
            assert cell == ("none ran" if math.isinf(distance) else f"{distance:.3f}"), switch


def test_what_the_document_says_of_the_search_is_what_is_stored():
    text = " ".join(document().split())
    with gzip.open(TABLES / "protocol_search_trials.csv.gz", "rt") as file:
        trials = pd.read_csv(file, dtype=str, keep_default_na=False)
    switches = list(trials.columns[4:43])
    assert f"searches {len(switches)} switches" in text and switches[-1] == "tvl1_sb.stencil_border"
    logs = trials[trials.columns[43:]].apply(pd.to_numeric)
    count = logs.notna().sum(axis=1)
    whole = count == trials["stage"].str.count("tvl1") * 24
    distinct = len(trials.drop_duplicates(["stage", *switches]))
    said = f"tried {len(trials)} configurations, of which {distinct} are distinct; {(~whole).sum()} ended early"
    assert said in text
    distance = (logs**2).mean(axis=1) ** 0.5
    joint = whole & (trials["stage"] == "tvl1+tvl1_sb")
    best = distance[joint].idxmin()
    within = [int((logs.loc[best].abs() <= math.log(1 + p)).sum()) for p in (0.05, 0.1)]
    said = f"a distance of {distance[best]:.3f}, where `published` has 0.121: "
    assert f"{said}{within[0]} of the 48 numbers are within 5 %, {within[1]} within 10 %" in text
    first = [column for column in logs if column.startswith("tvl1 ")]
    alone = (logs[first].dropna() ** 2).mean(axis=1) ** 0.5
    assert f"TV-L1 alone comes to {alone.min():.3f}" in text


def test_the_protocol_explained_is_the_nearest_run_that_a_protocol_can_be():
    with gzip.open(TABLES / "protocol_search_trials.csv.gz", "rt") as file:
        trials = pd.read_csv(file, dtype=str, keep_default_na=False)
    logs = trials[trials.columns[43:]].apply(pd.to_numeric)
    able = (trials["score"] == "frame") & (trials["margin"] == "0") & logs.notna().all(axis=1)
    able &= trials["tvl1.sweeps"] == trials["tvl1_sb.sweeps"]
    distance = ((logs**2).mean(axis=1) ** 0.5)[able]
    run = trials.loc[distance.idxmin()]
    params = load_config({"protocol": "explained"}).params
    for switch in trials.columns[4:43].drop(["score", "margin", "tvl1.tau"]):
        value = params.as_dict()[switch.rpartition(".")[2]]
        word = "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
        assert word == run[switch] or float(word) == float(run[switch]), switch
    assert f"`explained`, at a distance of {distance.min():.4f}" in " ".join(document().split())
    again = pd.read_csv(TABLES / "explained.csv")["ratio"]
    assert (np.log(again) ** 2).mean() ** 0.5 == pytest.approx(distance.min(), abs=2e-4)
    within = int((np.log(again).abs() <= math.log(1.05)).sum())
    assert f"{within} numbers are within 5 %" in " ".join(document().split())


def test_the_verdicts_under_explained_are_the_stored_ones():
    text = " ".join(document().split())
    counts, alphas = [], []
    for name in ("explained_claims", "claims"):
        table = pd.read_csv(TABLES / f"{name}.csv")
        table = table[table["protocol"] == ("published" if name == "claims" else "explained")]
        words = table["verdict"].value_counts()
        counts.append([int(words.get(word, 0)) for word in ("holds", "holds in part", "does not hold")])
        words = table[table["id"].str.contains("-alpha-(?:aae|aepe)$")]["verdict"].value_counts()
        alphas.append([int(words.get(word, 0)) for word in ("holds", "holds in part")])
    (holds, part, fails), published = counts[0], counts[1]
    said = f"of 39 claims {holds} hold, {part} hold in part and {fails} do not; under `published`"
    assert f"{said} {published[0]}, {published[1]} and {published[2]}" in text
    said = "12 best alphas, region by error, {} holds and {} hold in part (`published`: {} and {})"
    assert said.format(*alphas[0], *alphas[1]) in text
    evidence = pd.read_csv(TABLES / "explained_claims.csv").set_index("id")["evidence"]
    assert evidence["lambda-sb-best"].startswith("0 of 12 curves have their minimum from 3 to 10")
    assert "the minima lie at lambda_SB 0.1 to 1." in evidence["lambda-sb-best"]
    assert "Of 55 pairs of lambda and theta, TV-L1-SB has the smaller error at 0 %" in evidence["general-theta"]
    assert "Of 54 pairs of lambda and theta, TV-L1-SB has the smaller error at 7 %" in evidence["general-lambda"]


def test_the_halves_that_the_document_gives_are_the_stored_ones():
    text = " ".join(document().split())
    halves = pd.read_csv(TABLES / "protocol_search_halves.csv")
    first, last = halves.iloc[0], halves.iloc[-1]
    assert (
        f"has {first['distance there']:.3f} there and {first['distance on the others']:.3f} on the other" in text
    )
    assert f"has {last['distance there']:.3f} there and {last['distance on the others']:.3f} on the first" in text
    usual, ours = halves["grid's run on the others"], halves["distance on the others"]
    assert f"the ratio is {halves['ratio'].median():.2f} in the median" in text
    said = (
        f"in {(ours < usual).sum()} of {len(halves)} cases (medians {ours.median():.3f} and {usual.median():.3f})"
    )
    assert said in text


def test_the_numbers_that_no_run_explains_are_counted():
    numbers = pd.read_csv(TABLES / "protocol_search_numbers.csv")
    text = " ".join(document().split())
    assert f"but {(~numbers['explained']).sum()} of the {len(numbers)} by none of the nearest 1 %" in text
    assert numbers["floor"].max() <= 1.03
    worst = numbers.loc[(numbers["ratio"] - 1.0).abs().idxmax()]
    assert (worst["sequence"], worst["method"], worst["metric"]) == ("rubberwhale", "tvl1_sb", "aepe")
    assert f"{100 * (worst['ratio'] - 1):.0f} % too large" in text


def document() -> str:
    return (ROOT / "docs/protocol.md").read_text(encoding="utf-8")


def stored(name: str) -> pd.DataFrame:
    return pd.read_csv(ROOT / f"results/committed/tables/{name}.csv")


def table_of(path: str, first: str) -> list[list[str]]:
    """The rows below the heading `first` of a document's table, up to its end."""
    text = (ROOT / path).read_text(encoding="utf-8")
    return rows(text[text.index(f"\n| {first} |") :].partition("\n\n")[0])[2:]


def assert_told(cell: str, values: list[float]) -> None:
    """Assert that the numbers of a cell are the values, rounded to the digits that it has."""
    told = re.findall(r"-?\d+\.?\d*", cell.replace(" - ", " "))
    assert [float(x) for x in told] == [
        round(v, len(x.partition(".")[2])) for x, v in zip(told, values, strict=True)
    ]


FLUID_METHODS = (
    "protocol fluid", "alpha = 1", "OpenPIV", "scikit-image TV-L1", "OpenCV DualTVL1", "scikit-image iLK",
    "OpenCV DIS", "OpenCV Farneback",
)  # fmt: skip


def test_the_errors_of_fluids_are_those_of_the_stored_table():
    found = stored("fluids")
    flows = found[["dataset", "flow"]].drop_duplicates().to_numpy()
    told = table_of("docs/fluids.md", "flow")
    assert len(told) == len(flows)  # in the order of the stored table
    for (dataset, flow), row in zip(flows, told, strict=True):
        errors = found[(found["dataset"] == dataset) & (found["flow"] == flow)].set_index("method")
        for method, cell in zip(FLUID_METHODS, row[1:], strict=True):
            names = ["aepe", "aepe_low", "aepe_high"] if "(" in cell else ["aepe"]
            assert_told(cell, [errors.loc[method, name] for name in names])


def test_the_derivatives_and_orders_of_fluids_are_those_of_the_stored_tables():
    found = stored("fluids")
    means = found[found["flow"] == "mean"].set_index(["dataset", "method"])
    dataset = ""
    for label, *cells in table_of("docs/fluids.md", "mean over flows"):
        dataset = {"rendered": "particles", "public pairs": "piv"}.get(label.partition(":")[0], dataset)
        method = "protocol fluid" if "protocol" in label else label
        for name, cell in zip(
            ("vorticity", "vorticity_grid", "divergence", "divergence_grid"), cells, strict=True
        ):
            assert_told(cell, [means.loc[(dataset, method), name]])
    orders = stored("fluids_orders")
    orders = orders[(orders["flow"] == "mean") & (orders["lambda"] == orders["lambda"].min())]
    for dataset, (_, *cells) in zip(("particles", "piv"), table_of("docs/fluids.md", "order"), strict=True):
        for cell, error in zip(cells, orders[orders["dataset"] == dataset]["aepe"], strict=True):
            assert_told(cell, [error])


def test_the_settings_of_fluids_are_those_of_the_stored_table():
    found = stored("fluids_settings").set_index(["setting", "value", "method"])["aepe"]
    names = {"particles a pixel": "density", "noise, gray levels": "noise", "share of lost pairs": "lost",
             "largest displacement, px": "displacement"}  # fmt: skip
    methods = (*FLUID_METHODS[:3], "OpenPIV, windows to 32 px", "scikit-image TV-L1", "OpenCV DIS")
    setting = ""
    for label, value, *cells in table_of("docs/fluids.md", "setting"):
        setting = names.get(label, setting)
        for method, cell in zip(methods, cells, strict=True):
            assert_told(cell, [found[setting, float(value), method]])


def test_the_ablation_of_the_accurate_preset_is_that_of_the_stored_table():
    aepe = stored("accurate").set_index("part")["AEPE"]
    parts = {"finer pyramid": "pyramid", "flow in two parts": "infimal convolution"}
    parts |= {"structure-texture decomposition": "structure-texture", "derivatives of both frames": "derivatives"}
    told = {row[0].partition(" (")[0]: row[-1] for row in table_of("docs/beyond.md", "ingredient")}
    changed = {re.split("[/+]", part)[1] for part in aepe.index if part not in ("plain", "accurate")}
    assert {parts.get(name, name) for name in told} == changed
    for name, cell in told.items():
        pairs = [(f"{whole}{parts.get(name, name)}", whole[:-1]) for whole in ("plain/", "accurate/", "accurate+")]
        assert_told(cell, [100.0 * (aepe[part] / aepe[whole] - 1.0) for part, whole in pairs if part in aepe])


def test_the_errors_of_the_accurate_preset_are_those_of_the_stored_table():
    found = stored("accurate").set_index("part")
    choice = stored("accurate_choice").set_index("sequence")
    gray, color = found.loc["accurate"], found.loc["accurate+colour weights"]
    for label, _, *cells in table_of("docs/beyond.md", "sequence | AEPE before, px"):
        if label.startswith("mean, setting"):
            assert_told(" ".join(cells), [choice.loc["left out", name] for name in ("AEPE", "AAE")])
            continue
        end = "" if label == "mean" else f" {label.lower()}"
        assert_told(" ".join(cells), [part[f"{name}{end}"] for part in (gray, color) for name in ("AEPE", "AAE")])


def test_the_readme_shows_the_stored_answer():
    answer = (ROOT / "results/committed/tables/answer.md").read_text(encoding="utf-8")
    assert answer in (ROOT / "README.md").read_text(encoding="utf-8"), "run: make publish"


def documents() -> list[Path]:
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def named_tests(text: str) -> list[tuple[str, str]]:
    """The tests that a document names, as (path, name); a name alone belongs to the path before it."""
    found, path = [], ""
    for file, name in re.findall(r"(tests/[\w/]+\.py)?(?:::(test_\w+))?", text):
        path = file or path
        if file or name:
            found.append((path, name))
    return found


def test_the_documents_name_tests_that_exist():
    assert named_tests("`tests/a.py::test_b`, `::test_c`; tests/d.py") == [
        ("tests/a.py", "test_b"), ("tests/a.py", "test_c"), ("tests/d.py", ""),
    ]  # fmt: skip
    named = {test for document in documents() for test in named_tests(document.read_text(encoding="utf-8"))}
    assert len(named) > 30
    for path, name in sorted(named):
        assert (ROOT / path).is_file(), path
        assert f"def {name}" in (ROOT / path).read_text(encoding="utf-8"), f"{path}::{name}"


def test_each_guarantee_was_broken_on_purpose():
    """A new guarantee comes with a change to the code for which its test was seen to fail."""
    guarantees, text = (
        (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("guarantees.md", "testing.md")
    )
    section = text.partition("## Guarantees, broken on purpose")[2].partition("\n## ")[0]
    broken = [test for row in rows(section) for test in named_tests(row[-1])]
    assert sorted(broken) == sorted(set(named_tests(guarantees)))
    assert f"All {len(broken)} entries" in section


@pytest.mark.parametrize("path", documents() if ROOT else [], ids=lambda path: path.name)
def test_the_documents_name_files_that_exist(path):
    text = path.read_text(encoding="utf-8")
    files = re.findall(r"\b(?:fracbench|conf|experiments|docs)/[\w/]+(?:\.(?:py|md|yaml))?", text)
    links = [link for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link]
    for place in {*(ROOT / file for file in files), *(path.parent / source_of(link) for link in links)}:
        assert "NAME" in place.name or "my_" in place.name or place.exists(), place


def source_of(link: str) -> str:
    """The file that a page of the site is made of, seen from ``docs``."""
    link = re.sub(r"^auto_gallery/(plot_\w+)\.rst$", r"gallery/\1.py", link)
    link = re.sub(r"^auto_gallery/index\.rst$", "gallery/GALLERY_HEADER.rst", link)
    link = re.sub(r"^generated/tables/(\w+\.md)$", r"../results/committed/tables/\1", link)
    link = re.sub(r"^generated/contributing\.md$", "../CONTRIBUTING.md", link)
    return re.sub(r"^generated/(tables|protocols|commands)\.md$", "_ext/from_files.py", link)


def test_the_map_of_the_rooms_is_complete():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    told = [row[0].strip("`").rstrip("/") for row in rows(text) if row[0].startswith("`fracbench/")]
    package = ROOT / "fracbench"
    rooms = [init.parent.relative_to(ROOT).as_posix() for init in package.glob("*/**/__init__.py")]
    assert sorted(told) == sorted(rooms)


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


# -- commands and code ------------------------------------------------------------------------------


def commands(text: str) -> list[list[str]]:
    """The words after ``fracbench`` of every command in a document, in code blocks and in the text."""
    lines = [line for line in text.splitlines() if line.startswith("    ")]
    spans = [" ".join(span.split()) for span in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)]
    found = []
    for line in [*map(str.strip, lines), *spans]:
        start = re.match(r"(?:\$ )?(?:\w+=\S+ )*(?:(?:\S*python3?) -m )?fracbench (?=[a-z])", line)
        if start and "..." not in line:
            found.append(shlex.split(line[start.end() :], comments=True))
    return found


def sources() -> list[Path]:
    return [*documents(), *sorted((ROOT / "docs" / "gallery").glob("plot_*.py"))] if ROOT else []


def test_commands_are_found():
    text = "    .venv/bin/python -m fracbench sweep alpha=0:2:0.1  # errors\n"
    text += "`fracbench\nbench --only x`, `fracbench`, `A=1 fracbench data`"
    assert commands(text) == [["sweep", "alpha=0:2:0.1"], ["bench", "--only", "x"], ["data"]]
    assert sum(len(commands(path.read_text(encoding="utf-8"))) for path in sources()) > 60


@pytest.mark.parametrize("path", sources(), ids=lambda path: path.name)
def test_the_commands_of_the_documents_are_understood(path):
    for words in commands(path.read_text(encoding="utf-8")):
        try:
            arguments = build_parser().parse_words(words)
            grid = parse_overrides(getattr(arguments, "overrides", []))
        except InputError as exc:
            if len(words) > 1 or "arguments are required" not in str(exc):  # `fracbench sweep` names the command
                pytest.fail(f"fracbench {shlex.join(words)}: {exc}")
        else:
            assert grid.size > 0


PYTHON = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)  # CONTRIBUTING's are in its recipes' tests


@pytest.mark.parametrize(
    "path",
    [path for path in (documents() if ROOT else []) if PYTHON.search(path.read_text(encoding="utf-8"))],
    ids=lambda path: path.name,
)
def test_the_python_of_the_documents_runs(path, work, monkeypatch):
    blocks = PYTHON.findall(path.read_text(encoding="utf-8"))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    pair = load_sequence("flat", "synthetic")
    names = {"frame0": pair.frame0, "frame1": pair.frame1, "frames": [pair.frame0, pair.frame1]}
    for block in blocks:
        code = compile(block, path.name, "exec")
        missing = [
            name for name in re.findall(r"^(?:from|import) (\w+)", block, re.MULTILINE) if not find_spec(name)
        ]
        if missing:
            pytest.skip(f"needs {', '.join(missing)}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exec(code, names)  # as a reader would, one block after another


def test_the_gallery_is_made_of_scripts_with_text():
    scripts = sorted((ROOT / "docs" / "gallery").glob("plot_*.py"))
    assert len(scripts) >= 10
    for script in scripts:
        text = script.read_text(encoding="utf-8")
        title, rule = text.splitlines()[1:3]
        assert rule == "=" * len(rule) and len(rule) >= len(title), script.name
        assert "\n# %%\n" in text and "plt.show()" in text, script.name

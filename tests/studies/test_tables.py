"""Tables: every digit and every row is kept, and the sentences agree with the numbers."""

from __future__ import annotations

import dataclasses
import math
import os

import numpy as np
import pandas as pd
import pytest

from fracbench.data.files import ensure_folder, write_text
from fracbench.errors import InputError
from fracbench.harness.run.plan import make_plan
from fracbench.harness.run.tidy import tidy
from fracbench.studies.paper.table2 import distance, summary, versus_published, wide
from fracbench.studies.tables import CONVENTIONS, footnote, rounded, to_latex, to_markdown, write_table

SEQUENCES = ("grove2", "rubberwhale", "grove3", "hydrangea", "urban2", "dimetrodon", "urban3", "venus")
METRICS = ("aae", "aepe", "sdae")


def plan(*tokens):
    return make_plan([*tokens, "sequence=synthetic_flat"], allow_download=False)


def published() -> pd.DataFrame:
    """Made-up numbers of a paper: AEPE is 10 times AAE, SB is a tenth better."""
    rows = []
    for k, sequence in enumerate(SEQUENCES, start=1):
        for method, factor in (("tvl1", 1.0), ("tvl1_sb", 0.9)):
            rows.append((sequence, method, 0.1 * k * factor, 1.0 * k * factor, 0.05 * k))
    return pd.DataFrame(rows, columns=["sequence", "method", *METRICS])


def ours(factor=1.0, sb_better_on=8, protocol="reference", sequences=SEQUENCES) -> pd.DataFrame:
    """The paper's numbers times `factor`, SB better by AEPE on so many sequences, by AAE on one less."""
    table = published().assign(protocol=protocol)
    table[list(METRICS)] *= factor
    for k in range(8):
        for metric, n in (("aae", sb_better_on - 1), ("aepe", sb_better_on)):
            if k >= n:
                table.loc[2 * k + 1, metric] = table.loc[2 * k, metric]  # equal is not better
    names = dict(zip(SEQUENCES, sequences, strict=True))
    return table.assign(sequence=table["sequence"].map(names))


# -- tidy ----------------------------------------------------------------------------------------


def test_one_row_a_planned_point_in_the_order_of_the_plan(fake_rows):
    made = plan("alpha=1,0.5", "boundary=reflect,zero")
    table = tidy(made, fake_rows(made, lambda labels, params: (float(params["alpha"]), 1 / 3, 0.3)))
    assert table["alpha"].tolist() == [1.0, 1.0, 0.5, 0.5]
    assert table["boundary"].tolist() == ["reflect", "zero"] * 2
    assert table["aae"].tolist() == [1.0, 1.0, 0.5, 0.5]
    assert table["aepe"].tolist() == [1 / 3] * 4
    assert table["sequence"].tolist() == ["synthetic_flat"] * 4
    assert table["protocol"].tolist() == ["reference"] * 4
    assert table["iterations"].tolist() == [10 + 3 + 4] * 4
    assert table["inner_iterations"].tolist() == [20 + 6 + 8] * 4
    assert table["status"].tolist() == ["done"] * 4
    assert table["stop"].tolist() == ["converged"] * 4
    assert table["key"].tolist() == [planned.point.key for planned in made.points]


def test_points_that_share_a_key_have_a_row_each(fake_rows):
    made = plan("alpha=0,1", "method=tvl1")
    assert len(tidy(made, fake_rows(made))) == 2


def test_every_parameter_of_the_key_is_a_column(fake_rows):
    made = plan("alpha=1")
    table = tidy(made, fake_rows(made))
    for name, value in made.points[0].point.spec["params"].items():
        (shown,) = table[name]
        assert shown == value or float(shown) == float(value)
    assert table["lambda"].dtype.kind == "f"
    assert table["n_warps"].dtype.kind == "i"


def test_what_differs_from_run_to_run_is_not_in_the_table(fake_rows, tmp_path):
    made = plan("alpha=0:2:0.5")
    one = fake_rows(made)
    two = {
        key: dataclasses.replace(
            row, seconds=99.0, peak_mib=77.0, attempts=2, created="2030-01-01T00:00:00+00:00", provenance={}
        )
        for key, row in one.items()
    }
    first = write_table(tidy(made, one), tmp_path / "one").read_bytes()
    assert first == write_table(tidy(made, two), tmp_path / "two").read_bytes()
    assert first == write_table(tidy(made, one), tmp_path / "one").read_bytes()
    header = first.decode().splitlines()[0].split(",")
    assert not {"seconds", "peak_mib", "created", "host", "attempts", "phases"} & set(header)


def test_failed_and_missing_points_are_rows_without_errors(fake_rows):
    made = plan("alpha=0,1,2")
    done, failed, missing = (planned.point.key for planned in made.points)
    rows = {done: fake_rows(made)[done], failed: fake_rows(made, status="failed")[failed]}
    table = tidy(made, rows)
    assert table["status"].tolist() == ["done", "failed", "missing"]
    assert table["error"].tolist()[1] == "made up"
    assert table["aae"].tolist()[0] == 0.1
    assert table.loc[1:, [*METRICS, "n_pixels", "iterations"]].isna().all(axis=None)
    assert table["key"].tolist() == [done, failed, missing]


def test_counts_stay_whole_beside_a_point_that_failed(fake_rows, tmp_path):
    made = plan("alpha=0,1")
    first, second = (planned.point.key for planned in made.points)
    rows = {first: fake_rows(made)[first], second: fake_rows(made, status="failed")[second]}
    path = write_table(tidy(made, rows), tmp_path / "t")
    text = pd.read_csv(path, dtype=str, keep_default_na=False)
    assert text["n_pixels"].tolist() == ["100", ""]
    assert text["iterations"].tolist() == ["17", ""]


def test_a_label_that_only_some_points_have_is_blank_elsewhere(fake_rows):
    made = make_plan(["region=grove2_A", "shift=null,3", "dataset=synthetic"], allow_download=False)
    assert tidy(made, fake_rows(made))["shift"].tolist() == ["", "3"]


def test_a_younger_parameter_has_a_column_only_where_it_is_unusual(fake_rows):
    """The tables of commands that were typed before it came stay as they are, to the byte."""
    for words, expected in (((), False), (("finest_scale=0",), False), (("finest_scale=0,1",), True)):
        made = make_plan(["sequence=synthetic_flat", "alpha=1,1.2", *words])
        assert ("finest_scale" in tidy(made, fake_rows(made))) == expected
    table = tidy(made, fake_rows(made))
    assert sorted(table["finest_scale"]) == [0, 0, 1, 1]


# -- the paper beside ours -----------------------------------------------------------------------


def test_ratios_are_ours_over_the_papers():
    table = published().assign(protocol="reference")
    table[list(METRICS)] *= 1.1
    comparison = versus_published(table, published())
    assert list(comparison) == ["protocol", "sequence", "method", "metric", "published", "ours", "ratio"]
    assert len(comparison) == 8 * 2 * 3
    np.testing.assert_allclose(comparison["ratio"], 1.1)
    assert comparison["metric"].tolist() == list(METRICS) * 16
    assert comparison["sequence"].tolist() == [s for s in SEQUENCES for _ in range(6)]
    urban3 = comparison[(comparison["sequence"] == "urban3") & (comparison["method"] == "tvl1_sb")]
    assert urban3["published"].tolist() == pytest.approx([0.63, 6.3, 0.35])
    assert urban3["ours"].tolist() == pytest.approx([0.693, 6.93, 0.385])


def test_what_the_paper_does_not_have_has_no_ratio():
    scenes = tuple(f"synthetic_{k}" for k in range(8))
    comparison = versus_published(ours(sequences=scenes), published())
    assert comparison["published"].isna().all() and comparison["ratio"].isna().all()
    assert comparison["ours"].notna().all()
    assert list(wide(comparison, "reference")) == ["sequence", "method", "AAE ours", "AEPE ours", "SDAE ours"]
    assert not any("Distance" in sentence for sentence in summary(comparison, "reference"))


def test_the_distance_is_the_rms_of_the_logarithms():
    assert distance([1.0, 1.0]) == 0.0
    assert distance([1.1, 1 / 1.1, 1.1]) == pytest.approx(math.log(1.1))
    assert distance([math.e, 1.0]) == pytest.approx(math.sqrt(0.5))
    assert math.isnan(distance([1.0, math.nan]))


def test_the_papers_layout_has_a_row_for_each_sequence_and_method():
    both = pd.concat([ours(2.0), ours(3.0, protocol="published")])
    table = wide(versus_published(both, published()), "published")
    assert table["sequence"].tolist() == [s for s in SEQUENCES for _ in range(2)]
    assert table["method"].tolist() == ["TV-L1", "TV-L1-SB"] * 8
    assert list(table)[2:] == [
        f"{metric} {column}" for metric in ("AAE", "AEPE", "SDAE") for column in ("paper", "ours", "ratio")
    ]
    np.testing.assert_allclose(table["AEPE ratio"], 3.0)
    np.testing.assert_allclose(table["AEPE ours"], 3.0 * table["AEPE paper"])


@pytest.mark.parametrize(("n", "by_aae"), [(8, 7), (3, 2), (1, 0)])
def test_how_often_split_bregman_is_better_is_counted(n, by_aae):
    said = " ".join(summary(versus_published(ours(sb_better_on=n), published()), "reference"))
    assert f"better than TV-L1 on {by_aae} of 8 sequences by AAE, on {n} of 8 by AEPE (paper: 8 of 8" in said


def test_how_far_from_the_paper_is_said_in_numbers():
    table = published().assign(protocol="published")
    table.loc[:11, list(METRICS)] *= 1.04
    table.loc[12:, list(METRICS)] /= 1.08
    said = summary(versus_published(table, published()), "published")[0]
    expected = math.sqrt(0.75 * math.log(1.04) ** 2 + 0.25 * math.log(1.08) ** 2)
    assert f"48 numbers): {expected:.3f}; 36 numbers within 5 %, 48 within 10 %." in said


def test_means_are_over_all_sequences_or_none():
    table = ours()
    said = " ".join(summary(versus_published(table, published()), "reference"))
    assert "Mean of TV-L1: AAE 0.4500 rad, AEPE 4.5000 px." in said
    assert "Mean of TV-L1-SB: AAE 0.4150 rad, AEPE 4.0500 px." in said
    table.loc[0, list(METRICS)] = np.nan
    said = " ".join(summary(versus_published(table, published()), "reference"))
    assert "Mean of TV-L1: AAE nan rad, AEPE nan px." in said
    assert "Mean of TV-L1-SB: AAE 0.4150 rad" in said


def test_a_protocol_is_summed_up_alone():
    both = pd.concat([ours(sb_better_on=8), ours(2.0, sb_better_on=3, protocol="published")])
    comparison = versus_published(both, published())
    assert "on 8 of 8 by AEPE" in " ".join(summary(comparison, "reference"))
    assert "on 3 of 8 by AEPE" in " ".join(summary(comparison, "published"))


def test_one_method_alone_is_compared_with_nobody():
    table = ours().query("method == 'tvl1'")
    said = summary(versus_published(table, published()), "reference")
    assert not any("better" in sentence for sentence in said)
    assert len(said) == 2


def test_the_footnote_names_conventions_protocols_and_origins(fake_rows):
    made = plan("alpha=0,1")
    rows = fake_rows(made)
    key = next(iter(rows))
    provenance = {"python": "3.12.1", "versions": {"numpy": "2.1"}, "commit": "1" * 40, "dirty": True}
    rows[key] = dataclasses.replace(rows[key], provenance=provenance)
    said = "\n".join(footnote(rows, ["reference", "published"]))
    assert CONVENTIONS in said
    assert "reference, published" in said
    assert f"numpy 2.0, Python 3.11.0, commit {'0' * 12};" in said
    assert f"numpy 2.1, Python 3.12.1, commit {'1' * 12} with local changes" in said


# -- files ---------------------------------------------------------------------------------------


def test_a_csv_keeps_every_digit(tmp_path):
    values = [1 / 3, 0.1 + 0.2, 1e-17, 123456789.123456789, float(np.float32(0.1)), np.nextafter(1.0, 2.0)]
    path = write_table(pd.DataFrame({"x": values, "name": list("abcdef")}), tmp_path / "alpha=1.5")
    assert path == tmp_path / "alpha=1.5.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    assert rows[0] == ["x", "name"]
    assert [float(row[0]) for row in rows[1:]] == values
    assert path.read_bytes().count(b"\n") == 7
    assert b"\r" not in path.read_bytes()


def test_markdown_and_latex_hold_every_row_and_number():
    table = wide(versus_published(ours(1.1), published()), "reference")
    markdown, latex = to_markdown(table), to_latex(table, "Table 2 of_the paper")
    assert len(markdown.splitlines()) == 2 + 16
    assert latex.count(r"\\") == 1 + 16
    for _, row in rounded(table).iterrows():
        cells = [cell.strip() for cell in row]
        assert any(
            [part.strip() for part in line.strip("|").split("|")] == cells for line in markdown.splitlines()
        )
        assert any(
            [part.strip() for part in line.removesuffix(r"\\").split("&")] == cells for line in latex.splitlines()
        )
    assert r"\caption{Table 2 of\_the paper}" in latex
    assert r"\toprule" in latex


def test_names_with_an_underscore_are_escaped_in_latex():
    table = pd.DataFrame({"sequence": ["synthetic_flat"], "method": ["a & b"], "n_x": [1.0]})
    latex = to_latex(table, "caption")
    assert r"synthetic\_flat & a \& b & 1.0000" in latex
    assert r"n\_x" in latex


def test_rounding_is_for_reading_and_changes_nothing():
    table = pd.DataFrame({"aae": [0.123456, np.nan], "aae ratio": [1.0049, 2.0], "n": [3, 4], "name": ["a", "b"]})
    before = table.copy()
    shown = rounded(table)
    assert shown.to_dict("list") == {
        "aae": ["0.1235", ""],
        "aae ratio": ["1.00", "2.00"],
        "n": [3, 4],
        "name": ["a", "b"],
    }
    pd.testing.assert_frame_equal(table, before)


def test_a_text_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "t.md"
    assert write_text("ü\n", path) == path
    assert path.read_bytes() == "ü\n".encode()
    with pytest.raises(UnicodeEncodeError):
        write_text("new \udc80", path)
    assert path.read_bytes() == "ü\n".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_the_results_folder_is_made(tmp_path):
    folder = tmp_path / "a" / "b"
    assert ensure_folder(folder) == folder
    assert folder.is_dir()
    assert ensure_folder(folder) == folder


def test_a_results_folder_that_cannot_be_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"results folder .*file/runs: cannot be created .*set paths.results"):
        ensure_folder(tmp_path / "file" / "runs")
    with pytest.raises(InputError, match=r"results folder .*file: cannot be created"):
        ensure_folder(tmp_path / "file")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match=r"cannot be written; set paths.results"):
        ensure_folder(tmp_path)

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fracbench.errors import InputError
from fracbench.figures.curves import MARKERS, alpha_curves, heat_map, line_family
from fracbench.figures.style import DPI, WIDTH, house_style, new_figure, render, save_figure

ALPHA = np.round(np.arange(0.0, 2.01, 0.2), 10)
UNITS = ["AAE [rad]", "AEPE [px]"]


def sweep(best_aae: float = 1.2, best_aepe: float = 1.4, **columns: object) -> pd.DataFrame:
    aae, aepe = 0.05 + (ALPHA - best_aae) ** 2, 0.2 + (ALPHA - best_aepe) ** 2
    return pd.DataFrame({"alpha": ALPHA, "aae": aae, "aepe": aepe, **columns})


def lines(ax: Axes, gid: str | None = None) -> list[Line2D]:
    return [line for line in ax.lines if line.get_gid() == gid]


def panels(fig: Figure) -> list[Axes]:
    return [ax for ax in fig.axes if ax.get_label() != "<colorbar>"]


def texts(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.texts]


def legend_texts(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


# --- alpha_curves ---


def test_minimum_of_each_panel_is_marked_and_named() -> None:
    fig = alpha_curves(sweep().sample(frac=1, random_state=0))
    for ax, place, height in zip(fig.axes, (1.2, 1.4), (0.05, 0.2), strict=True):
        (star,) = lines(ax, "minimum")
        assert star.get_marker() == "*" and star.get_xdata() == [place]
        assert star.get_ydata() == pytest.approx([height])
        assert texts(ax) == [rf"min at $\alpha$ = {place}"]
        (curve,) = lines(ax)
        np.testing.assert_array_equal(curve.get_xdata(), ALPHA)


def test_axes_carry_units() -> None:
    fig = alpha_curves(sweep())
    assert [ax.get_ylabel() for ax in fig.axes] == UNITS
    assert [ax.get_xlabel() for ax in fig.axes] == [r"fractional order $\alpha$"] * 2


def test_failed_points_leave_gaps_and_are_never_the_minimum() -> None:
    table = sweep()
    table.loc[table.alpha == 1.2, "aae"] = np.nan
    table.loc[table.alpha == 0.4, "aae"] = -np.inf
    ax = alpha_curves(table).axes[0]
    (curve,) = lines(ax)
    gaps = np.isnan(np.asarray(curve.get_ydata(), dtype=float))
    assert ALPHA[gaps].tolist() == [0.4, 1.2] and len(gaps) == len(ALPHA)
    assert lines(ax, "minimum")[0].get_xdata()[0] in (1.0, 1.4)


def test_a_curve_without_any_finite_error_is_named_so() -> None:
    table = pd.concat([sweep(region="a"), sweep(region="b").assign(aae=np.nan)])
    ax = alpha_curves(table, hue="region").axes[0]
    assert len(lines(ax, "minimum")) == 1
    assert legend_texts(ax) == [r"a: min at $\alpha$ = 1.2", "b: no finite error"]


def test_curves_of_a_hue_differ_in_colour_and_marker() -> None:
    regions = {"r0": 0.4, "r1": 1.2, "r2": 1.6}
    fig = alpha_curves(pd.concat([sweep(v, v, region=r) for r, v in regions.items()]), hue="region")
    for ax in fig.axes:
        curves = lines(ax)
        assert len({(c.get_color(), c.get_marker()) for c in curves}) == len(curves) == 3
        assert "*" not in {c.get_marker() for c in curves}
        assert [s.get_xdata()[0] for s in lines(ax, "minimum")] == list(regions.values())
        assert legend_texts(ax) == [rf"{r}: min at $\alpha$ = {v:g}" for r, v in regions.items()]


def test_legend_stays_off_the_data_and_on_the_page() -> None:
    fig = alpha_curves(pd.concat([sweep(region=f"region_{i}") for i in range(6)]), hue="region", title="six")
    with house_style():
        fig.draw_without_rendering()
    page = fig.bbox
    for ax in fig.axes:
        box = ax.get_legend().get_window_extent()
        assert box.y1 < ax.get_window_extent().y0
        assert box.y1 < ax.xaxis.label.get_window_extent().y0 + 1
        assert page.y0 <= box.y0 and page.x0 <= box.x0 and box.x1 <= page.x1
    assert not fig.axes[0].get_legend().get_window_extent().overlaps(fig.axes[1].get_legend().get_window_extent())


def test_zero_is_ringed_and_explained_where_there_is_one() -> None:
    fig = alpha_curves(sweep(), zero_note="the operator is the identity")
    assert [tuple(r.get_xdata()) for ax in fig.axes for r in lines(ax, "zero")] == [(0.0,), (0.0,)]
    assert fig.get_supxlabel() == r"ringed: $\alpha$ = 0, the operator is the identity"
    assert alpha_curves(sweep().iloc[1:], zero_note="none").get_supxlabel() == ""


def test_any_key_can_be_swept_on_a_logarithmic_axis() -> None:
    table = sweep().rename(columns={"alpha": "lambda"}).assign(**{"lambda": np.logspace(-3, 0, len(ALPHA))})
    ax = alpha_curves(table, x="lambda", logx=True).axes[0]
    assert ax.get_xscale() == "log" and ax.get_xlabel() == r"data attachment weight $\lambda$"
    assert alpha_curves(table.rename(columns={"lambda": "tau"}), x="tau").axes[0].get_xlabel() == "tau"


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        (sweep().drop(columns="aepe"), {}, "unknown column 'aepe': did you mean 'aae'"),
        (sweep(), {"x": "alhpa"}, "unknown column 'alhpa': did you mean 'alpha'"),
        (sweep().iloc[:0], {}, "no rows"),
        (pd.concat([sweep(), sweep()]), {}, "several rows share alpha = 0:"),
        (pd.concat([sweep(region="a")] * 2), {"hue": "region"}, "several rows with region = a share alpha"),
        (sweep(), {"logx": True}, "'alpha' must hold positive numbers"),
        (sweep().assign(alpha=np.nan), {}, "'alpha' must hold finite numbers"),
        (sweep().assign(aae="fast"), {}, "must hold numbers"),
    ],
)
def test_unusable_tables_are_named_in_one_line(
    table: pd.DataFrame, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        alpha_curves(table, **options)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_the_table_is_not_changed() -> None:
    table = sweep().iloc[::-1]
    before = table.copy()
    alpha_curves(table)
    pd.testing.assert_frame_equal(table, before)


# --- line_family ---


def family_table(values: tuple[float, ...], methods: tuple[str, ...]) -> pd.DataFrame:
    return pd.concat(
        sweep(**{"lambda": value, "method": method}).rename(columns={"alpha": "theta"})
        for value in reversed(values)
        for method in methods
    )


def test_family_has_a_marker_a_value_and_a_line_style_a_method() -> None:
    values = (0.01, 0.05, 0.1, 0.2, 0.3, 0.5)
    fig = line_family(family_table(values, ("tvl1", "tvl1_sb")), x="theta", family="lambda")
    for ax, unit in zip(fig.axes, UNITS, strict=True):
        assert ax.get_ylabel() == unit and ax.get_xlabel() == r"tightness $\theta$"
        assert [line.get_marker() for line in ax.lines[::2]] == list(MARKERS) == ["o", "*", "x", "D", "^", "+"]
        assert [line.get_linestyle() for line in ax.lines] == ["--", "-"] * 6
        assert [line.get_color() for line in ax.lines[::2]] == [line.get_color() for line in ax.lines[1::2]]
    (legend,) = fig.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == [rf"$\lambda$ = {v}" for v in values] + ["TV-L1", "TV-L1-SB"]


def test_family_legend_is_outside_the_panels() -> None:
    fig = line_family(family_table((0.1, 0.2), ("tvl1", "tvl1_sb")), x="theta", family="lambda", title="t")
    with house_style():
        fig.draw_without_rendering()
    box = fig.legends[0].get_window_extent()
    assert box.x0 > max(ax.get_window_extent().x1 for ax in fig.axes) and box.x1 <= fig.bbox.x1


def test_methods_the_paper_lacks_get_styles_of_their_own() -> None:
    methods = ("tvl1", "opencv", "tvl1_sb", "skimage")
    fig = line_family(family_table((0.1,), methods), x="theta", family="lambda")
    styles = [line._unscaled_dash_pattern for line in fig.axes[0].lines]
    assert len({str(style) for style in styles}) == 4
    assert [text.get_text() for text in fig.legends[0].get_texts()][1:] == [
        "TV-L1",
        "opencv",
        "TV-L1-SB",
        "skimage",
    ]


def test_a_captions_styles_replace_markers_and_the_methods_line() -> None:
    values = (0.03, 0.05, 0.1, 0.3, 0.5, 1.0)
    styles = ["--*", "--o", "--x", "--", "-", "-."]
    fig = line_family(family_table(values, ("tvl1_sb",)), x="theta", family="lambda", styles=styles)
    for ax in fig.axes:
        drawn = [(line.get_linestyle(), line.get_marker()) for line in ax.lines]
        assert drawn == [("--", "*"), ("--", "o"), ("--", "x"), ("--", "None"), ("-", "None"), ("-.", "None")]
    assert [text.get_text() for text in fig.legends[0].get_texts()] == [rf"$\lambda$ = {v:g}" for v in values]


def test_the_papers_range_is_shaded_behind_the_lines() -> None:
    table = family_table((0.1, 0.2), ("tvl1_sb",)).assign(theta=lambda t: t.theta + 0.1)
    fig = line_family(table, x="theta", family="lambda", shade=(0.5, 1.5), logx=True)
    for ax in fig.axes:
        (span,) = ax.patches
        assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((0.5, 1.5))
        assert span.get_zorder() < min(line.get_zorder() for line in ax.lines)
    assert [text.get_text() for text in fig.legends[0].get_texts()].count("best in the paper") == 1


def test_a_logarithmic_axis_has_plain_numbers() -> None:
    table = family_table((0.1,), ("tvl1_sb",)).assign(theta=lambda t: 10.0 ** (t.theta - 1))
    fig = line_family(table, x="theta", family="lambda", logx=True)
    fig.draw_without_rendering()
    assert {"0.1", "1", "10"} <= {label.get_text() for label in fig.axes[0].get_xticklabels()}


def test_family_keeps_gaps_and_refuses_doubles() -> None:
    table = family_table((0.1, 0.2), ("tvl1",)).reset_index(drop=True)
    table.loc[3, "aepe"] = np.nan
    ax = line_family(table, x="theta", family="lambda").axes[1]
    assert [int(np.isnan(np.asarray(line.get_ydata(), dtype=float)).sum()) for line in ax.lines] == [0, 1]
    with pytest.raises(InputError, match="several rows with method = tvl1 share theta = 0"):
        line_family(
            table[table["lambda"] == 0.1].assign(method="tvl1").pipe(lambda t: pd.concat([t, t])),
            x="theta",
            family="lambda",
        )


# --- heat_map ---


def grid_table() -> pd.DataFrame:
    rows = [
        {"alpha": a, "lambda_sb": s, "aae": 0.1 + abs(a - 1.2) + abs(s - 5), "aepe": 1 + abs(a - 1) + abs(s - 1)}
        for a in (0.8, 1.0, 1.2)
        for s in (1, 5, 10)
    ]
    return pd.DataFrame(rows).sample(frac=1, random_state=1)


def test_heat_map_marks_the_best_cell() -> None:
    left, right = panels(heat_map(grid_table(), x="alpha", y="lambda_sb"))
    assert lines(left, "minimum")[0].get_xydata().tolist() == [[2.0, 1.0]]
    assert lines(right, "minimum")[0].get_xydata().tolist() == [[1.0, 0.0]]
    assert left.get_title() == r"min at $\alpha$ = 1.2, $\lambda_{SB}$ = 5"
    assert [t.get_text() for t in left.get_xticklabels()] == ["0.8", "1", "1.2"]
    assert [t.get_text() for t in left.get_yticklabels()] == ["1", "5", "10"]


def test_heat_map_bars_carry_units_and_rows_run_upwards() -> None:
    fig = heat_map(grid_table(), x="alpha", y="lambda_sb")
    bars = [ax for ax in fig.axes if ax.get_label() == "<colorbar>"]
    assert [bar.get_ylabel() for bar in bars] == UNITS
    ax = panels(fig)[0]
    cells = np.asarray(ax.images[0].get_array())
    assert cells[0, 0] == pytest.approx(0.1 + 0.4 + 4) and cells[2, 2] == pytest.approx(0.1 + 5)
    assert ax.get_ylim()[0] < ax.get_ylim()[1]


def test_heat_map_shows_missing_and_failed_cells_as_gaps() -> None:
    table = grid_table()
    table = table[~((table.alpha == 1.0) & (table.lambda_sb == 10))]
    table.loc[(table.alpha == 1.2) & (table.lambda_sb == 5), "aae"] = np.inf
    ax = panels(heat_map(table, x="alpha", y="lambda_sb"))[0]
    cells = np.ma.filled(ax.images[0].get_array(), np.nan)
    assert np.argwhere(np.isnan(cells)).tolist() == [[1, 2], [2, 1]]
    assert lines(ax, "minimum")[0].get_xydata().tolist() == [[1.0, 1.0]]
    assert to_hex(ax.images[0].get_cmap().get_bad()) == "#9e9e9e"


def test_heat_map_without_a_finite_error_says_so() -> None:
    ax = panels(heat_map(grid_table().assign(aae=np.nan), x="alpha", y="lambda_sb"))[0]
    assert ax.get_title() == "no finite error" and not ax.lines


def test_heat_map_refuses_two_rows_for_one_cell() -> None:
    with pytest.raises(InputError, match=r"several rows share one \(alpha, lambda_sb\)"):
        heat_map(pd.concat([grid_table()] * 2), x="alpha", y="lambda_sb")


# --- style and files ---


def test_saved_files_repeat_and_carry_neither_date_nor_version(tmp_path: Path) -> None:
    table = pd.concat([sweep(region="a"), sweep(region="b")])
    fig = alpha_curves(table, hue="region", title="twice", zero_note="a note")
    png, pdf = (path.read_bytes() for path in save_figure(fig, tmp_path / "fig5a_alpha1.2"))
    paths = save_figure(fig, tmp_path / "fig5a_alpha1.2")
    assert [path.name for path in paths] == ["fig5a_alpha1.2.png", "fig5a_alpha1.2.pdf"]
    assert sorted(tmp_path.iterdir()) == sorted(paths)
    assert [path.read_bytes() for path in paths] == [png, pdf]
    assert png.startswith(b"\x89PNG") and b"tEXt" not in png and b"tIME" not in png
    assert pdf.startswith(b"%PDF") and not re.search(rb"Date|" + matplotlib.__version__.encode(), pdf)
    assert b"/Type0" in pdf and b"/Type3" not in pdf  # TrueType outlines: text stays text


def test_png_is_1280_pixels_wide() -> None:
    assert WIDTH * DPI == 1280
    png = render(new_figure(1.0), "png")
    assert int.from_bytes(png[16:20], "big") == 1280


def test_bytes_do_not_depend_on_the_process() -> None:
    """A new process, another hash seed, another user's settings: the same picture."""
    code = (
        "import sys, hashlib, matplotlib; matplotlib.rcParams['axes.edgecolor'] = 'red'; import pandas as pd\n"
        "from fracbench.figures.curves import alpha_curves; from fracbench.figures.style import render\n"
        "f = alpha_curves(pd.DataFrame({'alpha': [0, 1, 2], 'aae': [2, 1, 3], 'aepe': [2, 3, 1]}), title='x')\n"
        "print(*[hashlib.sha256(render(f, k)).hexdigest() for k in ('png', 'pdf')])\n"
        "print('matplotlib.pyplot' in sys.modules)"
    )
    env = {**os.environ, "PYTHONHASHSEED": "1"}
    run = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    fig = alpha_curves(pd.DataFrame({"alpha": [0, 1, 2], "aae": [2, 1, 3], "aepe": [2, 3, 1]}), title="x")
    png, pdf, pyplot = run.stdout.split()
    assert [png, pdf] == [hashlib.sha256(render(fig, fmt)).hexdigest() for fmt in ("png", "pdf")]
    assert pyplot == "False"  # so no window system is loaded


def test_the_callers_settings_are_left_alone() -> None:
    before = dict(matplotlib.rcParams)
    render(alpha_curves(sweep()), "png")
    assert dict(matplotlib.rcParams) == before


def test_a_missing_folder_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        save_figure(new_figure(1.0), tmp_path / "nowhere" / "a")
    assert not list(tmp_path.iterdir())


def test_importing_the_module_loads_neither_matplotlib_nor_pandas() -> None:
    code = "import sys, fracbench.figures.curves\nprint([m for m in ('matplotlib', 'pandas') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out == "[]\n"

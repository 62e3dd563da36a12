"""Alpha by class of structure: choice, sentences, figure and files on made-up stores."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

from fracbench.errors import InputError
from fracbench.harness.config.experiment import load_experiment
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.plan import plan_artefact, plan_experiment
from fracbench.model.structure import CLASSES
from fracbench.studies.alpha_map import artefact
from fracbench.studies.alpha_map.figures import gain_panels, order_pictures, order_title
from fracbench.studies.alpha_map.oracle import SCOPES, pack
from fracbench.studies.alpha_map.tables import (
    MEAN,
    adaptive_sentences,
    adaptive_table,
    class_orders,
    confusion_table,
    predictability,
    reached,
)

SEQUENCES = [f"s{m}" for m in range(8)]
ALPHAS = [0.6, 1.0, 1.4]


def made_up(single, by_class):
    """A tidy table: ``single[alpha]`` and ``by_class[orders]`` are the AEPE on each sequence, AAE a tenth."""
    records = []
    for part, settings in (("single", single), ("classes", by_class)):
        for orders, errors in settings.items():
            given = {"alpha": orders} if part == "single" else dict(
                zip((f"alpha_{name}" for name in CLASSES), orders, strict=True))  # fmt: skip
            for sequence, aepe in zip(SEQUENCES, errors, strict=True):
                records.append({"part": part, "sequence": sequence, **given, "aepe": aepe, "aae": aepe / 10.0})
    return pd.DataFrame(records)


def oracle(run=0.15, least=0.1, best=(1, 1, 1, 1)):
    """Bounds with these errors by scope (or one for all), and these orders best in the four classes."""
    errors = {
        kind: value if isinstance(value, dict) else dict.fromkeys(SCOPES, value)
        for kind, value in (("run", run), ("least", least))
    }
    scopes = {
        scope: {kind: {"aepe": found[scope], "aae": found[scope] / 10.0} for kind, found in errors.items()}
        for scope in SCOPES
    }
    classes = {}
    for name, k in zip(CLASSES, best, strict=True):
        counts = [20, 20, 20]
        counts[k] += 40
        classes[name] = {
            "pixels": 100,
            "sums": [3.0 - (i == k) for i in range(3)],
            "window": counts,
            "pixel": counts,
        }
    return {"alphas": ALPHAS, "scopes": scopes, "classes": classes}


FLAT_LOW, CONSTANT = (0.9, 1.3, 1.3, 1.3), (1.0, 1.0, 1.0, 1.0)
ONE = {1.0: [0.20] * 8, 1.2: [0.30] + [0.19] * 7}
BETTER = {CONSTANT: [0.20] * 8, FLAT_LOW: [0.18] * 8}
WORSE = {CONSTANT: [0.20] * 8, FLAT_LOW: [0.17] + [0.21] * 7}


def values(table, estimate, column):
    return table[table["estimate"] == estimate].set_index("sequence")[column]


def test_settings_are_chosen_on_the_other_sequences():
    table = adaptive_table(made_up(ONE, BETTER), {})
    assert list(table["sequence"].unique()) == [*SEQUENCES, MEAN]
    # On the other seven, s0 is not seen and 1.2 looks best; with it, 1 is.
    assert values(table, "single", "orders").drop(MEAN).tolist() == ["1.2", *["1"] * 7]
    assert values(table, "single", "aepe").tolist() == pytest.approx([0.30, *[0.20] * 7, (0.3 + 1.4) / 8])
    assert set(values(table, "single all in", "orders")) == {"1"}
    assert values(table, "single own", "orders").drop(MEAN).tolist() == ["1", *["1.2"] * 7]
    assert set(values(table, "adaptive", "orders")) == {"0.9/1.3/1.3/1.3"}
    np.testing.assert_allclose(values(table, "one", "aae"), 0.02)
    np.testing.assert_allclose(values(table, "adaptive", "gain").iloc[[0, 1]], [40.0, 10.0])
    mean = values(table, "adaptive", "gain")[MEAN]
    assert mean == pytest.approx(100.0 * (1.0 - 0.18 * 8 / 1.7))
    assert reached(table) == (pytest.approx(mean), 8, 8)


def test_a_goal_that_is_reached_is_said_without_reasons():
    oracles = dict.fromkeys(SEQUENCES, oracle())
    sentences = adaptive_sentences(adaptive_table(made_up(ONE, BETTER), oracles), oracles)
    assert sentences[0] == (
        "Alpha by class, chosen on the other sequences, has a mean AEPE of 0.1800 px, one alpha chosen in the "
        "same way 0.2125 px: 15.3 % less, and better on 8 of 8 sequences. The goal of 3 % and 6 sequences is "
        "reached."
    )
    assert not any(sentence.startswith("The reason") for sentence in sentences)
    assert sentences[2].startswith("It gains on s0 (40.0 % less), s1 (10.0 % less), s2")
    assert "one alpha errs 6.2 % more, alpha by class 10.0 % less." in sentences[3]
    assert "by class (flat/edge/corner/texture) 0.9/1.3/1.3/1.3 (0.1800 px)" in sentences[4]


@pytest.mark.parametrize(
    ("least", "cause"),
    [
        ({"class": 0.199, "window": 0.198, "pixel": 0.1}, "there is little to gain by any map"),
        ({"class": 0.198, "window": 0.17, "pixel": 0.1}, "the classes do not predict the best order"),
        ({"class": 0.175, "window": 0.17, "pixel": 0.1}, "the best order of a class differs between sequences"),
    ],
)
def test_a_goal_that_is_missed_has_its_reason_computed(least, cause):
    oracles = dict.fromkeys(SEQUENCES, oracle(least=least, best=(0, 2, 2, 1)))
    single = {1.0: [0.20] * 8, 1.2: [0.21] * 8}
    sentences = adaptive_sentences(adaptive_table(made_up(single, WORSE), oracles), oracles)
    assert (
        "0.0 % less, and better on 0 of 8 sequences. The goal of 3 % and 6 sequences is not reached."
        in sentences[0]
    )
    assert sentences[2].startswith("It does not gain on s0 (0.0 % less)")
    why = [sentence for sentence in sentences if sentence.startswith("The reason")]
    assert len(why) == 1 and cause in why[0]
    assert not any(sentence.startswith("Run as maps") for sentence in sentences)
    worse = dict.fromkeys(SEQUENCES, oracle(run=0.21, least=least, best=(0, 2, 2, 1)))
    said = adaptive_sentences(adaptive_table(made_up(single, WORSE), worse), worse)
    assert any("the orders by neighbourhood err 5.0 % more, those by pixel 5.0 % more" in line for line in said)
    assert "at 60 % of the pixels; the order that is most often best for all pixels, at 40 %." in sentences[-1]
    assert "flat 0.6 to 0.6, edge 1.4 to 1.4" in sentences[-1]


def test_what_is_missing_leaves_no_number_and_no_sentence():
    runs = made_up(ONE, BETTER)
    runs.loc[runs["part"] == "classes", "aepe"] = np.nan
    table = adaptive_table(runs, dict.fromkeys(SEQUENCES))
    assert reached(table) is None and adaptive_sentences(table, {}) == []
    assert values(table, "run window", "aepe").isna().all() and not values(table, "single", "aepe").isna().any()
    one_missing = {name: oracle() if name != "s3" else None for name in SEQUENCES}
    table = adaptive_table(made_up(ONE, BETTER), one_missing)
    assert np.isnan(values(table, "run pixel", "aepe")[MEAN]) and values(table, "run pixel", "aepe")["s4"] == 0.15
    assert len(adaptive_sentences(table, one_missing)) == 5  # no sentence on bounds of which some are missing


def test_the_confusion_is_counted_over_all_sequences():
    oracles = {"a": oracle(best=(0, 1, 1, 2)), "b": oracle(best=(0, 1, 2, 2)), "c": None}
    table = confusion_table(oracles).query("scope == 'window'").set_index("class")
    assert table["pixels"].tolist() == [200] * 4
    assert table.loc["flat", ["0.6", "1", "1.4"]].tolist() == [60.0, 20.0, 20.0]
    assert table.loc["corner", ["0.6", "1", "1.4"]].tolist() == [20.0, 40.0, 40.0]
    assert predictability(oracles) == (pytest.approx(55.0), pytest.approx(100 * (20 + 20 + 40 + 60) / 400))
    assert class_orders(oracles).to_numpy().tolist() == [["a", 0.6, 1.0, 1.0, 1.4], ["b", 0.6, 1.0, 1.4, 1.4]]


def test_the_figure_shows_the_table():
    oracles = dict.fromkeys(SEQUENCES, oracle())
    table = adaptive_table(made_up(ONE, BETTER), oracles)
    left, right = gain_panels(table, confusion_table(oracles), "Title").axes[:2]
    drawn = {line.get_label(): line.get_xdata() for line in left.lines}
    np.testing.assert_allclose(drawn["alpha by class, left out"], values(table, "adaptive", "gain"))
    np.testing.assert_allclose(drawn["map of orders by window*"], values(table, "run window", "gain"))
    assert [text.get_text() for text in left.get_yticklabels()] == [*SEQUENCES, MEAN]
    assert right.images[0].get_array().tolist() == [[20.0, 60.0, 20.0]] * 4
    assert not gain_panels(table, confusion_table({}), "Title").axes[1].axison


def test_pictures_are_veiled_in_the_colours_they_name():
    frame, found = np.full((2, 2), 200.0), np.array([[0, 1], [2, 3]], np.uint8)
    ((title, picture),) = order_pictures([("name", frame, "classes", found, ALPHAS)])
    assert title == "name\nclasses"
    assert "(gray flat, blue edge, red corner, green texture)" in order_title(ALPHAS)
    assert "(blue 0.6 to yellow 1.4)" in order_title(ALPHAS)
    red, blue = picture[1, 0].astype(int), picture[0, 1].astype(int)
    assert red[0] > red[2] and blue[2] > blue[0] and len(set(picture[0, 0])) == 1


@pytest.fixture
def experiment():
    return load_experiment("adaptive_alpha")


def test_every_class_and_single_order_is_planned_on_every_sequence(experiment):
    plan = plan_experiment(experiment.grids, ["dataset=synthetic"])
    counts = pd.Series([planned.labels["part"] for planned in plan.points]).value_counts()
    assert counts["classes"] % 8 == counts["single"] % 8 == counts["oracle"] % 8 == 0
    singles = {planned.point.key for planned in plan.points if planned.labels["part"] == "single"}
    assert {planned.point.key for planned in plan.points if planned.labels["part"] == "oracle"} <= singles
    assert {planned.labels["protocol"] for planned in plan.points} == {"recommended"}
    corners = {(planned.point.canonical.get("alpha_edge"), planned.point.canonical.get("alpha_corner"))
               for planned in plan.points}  # fmt: skip
    assert all(edge == corner for edge, corner in corners)


def test_the_whole_of_it_on_a_made_up_store(work, experiment, fake_rows, unwritten, monkeypatch):
    plan = plan_artefact(experiment, ["dataset=synthetic"], small=True)
    rows = fake_rows(plan, lambda labels, params: (0.1, 0.2 - 0.01 * ("alpha_flat" in params), 0.3))
    for each in plan.points:
        if each.point.score == "oracle":
            rows[each.point.key] = dataclasses.replace(rows[each.point.key], result=oracle())
    monkeypatch.setattr(artefact, "_order_pictures", lambda *_: [])
    made = artefact.adaptive_alpha(experiment, plan, rows, work)
    names = {str(path.relative_to(work)) for path in made.files}
    stem = "adaptive_alpha_synthetic_small"
    tables = {f"tables/{stem}.{kind}" for kind in ("csv", "md", "tex")} | {f"tables/{stem}_confusion.csv"}
    assert names == tables | {f"figures/{stem}.{kind}" for kind in ("png", "pdf")}
    text = (work / f"tables/{stem}.md").read_text(encoding="utf-8")
    assert made.lines[0] in text and "5.0 % less, and better on 2 of 2" in made.lines[0]
    assert "flat, edge, corner, texture" in text and "32 x 32" in text and "0.6, 1, 1.4" in text
    again = (work / f"tables/{stem}.csv").read_bytes()
    artefact.adaptive_alpha(experiment, plan, rows, work)
    assert (work / f"tables/{stem}.csv").read_bytes() == again


@pytest.mark.parametrize("part", ["single", "classes", "oracle"])
def test_a_grid_that_is_missing_is_named(work, experiment, part):
    grids = {name: tokens for name, tokens in experiment.grids.items() if name != part}
    broken = type(experiment)(experiment.name, "t", "adaptive_alpha", grids)
    with pytest.raises(InputError, match=f"adaptive_alpha: the grid `{part}` is missing"):
        artefact.adaptive_alpha(broken, None, {}, work)


def test_bounds_are_planned_once_a_sequence_with_its_single_orders(experiment):
    plan = plan_artefact(experiment, ["dataset=synthetic"], small=True)
    bounds = [each for each in plan.points if each.point.score == "oracle"]
    assert [each.labels["sequence"] for each in bounds] == list(
        dict.fromkeys(each.labels["sequence"] for each in plan.points)
    )
    own = [each.point.params.alpha for each in plan.points if each.labels["part"] == "oracle"]
    assert dict(bounds[0].point.options) == {"alphas": tuple(own[: len(own) // len(bounds) - 1]), "window": 32}


@pytest.mark.parametrize("score", ["frame", "oracle"])
def test_bounds_want_their_own_point_and_the_single_orders_done(experiment, fake_rows, score):
    plan = plan_artefact(experiment, ["dataset=synthetic"], small=True)
    rows, failed = fake_rows(plan), fake_rows(plan, status="failed")
    assert None not in artefact.stored_oracles(plan, rows).values()
    part = [each for each in plan.points if each.labels["part"] == "oracle" and each.point.score == score]
    rows[part[0].point.key] = failed[part[0].point.key]
    del rows[part[-1].point.key]
    found = artefact.stored_oracles(plan, rows)
    assert found[part[0].labels["sequence"]] is found[part[-1].labels["sequence"]] is None


def test_pictures_show_the_classes_and_the_maps_of_the_row(work, experiment, fake_rows, monkeypatch):
    plan = plan_artefact(experiment, ["dataset=synthetic"], small=True)
    rows, shown = fake_rows(plan), []
    for each in plan.points:
        if each.point.score == "oracle":
            shape = point_arrays(each.point, None)[0].shape
            maps = {scope: np.full(shape, k, np.uint8) for k, scope in enumerate(("pixel", "window"))}
            result = {**oracle(), "maps": {scope: pack(orders) for scope, orders in maps.items()}}
            rows[each.point.key] = dataclasses.replace(rows[each.point.key], result=result)
    monkeypatch.setattr("fracbench.figures.cache.draw", lambda stem, panel, items, **_: shown.extend(items) or [])
    artefact._order_pictures(experiment, plan, rows, work)
    scopes = [title.partition("\n")[2] for title, _ in shown]
    assert scopes == ["classes", "best order about each pixel", "best order at each pixel"] * 2
    assert all(picture.shape[2] == 3 for _, picture in shown)

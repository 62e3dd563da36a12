from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from fracbench import estimate_flow
from fracbench.data.datasets.registry import load_sequence
from fracbench.evaluation.metrics import endpoint_error
from fracbench.evaluation.sparsification import ause, remaining_error
from fracbench.harness.config.experiment import Experiment
from fracbench.harness.run import sweep
from fracbench.harness.run.plan import make_plan, plan_artefact
from fracbench.harness.run.store import STORE, Store
from fracbench.studies import confidence
from fracbench.studies.registry import render

OPTIONS = {"protocols": ["fast", "recommended"], "dropped": [0.1, 0.5]}
TITLE = "Error left"


@pytest.fixture
def experiment():
    return Experiment("left", TITLE, "confidence", {}, OPTIONS)


def planned(tokens):
    """The check of the flow of one scene, as the experiment would plan it."""
    (made,) = make_plan(tokens).points
    return confidence.replace(
        made, point=confidence.replace(made.point, score="confidence", options=(("dropped", (0.1, 0.5)),))
    )


def test_a_point_for_each_protocol_and_sequence(experiment):
    points = plan_artefact(experiment, ["dataset=synthetic"]).points
    assert len(points) == 16
    assert {each.labels["protocol"] for each in points} == {"fast", "recommended"}
    assert {each.point.score for each in points} == {"confidence"}
    assert len({each.point.key for each in points}) == 16
    assert points[0].point.spec["options"] == {"dropped": ["0.1", "0.5"]}


def test_the_errors_are_those_of_the_estimate_and_its_check():
    point = planned(["sequence=synthetic_occlusion", "n_scales=3", "n_warps=2", "max_iter=3"]).point
    found = confidence.errors_left(point, None)
    pair = load_sequence(point.sequence, "synthetic")
    settings = point.params.as_dict()
    result = estimate_flow(pair.frame0, pair.frame1, confidence=True, **settings)
    errors, check = endpoint_error(result.flow, pair.truth), result.confidence
    known = ~np.isnan(errors)
    assert found["aepe"] == pytest.approx(errors[known].mean())
    assert found["left"] == pytest.approx(remaining_error(errors, check.distance, (0.1, 0.5)))
    assert found["best"] == pytest.approx(remaining_error(errors, errors, (0.1, 0.5)))
    assert found["ause"] == pytest.approx(ause(errors, check.distance))
    share = found["agree"]
    assert share == check.agrees[known].mean()
    assert share * found["aepe_agree"] + (1 - share) * found["aepe_rest"] == pytest.approx(found["aepe"])
    assert found["best"][1] < found["left"][1] < 1.0 and found["aepe_agree"] < found["aepe_rest"]


def test_the_table_has_means_by_protocol(experiment, work, monkeypatch):
    monkeypatch.setattr(
        confidence,
        "confidence_points",
        lambda *_: [
            planned([f"sequence={name}", f"protocol={protocol}", "n_scales=2", "n_warps=1", "max_iter=1"])
            for protocol in ("fast", "recommended")
            for name in ("synthetic_edge", "synthetic_zoom")
        ],
    )
    plan = plan_artefact(experiment, ["dataset=synthetic"])
    (work / STORE.parent).mkdir(parents=True, exist_ok=True)
    with Store(work / STORE) as store:
        rows = sweep.run(plan, store, jobs=1).rows
    made = render(experiment, plan, rows, work / "results")
    table = pd.read_csv(made.files[0])
    assert (
        list(table["sequence"]) == ["synthetic_edge", "synthetic_zoom"] * 2
        and list(table["protocol"]) == ["fast"] * 2 + ["recommended"] * 2
    )
    assert list(table.columns[2:7]) == ["AEPE", "left 10 %", "left 50 %", "best 10 %", "best 50 %"]
    ((title, means),) = made.views
    assert title == TITLE
    assert [float(value) for value in means["AEPE"]] == pytest.approx(
        table.groupby("protocol")["AEPE"].mean().to_list(), abs=1e-4
    )
    text = made.files[1].read_text(encoding="utf-8")
    assert text.startswith(f"# {TITLE}\n\n") and "AUSE: the area between the two curves" in text

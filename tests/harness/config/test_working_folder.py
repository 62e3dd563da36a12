"""``./conf/`` is read beside the package's configuration: plain data, under names of its own."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest
import yaml

from fracbench.commands.cli import EXIT_DONE
from fracbench.errors import InputError
from fracbench.harness.config import working_folder
from fracbench.harness.config.compose import group_options, load_config
from fracbench.harness.config.paths import asset, checkout
from fracbench.harness.run.plan import make_plan

PROTOCOL = "# @package _global_\nprotocol: {name}\nparams: {{n_warps: 2, boundary: reflect}}\n"
SEQUENCE = "# @package _global_\nsequence: {name: edge, dataset: synthetic}\nparams: {lambda: 0.7}\n"
REGION = (
    "# @package _global_\ndefaults: [{override /sequence: my_edge}]\n"
    "region: {name: my_corner, sequence: my_edge, rows: [0, 40], cols: [0, 50]}\nparams: {lambda_sb: 3}\n"
)


def write(group: str, name: str, text: str) -> Path:
    path = Path("conf") / group / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@pytest.fixture
def own(work):
    """A working folder with a protocol, a sequence and a region of its own."""
    write("protocol", "mine", PROTOCOL.format(name="mine"))
    write("sequence", "my_edge", SEQUENCE)
    write("region", "my_corner", REGION)
    return work


def test_files_of_the_working_folder_are_choices(own):
    assert {"mine", "reference"} <= set(group_options("protocol"))
    assert "my_edge" in group_options("sequence") and "my_corner" in group_options("region")
    assert "my_corner" not in group_options("region", own=False)
    config = load_config({"protocol": "mine", "region": "my_corner"})
    assert (config.protocol, config.region.name, config.sequence.name) == ("mine", "my_corner", "edge")
    params = config.params
    assert (params.n_warps, params.boundary, params.lambda_, params.lambda_sb) == (2, "reflect", 0.7, 3.0)


def test_points_of_the_working_folder_are_planned_beside_the_packages(own):
    plan = make_plan(["region=my_corner", "protocol=mine,reference"], allow_download=False)
    assert [planned.labels["protocol"] for planned in plan.points] == ["mine", "reference"]
    assert {planned.labels["region"] for planned in plan.points} == {"my_corner"}
    assert len(plan.unique()) == 2


def test_all_regions_are_those_of_the_paper(own):
    plan = make_plan(["region=all", "dataset=synthetic"], allow_download=False)
    assert {planned.labels["region"] for planned in plan.points} == set(group_options("region", own=False))
    assert len(make_plan(["region=my_*"], allow_download=False).points) == 1


def test_a_change_is_seen_in_the_same_process(own):
    assert load_config({"protocol": "mine"}).params.n_warps == 2
    for number in (3, 12):  # 3 leaves the size of the file as it is
        write("protocol", "mine", PROTOCOL.format(name="mine").replace("n_warps: 2", f"n_warps: {number}"))
        assert load_config({"protocol": "mine"}).params.n_warps == number
    write("protocol", "other", PROTOCOL.format(name="other"))
    assert "other" in group_options("protocol")


def test_another_working_folder_has_other_choices(own, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    with pytest.raises(InputError, match="unknown protocol 'mine'"):
        load_config({"protocol": "mine"})


@pytest.mark.parametrize("folder", ["a b", "it's", "a,b", "x=[1]", "é"])
def test_any_name_of_the_working_folder_will_do(work, monkeypatch, folder):
    (work / folder).mkdir()
    monkeypatch.chdir(folder)
    write("protocol", "mine", PROTOCOL.format(name="mine"))
    assert load_config({"protocol": "mine"}).params.n_warps == 2


def test_an_estimate_takes_a_protocol_of_the_working_folder(images, cli):
    write("protocol", "mine", PROTOCOL.format(name="mine"))
    done = cli("estimate", "a.png", "b.png", "-o", "out.flo", "protocol=mine", "max_iter=2")
    assert done.code == EXIT_DONE
    assert done.out.startswith("tvl1_sb_alpha (preset mine with max_iter=2): ")
    done = cli("estimate", "a.png", "b.png", "-o", "out.flo", "method=tvl1", "max_iter=2")
    assert done.out.startswith("tvl1 (preset recommended with max_iter=2): ")


def test_the_projects_own_folder_and_a_copy_of_it_shadow_nothing(work, monkeypatch):
    shutil.copytree(asset("conf"), work / "conf")
    assert load_config({"protocol": "accurate"}).params.median_radius == 2
    write("protocol", "mine", PROTOCOL.format(name="mine"))
    assert load_config({"protocol": "mine"}).params.n_warps == 2
    monkeypatch.chdir(asset("conf").parent)
    assert group_options("protocol") == group_options("protocol", own=False)


def test_other_folders_and_files_of_conf_are_left_alone(own):
    """A folder conf/ is common in projects with Hydra: theirs is not our affair."""
    write("model", "net", "_target_: torch.nn.Linear\n")
    Path("conf/config.yaml").write_text("hydra: {searchpath: ['pkg://boom']}\ndataset: 3\n")
    Path("conf/protocol/notes.txt").write_text("{")
    assert load_config({"protocol": "mine"}).dataset == "auto"
    assert "boom" not in sys.modules


@pytest.mark.parametrize("text", ["", "params: {n_warps: 1}\n", "# mine\n# @package _global_\nprotocol: bare\n"])
def test_a_file_without_its_first_line_is_refused_by_name(work, text):
    write("protocol", "bare", text)
    with pytest.raises(
        InputError, match=r"conf/protocol/bare\.yaml: the first line must be `# @package _global_`"
    ):
        load_config({"protocol": "bare"})


def test_the_example_in_the_documents(work):
    if (root := checkout()) is None:
        pytest.skip("the documents are those of a checkout")
    (text,) = re.findall(r"```yaml\n(.*?)```", (root / "docs/protocol.md").read_text(encoding="utf-8"), re.DOTALL)
    write("protocol", "my_preset", text)
    assert load_config({"protocol": "my_preset"}).params.alpha == 1.2


def test_groups_are_in_the_order_of_composition():
    """A file chooses those of its own group and of earlier ones; Hydra refuses the others."""
    defaults = yaml.safe_load(asset("conf/config.yaml").read_text("utf-8"))["defaults"]
    assert tuple(key for entry in defaults if isinstance(entry, dict) for key in entry) == working_folder.GROUPS

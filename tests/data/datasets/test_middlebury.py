from __future__ import annotations

import hashlib
import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fracbench.data import download
from fracbench.data.datasets import base
from fracbench.data.datasets import middlebury as mb
from fracbench.data.datasets.registry import list_sequences, load_sequence
from fracbench.errors import DataError, InputError

WAYS = ("FRACBENCH_DATA", "paths.data=", "data/middlebury", "fracbench data --download")


def small_files() -> dict[str, bytes]:
    """24 files in the place of Middlebury's, each sequence of another size and content."""
    content = {}
    for k, name in enumerate(mb.SEQUENCES):
        rng = np.random.default_rng(k)
        for file in ("frame10.png", "frame11.png"):
            buffer = io.BytesIO()
            Image.fromarray(rng.integers(0, 256, (5 + k, 6, 3), dtype=np.uint8)).save(buffer, "png")
            content[f"{name}/{file}"] = buffer.getvalue()
        header = b"PIEH" + np.array([6, 5 + k], dtype="<i4").tobytes()
        flow = rng.normal(size=(5 + k, 6, 2)).astype("<f4")
        flow[0, 0] = 1666666752.0
        content[f"{name}/flow10.flo"] = header + flow.tobytes()
    return content


SMALL = small_files()


def put(folder: Path, names=SMALL) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(SMALL[name])
    return folder


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """A working folder and a checkout without data, an empty cache, and the small files registered."""
    monkeypatch.setattr(mb, "REGISTRY", {n: hashlib.sha256(data).hexdigest() for n, data in SMALL.items()})
    package = tmp_path / "checkout" / "fracbench"
    package.mkdir(parents=True)
    (tmp_path / "checkout" / "pyproject.toml").touch()
    monkeypatch.setattr(base, "__file__", str(package / "data" / "datasets" / "base.py"))
    monkeypatch.setattr(mb, "cache_folder", lambda: tmp_path / "cache" / "middlebury")
    monkeypatch.delenv("FRACBENCH_DATA", raising=False)
    (tmp_path / "somewhere" / "work").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "somewhere" / "work")
    return tmp_path


def assert_names_the_ways(message: str) -> None:
    assert "\n" not in message
    assert all(way in message for way in WAYS)


class TestFind:
    def test_the_places_in_their_order(self, elsewhere, monkeypatch):
        work = elsewhere / "somewhere" / "work"
        places = {
            elsewhere / "cache" / "middlebury": "the user cache",
            elsewhere / "shared" / "middlebury": "../shared/middlebury",
            elsewhere / "checkout" / "data" / "middlebury": "data/middlebury",
            elsewhere / "somewhere" / "shared" / "middlebury": "../shared/middlebury",
            work / "data" / "middlebury": "data/middlebury",
        }
        for folder, source in places.items():  # each goes before all those put there earlier
            put(folder)
            assert mb.find() == mb.Location(folder, source, 24)
        monkeypatch.setenv("FRACBENCH_DATA", str(put(elsewhere / "env")))
        assert mb.find() == mb.Location(elsewhere / "env", "FRACBENCH_DATA", 24)
        assert mb.find(put(elsewhere / "given")).source == "paths.data"

    def test_a_complete_folder_goes_before_a_partial_one(self, elsewhere):
        partial = put(Path("data/middlebury"), ["Venus/flow10.flo"])
        assert mb.find() == mb.Location(partial.resolve(), "data/middlebury", 1)
        complete = put(elsewhere / "cache" / "middlebury")
        assert mb.find().folder == complete

    def test_nothing_found_names_the_ways(self, elsewhere):
        with pytest.raises(DataError, match="not found") as caught:
            mb.find()
        assert_names_the_ways(str(caught.value))

    def test_a_folder_asked_for_is_never_passed_over(self, elsewhere, monkeypatch):
        put(Path("data/middlebury"))
        with pytest.raises(DataError, match=r"paths\.data=.*empty: holds none of the 24"):
            mb.find(elsewhere / "empty")
        monkeypatch.setenv("FRACBENCH_DATA", "~nobody-here/x")
        with pytest.raises(DataError, match="FRACBENCH_DATA=~nobody-here/x: holds none"):
            mb.find()
        for dataset in ("auto", "middlebury"):
            with pytest.raises(DataError, match="FRACBENCH_DATA="):
                mb.resolve(dataset, allow_download=False)

    def test_an_explicit_folder_may_hold_a_part(self, elsewhere):
        part = put(elsewhere / "part", [name for name in SMALL if name.startswith("Venus/")])
        assert mb.find(part).n_files == 3
        assert mb.load("Venus", part).name == "Venus"


class TestState:
    def test_the_four_states(self, elsewhere):
        folder = put(elsewhere / "d")
        assert mb.state("venus", folder).state == "ok"
        (folder / "Venus/frame10.png").unlink()
        assert mb.state("Venus", folder).state == "missing"
        (folder / "Venus/frame11.png").write_bytes(b"something else")
        assert mb.state("Venus", folder).state == "corrupt"
        (folder / "Venus/flow10.flo").unlink()
        (folder / "Venus/flow10.flo").mkdir()
        found = mb.state("Venus", folder)
        assert found.state == "unreadable"
        assert [f.state for f in found.files] == ["missing", "corrupt", "unreadable"]
        assert found.files[1].expected == hashlib.sha256(SMALL["Venus/frame11.png"]).hexdigest()
        assert found.files[1].actual == hashlib.sha256(b"something else").hexdigest()
        assert found.files[2].actual is None and found.files[2].reason
        assert mb.state("Grove2", folder).state == "ok"

    def test_a_file_in_the_place_of_the_folder_is_missing_data(self, elsewhere):
        (elsewhere / "file").touch()
        assert mb.state("Venus", elsewhere / "file").state == "missing"

    def test_unknown_names_get_the_nearest(self, elsewhere):
        for act in (mb.state, mb.digest, mb.load):
            with pytest.raises(InputError, match="unknown Middlebury sequence 'Grov2': did you mean 'Grove2'"):
                act("Grov2", elsewhere)


class TestLoad:
    def test_the_content_arrives(self, elsewhere):
        folder = put(elsewhere / "d")
        sequence = mb.load("grove3", folder)
        assert (sequence.name, sequence.dataset, sequence.shape) == ("Grove3", "middlebury", (6, 6))
        rgb = np.asarray(Image.open(folder / "Grove3/frame11.png")).astype(int)
        np.testing.assert_array_equal(sequence.frame1, (rgb @ [299, 587, 114]) // 1000)
        np.testing.assert_array_equal(sequence.frame0_color, Image.open(folder / "Grove3/frame10.png"))
        pairs = np.frombuffer(SMALL["Grove3/flow10.flo"], "<f4", offset=12).reshape(6, 6, 2)
        assert np.isnan(sequence.truth[:, 0, 0]).all()
        np.testing.assert_array_equal(sequence.truth[:, 1:], pairs.transpose(2, 0, 1)[:, 1:])

    @pytest.mark.parametrize("act", [mb.load, mb.digest])
    @pytest.mark.parametrize("file", ["frame10.png", "frame11.png", "flow10.flo"])
    def test_a_changed_byte_is_reported_with_both_hashes(self, elsewhere, act, file):
        folder = put(elsewhere / "d")
        changed = SMALL[f"Venus/{file}"][:-1] + bytes([SMALL[f"Venus/{file}"][-1] ^ 1])
        (folder / "Venus" / file).write_bytes(changed)
        with pytest.raises(DataError, match=f"Venus/{file} is corrupt") as caught:
            act("Venus", folder)
        for data in (changed, SMALL[f"Venus/{file}"]):
            assert hashlib.sha256(data).hexdigest() in str(caught.value)

    @pytest.mark.parametrize("act", [mb.load, mb.digest])
    def test_missing_and_unreadable_files_are_named(self, elsewhere, act):
        folder = put(elsewhere / "d")
        (folder / "Venus/flow10.flo").unlink()
        with pytest.raises(DataError, match=r"Venus/flow10\.flo is missing") as caught:
            act("Venus", folder)
        assert_names_the_ways(str(caught.value))
        (folder / "Venus/flow10.flo").mkdir()
        with pytest.raises(DataError, match=r"Venus/flow10\.flo is unreadable: .*directory"):
            act("Venus", folder)

    def test_digests_tell_sequences_and_contents_apart(self, elsewhere, monkeypatch):
        folder = put(elsewhere / "d")
        digests = {name: mb.digest(name, folder) for name in mb.SEQUENCES}
        assert len(set(digests.values())) == 8
        assert mb.load("Venus", folder).digest == digests["Venus"] == mb.digest("VENUS", str(folder))
        (folder / "Venus/flow10.flo").write_bytes(b"other")
        monkeypatch.setitem(mb.REGISTRY, "Venus/flow10.flo", hashlib.sha256(b"other").hexdigest())
        assert mb.digest("Venus", folder) != digests["Venus"]

    def test_load_sequence_looks_the_folder_up(self, elsewhere):
        put(Path("data/middlebury"))
        assert load_sequence("urban2", "middlebury").name == "Urban2"
        assert load_sequence("urban2", "Middlebury", put(elsewhere / "d")).digest


class TestResolve:
    def test_what_is_found_is_used(self, elsewhere):
        folder = put(Path("data/middlebury")).resolve()
        assert mb.resolve("auto") == mb.resolve("middlebury") == mb.Resolved("middlebury", folder)
        assert mb.resolve("Auto", explicit=put(elsewhere / "d")).folder == elsewhere / "d"

    def test_synthetic_looks_nowhere(self, elsewhere):
        assert mb.resolve("synthetic", explicit=elsewhere / "none") == mb.Resolved("synthetic")

    def test_what_is_not_found_is_downloaded_into_the_cache(self, elsewhere, monkeypatch):
        monkeypatch.setattr(mb, "download", put)
        assert mb.resolve("auto") == mb.Resolved("middlebury", elsewhere / "cache" / "middlebury")
        assert mb.find().source == "the user cache"

    @pytest.mark.parametrize("allowed", [True, False])
    def test_auto_falls_back_with_a_notice_and_middlebury_does_not(self, elsewhere, monkeypatch, allowed):
        def fail(url, members, timeout):
            raise DataError(f"{url} cannot be reached")

        monkeypatch.setattr(download, "fetch_members", fail)
        resolved = mb.resolve("auto", allow_download=allowed)
        assert (resolved.dataset, resolved.folder) == ("synthetic", None)
        assert "synthetic scenes in place of Middlebury" in resolved.notice
        assert ("cannot be reached" in resolved.notice) is allowed
        assert_names_the_ways(resolved.notice)
        with pytest.raises(DataError) as caught:
            mb.resolve("middlebury", allow_download=allowed)
        assert_names_the_ways(str(caught.value))

    def test_an_unknown_dataset_gets_the_nearest(self):
        with pytest.raises(InputError, match="unknown dataset 'sintetic': did you mean 'synthetic'"):
            mb.resolve("sintetic")


def test_a_download_completes_what_there_is(monkeypatch, tmp_path):
    """Else the files would go where `find` does not look, as long as it finds some elsewhere."""
    partial, cache = tmp_path / "data" / "middlebury", tmp_path / "cache"
    monkeypatch.delenv("FRACBENCH_DATA", raising=False)
    monkeypatch.setattr(mb, "cache_folder", lambda: cache)
    monkeypatch.setattr(mb, "_usual_places", lambda: [("here", partial), ("the user cache", cache)])
    assert mb.download_folder() == cache
    (partial / "Venus").mkdir(parents=True)
    (partial / "Venus" / "flow10.flo").write_bytes(b"x")
    assert mb.download_folder() == partial
    monkeypatch.setenv("FRACBENCH_DATA", str(tmp_path / "asked"))  # which holds nothing yet
    assert mb.download_folder() == tmp_path / "asked"


def test_importing_the_look_up_loads_nothing_heavy():
    code = (
        "import sys, fracbench.data.datasets.middlebury; "
        "print([m for m in ('numpy', 'scipy', 'pooch', 'requests', 'PIL') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_the_registry_is_whole():
    assert list_sequences("middlebury") == mb.SEQUENCES
    assert set(mb.REGISTRY) == set(SMALL)
    assert len({int(sha256, 16) for sha256 in mb.REGISTRY.values()}) == 24
    assert {len(sha256) for sha256 in mb.REGISTRY.values()} == {64}


UNKNOWN_PIXELS = {"Dimetrodon": 10772, "Hydrangea": 14880, "RubberWhale": 3622}


@pytest.mark.middlebury
@pytest.mark.parametrize("name", mb.SEQUENCES)
def test_the_real_sequences(middlebury, name):
    sequence = mb.load(name, middlebury)
    assert sequence.shape == mb.SIZES[name]
    assert sequence.frame0_color.shape == (*mb.SIZES[name], 3)
    unknown = np.isnan(sequence.truth)
    np.testing.assert_array_equal(unknown[0], unknown[1])
    assert unknown[0].sum() == UNKNOWN_PIXELS.get(name, 0)
    for frame in (sequence.frame0, sequence.frame1):
        assert 0 <= frame.min() < frame.max() <= 255
        np.testing.assert_array_equal(frame, np.floor(frame))
    assert mb.state(name, middlebury).state == "ok"
    assert mb.digest(name, middlebury) == sequence.digest

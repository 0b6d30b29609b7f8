"""Data-set roots composed of recorded and generated scenes, and what keeps training and validation apart."""

import csv
import errno
import json
import os
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from breaches import breaches
from written import edit_json, edit_rows, in_first_lane, write_fake

from bridge.cli import measuring
from bridge.console import Activity
from bridge.forecasting.compose import check_leaks, compose
from bridge.forecasting.composition import CONTROLS, HID2_ONLY, Composition, composition_of_sources
from bridge.forecasting.places import SourceScene, groups_of, split_by_place
from bridge.forecasting.predictions import sources_of
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from bridge.toml import model_of, read_toml_as
from netconvert.errors import ConfigError, NoSceneError, ScenarioError


@pytest.fixture
def generated(tmp_path, data_root):
    """A root with one scene made of each of the three recorded ones, with 2 vehicles more."""
    for folder in find_scenarios(data_root):
        write_fake(read_scenario(folder), tmp_path / "made")
    return tmp_path / "made"


def composed(values, root):
    return compose(model_of(Composition, values, "test"), root)


def ids(place):
    return {path.name for path in place.iterdir()}


def origins(root):
    with (root / "origins.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def mixed(data_root, generated, **more):
    return {
        "sources": {"recorded": (str(data_root), str(data_root / "train")), "hid2": (str(generated),)},  # some twice
        "split": {"val": 0.34},
        "sets": {"mix": {"take": {"recorded": "all", "hid2": "all"}}},
        "validation": {"recorded": {"take": {"recorded": "all"}}},
    } | more


def tree(root):
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def test_a_mix_is_split_by_place_and_readers_find_it(data_root, generated, tmp_path):
    """Three recorded scenes at three places, two vehicles added to each: two places for training, one held out."""
    made = composed(mixed(data_root, generated), tmp_path / "root")
    root = made.root
    assert made.counts == {"": {"train": 4, "val": 1, "test": 0}}
    assert len(find_scenarios(root)) == 5
    assert (root / "test").is_dir()
    sources = {
        split: {row["source_id"] for row in origins(root) if row["split"] == split} for split in ("train", "val")
    }
    assert not sources["train"] & sources["val"]
    assert [row["kind"] for row in origins(root) if row["split"] == "val"] == ["recorded"]
    assert check_leaks(root) == []
    assert [finding for finding in breaches(root, source=data_root) if not finding.is_note] == []


def test_files_are_links_in_real_folders_and_copies_where_there_can_be_none(
    data_root, generated, tmp_path, monkeypatch
):
    def refuse(*_):
        raise OSError(errno.EXDEV, "another file system")

    root = composed(mixed(data_root, generated), tmp_path / "linked").root
    linked, parquet = tree(root), next(root.glob("val/*/scenario_*.parquet"))
    assert not parquet.parent.is_symlink()
    assert not parquet.is_symlink()
    assert parquet.stat().st_nlink > 1
    monkeypatch.setattr(os, "link", refuse)
    copied = composed(mixed(data_root, generated), tmp_path / "copied").root
    assert tree(copied) == linked
    assert next(copied.rglob("scenario_*.parquet")).stat().st_nlink == 1


def test_the_same_seed_makes_the_same_root_whatever_the_jobs_and_another_one_another(data_root, generated, tmp_path):
    values = mixed(data_root, generated, sets={"few": {"take": {"hid2": 1}}})
    found = model_of(Composition, values, "test")
    first, again = (tree(compose(found, tmp_path / str(jobs), jobs=jobs).root) for jobs in (1, 2))
    assert first == again
    others = [tree(composed(values | {"seed": seed}, tmp_path / f"seed{seed}").root) for seed in range(1, 5)]
    assert any(other.keys() != first.keys() for other in others)


def test_qcnet_finds_its_scenes_in_raw(data_root, generated, tmp_path):
    root = composed(mixed(data_root, generated, layout="qcnet"), tmp_path / "root").root
    assert {path.parent.name for path in find_scenarios(root)} == {"raw"}
    assert len(find_scenarios(root / "train")) == 4
    assert [finding for finding in breaches(root) if not finding.is_note] == []
    assert {read_scenario(path).split for path in find_scenarios(root)} == {"train", "val"}


def test_the_controls_have_as_many_scenes_and_one_validation_set(data_root, generated, tmp_path):
    """2 recorded scenes for training and 2 made of them: each control has 4, of the kinds that its name says."""
    values = {
        "sources": {"recorded": (str(data_root),), "hid2": (str(generated),), "plain": (str(_renamed(generated)),)},
        "split": {"val": 0.34},
        "controls": {"recorded": "recorded", "generated": "hid2", "without_interaction": "plain"},
        "validation": {"recorded": {"take": {"recorded": "all"}}, "hid2": {"take": {"hid2": "all"}}},
    }
    made = composed(values, tmp_path / "root")
    assert {name: counts["train"] for name, counts in made.counts.items() if counts["train"]} == {
        "recorded": 2, "recorded-twice": 4, "recorded-dense": 4, "no-interaction": 4, "hid2": 4, "hid2-only": 2,
    }  # fmt: skip
    kinds = {
        name: sorted(row["source"] + " " + row["kind"] for row in origins(made.root / name) if row["split"] == "train")
        for name in (*CONTROLS, HID2_ONLY)
    }
    recorded = ["recorded recorded"] * 2
    assert kinds == {
        "recorded": recorded,
        "recorded-twice": ["recorded copy"] * 2 + recorded,
        "recorded-dense": ["recorded copy"] * 2 + recorded,
        "no-interaction": ["plain generated"] * 2 + recorded,
        "hid2": ["hid2 generated"] * 2 + recorded,
        "hid2-only": ["hid2 generated"] * 2,
    }
    held_out = {frozenset(ids(made.root / name / "val")) for name in (*CONTROLS, HID2_ONLY)}
    assert held_out == {frozenset(ids(made.root / "validation" / "recorded" / "val"))}
    source_of = sources_of(made.root)
    for row in (row for row in origins(made.root / "recorded-twice") if row["kind"] == "copy"):
        assert source_of[row["scenario_id"]] == row["source_id"]
        folder = made.root / "recorded-twice" / "train" / row["scenario_id"]
        copy, drawn = read_scenario(folder), read_scenario(Path(row["folder"]))
        assert copy.scenario_id == row["scenario_id"] != drawn.scenario_id == row["drawn"]
        kept = [name for name in drawn.table.column_names if name != "scenario_id"]
        assert copy.table.select(kept).equals(drawn.table.select(kept))
    assert check_leaks(made.root) == []


def _renamed(root):
    """The same scenes under ids of their own, as those of another generation are."""
    other = root.with_name("plain")
    shutil.copytree(root, other)
    for number, folder in enumerate(find_scenarios(other)):
        new = f"00000000-0000-5000-8000-{number:012d}"
        table = read_scenario(folder).table.to_pandas()
        table["scenario_id"] = new
        for path in list(folder.iterdir()):
            path.rename(path.with_name(path.name.replace(folder.name, new)))
        table.to_parquet(folder / f"scenario_{new}.parquet")
        folder.rename(folder.with_name(new))
    return other


def second_recording(held_out, root):
    """The place of a validation scene recorded again, in train, without a word of the log."""
    target = root / "train" / "11111111-1111-5111-8111-111111111111"
    target.mkdir()
    table = read_scenario(held_out).table.to_pandas().drop(columns="slice_id").assign(scenario_id=target.name)
    table.to_parquet(target / f"scenario_{target.name}.parquet")
    shutil.copy(next(held_out.glob("log_map*")), target / f"log_map_archive_{target.name}.json")
    return target


def test_planted_variants_of_a_validation_scene_are_found_and_named_and_copies_by_their_place(
    data_root, generated, tmp_path
):
    root = composed(mixed(data_root, generated), tmp_path / "root").root
    (held_out,) = find_scenarios(root / "val")
    (variant,) = (f for f in find_scenarios(generated) if f.name not in ids(root / "train"))
    planted = shutil.copytree(variant, root / "train" / variant.name)
    (leak,) = check_leaks(root)
    assert (leak.folder, leak.other) == (planted, held_out)
    assert f"made of the same recorded scene {held_out.name}" in leak.text()
    shutil.rmtree(planted)
    target = second_recording(held_out, root)
    (leak,) = check_leaks(root)
    assert (leak.folder, leak.other) == (target, held_out)
    assert "lies on the ground of" in leak.why


@pytest.mark.parametrize(("rows", "lane"), [({"velocity_x": np.inf}, {}), ({"object_type": "-"}, {}), ({}, {"id": 1})])
def test_a_scene_that_its_readers_refuse_is_in_no_data_set_and_told(data_root, tmp_path, capsys, rows, lane):
    """An infinite velocity, an unknown type, a broken map: two of three scenes are left, one of each split, and 1."""
    root, command = shutil.copytree(data_root, tmp_path / "data"), measuring.compose.function
    broken, *_ = find_scenarios(root)
    edit_rows(broken, lambda table: table.assign(**rows))
    edit_json(next(broken.glob("log_map*")), in_first_lane(lambda first: first.update(lane)))
    out = tmp_path / "mix"
    assert command([str(root)], out=out, check=False, jobs=1, as_json=True, activity=Activity(quiet=True)) is True
    assert capsys.readouterr().err.startswith(f"hid2: warning: left out: {broken}/")
    assert [len(find_scenarios(out / split)) for split in ("train", "val")] == [1, 1]


@pytest.mark.parametrize(("split", "way"), [({"val": 0.34}, "set split.val = 0 or add"), ({"by": "folder"}, "add")])
def test_scenes_held_out_that_no_validation_takes_are_told(data_root, tmp_path, split, way):
    values = {"sources": {"data": (str(data_root),)}, "split": split, "sets": {"a": {"take": {"data": "all"}}}}
    said = f"1 scenes held out for val, which no validation takes; {way} [validation]"
    assert composed(values, tmp_path / "root").left_out[0] == said


def test_min_agents_counts_in_all_or_at_the_observations_end(data_root, tmp_path):
    """The arterial has 26 tracks, 25 of them at the observation's end; the others have 22 and 21, and 21 and 20."""
    for counted, bound, expected in (("all", 26, 1), ("observed", 22, 1), ("all", 22, 2), ("observed", 21, 2)):
        values = {
            "sources": {"data": (str(data_root),)},
            "split": {"val": 0.0},
            "sets": {"dense": {"take": {"data": "all"}, "min_agents": bound, "min_agents_in": counted}},
        }
        made = composed(values, tmp_path / f"{counted}{bound}")
        assert made.counts[""]["train"] == expected, (counted, bound)


def test_splits_by_folder_keep_the_official_ones_which_share_ground(data_root, tmp_path):
    root = tmp_path / "official"
    shutil.copytree(data_root, root)
    second_recording(find_scenarios(root / "val")[0], root)
    every = {"all": {"take": {"data": "all"}}}
    values = {"sources": {"data": (str(root),)}, "split": {"by": "folder"}, "sets": every, "validation": every}
    made = composed(values, tmp_path / "root").root
    for split in ("train", "val"):
        assert ids(made / split) == ids(root / split)


def fact(name, *, source=None, city="miami", tracks=20, cells=(1,), block=(0, 0), log=""):
    return SourceScene(
        Path(name), name, source or name, city, 110, tracks, tracks, log,
        np.array(cells, dtype=np.int64).tobytes(), block,
    )  # fmt: skip


def test_groups_join_blocks_sources_and_logs():
    """a and b lie in one block; c was made of a; d shares a log with e; f lies alone."""
    facts = [
        fact("a"), fact("b"), fact("c", source="a", block=(7, 7)), fact("d", block=(1, 0), log="x"),
        fact("e", block=(2, 0), log="x"), fact("f", city="austin"),
    ]  # fmt: skip
    assert groups_of(facts) == [[0, 1, 2], [3, 4], [5]]


def test_cities_and_densities_are_on_both_sides_in_proportion():
    """Of 20 places in each of two cities, half of them dense, a quarter is held out: 2.5 of each kind, 2 or 3."""
    facts = [
        fact(f"{city}{n}", city=city, tracks=100 if n % 2 else 10, block=(n, 0), cells=(n,))
        for city in ("miami", "austin")
        for n in range(20)
    ]
    splits = split_by_place(facts, {"train": 0.75, "val": 0.25, "test": 0.0}, seed=3, bounds=(50,))
    held_out = [facts[row] for row in splits["val"]]
    assert len(held_out) == 10
    kinds = Counter((one.city, one.tracks > 50) for one in held_out)
    assert set(kinds.values()) == {2, 3}
    assert len(kinds) == 4
    assert sorted(splits["train"] + splits["val"]) == list(range(40))


def test_a_share_of_a_source_is_drawn(data_root, tmp_path):
    """Two of three scenes: 0.5 of three is 1.5, which is 2; the same on the command line."""
    values = {"sources": {"data": (str(data_root),)}, "sets": {"a": {"take": {"data": 0.5}}}, "split": {"val": 0.0}}
    assert composed(values, tmp_path / "root").counts == {"": {"train": 2, "val": 0, "test": 0}}
    made = composition_of_sources(["here:0.5", "there:7", "all"])
    assert dict(made.only) == {"source-0": 0.5, "source-1": 7}
    with pytest.raises(ConfigError, match=r"'here:1\.5': expected SOURCE or SOURCE:N"):
        composition_of_sources(["here:1.5"])


def test_copies_of_generated_scenes_are_valid(data_root, generated, tmp_path):
    values = mixed(data_root, generated, sets={"a": {"take": {"hid2": 2}, "again": {"hid2": 3}}})
    root = composed(values, tmp_path / "r").root
    assert len({row["scenario_id"] for row in origins(root) if row["kind"] == "copy"}) == 3
    assert [finding for finding in breaches(root, source=data_root) if not finding.is_note] == []
    for damaged in (b"scenario_id\nx\n", b"scenario_id,source_id\nx\n", b"\xff"):
        (root / "origins.csv").write_bytes(damaged)
        with pytest.raises(ScenarioError, match=rf"^{root}/origins.csv: .*expected columns scenario_id, source_id"):
            check_leaks(root)


def test_what_cannot_be_composed_is_explained(data_root, tmp_path):
    source = {"data": (str(data_root),)}
    for values, message in (
        ({"sources": source}, "neither sets nor controls"),
        ({"sources": source, "sets": {"a": {"take": {"other": 1}}}}, "sets.a: source 'other', expected one of data"),
        ({"sources": source, "sets": {"a": {"take": {"data": -1}}}}, "sets.a.take.data"),
        ({"sources": source, "sets": {"a": {}}, "split": {"val": 0.6, "test": 0.5}}, "expected less than 1"),
        ({"sources": source, "sets": {"a/b": {}}}, "sets.a/b"),
        ({"sources": source, "sets": {"a": {"tke": {}}}}, r"unknown key 'sets\.a\.tke'; expected take, again"),
        ({"sources": source, "sets": {"a": {"take": {"data": 1.5}}}}, "= 1.5, expected a number of scenes, a share"),
        ({"sources": source, "sets": {"a": {"take": {"data": True}}}}, "= True, expected a number of scenes, a share"),
    ):
        with pytest.raises(ConfigError, match=message):
            model_of(Composition, values, "C.toml")
    values = {"sources": source, "sets": {"a": {"take": {"data": 4}}}, "split": {"val": 0.0}}
    with pytest.raises(ConfigError, match=r"sets\.a: train: 4 of 'data' \(.*\) asked for, 3 are there"):
        composed(values, tmp_path / "root")
    assert not (tmp_path / "root").exists()
    (tmp_path / "full" / "something").mkdir(parents=True)
    with pytest.raises(ConfigError, match="is there already"):
        composed(values, tmp_path / "full")
    with pytest.raises(NoSceneError, match="no such folder"):
        composed(values | {"sources": {"data": ("nowhere",)}}, tmp_path / "root")
    write_fake(read_scenario(find_scenarios(data_root)[0]), tmp_path / "made", count=0)
    with pytest.raises(NoSceneError, match=r"made: no scene .* used; .*made/.*no vehicle was inserted.*\(1 left"):
        composed(values | {"sources": {"data": (str(tmp_path / "made"),)}}, tmp_path / "root")
    with pytest.raises(ConfigError, match="no such file, expected a composition"):
        read_toml_as(Composition, tmp_path / "none.toml", "a composition")
    shutil.copytree(data_root, tmp_path / "same")
    both = {"a": {"take": {"data": "all", "same": "all"}}}
    twice = {"sources": source | {"same": (str(tmp_path / "same"),)}, "sets": both}
    with pytest.raises(ConfigError, match=rf"is in two of the sources, {data_root}/\S+ and {tmp_path}/same/\S+; leave"):
        composed(twice | {"split": {"val": 0.0}}, tmp_path / "r")
    with pytest.raises(ConfigError, match=r"in the sources 'data' and 'more'; leave it out of one"):
        composed(twice | {"sources": source | {"more": (str(data_root),)}, "sets": values["sets"]}, tmp_path / "r")


def test_a_file_and_the_command_line_say_the_same(data_root, generated, tmp_path):
    """One data set of all, a tenth of the three held out: one, as each has its place. One of any two as well.

    Where none is asked for of one source, that of the other is held out, and not what nothing asks for.
    """
    (tmp_path / "c.toml").write_text(
        f'[sources]\nsource-0 = "{data_root}"\n[sets.all.take]\nsource-0 = "all"\n'
        '[validation.all.take]\nsource-0 = "all"\n'
    )
    line = composition_of_sources([str(data_root)])
    written = read_toml_as(Composition, tmp_path / "c.toml", "a composition")
    assert line.model_dump() == written.model_dump()
    assert compose(line, tmp_path / "a").counts == {"": {"train": 2, "val": 1, "test": 0}}
    for few, every in ((2, 0), (0, 2), (0, 3)):
        asked = composition_of_sources([f"{data_root}:{few}", f"{generated}:{every}"])
        made = compose(asked, tmp_path / f"{few} and {every}")
        assert (made.counts, made.left_out) == ({"": {"train": few + every - 1, "val": 1, "test": 0}}, ())
    (told,) = compose(composition_of_sources([f"{data_root}:1"]), tmp_path / "one").left_out
    assert told.startswith("no scene held out for val: all are of one place")
    with pytest.raises(
        ConfigError, match=r"scenes: 4 of 'source-0' \(.*\) asked for, 3 are there .*; ask for fewer, or"
    ):
        compose(composition_of_sources([f"{data_root}:4", str(generated)]), tmp_path / "many")
    with pytest.raises(ConfigError, match="no scene in any data set, expected one at least"):
        compose(composition_of_sources([f"{data_root}:0.1"]), tmp_path / "a tenth of three")
    assert json.loads((tmp_path / "a" / "composition.json").read_text())["sources"] == {"source-0": [str(data_root)]}

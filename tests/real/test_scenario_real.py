"""Real scenes read as av2 reads them."""

from pathlib import Path

from as_av2 import read_as_av2

from bridge.recordings.scenario import read_scenario


def test_real_scene_reads_as_av2_reads_it(real_scene: Path) -> None:
    scenario = read_as_av2(real_scene)
    assert scenario.num_steps == (50 if real_scene.parent.name == "test" else 110)
    assert scenario.split == real_scene.parent.name


def test_sizes_of_labelled_scenes_are_used(real_scenes: list[Path]) -> None:
    for folder in real_scenes:
        scenario = read_scenario(folder)
        labelled = (folder / "agent_sizes.csv").is_file()
        assert labelled == (folder.name[:8] in ("3b3570b4", "7fab2350"))
        assert scenario.track("AV").size == ((4.877, 2.0) if labelled else (4.5, 1.9))

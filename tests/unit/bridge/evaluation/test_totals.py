"""What an evaluation keeps of its scenes: exact sums in a size that does not grow with their number."""

import pickle
import random
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bridge.evaluation.scene_metrics import measure_folder
from bridge.evaluation.totals import Diversity, ManeuverCounts, Samples, SourceSums, Totals
from bridge.pages.charts import diversity_figure
from hid2.agents import Policy
from hid2.evaluation.realism import FEATURES, GENERATED, RECORDED
from hid2.evaluation.windows import WINDOW
from hid2.measures.manoeuvres import ManeuverKind

COLUMNS = ("hits", "rows")


def rows_of(*sources, seed=0):
    rng = random.Random(seed)
    return [{"log": source, "hits": rng.randint(0, 4), "rows": 5} for source in sources]


@pytest.fixture(scope="module")
def measured(made_scene):
    return measure_folder(made_scene)


def named(measures, number, *, sources):
    """The same scene under another name, made from one of `sources` scenes."""
    scene = measures.scene | dict.fromkeys(("source", "log"), f"source-{number % sources}")
    scene |= {"scenario_id": f"scene-{number}"}
    return replace(measures, tables={**measures.tables, "scenes": [scene]})


@pytest.mark.parametrize("sources", [3, 10**6])
def test_size_does_not_grow_with_scenes(measured, sources):
    """From 60 to 300 scenes of few sources nothing is added; of as many sources, their names."""
    totals, sizes = Totals(), []
    totals.sums, totals.samples = SourceSums(most=20), Samples(most=50)
    for number in range(300):
        totals.add(named(measured, number, sources=sources))
        totals.add_source(measured)
        if number in {59, 299}:
            assert totals.content()["scenes"]["scenes"] == number + 1
            sizes.append(len(pickle.dumps(totals)))
    # figures of more digits and names of sources take a few bytes more
    assert sizes[1] - sizes[0] < 600 + 20 * (min(sources, 300) - min(sources, 60))


def test_many_sources_are_pooled_in_groups_and_totals_stay_exact():
    """Fifty sources in at most eight groups: the same groups whatever the order, no scene lost."""
    rows = rows_of(*(f"s{k}" for k in range(50)), *(f"s{k}" for k in range(0, 50, 7)))
    pooled, exact = SourceSums(rows, names=COLUMNS, most=8), SourceSums(rows, names=COLUMNS)
    assert len(pooled.of_columns("hits")[0]) <= 8 < len(exact.of_columns("hits")[0]) == 50
    backwards = SourceSums(rows[::-1], names=COLUMNS, most=8)
    for name in COLUMNS:
        assert pooled.of_columns(name)[0].sum() == exact.of_columns(name)[0].sum()
        assert pooled.of_columns(name)[0].tolist() == backwards.of_columns(name)[0].tolist()


def offer(samples, scenes):
    """Each scene: two generated and one recorded vehicle, whose vectors tell which they are."""
    for number in scenes:
        offered = np.zeros(3, dtype=WINDOW)
        offered["scene"], offered["speed_mps"], offered["agent"] = f"s{number % 4}", number, [0, 1, 2]
        offered["generated"] = [True, True, False]
        samples.add(offered, scene=f"scene-{number}")
    return {(one["speed_mps"], one["agent"]) for one in samples.windows()}


def test_sample_is_of_fixed_size_fair_and_the_same_in_any_order():
    """600 scenes, 100 vehicles of a kind: which ones does not depend on the order, and late scenes count as much."""
    scenes = list(range(600))
    kept = offer(Samples(most=100), scenes)
    assert len(kept) == 200
    assert sum(kind < 2 for _, kind in kept) == 100
    assert kept == offer(Samples(most=100), scenes[::-1])
    assert 60 < sum(number >= 300 for number, _ in kept) < 140


@pytest.mark.parametrize("delays", [[3.0, 0.25, 0.25, 1.0], [2.0, 0.0, 1.0, 1.0, 7.5]])
def test_median_delay_is_that_of_the_list(delays):
    counts = ManeuverCounts()
    known = {"group": "generated", "kind": "overtake", "status": "done", "recorded": True, "seen": None, "reason": None}
    counts.add([known | {"trigger_s": 2.0, "start_s": 2.0 + delay} for delay in delays])
    counts.add([known | {"kind": "lane_change", "trigger_s": 2.0, "start_s": None}])
    found = counts.content()
    assert found["overtake"]["median_trigger_to_start_s"] == pytest.approx(np.median(delays))
    assert found["lane_change"]["median_trigger_to_start_s"] is None


def scene_row(tracks, generated, **more):
    zeros = {
        f"{group}_{name}": 0
        for group in ("original", "generated", "combined")
        for name in (*(f"policy_{p.value}" for p in Policy), *(f"seen_{k.value}" for k in ManeuverKind))
    }
    return {"tracks": tracks, "generated": generated, "tracks_at_49": 9, "generated_at_49": 0} | zeros | more


def test_diversity_counts_scenes_by_number_of_agents():
    """45 and 61 tracks, 5 and 1 of them added: before 40 and 60. Above 40: half before, all after."""
    rows = [scene_row(45, 5, combined_policy_straight=3, combined_seen_overtake=2), scene_row(61, 1)]
    found = Diversity(rows, rows).content()
    density = found["density"]["tracks"]
    assert density["before"] == {"40": 1, "60": 1}
    assert density["after"] == {"45": 1, "61": 1}
    assert (density["mean_before"], density["mean_after"]) == (50.0, 53.0)
    assert density["share_above"]["40"] == {"before": 0.5, "after": 1.0}
    assert found["density"]["tracks_at_49"]["after"] == {"9": 2}
    after = found["behaviours"]["after"]
    assert (after["scenes"], after["vehicles"]["straight"], after["scenes_with"]["straight"]) == (2, 3, 1)
    assert after["maneuvers"]["overtake"] == 2


@pytest.mark.parametrize("measured_sources", [(), ("source-1",)])
def test_before_holds_each_source_once_whether_it_is_measured_itself_or_not(measured, measured_sources):
    """Five scenes made from two sources; what was recorded is the same in all of them."""
    totals = Totals(measured_sources)
    for number in range(5):
        totals.add(named(measured, number, sources=2))
    for _ in measured_sources:
        totals.add_source(measured)
    # how recorded vehicles drive counts once for each source as well, how generated ones drive for each scene
    for kind, times in ((RECORDED, 2), (GENERATED, 5)):
        once, pooled = (int(each.of(FEATURES[0])[kind].sum()) for each in (measured.realism, totals.realism))
        assert pooled == times * once > 0
    found = totals.content()["diversity"]
    assert found["scenes"] == {"before": 2, "after": 5}
    recorded = measured.scene["tracks"] - measured.scene["generated"]
    assert found["density"]["tracks"]["before"] == {str(recorded): 2}


def test_bars_of_the_diversity_figure_agree_with_the_shares_above():
    """40 tracks are not more than 40: before, the bar ends at 40; after, 41 tracks are in the next."""
    found = Diversity([scene_row(41, 1)], [scene_row(41, 1)]).content()
    figure = diversity_figure(found)
    bars = [patch.get_data() for patch in figure.axes[0].patches]
    plt.close(figure)
    (before, edges, _), (after, _, _) = bars[0], bars[2]
    assert edges[np.flatnonzero(before)].tolist() == [20]
    assert edges[np.flatnonzero(after)].tolist() == [40]
    assert found["density"]["tracks"]["share_above"]["40"] == {"before": 0.0, "after": 1.0}

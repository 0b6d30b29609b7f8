"""The table of metrics: complete, without doubles, and with the numbers of the parameters in its names."""

from collections import Counter
from typing import get_args

from hid2.evaluation.metrics import METRICS, MetricTable, columns


def test_every_metric_says_what_it_is_once_with_the_default_parameters_and_every_section_is_filled() -> None:
    assert Counter(metric.key for metric in METRICS).most_common(1)[0][1] == 1
    for metric in METRICS:
        assert metric.label, metric.key
        assert metric.unit, metric.key
        assert metric.sentence.endswith("."), metric.key
    assert {metric.section for metric in METRICS} == set(get_args(MetricTable))
    label = {metric.key: metric.label for metric in METRICS}
    assert label["ttc_critical"] == "share of driving, TTC below 1.5 s to anything"
    assert label["footprint_orr"] == "footprint ORR: share of boxes over 0.3 m off"


def test_a_column_has_one_function() -> None:
    """Two metrics may share a column; two functions under one name would hide one of them."""
    used = [column for metric in METRICS for column in (metric.numerator, metric.denominator)]
    assert {column.name: column for column in used} == columns()
    assert all(columns()[column.name].of is column.of for column in used)

"""Seconds, told apart by stage."""

from edit3r_measure.bench_item import timing_of

from edit3r.reporting import StageRecord


def test_stages_are_counted_where_they_belong_and_others_not_at_all():
    stages = [
        StageRecord("load components", 50, 50, 0),
        StageRecord("edit (recolor)", 1, 2, 0),
        StageRecord("reconstruct (edit3r)", 3, 4, 0),
        StageRecord("render", 5, 6, 0),
    ]
    timing = timing_of(stages, cold=True)
    assert (timing["editor"], timing["network"], timing["rendering"]) == (1, 3, 5)
    assert (timing["editor_cpu"], timing["network_cpu"], timing["rendering_cpu"]) == (
        2,
        4,
        6,
    ) and timing["cold"]

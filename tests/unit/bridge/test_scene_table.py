"""Rows kept by column come back as they were put in."""

import tracemalloc

from bridge.scene_table import SceneTable

ROWS = [
    {"id": "a", "tracks": 3, "lo": 0.5, "asked": 4, "rejected": {"would_stand": 2}},
    {"id": "b", "tracks": 4, "lo": 1.5, "asked": None, "seed": 7},
    {"id": "c", "tracks": 0, "lo": 2, "asked": 1, "rejected": {}, "seed": 8},
]


def filled(rows):
    table = SceneTable()
    for row in rows:
        table.append(row)
    return table


def test_rows_come_back_with_their_types_and_none_where_they_lack_a_column():
    table = filled(ROWS)
    names = ["id", "tracks", "lo", "asked", "rejected", "seed"]
    assert [dict(row) for row in table] == [{name: row.get(name) for name in names} for row in ROWS]
    assert table.columns == tuple(names)
    assert [type(row["lo"]) for row in table] == [float, float, int]
    assert table[-1]["id"] == "c"
    assert [row["id"] for row in table[1:]] == ["b", "c"]


def test_a_number_takes_eight_bytes():
    row = {f"n{k}": k for k in range(50)} | {f"x{k}": k / 7 for k in range(50)}
    tracemalloc.start()
    table = filled([dict(row) for _ in range(2000)])
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(table) == 2000
    assert size / 2000 < 1.3 * 8 * 100

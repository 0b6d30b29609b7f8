"""The rule on what follows the last step of a generated track: no contact that nobody could avoid."""

from collections.abc import Iterator, Mapping, Set

import numpy as np

from bridge.recordings.row_rules import Rows
from bridge.recordings.rules import Breach
from bridge.recordings.scenario import split_rows
from hid2.agents import BoxSize
from hid2.measures.arrays import stack
from hid2.measures.scene_end import contacts_after_last_step
from hid2.params import Conflict
from netconvert.errors import ScenarioError


def check_scene_end(rows: Rows, generated_ids: Set[str], *, sizes: Mapping[str, BoxSize]) -> Iterator[Breach]:
    """Generated tracks that come to touch somebody too soon after their own last step, everybody at constant velocity.

    rows: of a scenario without other breaches; sizes: boxes by track id, by object type where a track has none.
    """
    try:
        tracks = split_rows(rows.table, name="rows", sizes=sizes, observed_steps=rows.observed_steps).tracks
    except ScenarioError as error:
        yield "scene-end", f"cannot be told: {error}"
        return
    arrays = stack(tracks, step_s=rows.step_s, is_generated=generated_ids.__contains__)
    limits = Conflict()
    contacts = contacts_after_last_step(arrays, arrays.generated, horizon_s=limits.end_horizon_s)
    for agent, contact in contacts.items():
        if contact.ttc_s < limits.end_ttc_min_s:
            last = int(np.max(tracks[agent].timesteps))
            yield (
                "scene-end",
                (
                    f"track {arrays.track_ids[agent]!r}, timestep {last}: TTC {contact.ttc_s:.2f} s to track "
                    f"{arrays.track_ids[contact.other]!r} at constant velocity, expected {limits.end_ttc_min_s:g} s"
                ),
            )

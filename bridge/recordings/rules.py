"""What `hid2 validate` demands of a scene: the rules by name, as findings quote them."""

from collections.abc import Mapping

from hid2.judge.findings import NOTES, Quantity
from netconvert.av2_map import Breach as Breach

#: The rule on recorded rows, which are kept as they are.
RECORDED = "recorded"
#: Rules whose breaches are told and are no faults.
NOTED = frozenset({RECORDED, *(quantity.value for quantity in NOTES)})

#: What each rule demands; the names are those of findings.
RULES: Mapping[str, str] = {
    "folder": "OUT/[train|val|test/]<id>/ with scenario_<id>.parquet, log_map_archive_<id>.json and hid2_<id>.json",
    "other-parquet": "no other parquet file anywhere under OUT: readers take every one they find",
    "scenario-id": "a UUID, the same in folder, file names and column, made of source, configuration, seed and variant",
    "columns": "every column of the format with its type and no nulls, RangeIndex from 0",
    "constant": "scenario columns say the same in every row, object_type and object_category in every row of a track",
    "finite": "no NaN and no infinity",
    "duplicate": "one row for a track and a timestep",
    "timestep": "timesteps from 0 to 109, num_timestamps at least as many as there are and at most 110",
    "observed": "observed where the timestep is below 50 (20 in a scene of Argoverse 1), and only there",
    "object-type": "an object type of the format",
    "category": "0 fragment, 1 context, 2 scored or 3 focal",
    "focal": "exactly one track of category 3, which is focal_track_id, present at the last observed "
    "timestep and to the end",
    "scored": "a track of category 2 is present at the last observed timestep",
    "av": "a track named AV",
    "city": "a city, that of the source",
    "map": "drivable areas, lane segments with every field, z on every point",
    "mark-type": "lane mark types of the enum, never null",
    "lane-type": "VEHICLE, BIKE or BUS",
    "boundary": "boundaries and centrelines of at least two points",
    "sidecar": "the schema of hid2_<id>.json, in agreement with itself, the tracks and the map",
    RECORDED: "noted, as the source has it so: another city than the six, a focal track that ends early, "
    "a scored track that is absent at the last observed timestep, figures that are not plausible",
    "generated": "gen_<n>, a vehicle, category 1 to 3, without gaps, present at the last observed step; "
    "scored or focal: at all steps",
    "velocity": "a generated track's velocity is the time derivative of its position",
    "heading": "a generated track's heading follows its motion",
    "sequence": "an Argoverse 1 sequence keeps that format, its inserted tracks are the scene's",
    "replay": "recorded vehicles drive as recorded: driving.replay is fixed",
    **{quantity.value: f"the judge's limit: {quantity.sentence}" for quantity in Quantity},
    "source": "recorded rows are the source's bit for bit, but for a former focal's category; the map is the source's",
}

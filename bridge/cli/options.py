"""Arguments and options that several commands share, and the exit codes."""

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

ALL_DONE, SOME_FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

# Options of each group in the help.
request_option = partial(typer.Option, rich_help_panel="What to generate")
event_option = partial(typer.Option, rich_help_panel="Events")
selection_option = partial(typer.Option, rich_help_panel="Which scenes")
parameter_option = partial(typer.Option, rich_help_panel="Parameters")
running_option = partial(typer.Option, rich_help_panel="Running")
output_option = partial(typer.Option, rich_help_panel="Output")
prediction_option = partial(typer.Option, rich_help_panel="With prediction")

# Choices, written out because what they mirror is slow to import; tests/cli/test_options.py compares them.
EventName = StrEnum("EventName", ["CUT_IN", "OVERTAKE", "LEAD", "FOLLOW", "MERGE", "CROSS"])
CanName = StrEnum(
    "CanName",
    {
        "STRAIGHT": "straight", "LEFT_TURN": "left_turn", "RIGHT_TURN": "right_turn", "LANE_CHANGE": "lane_change",
        "OVERTAKE": "overtake", "CUT_IN_AV": "cut_in:av", "CUT_IN_FOCAL": "cut_in:focal", "OVERTAKE_AV": "overtake:av",
        "OVERTAKE_FOCAL": "overtake:focal", "LEAD_AV": "lead:av", "LEAD_FOCAL": "lead:focal", "FOLLOW_AV": "follow:av",
        "FOLLOW_FOCAL": "follow:focal", "MERGE_AV": "merge:av", "MERGE_FOCAL": "merge:focal", "CROSS_AV": "cross:av",
        "CROSS_FOCAL": "cross:focal",
    },
)  # fmt: skip
ComponentName = StrEnum("ComponentName", ["TOPOLOGY", "COLLISION", "SMOOTHING"])
SplitName = StrEnum("SplitName", ["TRAIN", "VAL", "TEST"])
FormatName = StrEnum("FormatName", ["ARGOVERSE1"])
RecordName = StrEnum("RecordName", ["GAPS"])
FocalName = Literal["recorded", "generated"]
ExperimentName = Literal["table1", "ablation", "density", "diversity", "prediction"]
ReadingName = Literal["recorded", "generated", "both"]

MapChoice = Annotated[
    Path | None,
    selection_option(
        "--map",
        metavar="MAP",
        help="An Argoverse 2 map, or a scene's folder with one, for Argoverse 1 sequences without their city's map.",
    ),
]
Window = Annotated[
    int,
    selection_option(min=0, metavar="N", help="First sweep of a sensor log that is taken."),
]
Stride = Annotated[
    int | None,
    selection_option(min=1, metavar="N", help="More windows of a sensor log, N sweeps from one to the next."),
]
Scenes = Annotated[
    list[Path],
    typer.Argument(metavar="SCENE", help="Scenario folders, split folders or data-set roots.", show_default=False),
]
Scene = Annotated[Path, typer.Argument(metavar="SCENE", help="Scenario folder.", show_default=False)]
Out = Annotated[Path, output_option("-o", "--out", metavar="OUT", help="Folder to write to.")]
Jobs = Annotated[
    int,
    running_option("--jobs", "-j", min=1, metavar="N", help="Worker processes on this machine."),
]
Scheduler = Annotated[
    str | None,
    running_option(metavar="ADDRESS", help="A running Dask scheduler, tcp://HOST:PORT."),
]
ConfigFile = Annotated[
    Path | None,
    parameter_option("--config", metavar="FILE.toml", help="Parameters, as `hid2 config` lists them."),
]
Settings = Annotated[
    list[str],
    parameter_option(
        "--set", metavar="KEY=VALUE", help="One parameter, section.key=value; repeatable.", show_default=False
    ),
]
Timeout = Annotated[
    float,
    running_option("--scene-timeout", min=1, metavar="S", help="Seconds after which a scene is ended and quarantined."),
]
Memory = Annotated[
    int,
    running_option(
        "--scene-memory", min=500, metavar="MB", help="Memory beyond which a scene is ended and quarantined."
    ),
]
Resume = Annotated[
    bool,
    running_option("--resume", metavar="", help="Skip scenes that are complete and unchanged."),
]
Verbose = Annotated[
    int,
    output_option(
        "-v",
        "--verbose",
        count=True,
        metavar="",
        help="Say more; -vv: everything, in generate the story of every vehicle that was tried.",
        show_default=False,
    ),
]
Quiet = Annotated[bool, output_option("-q", "--quiet", metavar="", help="Print errors only.")]
AsJson = Annotated[bool, output_option("--json", metavar="", help="Print the table as JSON.")]
MinAgents = Annotated[
    int,
    selection_option(min=0, metavar="N", help="Only scenes with at least N recorded tracks."),
]
City = Annotated[
    list[str],
    selection_option(metavar="CITY", help="Only scenes of this city; repeatable.", show_default=False),
]
Split = Annotated[
    list[SplitName],
    selection_option(help="Only scenes of this split; repeatable.", show_default=False),
]
Can = Annotated[
    list[CanName],
    selection_option(help="Only scenes with room for this manoeuvre or event; repeatable.", show_default=False),
]
Sample = Annotated[
    int | None,
    selection_option(min=1, metavar="N", help="N of the selected scenes, drawn with the seed."),
]

"""Arguments and options that several commands share, and the exit codes."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

ALL_DONE, SOME_FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

#: Groups of options in the help.
REQUEST, EVENTS, SELECTION = "What to generate", "Events", "Which scenes"
PARAMETERS, RUNNING, OUTPUT = "Parameters", "Running", "Output"
PREDICTION = "With prediction"

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
    typer.Option(
        "--map",
        metavar="MAP",
        help="An Argoverse 2 map, or a scene's folder with one, for Argoverse 1 sequences without their city's map.",
        rich_help_panel=SELECTION,
    ),
]
Window = Annotated[
    int,
    typer.Option(min=0, metavar="N", help="First sweep of a sensor log that is taken.", rich_help_panel=SELECTION),
]
Stride = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="More windows of a sensor log, N sweeps from one to the next.",
        rich_help_panel=SELECTION,
    ),
]
Scenes = Annotated[
    list[Path],
    typer.Argument(metavar="SCENE", help="Scenario folders, split folders or data-set roots.", show_default=False),
]
Scene = Annotated[Path, typer.Argument(metavar="SCENE", help="Scenario folder.", show_default=False)]
Out = Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="Folder to write to.", rich_help_panel=OUTPUT)]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", min=1, metavar="N", help="Worker processes on this machine.", rich_help_panel=RUNNING),
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="A running Dask scheduler, tcp://HOST:PORT.", rich_help_panel=RUNNING),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE.toml", help="Parameters, as `hid2 config` lists them.", rich_help_panel=PARAMETERS
    ),
]
Settings = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="One parameter, section.key=value; repeatable.",
        rich_help_panel=PARAMETERS,
        show_default=False,
    ),
]
Timeout = Annotated[
    float,
    typer.Option(
        "--scene-timeout",
        min=1,
        metavar="S",
        help="Seconds after which a scene is ended and quarantined.",
        rich_help_panel=RUNNING,
    ),
]
Memory = Annotated[
    int,
    typer.Option(
        "--scene-memory",
        min=500,
        metavar="MB",
        help="Memory beyond which a scene is ended and quarantined.",
        rich_help_panel=RUNNING,
    ),
]
Resume = Annotated[
    bool,
    typer.Option("--resume", metavar="", help="Skip scenes that are complete and unchanged.", rich_help_panel=RUNNING),
]
Verbose = Annotated[
    int,
    typer.Option(
        "-v",
        "--verbose",
        count=True,
        metavar="",
        help="Say more; -vv: everything, in generate the story of every vehicle that was tried.",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", metavar="", help="Print errors only.", rich_help_panel=OUTPUT)]
AsJson = Annotated[bool, typer.Option("--json", metavar="", help="Print the table as JSON.", rich_help_panel=OUTPUT)]
MinAgents = Annotated[
    int,
    typer.Option(min=0, metavar="N", help="Only scenes with at least N recorded tracks.", rich_help_panel=SELECTION),
]
City = Annotated[
    list[str],
    typer.Option(
        metavar="CITY", help="Only scenes of this city; repeatable.", rich_help_panel=SELECTION, show_default=False
    ),
]
Split = Annotated[
    list[SplitName],
    typer.Option(help="Only scenes of this split; repeatable.", rich_help_panel=SELECTION, show_default=False),
]
Can = Annotated[
    list[CanName],
    typer.Option(
        help="Only scenes with room for this manoeuvre or event; repeatable.",
        rich_help_panel=SELECTION,
        show_default=False,
    ),
]
Sample = Annotated[
    int | None,
    typer.Option(min=1, metavar="N", help="N of the selected scenes, drawn with the seed.", rich_help_panel=SELECTION),
]

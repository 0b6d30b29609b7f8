"""Writes bridge/PYTHON.md from the docstrings of the public names: python .ci/public_names.py. A test compares them."""

import inspect
import re
from pathlib import Path

import bridge

PAGE = Path(__file__).parents[1] / "bridge" / "PYTHON.md"
INTRODUCTION = """\
# From Python

The public interface, `from bridge import ...`. `python .ci/public_names.py` makes this page of the docstrings, and a
test compares them; `help(name)` has shapes, units and errors. It follows semantic versioning from 1.0 on: until then a
minor version may change it, and [CHANGELOG.md](../CHANGELOG.md) says so. All other names may change with any version.
The packages carry types, which mypy and editors follow in an editable install too.

Lengths are in metres, times in seconds, headings in radians counter-clockwise from east; positions are box centres in
city coordinates, in pictures and tables too. One process runs one simulation at a time: to use several cores, use
`run_batch`.

## A scene to hold

`read_scene` gives a recorded or a generated scene of any format, `generate` a denser one; both are a `TrafficScene`,
and nothing has to be written to be looked at. As the last line of a notebook's cell it shows itself as `hid2 view`
does. A test runs these lines:

```python
from bridge import draw_conflicts, evaluate_scene, find_scenarios, generate, load_config, parse_behaviours, read_scene

recorded = read_scene(find_scenarios("data/av2")[0])
mix = parse_behaviours("lane_change=0.5,straight=0.5")  # shares; a behaviour that is not named gets none
scene = generate(recorded, load_config(flags={"request.agents": 6, **mix}))
print(recorded)
print(scene)

scene.maneuvers[["track_id", "kind", "status", "reason", "start_s"]]  # pandas: a row for each that was asked for
scene.tracks.groupby("track_id")["position_x"].mean()  # pandas: a row for each track and timestep, city coordinates
scene.judge()  # pandas: what `hid2 validate` finds, a row each; none here
scene.sidecar.agents[0].driver  # all that is known of a vehicle; `scene.generated[0].position` is its path, (T, 2) m

scene.draw().savefig("scene.png")  # before | after, a figure of matplotlib
scene.plot("gen_0").savefig("gen_0.png")  # one track over time
scene.render("scene.gif", agent="gen_0")  # a film
scene.view("scene.html")  # the page that plays; without a name it opens in a browser

folder = scene.write("out")  # an Argoverse 2 scenario folder
assert read_scene(folder).tracks.equals(scene.tracks)
```

A lane-change rule and a metric of your own are functions. They are tried at once: one that takes other arguments,
raises or answers something else is an error of one line with its file and line, before anything is driven.

```python
def patient(view, gap_m=6.0):  # view: hid2.policy.rules.GapView; takes a gap that is long enough both ways
    return {"lead": view.front.distance_m > gap_m, "lag": view.rear.distance_m > gap_m}


def standing_share(group):  # group: hid2.evaluation.metrics.Group; of all states of vehicles, how many stand
    speeds = (group.arrays.velocity[group.rows] ** 2).sum(axis=1) ** 0.5
    return (speeds < 0.5).mean() if len(speeds) else 0.0


rule = {"lane_change.rule": patient, "lane_change.rule_with": "gap_m=4"}
careful = generate(recorded, load_config(flags={"request.agents": 6, **mix, **rule}))
print(evaluate_scene(careful, standing_share).loc[["scr", "standing_share"]])  # columns: original, generated, combined
```

{members}
## All names

| name | what it is |
|---|---|
"""


def page() -> str:
    """The text of the page: each name with its arguments and the first sentence of its docstring."""
    members = [
        f"| `.{name}{_arguments(found)}` | {_sentence(found)} |\n"
        for name, found in vars(bridge.TrafficScene).items()
        if not name.startswith("_") and (isinstance(found, property) or inspect.isfunction(found))
    ]
    table = "| of a `TrafficScene` | what it is |\n|---|---|\n" + "".join(members)
    return INTRODUCTION.replace("{members}", table) + "".join(
        f"| `{_call(name)}` | {_sentence(getattr(bridge, name))} |\n" for name in sorted(bridge.__all__, key=str.lower)
    )


def _call(name: str) -> str:
    found = getattr(bridge, name)
    return name if inspect.isclass(found) else f"{name}({', '.join(inspect.signature(found).parameters)})"


def _arguments(found: object) -> str:
    names = list(inspect.signature(found).parameters)[1:] if callable(found) else []
    return f"({', '.join(names)})" if callable(found) else ""


def _sentence(found: object) -> str:
    text = " ".join((inspect.getdoc(found) or "").split("\n\n")[0].split())
    return (re.match(r".*?[.](?=\s|$)", text) or re.match(".*", text))[0].replace("|", "\\|")  # type: ignore[index]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

"""A scene to hold: recorded or generated, written or not. Looked at, measured, judged and written in Python."""

import gzip
import tempfile
import webbrowser
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.files import write_text
from bridge.generation.gaps import gaps_bytes
from bridge.recordings.export import write_recording
from bridge.recordings.folders import Address
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import EventRecord, ManeuverRecord, Sidecar
from bridge.recordings.sources import find_one, read_recording
from hid2.agents import Track
from hid2.insertion.finalise import ExportedVehicle
from hid2.measures.arrays import is_generated_id
from hid2.params import Config
from hid2.scene import Scene, build_scene
from hid2.vehicle import DrivenVehicle
from netconvert.cells import CellGrid, build_cell_grid
from netconvert.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hid2.measures.conflicts import TrafficConflict


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class TrafficScene:
    """A scene, recorded or generated, written or not; m, s, rad, city coordinates. A notebook shows it as it plays.

    recording: all its tracks, map, rows, sidecar; source: the recording that it was made of; vehicles: paths and motion
    of the inserted tracks; driven: round and vehicle of all that were tried. The last three are not written.
    """

    recording: Recording
    source: Recording | None = None
    vehicles: tuple[ExportedVehicle, ...] = ()
    driven: tuple[tuple[int, DrivenVehicle], ...] = ()

    @property
    def sidecar(self) -> Sidecar | None:
        """What was asked for and what became of it; None: nothing was inserted."""
        return self.recording.sidecar

    @property
    def generated(self) -> tuple[Track, ...]:
        """The inserted tracks gen_0, gen_1, ..."""
        return tuple(track for track in self.recording.tracks if is_generated_id(track.track_id))

    @property
    def tracks(self) -> "pd.DataFrame":
        """One row for each track and timestep, in the columns of Argoverse 2."""
        table: pd.DataFrame = self.recording.table.to_pandas()
        return table

    @property
    def maneuvers(self) -> "pd.DataFrame":
        """One row for each manoeuvre that was asked for; track_id missing (`isna`) where no vehicle does it."""
        import pandas as pd

        asked = self.sidecar.asked if self.sidecar is not None else ()
        agents = self.sidecar.agents if self.sidecar is not None else ()
        policy: dict[str | None, str] = {one.track_id: one.policy.value for one in agents}
        rows = [{"track_id": name, "policy": policy.get(name), **record.model_dump()} for name, record in asked]
        return pd.DataFrame(rows, columns=["track_id", "policy", *ManeuverRecord.model_fields])

    @property
    def events(self) -> "pd.DataFrame":
        """One row for each event that was asked for, with what was measured of it or the reason, as in sidecars."""
        import pandas as pd

        events = self.sidecar.events if self.sidecar is not None else ()
        return pd.DataFrame([one.model_dump() for one in events], columns=[*EventRecord.model_fields])

    def judge(self) -> "pd.DataFrame":
        """What `hid2 validate` finds in the motion of inserted tracks and in the sidecar's claims: a row each."""
        import pandas as pd

        from bridge.recordings.judging import findings_of, recording_states

        one, states = self.recording, recording_states(self.recording)
        columns = ["track_id", "time_s", "quantity", "value", "limit", "unit", "other", "sentence"]
        each = ((f, f.quantity, round(f.step * one.step_s, 6)) for f in findings_of(states, self.sidecar))
        rows = [
            (f.track_id, time_s, of.value, f.value, f.limit, of.unit, f.other, of.sentence) for f, of, time_s in each
        ]
        return pd.DataFrame(rows, columns=columns)

    def conflicts(self, *, agent: str | None = None, pet_s: float = 5.0, ttc_s: float = 1.5) -> "list[TrafficConflict]":
        """Conflicts in SSAM's terms, of all or of one track: a TTC below ttc_s or a PET within pet_s.

        Errors: ConfigError for a track that the scene does not have.
        """
        from hid2.measures.arrays import stack
        from hid2.measures.conflicts import conflicts

        one = self.recording
        if agent is not None:
            one.track(agent)
        found = conflicts(stack(one.tracks, num_steps=one.num_steps, step_s=one.step_s), ttc_s=ttc_s, pet_s=pet_s)
        return [met for met in found if agent is None or agent in (met.first_id, met.second_id)]

    def draw(
        self, axes: "Axes | None" = None, *, step: int | None = None, agent: str | None = None, cells: bool = False
    ) -> "Figure":
        """The scene from above, before | after, as a figure; or as it is after, drawn into axes of your own.

        step: a timestep (default: the last observed one); agent: a track to highlight with its surroundings.
        Errors: ConfigError for an unknown step or track.
        """
        from bridge.pictures.render import draw_scene, scene_figure

        if axes is None:
            return scene_figure(self.recording, step=step, agent=agent, cells=cells)
        draw_scene(axes, self.recording, step=step, agent=agent, cells=cells)
        figure: Figure = axes.figure.figure  # of a subfigure too
        return figure

    def render(
        self, out_file: Path | str, *, step: int | None = None, agent: str | None = None, cells: bool = False
    ) -> Path:
        """Write `draw`'s picture (.png, .jpg, .pdf, .svg) or a film of all steps (.gif, .mp4); returns the file."""
        from bridge.pictures.render import render_scene

        return render_scene(self.recording, Path(out_file), step=step, agent=agent, cells=cells)

    def plot(self, track_id: str) -> "Figure":
        """One track over time: path, speed, acceleration, jerk, lateral offset, cells. Errors: ConfigError."""
        from bridge.pictures.plot import agent_figure

        return agent_figure(self.recording, track_id)

    def view(self, out_file: Path | str | None = None) -> Path:
        """Write the page of `hid2 view`; without a file, one of its own, which a browser opens. Returns the file."""
        path = Path(tempfile.mkdtemp(prefix="hid2-"), "scene.html") if out_file is None else Path(out_file)
        write_text(path, self._page())
        if out_file is None:
            webbrowser.open(path.as_uri())
        return path

    def write(self, out_dir: Path | str, *, record: Collection[str] = ()) -> Path:
        """Write a generated scene; returns its folder. record: `gaps`, beside it, of a scene just generated.

        Errors: ExportError; ConfigError for another record, and for gaps of a scene that was read.
        """
        if {*record} - ({"gaps"} if self.source is not None else set()):
            wanted = "['gaps']" if self.source is not None else "none, as a scene that was read tells no gaps"
            raise ConfigError(f"record = {record!r:.200}: expected {wanted}")
        extra = {f"gaps_{self.recording.scenario_id}.csv.gz": self._looks()} if "gaps" in record else {}
        return write_recording(self.recording, Path(out_dir), extra=extra)

    def __repr__(self) -> str:
        """Id, city, and how much is in it."""
        one, inserted, table = self.recording, len(self.generated), self.maneuvers
        done = f", {(table['status'] == 'done').sum()} of {len(table)} manoeuvres done" if len(table) else ""
        agents = f"{len(one.tracks) - inserted} recorded tracks, {inserted} inserted{done}"
        return f"TrafficScene({one.scenario_id}, {one.city}, {one.num_steps} steps: {agents})"

    def _repr_html_(self) -> str:
        style = "width:100%;height:640px;border:1px solid #ccc"
        return f'<iframe title="{escape(repr(self))}" srcdoc="{escape(self._page())}" style="{style}"></iframe>'

    def _page(self) -> str:
        from bridge.pages.viewer import page_of, scene_document

        return page_of([scene_document(self.recording, gzip.decompress(self._looks()) if self.driven else None)])

    def _looks(self) -> bytes:
        names = {one.driven.vehicle_id: f"gen_{row}" for row, one in enumerate(self.vehicles)}
        return gaps_bytes(self.driven, names, step_s=self.recording.step_s)


def read_scene(address: Address | str) -> TrafficScene:
    """The one scene at a path, recorded in any format or generated. Errors: ConfigError, ScenarioError, MapError."""
    return TrafficScene(read_recording(find_one(Path(address)) if isinstance(address, str | Path) else address))


def scene_of(
    recording: Recording, config: Config, grid: CellGrid | None = None, *, tracks: Sequence[Track] | None = None
) -> Scene:
    """The scene; grid: where it is known; tracks: where recorded vehicles drive otherwise. Errors: MapError."""
    return build_scene(
        build_cell_grid(recording.graph, cell_m=config.grid.cell_m) if grid is None else grid,
        recording.tracks if tracks is None else tracks,
        config=config,
        num_steps=recording.num_steps,
        step_s=recording.step_s,
        last_observed_step=recording.last_observed,
    )

"""Files that open a net in plain sumo-gui, and the table of its cells."""

import csv
import io
from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from lxml import etree
from lxml.builder import E

from netconvert.cells import CellGrid
from netconvert.geometry import FloatArray
from netconvert.net_xml import shape

#: Zoom at which all is shown: 100 by sumo-gui's own account, less for the frame that it leaves.
_ZOOM = 80.0
#: Milliseconds that sumo-gui waits for each simulated second: real time.
REAL_TIME_MS = 1000


def gui_files(
    grid: CellGrid,
    name: str,
    *,
    step_s: float,
    shown: tuple[FloatArray, FloatArray] | None = None,
    covered: Sequence[FloatArray] = (),
    options: Mapping[str, Mapping[str, str]] | None = None,
    vehicles: etree._Element | None = None,
) -> dict[str, bytes]:
    """Contents by file name of everything beside <name>.net.xml.

    step_s: of the simulation that sumo-gui runs. shown: low and high corner of the ground to look at first, (2,) m; all
    lanes by default. covered: lines of the net that are not the grid's, (N, 2) m. options: more of SUMO's, by section
    and name; vehicles: how they are drawn.

    <name>.sumocfg refers to the net, the drivable area (<name>.poly.xml) and the view (<name>.view.xml) by file names,
    so that the folder can be moved; <name>.cells.csv has one row a cell.
    """
    own = {
        "input": {"net-file": f"{name}.net.xml", "additional-files": f"{name}.poly.xml"},
        "time": {"step-length": f"{step_s}"},
        "gui_only": {"gui-settings-file": f"{name}.view.xml", "delay": str(REAL_TIME_MS)},
    }
    more = options or {}
    sections = {section: {**own.get(section, {}), **more.get(section, {})} for section in {**own, **more}}
    parts = (E(section, *(E(key, value=value) for key, value in of.items())) for section, of in sections.items())
    ground = np.concatenate([grid.graph.bounds, *grid.graph.drivable_areas, *covered])
    return {
        f"{name}.sumocfg": xml_bytes(E.sumoConfiguration(*parts)),
        f"{name}.poly.xml": xml_bytes(E.additional(*_polygons(grid))),
        f"{name}.view.xml": _view(ground, shown or grid.graph.bounds, vehicles),
        f"{name}.cells.csv": cells_csv(grid),
    }


def cells_csv(grid: CellGrid) -> bytes:
    """One row a cell, in the order of the grid's cells."""
    columns = {
        "lane_segment_id": [cell.lane_id for cell in grid.cells],
        "cell_index": [cell.index for cell in grid.cells],
        "sumo_lane_id": map(grid.sumo_lane_id, grid.cells),
        "length_m": [f"{grid.length_m(cell):.3f}" for cell in grid.cells],
        "center_x_m": [f"{x:.3f}" for x in grid.centers[:, 0].tolist()],
        "center_y_m": [f"{y:.3f}" for y in grid.centers[:, 1].tolist()],
        "lane_type": [grid.graph.lanes[cell.lane_id].lane_type for cell in grid.cells],
    }
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *zip(*columns.values(), strict=True)])
    return text.getvalue().encode()


def xml_bytes(root: etree._Element) -> bytes:
    """A file of SUMO's."""
    content: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return content


def _polygons(grid: CellGrid) -> list[etree._Element]:
    """The drivable area below the lanes, and the outline of each cell above them."""
    area = {"type": "drivable_area", "color": "205,205,200", "fill": "1", "layer": "-10"}
    # sumo-gui draws lanes on layer 100, vehicles on 400
    cell = {"type": "cell", "color": "150,154,160", "fill": "0", "lineWidth": "0.1", "layer": "150"}
    return [
        E.poly({"id": f"drivable_area_{number}", **area, "shape": shape(ring)})
        for number, ring in enumerate(grid.graph.drivable_areas)
    ] + [
        E.poly({"id": f"cell_{lane_id}_{index}" + f"_{k}" * (k > 0), **cell, "shape": shape(np.array(ring.coords))})
        for (lane_id, index), polygon in zip(grid.cells, grid.polygons, strict=True)
        for k, ring in enumerate(shapely.get_exterior_ring(shapely.get_parts(polygon)))  # more where boundaries cross
        if not ring.is_empty
    ]


def _view(ground: FloatArray, shown: tuple[FloatArray, FloatArray], vehicles: etree._Element | None) -> bytes:
    """The view of what is shown of the ground (N, 2) m, all of which zoom 100 shows."""
    low, high = shown
    x, y = ((low + high) / 2.0).tolist()
    zoom = _ZOOM * _window_width(ground.min(axis=0), ground.max(axis=0)) / _window_width(low, high)
    # waterways are lanes that only carry a trace
    shown_as = {"road": "96,99,104", "bike lane": "178,96,76", "waterway": "0,0,0,0"}
    colors = E.colorScheme(*(E.entry(color=color, name=name) for name, color in shown_as.items()), name="uniform")
    # Every cell ends in a junction: the arrows and stop lines there would hide the lanes, and there is nothing to see.
    edges = E.edges(colors, showLinkDecals="0", showLinkRules="0", laneShowBorders="0", showBikeMarkings="0")
    more = [E.junctions(drawShape="0"), *([] if vehicles is None else [vehicles])]
    scheme = E.scheme(E.background(backgroundColor="250,250,248", showGrid="0"), edges, *more, name="hid2")
    return xml_bytes(E.viewsettings(scheme, E.viewport(zoom=f"{zoom:.1f}", x=f"{x:.2f}", y=f"{y:.2f}")))


def _window_width(low: FloatArray, high: FloatArray) -> float:
    """Width of the ground in a window that shows all from low to high, m; a usual one is 1.78 times as wide as high."""
    wide, high_m = (high - low).tolist()
    return max(float(wide), float(high_m) * 1.78, 1.0)

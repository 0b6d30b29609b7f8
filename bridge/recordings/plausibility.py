"""Whether a recording is what it says it is: asked before anything is driven in it, and by `hid2 validate`.

The bounds follow from what each figure means and from how many vehicles tell it; none is fitted to a data set.
`tests/benchmarks/plausibility_figures.py` prints the figures of real scenes beside them.
"""

from bridge.recordings.recording import Recording
from hid2.measures.arrays import stack
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.plausibility import Plausibility, plausibility

#: Least vehicles that tell something: one or two may reverse, leave a car park or be tracked badly.
LEAST_VEHICLES = 3
#: Range of the way by velocities over the displacement: 1 where they agree, 0 without velocity, 2 for halved tracks.
STATED = (0.5, 1.5)
#: Least share of points on drivable ground, of moving vehicles that come within the map: chance has about a quarter.
LEAST_GROUND = 0.75
#: Least share of the moving vehicles within the map: where it ends early many are not, elsewhere none is.
LEAST_MAPPED = 0.25
#: Most of the moving vehicles, as a share, with a heading mostly off their motion: at random 3 of 4 are.
MOST_TURNED = 0.5
#: Bound of the share of moving vehicles that fit a lane only after a shift beyond half a lane; least of them that tell.
MOST_GAIN, LEAST_GAINING = 0.15, 2


def figures_of(recording: Recording) -> Plausibility:
    """The figures of a recording."""
    return plausibility(stack(recording.tracks, step_s=recording.step_s), flatten_lanes(recording.graph))


def implausible(recording: Recording) -> str:
    """The first figure beyond its bound: value, bound and what is probably wrong; "" where all are plausible."""
    start, end = (recording.table.column(f"{name}_timestamp")[0].as_py() for name in ("start", "end"))
    if end < start:
        return f"end_timestamp {end:.0f}, start_timestamp {start:.0f}, expected the end later; probably exchanged"
    f, map_name = figures_of(recording), f"map {recording.map_path.name}"
    for axis, (ratio, count) in zip("xy", f.stated, strict=True):
        if count >= LEAST_VEHICLES and not STATED[0] <= ratio <= STATED[1]:
            return (
                f"velocity_{axis} makes {ratio:.2f} of the displacement along {axis} (median of {count} moving "
                f"vehicles), expected {STATED[0]:g} to {STATED[1]:g}; probably no velocities, another unit, scaled "
                "tracks, or x and y exchanged"
            )
    if f.turned >= LEAST_VEHICLES and f.turned > MOST_TURNED * f.moving:
        return (
            f"headings of {f.turned} of {f.moving} moving vehicles more than 45 degrees off their motion, expected at "
            f"most {MOST_TURNED:.0%}; probably headings in degrees, or from another axis"
        )
    mapped, ground = f.mapped >= LEAST_MAPPED * f.moving, f.ground >= LEAST_GROUND
    off_map, off_ground = f.moving - f.mapped, (1.0 - f.ground) * f.mapped
    if (not mapped and off_map >= LEAST_VEHICLES) or (not ground and off_ground >= LEAST_VEHICLES):
        return (
            f"{f.mapped} of {f.moving} moving vehicles within the map, on drivable ground for {f.ground:.0%} of their "
            f"points there, expected at least {LEAST_MAPPED:.0%} and {LEAST_GROUND:.0%}; probably the map of another "
            f"place, another frame, or x and y exchanged ({map_name})"
        )
    if f.gain >= max(MOST_GAIN, LEAST_GAINING / max(1, f.moving)):
        return (
            f"tracks beside the lanes: {f.gain:.0%} of {f.moving} moving vehicles are on a lane of their direction "
            f"only when shifted, by {f.shift_m:.1f} m, expected below {MOST_GAIN:.0%}; probably a shifted {map_name}"
        )
    return ""

"""Oriented boxes against each other: the separating axis test, compiled for loops over many of them.

A box is its centre, cosine and sine of its heading, half its length and half its width.
"""

import math

from hid2.kernels.compiled import inner


@inner
def shadows(x: float, y: float, ac: float, asn: float, bc: float, bs: float) -> tuple[float, float, float, float]:
    """A vector on the four axes: along and across box a, along and across box b."""
    return x * ac + y * asn, -x * asn + y * ac, x * bc + y * bs, -x * bs + y * bc


@inner
def half_shadows(
    ac: float, asn: float, al: float, aw: float, bc: float, bs: float, bl: float, bw: float
) -> tuple[float, float, float, float]:
    """Half the shadows of two boxes, one behind the other, on the four axes, m: centres farther apart are separated."""
    c, s = abs(ac * bc + asn * bs), abs(ac * bs - asn * bc)
    return al + bl * c + bw * s, aw + bl * s + bw * c, bl + al * c + aw * s, bw + al * s + aw * c


@inner
def apart(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> float:  # fmt: skip
    """How far apart the boxes are at least along a separating axis, m; not above 0 where they overlap."""
    distance = shadows(bx - ax, by - ay, ac, asn, bc, bs)
    half = half_shadows(ac, asn, al, aw, bc, bs, bl, bw)
    ahead, beside = abs(distance[0]) - half[0], abs(distance[1]) - half[1]
    its_ahead, its_beside = abs(distance[2]) - half[2], abs(distance[3]) - half[3]
    # no max(): in a loop over many boxes the compiler then does several at once
    own = ahead if ahead > beside else beside
    its = its_ahead if its_ahead > its_beside else its_beside
    return own if own > its else its


@inner
def overlap(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> bool:  # fmt: skip
    """Whether two boxes touch."""
    return apart(ax, ay, ac, asn, al, aw, bx, by, bc, bs, bl, bw) <= 0.0


@inner
def contact_time(
    x: float, y: float, vx: float, vy: float,
    ac: float, asn: float, al: float, aw: float, bc: float, bs: float, bl: float, bw: float,
) -> float:  # fmt: skip
    """Time until box b, at (x, y) from box a and moving at (vx, vy) relative to it, touches it; inf if never.

    On each of the four axes the shadows overlap during an interval of time; the boxes touch when all four intervals
    hold at once. 0 where they overlap already.
    """
    enter, leave = 0.0, math.inf
    distances, speeds = shadows(x, y, ac, asn, bc, bs), shadows(vx, vy, ac, asn, bc, bs)
    halves = half_shadows(ac, asn, al, aw, bc, bs, bl, bw)
    for k in range(4):
        distance, speed, half = distances[k], speeds[k], halves[k]
        if abs(speed) < 1e-12:
            if abs(distance) > half:
                return math.inf
            continue
        t0, t1 = (-half - distance) / speed, (half - distance) / speed
        enter = max(enter, min(t0, t1))
        leave = min(leave, max(t0, t1))
    return enter if enter <= leave else math.inf

"""Whether two boxes overlap, and how far they are apart: separating axes, compiled for loops over many of them."""

from numba import njit


@njit(cache=True)
def apart(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> float:  # fmt: skip
    """How far apart the boxes are at least along a separating axis, m; not above 0 where they overlap."""
    dx, dy = bx - ax, by - ay
    c, s = abs(ac * bc + asn * bs), abs(ac * bs - asn * bc)
    ahead = abs(dx * ac + dy * asn) - (al + bl * c + bw * s)
    beside = abs(-dx * asn + dy * ac) - (aw + bl * s + bw * c)
    its_ahead = abs(dx * bc + dy * bs) - (bl + al * c + aw * s)
    its_beside = abs(-dx * bs + dy * bc) - (bw + al * s + aw * c)
    # no max(): in a loop over many boxes the compiler then does several at once
    own = ahead if ahead > beside else beside
    its = its_ahead if its_ahead > its_beside else its_beside
    return own if own > its else its


@njit(cache=True)
def overlap(
    ax: float, ay: float, ac: float, asn: float, al: float, aw: float,
    bx: float, by: float, bc: float, bs: float, bl: float, bw: float,
) -> bool:  # fmt: skip
    """Whether two boxes touch, given by centre, cosine and sine of the heading, half length and half width."""
    return apart(ax, ay, ac, asn, al, aw, bx, by, bc, bs, bl, bw) <= 0.0

"""Which cells of the grid boxes cover, and which cell an agent's centre belongs to."""

import numpy as np
import numpy.typing as npt

from hid2.kernels.boxes import overlap
from hid2.kernels.compiled import kernel
from netconvert.geometry import BoolArray, FloatArray, IntArray


@kernel("(f8[:,::1], f8[::1], f8[::1], f8[::1], i8[::1], f8, f8[:,:,::1], f8[:,::1], b1[:,::1], f8[::1], f8[::1], f8)")
def original_cells(
    center: FloatArray, c_heading: FloatArray, c_length: FloatArray, c_width: FloatArray, by_x: IntArray, widest: float,
    position: FloatArray, heading: FloatArray, present: BoolArray, lengths: FloatArray, widths: FloatArray,
    agrees: float,
) -> tuple[npt.NDArray[np.uint8], IntArray]:  # fmt: skip
    """Sigma (T, C), 1 where an agent's box is, and the cell (A, T) of each agent's centre, -1 for none.

    by_x (C,): cells in the order of their x; widest: largest half diagonal of any, m.
    """
    (agents, steps), cells = present.shape, center.shape[0]
    sigma = np.zeros((steps, cells), dtype=np.uint8)
    found = np.full((agents, steps), -1, dtype=np.int64)
    cosine, sine, left_of, cos_agrees = np.cos(c_heading), np.sin(c_heading), center[by_x, 0], np.cos(agrees)
    for a in range(agents):
        half_l, half_w = lengths[a] / 2, widths[a] / 2
        reach = np.hypot(half_l, half_w) + widest
        for t in range(steps):
            if not present[a, t]:
                continue
            x, y, angle = position[a, t, 0], position[a, t, 1], heading[a, t]
            still = t > 0 and present[a, t - 1] and angle == heading[a, t - 1]
            still = still and x == position[a, t - 1, 0] and y == position[a, t - 1, 1]
            co, si = np.cos(angle), np.sin(angle)
            best_level, best_distance, best = 4, np.inf, -1
            for k in range(np.searchsorted(left_of, x - reach), cells):
                c = by_x[k]
                dx, dy = x - center[c, 0], y - center[c, 1]
                if dx < -reach:
                    break
                if abs(dy) > reach:
                    continue
                if overlap(
                    x, y, co, si, half_l, half_w,
                    center[c, 0], center[c, 1], cosine[c], sine[c], c_length[c] / 2, c_width[c] / 2,
                ):  # fmt: skip
                    sigma[t, c] = 1
                if still:
                    continue
                along = abs(dx * cosine[c] + dy * sine[c])
                across = abs(-dx * sine[c] + dy * cosine[c])
                same_way = co * cosine[c] + si * sine[c] > cos_agrees
                distance = np.hypot(dx, dy)
                level = 4
                if same_way and along <= c_length[c] / 2 + 1e-9 and across <= c_width[c] / 2:
                    level, distance = 1, across
                elif same_way and along <= c_length[c] / 2 + 0.5 and across <= c_width[c] / 2 + 0.5:
                    level, distance = 2, across
                elif distance <= c_length[c]:
                    level = 3
                nearer = distance < best_distance or (distance == best_distance and c < best)
                if level < best_level or (level == best_level and level < 4 and nearer):
                    best_level, best_distance, best = level, distance, c
            found[a, t] = found[a, t - 1] if still else best
    return sigma, found


@kernel("(f8[:,::1], f8[::1], f8[::1], f8[::1], i8, f8[:,:,::1], f8[:,::1], b1[:,::1], f8[::1], f8[::1])")
def clear_places(
    point: FloatArray, angle: FloatArray, half_l: FloatArray, half_w: FloatArray, step: int, position: FloatArray,
    heading: FloatArray, present: BoolArray, length: FloatArray, width: FloatArray,
) -> BoolArray:  # fmt: skip
    """Whether a box at each of some places (N, 2) m, at an angle (N,) rad, meets no agent's at a step.

    half_l, half_w (N,) m: half the length and width of each box.
    """
    found = np.ones(angle.size, dtype=np.bool_)
    for n in range(angle.size):
        co, si = np.cos(angle[n]), np.sin(angle[n])
        for a in range(length.size):
            x, y, bl, bw = position[a, step, 0], position[a, step, 1], length[a] / 2, width[a] / 2
            reach = half_l[n] + half_w[n] + bl + bw
            if not present[a, step] or abs(x - point[n, 0]) > reach or abs(y - point[n, 1]) > reach:
                continue
            bc, bs = np.cos(heading[a, step]), np.sin(heading[a, step])
            if overlap(point[n, 0], point[n, 1], co, si, half_l[n], half_w[n], x, y, bc, bs, bl, bw):
                found[n] = False
                break
    return found

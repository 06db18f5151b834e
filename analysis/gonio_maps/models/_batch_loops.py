"""The compiled part of `gonio_maps.models.batch`: one pixel after the other, its directions, starts and fits.

A model comes in as five compiled functions (`_batch_steps.SHADE` and its like), so that all this is compiled once for
all models. Indices: j values, a parameters that move, c common causes, p pixels. numba is imported with this module,
which `batch` imports at its first fit.
"""

import functools

import numpy as np
from numba import types

from gonio.compiled import njit
from gonio.models._compile import fingerprint
from gonio_maps.models._batch_algebra import (
    OPTIONS,
    called,
    copied,
    inverted,
    moments,
    on_scale,
    per_root,
    slope_moments,
    smallest,
    sum_of,
    vectors,
    viewing,
)
from gonio_maps.models._batch_misfit import nearest
from gonio_maps.models._batch_models import FREE_BASE, FREE_LEVELS, FREE_LOBE
from gonio_maps.models._batch_scaled import ABOVE, scaled
from gonio_maps.models._batch_steps import (
    DERIVE,
    LEVELS,
    SHADE,
    TAKE,
    UNIT,
    by_differences,
    difference,
    minimised,
    room_for,
)

FAR_VALLEY = 100.0
"""The second valley counts where its chi-square is at most this many times that of the first, plus this number."""
CLOSE_VALLEY = 10.0
"""A fit is followed by another start whose chi-square is at most this many times its own, plus 20."""
CLOSE = 1000.0
"""Or at most this, times what an unacceptable fit exceeds an acceptable one by: where values are few, valleys lie close
together and the grid's steps cost less chi-square."""
FLAT = 50.0
"""Other rows of a valley are tried where chi-square is at most this much above an acceptable one."""
UNCLEAR, AGAIN = 10.0, 10
"""Below this many times an acceptable chi-square by some of the values, so many rows are compared by all of them."""
NEAR_VALLEY, NEAR, NEARLY_FLAT = 3.0, 200.0, 5.0
"""`CLOSE_VALLEY`, `CLOSE` and `FLAT` where what was found is rough, so that `_batch_scaled` looks for other valleys."""
NARROWINGS = 3
"""Steps of the width alone, before all parameters are fitted."""
FEWEST_OF_SOME = 25
"""Values that tell the start at least, where some of them do (`Batched.every`)."""


@viewing
def levels_of(how, s0, sz, sg, sgg, sgz):  # type: ignore[no-untyped-def]
    """Level of a lobe and base by least squares, both at least 0, from sums over the values."""
    level, base = 1.0, 0.0
    if how == FREE_LOBE:
        level = sgz / sgg
    elif how == FREE_BASE:
        base = max((sz - sg) / s0, 0.0)
    elif how == FREE_LEVELS:
        det = s0 * sgg - sg * sg
        if det > 1e-12 * s0 * sgg:
            level, base = (s0 * sgz - sg * sz) / det, (sgg * sz - sg * sgz) / det
        if base < 0.0 or det <= 1e-12 * s0 * sgg:
            level, base = sgz / sgg, 0.0
        if level < 0.0:
            level, base = 0.0, max(sz / s0, 0.0)
    return level, base


@viewing
def lowest_row(profile, first, step):  # type: ignore[no-untyped-def]
    """Where chi-square is lowest of rows `first`, `first + step`, ...; a number wins over NaN."""
    best = first
    for row in range(first + step, profile.size, step):
        if profile[row] < profile[best] or profile[best] != profile[best]:
            best = row
    return best


@viewing
def levelled(how, s0, sz, sg, sgg, sgz):  # type: ignore[no-untyped-def]
    """The best level and base of a lobe, and by how much they lower chi-square below that of nothing."""
    level, base = levels_of(how, s0, sz, sg, sgg, sgz)
    return level, base, 2.0 * (level * sgz + base * sz - level * base * sg) - level * level * sgg - base * base * s0


@viewing
def weighed(z, w, weight, weighted, count):  # type: ignore[no-untyped-def]
    """Weights and weighted values; their sums, and that of weighted squares."""
    s0, sz, szz = 0.0, 0.0, 0.0
    for j in range(count):
        weight[j] = w[j] * w[j]
        weighted[j] = weight[j] * z[j]
        s0 += weight[j]
        sz += weighted[j]
        szz += weighted[j] * z[j]
    return s0, sz, szz


@viewing
def judged(levels, how, z, w, grid, starts, profile, weight, weighted, lobes, count):  # type: ignore[no-untyped-def]
    """Parameters and chi-square of each row of the grid, into `starts` and `profile`.

    Where levels are solved for, the model is a lobe times a level and a base: both follow by linear least squares.
    `lobes` has the lobes, row after row.
    """
    s0, sz, szz = weighed(z, w, weight, weighted, count)
    for row in range(grid.shape[0]):
        sg, sgg, sgz = moments(lobes[row * count : row * count + count], weight, weighted, count)
        level, base, gain = levelled(how, s0, sz, sg, sgg, sgz)
        profile[row] = szz - gain
        start = starts[row]
        copied(grid[row], start, 0, start.size)
        levels(start, level, base)


@viewing
def judged_again(  # type: ignore[no-untyped-def]
    shade, levels, columns, z, w, units, starts, how, profile, whole, shaded_rows, anew, weight, weighted, count
):
    """`judged` by all values, for the rows that are lowest by some of them; the others count as no lower than these.

    `whole` has the lobes of all values, where `shaded_rows` is 1: neighbours with the same directions share them.
    `anew`: room for the rows, their parameters and their lobes, which are evaluated in one call.
    """
    again, trials, fresh = anew
    s0, sz, szz = weighed(z, w, weight, weighted, count)
    highest, chosen, missing, size = -np.inf, 0, 0, starts.shape[1]
    while chosen < min(AGAIN, profile.size):
        row = -1
        for other in range(profile.size):
            if shaded_rows[other] < 2 and (row < 0 or profile[other] < profile[row]):
                row = other
        again[chosen] = row
        if shaded_rows[row] == 0:
            copied(units[row], trials, missing * size, size)
            missing += 1
        shaded_rows[row] += 2
        chosen += 1
    if missing:
        shade(columns, trials[: missing * size], missing, fresh[: missing * count])
    missing = 0
    for row in again[:chosen]:
        g = whole[row * count : row * count + count]
        if shaded_rows[row] == 2:
            copied(fresh[missing * count : missing * count + count], g, 0, count)
            missing += 1
        shaded_rows[row] = 3
        sg, sgg, sgz = moments(g, weight, weighted, count)
        level, base, gain = levelled(how, s0, sz, sg, sgg, sgz)
        profile[row] = szz - gain
        highest = max(highest, profile[row])
        levels(starts[row], level, base)
    for row in range(profile.size):
        if shaded_rows[row] < 2:
            profile[row] = max(profile[row], highest)
        shaded_rows[row] = min(shaded_rows[row], 1)


@viewing
def valleys(profile, widths):  # type: ignore[no-untyped-def]
    """The rows of the two lowest valleys of chi-square over the grid's widths, which run fastest; -1 for none."""
    first, second = -1, -1
    for a in range(widths):
        here = lowest_row(profile, a, widths)
        low = a == 0 or profile[here] <= profile[lowest_row(profile, a - 1, widths)]
        low = low and (a == widths - 1 or profile[here] < profile[lowest_row(profile, a + 1, widths)])
        if low and (first < 0 or profile[here] < profile[first]):
            first, second = here, first
        elif low and (second < 0 or profile[here] < profile[second]):
            second = here
    if second >= 0 and profile[second] > FAR_VALLEY * (profile[first] + 1.0):
        second = -1
    return first, second


@viewing
def narrowed(shade, derive, unit, levels, columns, start, width, low, high, weights, room, count):  # type: ignore[no-untyped-def]
    """Brings the width of a start towards the lowest chi-square by Gauss-Newton steps, each with the best levels.

    That is variable projection (Golub and Pereyra 1973) with Kaufman's derivative: levels are taken out of the values
    and of the derivative by linear least squares.
    """
    weight, weighted = weights
    trial, trials, both = room[6], room[7][: 2 * start.size], room[9][: 2 * count]
    g, d = both[:count], both[count:]
    s0, sz, best = sum_of(weight, count), sum_of(weighted, count), -np.inf
    copied(start, trial, 0, start.size)
    how, known = unit(trial), derive(columns[:0], start, width, columns[:0], columns[:0])
    for turn in range(NARROWINGS + 1):
        step, sets = difference(trial[width], low, high), 1 if known or turn == NARROWINGS else 2
        copied(trial, trials, 0, start.size)
        copied(trial, trials, start.size, start.size)
        trials[start.size + width] += step
        shade(columns, trials[: sets * start.size], sets, both[: sets * count])
        sg, sgg, sgz = moments(g, weight, weighted, count)
        level, base, gain = levelled(how, s0, sz, sg, sgg, sgz)
        if not gain > best:
            break
        best = gain
        copied(trial, start, 0, start.size)
        levels(start, level, base)
        if turn == NARROWINGS:
            break
        if derive(columns, trial, width, g, d) == 0:
            for j in range(count):
                d[j] = (d[j] - g[j]) / step
        sd, sdd, sgd, sdz = slope_moments(g, d, weight, weighted, count)
        if base > 0.0:
            sdd, sgd, sgg, sdz = sdd - sd * sd / s0, sgd - sg * sd / s0, sgg - sg * sg / s0, sdz - sd * sz / s0
        bend = sdd if how == FREE_BASE else sdd - sgd * sgd / sgg
        if not (level > 0.0 and bend > 0.0):
            break
        step = (sdz - level * sgd) / (level * bend)
        trial[width] = min(max(trial[width] + step, low, 0.5 * trial[width]), high, 2.0 * trial[width])


@vectors
def seen_from(x, y, source, camera, count, omega_i, omega_r):  # type: ignore[no-untyped-def]
    """Unit vectors from a place to source and camera of each value."""
    for j in range(count):
        dx, dy, dz = source[0, j] - x, source[1, j] - y, source[2, j]
        inverse = per_root(dx * dx + dy * dy + dz * dz)
        omega_i[3 * j], omega_i[3 * j + 1], omega_i[3 * j + 2] = dx * inverse, dy * inverse, dz * inverse
        dx, dy, dz = camera[0, j] - x, camera[1, j] - y, camera[2, j]
        inverse = per_root(dx * dx + dy * dy + dz * dz)
        omega_r[3 * j], omega_r[3 * j + 1], omega_r[3 * j + 2] = dx * inverse, dy * inverse, dz * inverse


@viewing
def taken(values, u, z, own, w, at):  # type: ignore[no-untyped-def]
    """Packs the values that have an uncertainty: how many there are, and whether they are those of before."""
    count, moved = 0, 0
    for j in range(values.size):
        count += 1 if u[j] > 0.0 and values[j] - values[j] == 0.0 else 0
    if count == values.size:  # without a branch a value
        for j in range(count):
            moved |= at[j] ^ j
            at[j] = j
            z[j], own[j], w[j] = values[j], u[j], 1.0 / u[j]
        return count, moved == 0
    count = 0
    for j in range(values.size):
        if u[j] > 0.0 and values[j] - values[j] == 0.0:
            moved |= at[count] ^ j
            at[count] = j
            z[count], own[count], w[count] = values[j], u[j], 1.0 / u[j]
            count += 1
    return count, moved == 0


@called
def gathered(at, count, source, camera, common, numbers, source_of, camera_of, relative, block):  # type: ignore[no-untyped-def]
    """What belongs to the values that `taken` packs."""
    for j in range(count):
        source_of[:, j], camera_of[:, j], relative[:, j] = source[:, at[j]], camera[:, at[j]], common[:, at[j]]
        block[:, j] = numbers[:, at[j]]


@called
def thinned(z, w, omega_i, omega_r, step, some_z, some_w, few_i, few_r):  # type: ignore[no-untyped-def]
    """One of `step` values, with its directions."""
    for j in range(some_z.size):
        some_z[j], some_w[j] = z[j * step], w[j * step]
        few_i[3 * j : 3 * j + 3] = omega_i[3 * j * step : 3 * j * step + 3]
        few_r[3 * j : 3 * j + 3] = omega_r[3 * j * step : 3 * j * step + 3]


REAL, WHOLE = types.float64, types.int64
RESULT = types.int64(
    *(types.FunctionType(one) for one in (TAKE, SHADE, DERIVE, UNIT, LEVELS)),
    *(WHOLE, REAL[::1], REAL[::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1]),
    *(WHOLE[::1], REAL[::1], REAL[::1], REAL[:, ::1], WHOLE, WHOLE[:, ::1], REAL[::1], WHOLE, WHOLE),
    *(REAL[::1], WHOLE[::1]),
    *(REAL[:, ::1], REAL[:, :, ::1], REAL[::1], REAL[::1], WHOLE[::1], WHOLE, WHOLE),
)


@viewing
def lowered(shade, derive, seen, box, kept, work, rooms, best):  # type: ignore[no-untyped-def]
    """Least squares from `end` on: the lower chi-square of it and `best`, with its parameters, matrix and covariance.

    `seen`: columns, values, weights and causes; `box`: what is free, and bounds; `kept`: the normal matrix, that of the
    best, which parameters move, room, `end`, parameters and covariance of the best; `rooms`: `room_for` and the model.
    """
    columns, z, w, relative = seen
    free, lower, upper = box
    matrix, around, moves, triangle, end, theta, spread = kept
    room, f = rooms
    found = minimised(
        shade, derive, columns, z, w, 0.0, relative, end, free, lower, upper, f, work, matrix, moves, room, z.size,
        best, theta, around,
    )  # fmt: skip
    if not found < best:
        return best
    copied(end, theta, 0, end.size)
    for a in range(moves.size):
        copied(matrix[a], around[a], 0, moves.size)
    inverted(matrix, moves, triangle, spread)
    return found


@viewing
def begun(shade, derive, unit, levels, columns, start, width, weights, box, rooms, end, count):  # type: ignore[no-untyped-def]
    """A start with a better width where that is free, within bounds, into `end`."""
    _, lower, upper = box
    if width >= 0:
        narrowed(
            shade, derive, unit, levels, columns, start, width, lower[width], upper[width], weights, rooms[0], count
        )
    for a in range(end.size):
        end[a] = min(max(start[a], lower[a]), upper[a])


@viewing
def by_valleys(  # type: ignore[no-untyped-def]
    shade, derive, unit, levels, seen, box, kept, work, rooms, axis, grid, starts, profile, weights, acceptable,
):  # fmt: skip
    """Chi-square of the lowest valley of those that the profile over the grid shows."""
    (_, widths, width, scales, pair), end, theta = axis, kept[4], kept[5]
    first, second = valleys(profile, widths)
    best, which, times, close, more = np.inf, first, CLOSE_VALLEY, CLOSE, FLAT
    while which >= 0:
        if profile[which] > max(times * best + 20.0, close * max(best / acceptable, 1.0)):
            break
        begun(shade, derive, unit, levels, seen[0], starts[which], width, weights, box, rooms, end, seen[1].size)
        best = lowered(shade, derive, seen, box, kept, work, rooms, best)
        rough = scales.size and theta[pair[0]] > scales[1]
        if rough:
            times, close, more = NEAR_VALLEY, NEAR, NEARLY_FLAT
        block, flat = which - which % widths, min(best, acceptable) + more
        for row in range(block, block + widths):
            other = abs(row - which) > 1 and profile[row] < flat
            if not (other or (row == second and which == first)):
                profile[row] = np.inf
        profile[which] = np.inf
        if rough and best <= acceptable:
            for row in range(profile.size):
                if grid[row, pair[0]] > scales[1]:
                    profile[row] = np.inf
        which = lowest_row(profile, 0, 1)  # the second valley, or one of another index or another sigma
        which = which if profile[which] < np.inf else -1
    return best


@viewing
def off_bounds(  # type: ignore[no-untyped-def]
    shade, derive, unit, levels, seen, box, kept, work, rooms, axis, grid, start, weights, best,
):  # fmt: skip
    """`best`, or what is lower inside a bound that the search ended on."""
    (free, lower, upper), width, end, theta = box, axis[2], kept[4], kept[5]
    for a in range(free.size):
        if lower[free[a]] < theta[free[a]] < upper[free[a]]:
            continue
        for row in range(grid.shape[0]):
            value = grid[row, free[a]]
            new = lower[free[a]] < value < upper[free[a]]
            for before in range(row):
                new = new and grid[before, free[a]] != value
            if new:
                copied(theta, start, 0, end.size)
                start[free[a]] = value
                begun(shade, derive, unit, levels, seen[0], start, width, weights, box, rooms, end, seen[1].size)
                best = lowered(shade, derive, seen, box, kept, work, rooms, best)
    return best


@viewing
def lowest(  # type: ignore[no-untyped-def]
    shade, derive, unit, levels, seen, some_z, some_w, box, kept, work, rooms, axis, grid, of_grid, weights, acceptable,
):  # fmt: skip
    """Chi-square of the lowest valley; its parameters and their covariance in `kept`, as of `lowered`.

    `axis`: what `unit` tells, how many widths the grid has, which parameter the width is, or -1, and the scales and the
    pair of parameters for `scaled`.
    """
    (columns, z, w, relative), (how, _, _, scales, pair), count = seen, axis, seen[1].size
    lobes, units, whole, shaded_rows, anew, starts, profile = of_grid
    weight, weighted = weights
    judged(levels, how, some_z, some_w, grid, starts, profile, weight, weighted, lobes, some_z.size)
    for row in range(profile.size):
        profile[row] *= count / some_z.size
    if some_z.size < count and profile[lowest_row(profile, 0, 1)] < UNCLEAR * acceptable:
        judged_again(
            shade, levels, columns, z, w, units, starts, how, profile, whole, shaded_rows, anew, weight, weighted,
            count,
        )  # fmt: skip
    best = by_valleys(
        shade, derive, unit, levels, seen, box, kept, work, rooms, axis, grid, starts, profile, weights, acceptable
    )
    best = off_bounds(shade, derive, unit, levels, seen, box, kept, work, rooms, axis, grid, starts[0], weights, best)
    if scales.size and (best > acceptable or kept[5][pair[0]] > scales[1]):
        others, count_of_others, promised = scaled(
            shade, derive, columns, z, w, relative, kept[5], box, kept[1], best, scales, pair, rooms[0], work, count
        )
        for row in range(count_of_others):
            if promised[row] < best + ABOVE:
                copied(others[row], kept[4], 0, kept[4].size)
                best = lowered(shade, derive, seen, box, kept, work, rooms, best)
    return best


@called
def by_logarithms(shade, derive, seen, own, box, kept, work, rooms, block, critical, chi):  # type: ignore[no-untyped-def]
    """A rejected model once more, by way of logarithms: where a narrow lobe lies beside the values, these lead to it.

    Chi-square of the lower one and 0, or where that is rejected, too, the misfit of the nearest model.
    """
    columns, z, w, relative = seen
    free, lower, upper = box
    matrix, around, moves, _, end, theta, spread = kept
    room, f = rooms
    small, measured, logarithms, count = smallest(z), z.copy(), theta.copy(), z.size
    for j in range(count):
        z[j], w[j] = on_scale(measured[j], small), 1.0
    minimised(
        shade, derive, columns, z, w, small, relative[:0], logarithms, free, lower, upper, f, work, matrix, moves, room,
        count, np.inf, end, around,
    )  # fmt: skip
    for j in range(count):
        z[j], w[j] = measured[j], 1.0 / own[j]
    copied(logarithms, end, 0, end.size)
    chi = lowered(shade, derive, seen, box, kept, work, rooms, chi)
    if chi <= critical:
        return chi, 0.0
    copied(logarithms, theta, 0, end.size)
    tau = nearest(
        shade, derive, columns, measured, own, z, w, small, relative, theta, free, lower, upper, f, work, block, spread,
        moves, room, count,
    )  # fmt: skip
    return chi, tau


def fit_pixels(  # type: ignore[no-untyped-def]
    take, shade, derive, unit, levels, count_of_columns, x, y, source, camera, values, u, common, free, lower, upper,
    grid, widths, numbers, critical, every, width, scales, pair, theta, spread, chi, tau, used, start, stop,
):  # fmt: skip
    """Fit pixels `start` to `stop`, one after the other; see `gonio_maps.models.batch.fit`."""
    n, k, r, size = values.shape[1], free.size, common.shape[0], grid.shape[1]
    omega_i, omega_r, packed = np.empty(3 * n), np.empty(3 * n), np.empty(count_of_columns * n)
    z, w, own, at = np.empty(n), np.empty(n), np.empty(n), np.full(n, -1, np.int64)
    of_causes, of_blocks, rows = np.empty(r * n), np.empty(numbers.shape[0] * n, np.int64), np.empty((3, n))
    work, starts, square = np.empty((k + r + 3, n)), np.empty((grid.shape[0], size)), np.empty((3, k, k))
    moves, end, profile = np.empty(k, np.bool_), np.empty(size), np.empty(grid.shape[0])
    whole, shaded_rows = np.empty(grid.shape[0] * n), np.zeros(grid.shape[0], np.int64)
    anew = np.empty(AGAIN, np.int64), np.empty(AGAIN * size), np.empty(AGAIN * n)
    lobes, units, how, before = np.empty(grid.shape[0] * n), grid.copy(), 0, -1
    few_i, few_r, few = np.empty(3 * n), np.empty(3 * n), np.empty(count_of_columns * n)
    few_z, few_w, source_of, camera_of = np.empty(n), np.empty(n), np.empty((3, n)), np.empty((3, n))
    room = room_for(k, r, size, n, by_differences(derive, packed, free, lower, upper))
    for row in range(grid.shape[0]):
        how = unit(units[row])
    columns, relative, block = packed[:0], of_causes[:0].reshape((r, 0)), of_blocks[:0].reshape((numbers.shape[0], 0))
    for p in range(start, stop):
        count, same = taken(values[p], u[p], z, own, w, at)
        used[p] = count
        chi[p], tau[p], theta[p], spread[p] = np.nan, 0.0, np.nan, np.nan
        same = same and count == before
        if not same:
            columns = packed[: count_of_columns * count]
            relative = of_causes[: r * count].reshape((r, count))
            block = of_blocks[: numbers.shape[0] * count].reshape((numbers.shape[0], count))
            gathered(at, count, source, camera, common, numbers, source_of, camera_of, relative, block)
        before = count if count > k else -1
        if count <= k:
            continue
        fresh = not same or x[p] != x[p - 1] or y[p] != y[p - 1]
        if fresh:
            seen_from(x[p], y[p], source_of, camera_of, count, omega_i, omega_r)
            take(omega_i[: 3 * count], omega_r[: 3 * count], lower, columns)
        step = every if count >= FEWEST_OF_SOME * every else 1
        some, some_z, some_w = columns, z[:count], w[:count]
        if step > 1:
            m = (count + step - 1) // step
            some, some_z, some_w = few[: count_of_columns * m], few_z[:m], few_w[:m]
            thinned(z, w, omega_i, omega_r, step, some_z, some_w, few_i, few_r)
            if fresh:
                take(few_i[: 3 * m], few_r[: 3 * m], lower, some)
        if fresh:
            shaded_rows[:] = 0
            shade(some, units.ravel(), grid.shape[0], lobes[: grid.shape[0] * some_z.size])
        seen, box, rooms = (columns, z[:count], w[:count], relative), (free, lower, upper), (room, rows[0, :count])
        kept = square[0], square[1], moves, square[2], end, theta[p], spread[p]
        chi[p] = lowest(
            shade, derive, unit, levels, seen, some_z, some_w, box, kept, work, rooms,
            (how, widths, width, scales, pair), grid, (lobes, units, whole, shaded_rows, anew, starts, profile),
            (rows[1], rows[2]), critical[count],
        )  # fmt: skip
        if chi[p] > critical[count]:
            chi[p], tau[p] = by_logarithms(
                shade, derive, seen, own[:count], box, kept, work, rooms, block, critical[count], chi[p]
            )
    return 0


@functools.cache
def engine():  # type: ignore[no-untyped-def]
    """`fit_pixels`, compiled: half a minute where it is not on the disk."""
    fit_pixels.__name__ = fit_pixels.__qualname__ = f"fit_pixels_{fingerprint(fit_pixels)}"
    return njit(*RESULT.args, **OPTIONS)(fit_pixels)

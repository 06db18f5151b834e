"""Files of measured tables for Mitsuba 3 and for Radiance; each says in words what of it was not measured."""

from pathlib import Path

import numpy as np

from gonio import geometry
from gonio.formats import klems_xml, rgl
from gonio.formats.reader import write_bytes
from gonio.renderers.channels import Rows
from gonio.renderers.interpolated import Interpolated
from gonio.typing import Floats

_NODES = 193
"""Nodes of the half vector's angles: 0.002 degrees apart at the mirror direction, 0.2 at 4 degrees, 0.9 at the horizon.
An odd number of azimuths has the plane of incidence among them."""
_VIEWS = 33
"""Viewing directions at least, even from 0 to 89 degrees; those of the table besides."""
_MOST_VIEWS = 100
_CHECKED = np.deg2rad([0.0, 8.0, 15.0, 30.0, 45.0, 60.0, 75.0])
"""Incidences at which the interpolated table's reflectance is watched."""


def remarks(rows: Rows, interpolated: Interpolated) -> list[str]:
    """What was not measured, how it was interpolated, and what that leads to: a sentence each."""
    said = list(rows.notes)
    listed = ", ".join(f"{t:.3g}" for t in np.rad2deg(interpolated.incidences))
    if interpolated.left_out:
        said.append(f"{interpolated.left_out} rows are left out: fewer than three at their angle of incidence")
    said.append(
        f"measured at theta_i = {listed} degrees; in between linear at the same half vector, beyond as at the nearest"
    )
    share = 100 * interpolated.extrapolated()
    what = "in the plane of incidence alone" if interpolated.in_plane else "in and out of the plane of incidence"
    said.append(
        f"measured {what}: {share:.0f} % of the hemisphere (projected solid angle, mean over these incidences) is"
        " extrapolated"
    )
    said.append(
        "the sample is taken as isotropic; out of plane a value is that of the two in-plane directions of the same"
        " theta_h, linear in the cosine of theta_d"
        + ("" if interpolated.in_plane else ", plus what the values out of plane differ from that")
    )
    narrow = interpolated.unresolved()
    if narrow.size:
        said.append(
            f"the lobe at theta_i = {', '.join(f'{t:.3g}' for t in np.rad2deg(narrow))} degrees is narrower than the"
            " table's step: its height is the table's, its width that of the step, and its flux is not known"
        )
    else:
        peak = [s for s in interpolated.slices if s.line is not None and -s.reach[0] > geometry.AT_MIRROR]
        if peak:
            said.append(
                "at some incidences the mirror direction lies beyond what was measured: the lobe may be missing"
            )
    rho = interpolated.reflectance(_CHECKED).max(axis=1)
    at = ", ".join(f"{r:.3g} at {t:.3g}" for r, t in zip(rho, np.rad2deg(_CHECKED), strict=True))
    said.append(f"rho_dh, the largest of the channels, by theta_i in degrees: {at}")
    if (rho > 1).any():
        worst = int(np.argmax(rho))
        said.append(
            f"WARNING: more is reflected than received: {rho[worst]:.3g} times at"
            f" theta_i = {np.rad2deg(_CHECKED[worst]):.3g} degrees; nothing was scaled down"
        )
    return said


def write_mitsuba(rows: Rows, path: Path) -> list[str]:
    """Write a table for Mitsuba 3's plug-in `measured`, in its RGB variants; what `remarks` says.

    Mitsuba's first direction is the viewer's: a slice is a viewing direction, and the table's receivers are among them.
    So a picture shows f(source, viewer) even of a table that is not reciprocal.
    """
    interpolated = Interpolated(rows)

    def seen(viewer: Floats, source: Floats) -> Floats:
        return np.broadcast_to(interpolated.brdf(source, viewer), (len(source), 3))

    said = remarks(rows, interpolated)
    views = _views(interpolated)
    source, viewer = _vectors(rows)
    both = np.concatenate([viewer, viewer * [1, -1, 1]]), np.concatenate([source, source * [1, -1, 1]])
    given = np.broadcast_to(rows.values, (len(rows.values), 3))
    data = rgl.sliced(
        seen,
        rows.name,
        nodes=_NODES,
        incidences=views,
        remarks="\n".join(said),
        exact=(*both, np.concatenate([given, given])),
    )
    write_bytes(path, data)
    return said


def _vectors(rows: Rows) -> tuple[Floats, Floats]:
    """Unit vectors (n, 3) toward the source and the detector of what was measured, the detector at the azimuth 0."""
    theta_i, theta_r, dphi = rows.angles.T
    return geometry.direction(theta_i, dphi), geometry.direction(theta_r, 0.0 * dphi)


def _views(interpolated: Interpolated) -> Floats:
    """Viewing directions [rad] of the slices: the table's own, and even ones in the gaps between them."""
    even = np.deg2rad(np.linspace(0.0, 89.0, _VIEWS))
    kept = [float(interpolated.receivers[0])]
    for receiver in interpolated.receivers[1:]:  # from the last one that is kept: a fine table is a chain of near ones
        if receiver - kept[-1] > geometry.SAME_ANGLE:
            kept.append(float(receiver))
    own = np.array(kept)
    if own.size > _MOST_VIEWS:
        own = own[np.linspace(0, own.size - 1, _MOST_VIEWS).astype(int)]
    in_gap = np.abs(even[:, np.newaxis] - own).min(axis=1) > 0.4 * (even[1] - even[0])
    keep = in_gap | (even == even[0]) & (own[0] > 1e-3) | (even == even[-1]) & (own[-1] < even[-1])
    return np.unique(np.concatenate([even[keep], own]))


def write_radiance(rows: Rows, path: Path) -> list[str]:
    """Write a table as Klems XML for Radiance's primitive BSDF: averages over patches, of luminance; what was said."""
    interpolated = Interpolated(rows)
    weights = np.array([0.2126, 0.7152, 0.0722]) if interpolated.channels == 3 else np.ones(1)

    def luminance(theta_i: Floats, phi_i: Floats, theta_r: Floats, phi_r: Floats) -> Floats:
        given = np.broadcast_arrays(theta_i, phi_i, theta_r, phi_r)
        shape = given[0].shape
        t_i, p_i, t_r, p_r = (a.ravel() for a in given)
        return (interpolated.brdf(geometry.direction(t_i, p_i), geometry.direction(t_r, p_r)) @ weights).reshape(shape)

    said = remarks(rows, interpolated)
    if interpolated.channels == 3:
        said.append("Radiance's file holds the luminance of the three channels; colour is for a pattern on it")
    said.append("values are averages over pairs of Klems patches, 10 degrees wide: a narrower lobe is spread over one")
    frame = klems_xml.averaged(luminance, rows.name, samples=3)
    frame.attrs["remarks"] = said
    klems_xml.write(frame, path)
    return said


def write(rows: Rows, path: Path, to: str) -> list[str]:
    """Write a table for a renderer; what was not measured of what the file says, a sentence each.

    Parameters
    ----------
    rows
        What was measured.
    path
        The file, of any ending.
    to
        "mitsuba" or "radiance".

    Raises
    ------
    DataError
        The table's directions are scattered: no angle of incidence has three values.
    ConfigError
        The file cannot be written.
    """
    return {"mitsuba": write_mitsuba, "radiance": write_radiance}[to](rows, path)

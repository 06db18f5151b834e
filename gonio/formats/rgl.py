"""RGL's measured BRDFs (`.bsdf`, EPFL; Dupuy & Jakob 2018): an adaptive parameterisation in a `tensor_file` container.

The file holds a microfacet distribution (`ndf`), its projected area (`sigma`), the density of visible normals (`vndf`)
by incidence, and the measured values (`rgb`, or `spectra` by wavelength) on the unit square that the density's
cumulative distribution maps the half vector to. With u_m and u_i the half vector and the incidence on unit squares,

    brdf cos(theta_r) = value(warp(u_m)) ndf(u_m) / (4 sigma(u_i))

Nothing in the file lies on a plane that a goniometer would measure: the table is this interpolation on a grid of 5
degrees in theta_i and theta_r (to 85) and 15 degrees in phi_r; anisotropic materials at eight phi_i. Colours are
samples named "<name> red" and so on, broad bands without stated limits; spectra have wavelengths. A row whose nearest
node the laboratory extrapolated is flagged "extrapolated". There are neither uncertainties nor solid angles.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import geometry
from gonio.errors import DataError
from gonio.formats.reader import Format, table, write_bytes
from gonio.spectra import RGB_NM
from gonio.typing import Array, Bools, DataFrame, Floats, Ints, NDArray

if TYPE_CHECKING:
    from gonio.models import Model

_MAGIC = b"tensor_file\0"
_KINDS = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8"}
_COLOURS = tuple(RGB_NM)
_NODES, _INCIDENCES = 128, 64
_SWEEPS = 30
_MOST_FIELDS, _MOST_DIMENSIONS = 1000, 8
_MOST_VALUES = {"spectra": 2**26, "rgb": 2**26}
_MOST_OTHERS = 2**23
"""Most values of a field by its name, and of others: they are held as doubles, some of them several times."""
_MOST_ROWS = 12_000_000


def tensors(data: bytes, path: Path) -> dict[str, Array]:
    """The arrays of a `tensor_file` by name.

    Raises
    ------
    DataError
        The container is damaged (with the byte offset).
    """
    if data[:12] != _MAGIC or len(data) < 18 or data[12] != 1:
        raise DataError(f"{path}, byte 0: is not a tensor_file of version 1")
    (count,) = struct.unpack_from("<I", data, 14)
    if count > _MOST_FIELDS:
        raise DataError(f"{path}, byte 14: states {count} fields; at most {_MOST_FIELDS} are read")
    out: dict[str, Array] = {}
    at = 18
    for _ in range(count):
        start = at
        try:
            (length,) = struct.unpack_from("<H", data, at)
            name = data[at + 2 : at + 2 + length].decode("latin-1")
            at += 2 + length
            dimensions, kind, offset = struct.unpack_from("<HBQ", data, at)
            at += 11
            if dimensions > _MOST_DIMENSIONS:
                raise DataError(
                    f"{path}, byte {start}: the field {name[:40]!r} has {dimensions} dimensions; at most "
                    f"{_MOST_DIMENSIONS} are read"
                )
            shape = struct.unpack_from(f"<{dimensions}Q", data, at)
            at += 8 * dimensions
        except struct.error:
            raise DataError(f"{path}, byte {start}: the list of fields is cut") from None
        size = math.prod(shape)
        if kind not in _KINDS or size < 1:
            raise DataError(f"{path}, byte {start}: the field {name[:40]!r} has no type or shape of this format")
        dtype = np.dtype(_KINDS[kind])
        if offset + size * dtype.itemsize > len(data):
            raise DataError(f"{path}, byte {start}: the field {name[:40]!r} reaches beyond the end of the file")
        out[name] = np.frombuffer(data, dtype, size, offset).reshape(shape)
    return out


class RglMeasured:
    """An RGL file, to be evaluated at any pair of directions."""

    def __init__(self, data: bytes, path: Path) -> None:
        self.path = path
        fields = tensors(data, path)
        values = "spectra" if "spectra" in fields else "rgb"
        self.wavelengths_nm = self._take(fields, "wavelengths", 1) if values == "spectra" else None
        self.phi_i, self.theta_i = self._take(fields, "phi_i", 1), self._take(fields, "theta_i", 1)
        self.ndf, self.sigma = self._take(fields, "ndf", 2), self._take(fields, "sigma", 2)
        self.vndf, self.values = self._take(fields, "vndf", 4), self._take(fields, values, 5)
        grid = (self.phi_i.size, self.theta_i.size)
        channels = 3 if self.wavelengths_nm is None else self.wavelengths_nm.size
        if channels > 1000:
            raise DataError(f"{path}: the file has {channels} wavelengths; at most 1000 are read")
        if self.vndf.shape[:2] != grid or self.values.shape[:3] != (*grid, channels):
            raise DataError(f"{path}: the shapes of vndf and {values} do not fit phi_i, theta_i and their channels")
        if min(self.ndf.shape + self.sigma.shape + self.vndf.shape[2:] + self.values.shape[3:]) < 2:
            raise DataError(f"{path}: a table of the file has fewer than two nodes along a side")
        for name, axis in (("phi_i", self.phi_i), ("theta_i", self.theta_i)):
            if (np.diff(axis) <= 0).any():
                raise DataError(f"{path}: the nodes of {name} do not grow")
        if (self.vndf < 0).any() or (self.sigma <= 0).any() or (self.ndf < 0).any():
            raise DataError(f"{path}: a density in the file is negative")
        self.isotropic = self.phi_i.size <= 2
        self.cumulative, self.marginal = self._distribution()
        nodes = math.prod(grid) * math.prod(self.values.shape[3:])
        self._require_known(fields)
        valid = fields.get("valid")
        self.valid = None
        if valid is not None:
            if valid.dtype != np.uint8 or valid.size != -(-nodes // 8):
                raise DataError(f"{path}: the field valid has {valid.size} {valid.dtype}; a bit a node is needed")
            bits = np.unpackbits(valid.ravel())[:nodes]
            self.valid = bits.reshape(*grid, *self.values.shape[3:]).astype(bool)
        text = fields.get("description")
        self.name = (
            bytes(text.tobytes()).decode("utf-8", "replace").strip("\0 ")[:80] if text is not None else path.stem
        )

    def _require_known(self, fields: dict[str, Array]) -> None:
        """`DataError` for angles that are not in radians, and for values without the factor of the distribution."""
        for name, axis, limit in (("theta_i", self.theta_i, math.pi / 2), ("phi_i", self.phi_i, 2 * math.pi)):
            if axis[0] < -limit - 1e-3 or axis[-1] > limit + 1e-3 or (name == "theta_i" and axis[0] < -1e-3):
                raise DataError(f"{self.path}: {name} goes from {axis[0]:g} to {axis[-1]:g}; radians are needed")
        jacobian = fields.get("jacobian")
        if jacobian is not None and (jacobian.size != 1 or jacobian.ravel()[0] != 1):
            raise DataError(f"{self.path}: jacobian is not 1: values without the distribution's factor are not read")

    def _take(self, fields: dict[str, Array], name: str, dimensions: int) -> Floats:
        if name not in fields:
            raise DataError(f"{self.path}: the field {name} is missing")
        most = _MOST_VALUES.get(name, _MOST_OTHERS)
        if fields[name].size > most:
            raise DataError(f"{self.path}: the field {name} has {fields[name].size} values; at most {most} are read")
        if fields[name].dtype.kind != "f":
            raise DataError(f"{self.path}: the field {name} holds {fields[name].dtype}; real numbers are needed")
        found = np.asarray(fields[name], dtype=np.float64)
        if found.ndim != dimensions or not np.isfinite(found).all():
            raise DataError(f"{self.path}: the field {name} needs {dimensions} dimensions and finite values")
        return found

    def _distribution(self) -> tuple[Floats, Floats]:
        """Cumulative distributions of the visible normals along x in each row, and along y; they end at one."""
        steps = 0.5 * (self.vndf[..., 1:] + self.vndf[..., :-1])
        rows = np.concatenate([np.zeros((*steps.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)
        totals = 0.5 * (rows[..., 1:, -1] + rows[..., :-1, -1])
        marginal = np.concatenate([np.zeros((*totals.shape[:-1], 1)), np.cumsum(totals, axis=-1)], axis=-1)
        sums = marginal[..., -1]
        if (sums <= 0).any():
            raise DataError(f"{self.path}: the density of visible normals is zero for an incidence")
        self.vndf = self.vndf / sums[..., np.newaxis, np.newaxis]
        return rows / sums[..., np.newaxis, np.newaxis], marginal / sums[..., np.newaxis]

    def brdf(self, theta_i: Floats, phi_i: Floats, theta_r: Floats, phi_r: Floats) -> tuple[Floats, Bools]:
        """BRDF (n, channels) [1/sr] at n pairs of directions [rad], and which of them were measured."""
        incident, outgoing = _vector(theta_i, phi_i), _vector(theta_r, phi_r)
        if not self.isotropic:
            self._into_measured_sector(incident, outgoing)
        half = incident + outgoing
        theta_m = np.arctan2(np.hypot(half[0], half[1]), half[2])
        phi_i, phi_m = np.arctan2(incident[1], incident[0]), np.arctan2(half[1], half[0])
        turn = (phi_m - phi_i if self.isotropic else phi_m) / (2 * np.pi) + 0.5
        u_m = np.sqrt(theta_m * 2 / np.pi), turn - np.floor(turn)
        u_i = np.sqrt(theta_i * 2 / np.pi), phi_i / (2 * np.pi) + 0.5
        slices = self._slices(phi_i, theta_i)
        x, y = self._warp(*u_m, slices)
        values = np.zeros((theta_i.size, self.values.shape[2]))
        for p, t, weight in slices:
            values += weight[:, np.newaxis] * _bilinear(self.values, x, y, lead=(p, t))
        scale = _bilinear(self.ndf, *u_m) / (4 * _bilinear(self.sigma, *u_i) * np.cos(theta_r))
        measured = np.ones(theta_i.size, dtype=bool)
        if self.valid is not None:
            p, t = _nearest(slices)
            height, width = self.valid.shape[2:]
            measured = self.valid[p, t, np.rint(y * (height - 1)).astype(int), np.rint(x * (width - 1)).astype(int)]
        return np.maximum(values, 0.0) * scale[:, np.newaxis], measured

    def _into_measured_sector(self, incident: Floats, outgoing: Floats) -> None:
        """Mirror both directions into the half or quarter of the azimuths that a symmetric sample was measured in."""
        reduction = round(2 * math.pi / float(self.phi_i[-1] - self.phi_i[0]))
        if reduction >= 2:
            flip_y = np.where(incident[1] > 0, -1.0, 1.0)
            flip_x = np.where(incident[0] > 0, -1.0, 1.0) if reduction == 4 else flip_y
            for v in (incident, outgoing):
                v[0] *= flip_x
                v[1] *= flip_y

    def _slices(self, phi: Floats, theta: Floats) -> list[tuple[Ints, Ints, Floats]]:
        """The up to four incidences of the file around each one asked for, and their weights."""
        out = []
        for p, wp in _around(self.phi_i, phi):
            out += [(p, t, wp * wt) for t, wt in _around(self.theta_i, theta)]
        return out

    def _warp(self, u: Floats, v: Floats, slices: list[tuple[Any, Any, Floats]]) -> tuple[Floats, Floats]:
        """From the half vector to the unit square of the values, by the distribution of a bilinear density."""
        height, width = self.vndf.shape[2:]
        column, x = _cell(u, width)
        row, y = _cell(v, height)

        def mix(array: Floats, *index: Any) -> Floats:
            return np.asarray(sum(w * array[(p, t, *index)] for p, t, w in slices))

        left = (1 - y) * mix(self.vndf, row, column) + y * mix(self.vndf, row + 1, column)
        right = (1 - y) * mix(self.vndf, row, column + 1) + y * mix(self.vndf, row + 1, column + 1)
        before = (1 - y) * mix(self.cumulative, row, column) + y * mix(self.cumulative, row + 1, column)
        low, high = mix(self.cumulative, row, width - 1), mix(self.cumulative, row + 1, width - 1)
        whole = (1 - y) * low + y * high
        inside = before + x * (left + 0.5 * x * (right - left))
        out_x = np.divide(inside, whole, out=np.zeros_like(inside), where=whole > 0)
        out_y = mix(self.marginal, row) + y * (low + 0.5 * y * (high - low))
        return np.clip(out_x, 0.0, 1.0), np.clip(out_y, 0.0, 1.0)


def _vector(theta: Floats, phi: Floats) -> Floats:
    return np.moveaxis(geometry.direction(theta, phi), -1, 0)


def _cell(u: Floats, nodes: int) -> tuple[Ints, Floats]:
    position = np.clip(u, 0.0, 1.0) * (nodes - 1)
    index = np.minimum(position.astype(np.intp), nodes - 2)
    return index, position - index


def _around(axis: Floats, value: Floats) -> list[tuple[Ints, Floats]]:
    zero = np.zeros(value.size, dtype=np.intp)
    if axis.size == 1:
        return [(zero, np.ones(value.size))]
    index = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2)
    weight = np.clip((value - axis[index]) / (axis[index + 1] - axis[index]), 0.0, 1.0)
    return [(index, 1 - weight), (index + 1, weight)]


def _nearest(slices: list[tuple[Any, Any, Floats]]) -> tuple[Any, Any]:
    """Of the incidences around each one asked for, the one with the largest weight."""
    best = np.argmax([w for _, _, w in slices], axis=0)
    rows = np.arange(best.size)
    return np.stack([p for p, _, _ in slices])[best, rows], np.stack([t for _, t, _ in slices])[best, rows]


def _bilinear(array: Floats, u: Floats, v: Floats, lead: tuple[Any, Any] | None = None) -> Floats:
    """Bilinear interpolation over the last two axes (v, u); with `lead`, of the slices (p, t, every channel)."""
    column, x = _cell(u, array.shape[-1])
    row, y = _cell(v, array.shape[-2])

    def at(r: Any, c: Any) -> Floats:
        return array[r, c] if lead is None else array[lead[0], lead[1], :, r, c]

    if lead is not None:
        x, y = x[:, np.newaxis], y[:, np.newaxis]
    low = (1 - x) * at(row, column) + x * at(row, column + 1)
    return (1 - y) * low + y * ((1 - x) * at(row + 1, column) + x * at(row + 1, column + 1))


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in an RGL tensor file; `DataError` says what is wrong with the file, and where."""
    measured = RglMeasured(data, path)
    theta = np.arange(0.0, 86.0, 5.0)
    phi_i = np.zeros(1) if measured.isotropic else np.arange(0.0, 360.0, 45.0)
    grid = np.meshgrid(theta, phi_i, theta, np.arange(0.0, 360.0, 15.0), indexing="ij")
    theta_i, phi_in, theta_r, dphi = (a.ravel() for a in grid)
    once = (theta_r > 0) | (dphi == 0)  # the normal is one direction
    theta_i, phi_in, theta_r = theta_i[once], phi_in[once], theta_r[once]
    phi_r = np.mod(phi_in + dphi[once], 360.0)
    channels = measured.values.shape[2]
    if theta_i.size * channels > _MOST_ROWS:
        raise DataError(f"{path}: {theta_i.size} directions of {channels} wavelengths are more than {_MOST_ROWS} rows")
    brdf, valid = measured.brdf(*(np.deg2rad(a) for a in (theta_i, phi_in, theta_r, phi_r)))
    if not np.isfinite(brdf).all():
        raise DataError(f"{path}: the file's tables give values that are not finite")
    nm = measured.wavelengths_nm
    sample = None
    if nm is None:
        names = [f"{measured.name or path.stem} {colour}" for colour in _COLOURS]
        sample = np.repeat(np.array(names, dtype=object), theta_i.size)
    elif (nm <= 0).any():
        raise DataError(f"{path}: a wavelength is not positive")
    flag = np.array(["extrapolated", ""], dtype=object)[np.tile(valid, channels).astype(np.intp)]
    return table(
        theta_i_deg=np.tile(theta_i, channels),
        phi_i_deg=np.tile(phi_in, channels),
        theta_r_deg=np.tile(theta_r, channels),
        phi_r_deg=np.tile(phi_r, channels),
        wavelength_nm=math.nan if nm is None else np.repeat(nm, theta_i.size),
        brdf=brdf.T.ravel(),
        flag=flag,
        sample=sample,
        attrs={
            "source_file": str(path),
            "sample": measured.name or path.stem,
            "bands": [{"name": colour} for colour in _COLOURS] if nm is None else [],
            "notes": [
                "interpolated from the file's adaptive grid by its own formula, at 5 degrees in theta and 15 in phi",
                "the file states no uncertainties and no solid angles",
            ],
        },
    )


def write_model(model: Model, name: str, path: Path) -> None:
    """A model for Mitsuba 3's plug-in `measured`, at the wavelengths of red, green and blue; see `sliced`."""
    waves = np.array(list(RGB_NM.values()))

    def brdf(omega_i: Floats, omega_r: Floats) -> Floats:
        return np.stack([model.brdf_vectors(omega_i, omega_r, wavelength_nm=float(nm)) for nm in waves], axis=-1)

    write_bytes(path, sliced(brdf, name))


def _slices(brdf: Callable[[Floats, Floats], Floats], half: Floats, theta_i: Floats) -> NDArray[np.float32]:
    """brdf cos(theta_r) of three channels at half vectors (3, m, n), for one angle of incidence after another."""
    values = np.zeros((theta_i.size, 3, *half.shape[1:]), np.float32)
    for slice_, theta in zip(values, theta_i.tolist(), strict=True):
        incident = _vector(np.array(theta), np.zeros(()))[:, np.newaxis, np.newaxis]
        outgoing = 2 * (incident * half).sum(axis=0) * half - incident
        above = outgoing[2] > 1e-6
        directions = np.moveaxis(outgoing[:, above], 0, -1)
        f = brdf(np.broadcast_to(incident[:, 0, 0], directions.shape), directions)
        slice_[:, above] = (np.maximum(f, 0.0) * outgoing[2][above, np.newaxis]).T
    return values


def sliced(
    brdf: Callable[[Floats, Floats], Floats],
    name: str,
    *,
    nodes: int = _NODES,
    incidences: int | Floats = _INCIDENCES,
    remarks: str = "",
    exact: tuple[Floats, Floats, Floats] | None = None,
) -> bytes:
    """A BRDF as a file of three channels: brdf cos(theta_r) on the half vector's own grid, without a warp.

    The densities are even, so that a half vector keeps its place on the unit square. With the default numbers there are
    128 polar angles from the normal, close together there (0.006 degrees, then growing to 1.4), 128 azimuths, and 64
    incidences to 89 degrees. Between them a reader interpolates straight.

    Parameters
    ----------
    brdf
        From unit vectors toward the source and the detector, (n, 3) each, to values (n, 3), a column a channel [1/sr].
        The source lies at the azimuth 0: only isotropic BRDFs are told apart by the half vector so.
    name
        The sample's name in the file.
    nodes, incidences
        Nodes of both axes of the half vector (Mitsuba wants as many of both), and of theta_i, or those angles
        themselves [rad]. Twice as many of all leave a quarter of the error, in eight times as large a file.
    remarks
        Words that the file carries in a field of its own, which renderers pass over.
    exact
        Pairs of directions (n, 3), (n, 3) and values (n, 3) there: the nodes around them are moved until a reader's
        straight lines give these back.
    """
    side = np.linspace(0.0, 1.0, nodes)
    theta_m, phi_m = np.meshgrid(np.pi / 2 * side**2, np.pi * (2 * side - 1))
    half = _vector(theta_m, phi_m)
    theta_i = np.linspace(0.0, np.deg2rad(89.0), incidences) if isinstance(incidences, int) else incidences
    values = _slices(brdf, half, theta_i)[np.newaxis]
    if exact is not None:
        _move_nodes(values[0], theta_i, *exact)
    # samples are drawn from this: what a half vector reflects, times the solid angle of its cell
    weight = values.mean(axis=2, dtype=np.float64) * side * np.sin(theta_m)
    words = {"remarks": np.frombuffer(remarks.encode(), np.uint8)} if remarks else {}
    return _pack(
        {
            "description": np.frombuffer(name.encode()[:80] or b"model", np.uint8),
            "phi_i": np.zeros(1, np.float32),
            "theta_i": theta_i.astype(np.float32),
            "ndf": np.ones((2, 2), np.float32),
            "sigma": np.full((2, 2), 0.25, np.float32),
            "vndf": np.ones((1, theta_i.size, 2, 2), np.float32),
            "luminance": np.maximum(weight, 1e-6 * weight.max()).astype(np.float32),
            "rgb": values,
            "jacobian": np.ones(1, np.uint8),
            **words,
        }
    )


def _move_nodes(values: Array, theta_i: Floats, first: Floats, second: Floats, wanted: Floats) -> None:
    """Change nodes (incidences, 3, phi, theta) as little as gives `wanted` back: Kaczmarz, all at once."""
    half = first + second
    theta_m = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    turn = np.arctan2(half[:, 1], half[:, 0]) - np.arctan2(first[:, 1], first[:, 0])
    turn = np.where(np.hypot(first[:, 0], first[:, 1]) < 1e-9, np.arctan2(half[:, 1], half[:, 0]), turn)
    v = turn / (2 * np.pi) + 0.5
    column, x = _cell(np.sqrt(theta_m * 2 / np.pi), values.shape[-1])
    row, y = _cell(v - np.floor(v), values.shape[-2])
    nodes, weights = [], []
    for t, wt in _around(theta_i, np.arccos(np.clip(first[:, 2], -1, 1))):
        for r, wr in ((row, 1 - y), (row + 1, y)):
            for c, wc in ((column, 1 - x), (column + 1, x)):
                nodes.append((t * values.shape[-2] + r) * values.shape[-1] + c)
                weights.append(wt * wr * wc)
    index, weight = np.stack(nodes), np.stack(weights)
    flat = np.moveaxis(values, 1, 0).reshape(3, -1).astype(np.float64)
    goal = (wanted * second[:, 2:3]).T
    count = np.zeros(flat.shape[1])
    np.add.at(count, index, weight)
    share = weight / (weight**2).sum(axis=0) / np.maximum(count[index], 1.0)
    for _ in range(_SWEEPS):
        for channel, step in zip(flat, goal - (flat[:, index] * weight).sum(axis=1), strict=True):
            np.add.at(channel, index, share * step)
        np.maximum(flat, 0.0, out=flat)
    values[:] = np.moveaxis(flat.reshape(3, values.shape[0], *values.shape[2:]), 0, 1)


def _pack(fields: dict[str, Array]) -> bytes:
    """A `tensor_file` of these arrays, each aligned to 8 bytes."""
    codes = {np.dtype(kind): code for code, kind in _KINDS.items()}
    at = 18 + sum(13 + len(key) + 8 * array.ndim for key, array in fields.items())
    head, body = [_MAGIC, b"\1\0", struct.pack("<I", len(fields))], []
    for key, array in fields.items():
        gap = -at % 8
        head.append(struct.pack("<H", len(key)) + key.encode())
        head.append(struct.pack(f"<HBQ{array.ndim}Q", array.ndim, codes[array.dtype], at + gap, *array.shape))
        body += [bytes(gap), array.tobytes()]
        at += gap + array.nbytes
    return b"".join(head + body)


FORMAT = Format(
    name="rgl",
    title="RGL adaptive BSDF",
    endings=(".bsdf",),
    sniff=lambda head: head.startswith(_MAGIC),
    read=read,
    write_model=write_model,
)

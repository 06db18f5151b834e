"""A whole file format: lines of four angles, wavelength and BRDF (docs/formats.md)."""

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, single, table, write_lines

HEAD = "# bench 1"
COLUMNS = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "brdf"]


def read(data, path):
    rows = []
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        if line and not line.startswith("#"):
            try:
                values = [float(cell) for cell in line.split()]
            except ValueError as error:
                raise DataError(f"{path}, line {number}: {error}") from None
            if len(values) != len(COLUMNS):
                raise DataError(f"{path}, line {number}: {len(values)} numbers, and not {len(COLUMNS)}")
            rows.append(values)
    if not rows:
        raise DataError(f"{path}: has no values")
    theta_i, phi_i, theta_r, phi_r, wavelength, brdf = np.array(rows).T
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=wavelength,
        brdf=brdf,
        attrs={"source_file": str(path), "sample": path.stem},
    )


def write(frame, path):
    single(frame, path, "a bench file")
    rows = frame.loc[frame["flag"] == "", COLUMNS].to_numpy().tolist()
    write_lines(path, [HEAD, *(" ".join(map(repr, row)) for row in rows)])


FORMAT = Format(
    name="bench",
    title="bench file",
    endings=(".bench",),
    sniff=lambda head: head.startswith(HEAD.encode()),
    read=read,
    write=write,
)

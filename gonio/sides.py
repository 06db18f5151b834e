"""The sides of a sample in a measurement table: what is reflected, and what is transmitted."""

from gonio.typing import DataFrame


def reflection(frame: DataFrame) -> DataFrame:
    """The rows of reflection; a note says how many of transmission are left out."""
    if "side" not in frame.columns:
        return frame
    kept, left = _of_side(frame, "reflection")
    if left:
        kept.attrs["notes"] = [*kept.attrs.get("notes", ()), f"{left} rows of transmission are left out"]
    return kept


def transmission(frame: DataFrame) -> DataFrame | None:
    """The rows of transmission; None where there are none."""
    if "side" not in frame.columns or not (frame["side"] == "transmission").any():
        return None
    return _of_side(frame, "transmission")[0].assign(side="transmission")


def turned_over(frame: DataFrame) -> DataFrame:
    """Transmission as if it were reflection: directions toward the detector mirrored at the sample's plane.

    theta_r becomes 180 - theta_r, the angle from the normal of the back, so that whatever integrates, interpolates or
    plots over a hemisphere serves for both. Straight through becomes the mirror direction.
    """
    if "side" not in frame.columns:
        return frame
    behind = frame["side"] == "transmission"
    out = frame.drop(columns="side")
    out["theta_r_deg"] = frame["theta_r_deg"].where(~behind, 180.0 - frame["theta_r_deg"])
    return out


def _of_side(frame: DataFrame, side: str) -> tuple[DataFrame, int]:
    """The rows of one side without the column, and how many others there are."""
    here = frame["side"] == side
    out = frame[here].drop(columns="side").reset_index(drop=True)
    out.attrs = {**frame.attrs, "quantity": "brdf" if side == "reflection" else "btdf"}
    return out, int((~here).sum())

"""Samples that are the channels red, green and blue of one, as files in colour have them."""

from collections.abc import Iterable, Mapping

from gonio.spectra import RGB_NM
from gonio.typing import DataFrame

_NOTE = (
    "The samples red, green and blue are the channels of one: broad bands, which stand at nominal wavelengths"
    f" ({', '.join(f'{RGB_NM[colour]:g}' for colour in RGB_NM)} nm)."
)


def is_joined(table: DataFrame) -> bool:
    """Whether a table was made of three channels by `joined`."""
    return bool(table.attrs.get("channels"))


def incomplete(names: Iterable[str], of: str) -> str:
    """What is said of samples named as channels of one, of which some are missing; "" where there is no such sample.

    `of` is the file, for the words to write.
    """
    parts: dict[str, list[str]] = {}
    for name in names:
        stem, _, colour = name.rpartition(" ")
        if colour in RGB_NM:
            parts.setdefault(stem, []).append(colour)
    for stem, there in parts.items():
        missing = [colour for colour in RGB_NM if colour not in there]
        if missing and len(there) > 1:
            whole = f"{stem} {missing[0]}".strip()
            return (
                f"{stem or 'the sample'} has the channels {' and '.join(there)} and no {missing[0]}, and a colour "
                f'needs all three: add the sample "{whole}", or take one channel alone, as '
                f'"{of}:{f"{stem} {there[0]}".strip()}"'
            )
    return ""


def joined(samples: Mapping[str, DataFrame]) -> dict[str, DataFrame]:
    """Tables by sample; "paint red", "paint green" and "paint blue" become one, "paint", with a wavelength a channel.

    Parameters
    ----------
    samples
        Tables by the names of their samples. Channels are broad bands without a wavelength; other tables stay as they
        are, and so do channels beside a sample of the name that they would have.

    Returns
    -------
    dict
        A joined table has the nominal wavelengths `gonio.spectra.RGB_NM`, and the names of its channels in
        `attrs["channels"]`.
    """
    import pandas as pd

    def whole(name: str) -> dict[str, str]:
        """The names of the three channels that a sample belongs with, by colour; none where one of them is missing."""
        stem, _, colour = name.rpartition(" ")
        names = {c: f"{stem} {c}".strip() for c in RGB_NM}
        if colour not in RGB_NM or stem in samples or any(n not in samples for n in names.values()):
            return {}
        return names if all(samples[n]["wavelength_nm"].isna().all() for n in names.values()) else {}

    out = dict[str, DataFrame]()
    for name, table in samples.items():
        channels = whole(name)
        stem = name.rpartition(" ")[0] or "colour"
        if not channels:
            out[name] = table
        elif stem not in out:
            parts = [samples[channels[colour]].assign(wavelength_nm=nm) for colour, nm in RGB_NM.items()]
            one = pd.concat(parts, ignore_index=True)
            one.attrs = dict(table.attrs)
            one.attrs["sample"], one.attrs["channels"] = stem, list(RGB_NM)
            one.attrs["bands"] = [{"name": colour, "centre_nm": nm} for colour, nm in RGB_NM.items()]
            one.attrs["notes"] = [*(table.attrs.get("notes") or []), _NOTE]
            out[stem] = one
    if part := incomplete(out, "FILE"):
        for name in [name for name in out if name.rpartition(" ")[2] in RGB_NM]:
            out[name] = out[name].copy(deep=False)
            out[name].attrs = samples[name].attrs | {"notes": [*(samples[name].attrs.get("notes") or []), part]}
    return out

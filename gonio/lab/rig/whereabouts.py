"""Where the axes of a rig stand after it was left, and whether they hold: read back from the devices, never assumed."""

from collections.abc import Callable, Iterable

from gonio.lab.rig import clock
from gonio.lab.rig.health import Health
from gonio.lab.rig.protocols import Rig

AT_REST_S = 4.0
"""A stopped axis stands still by then."""
LOOK_S = 0.1


def left(rig: Rig, otherwise: str) -> str:
    """What is true of a rig that has been left: its lamp, and where every axis stands, as its driver reads them back.

    Parameters
    ----------
    rig
        Has been left.
    otherwise
        What is said of a rig whose driver has no `left`: that it did what every rig promises.
    """
    told: Callable[[], str] | None = getattr(rig, "left", None)
    return (told() if told is not None else "") or otherwise


def axes_stand(look: Callable[[], Health], names: Iterable[str]) -> str:
    """Where axes stand once they are at rest, and whether they hold; `look` reads them anew."""
    health, before, end = look(), None, clock.monotonic() + AT_REST_S
    while health.readings and clock.monotonic() < end and (_moves(health) or _angles(health) != before):
        before = _angles(health)  # a servo that was stopped at speed overshoots, and comes back
        clock.sleep(LOOK_S)
        health = look()
    if not health.readings:
        return f"where the axes stand is not known: {'; '.join(dict.fromkeys(health.silent.values()))}"
    said = []
    for name in names:
        angle, torque = health.of(name, "angle"), health.of(name, "torque")
        if isinstance(angle, float):
            held = "" if torque is None else ", holds" if torque == "holds" else ", torque off"
            held += ", and moves still" if health.of(name, "motion") == "moves" else ""
            said.append(f"{name} {angle:.2f} deg{held}")
        else:
            said.append(f"{name} not known ({health.silent.get(name, 'no answer')})")
    return "the axes stand now: " + "; ".join(said)


def _moves(health: Health) -> bool:
    return any(r.quantity == "motion" and r.value == "moves" for r in health.readings)


def _angles(health: Health) -> dict[str, int]:
    """Angles in tenths of a degree, so that a flickering encoder stands still."""
    found = (r for r in health.readings if r.quantity == "angle")
    return {r.device: round(10 * float(r.value)) for r in found}

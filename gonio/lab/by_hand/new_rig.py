"""A rig file for devices that are plugged in: what can be found out is, the rest is asked, each value with its comment.

The file that the driver ships is the form that is filled in, so that its comments stand beside the values.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from gonio.config import parse
from gonio.errors import ConfigError, DeviceError
from gonio.lab.acquisition.measure import RigChoice
from gonio.lab.rig import FoundServo, RigDiscovery, RigPlugin, RigService
from gonio.lab.rig.description import RigDescription
from gonio.typing import TomlTable

Check = Callable[[str], Any]
"""What an answer means; raises `ValueError` that says what is wrong with it, and how it should be."""
ARMS = ("light", "camera")
TURNED = (*ARMS, "tilt", "spin", "changer", "azimuth", "none")
COUNTS = 4096
TIMES = 20
"""Wrong answers to one question after which the command gives up."""


class DriverPlugin(RigPlugin, RigService, RigDiscovery, Protocol):
    """What a wizard needs of a driver."""


@dataclass(slots=True)
class Person:
    """Asks at a terminal, and again where an answer is no good."""

    ask: Callable[[str], str]
    """Shows a prompt and gives the line that was typed; raises `EOFError` at the end of the input."""
    say: Callable[[str], None]

    def about(self, key: str, text: str, default: str | None, check: Check) -> Any:
        """The answer to one question, as `check` understands it."""
        shown = f"{text} [{default}]: " if default is not None else f"{text}: "
        for _ in range(TIMES):
            try:
                answer = self.ask(shown).strip() or (default or "")
            except EOFError:
                raise ConfigError(f"{key}: no answer came; nothing is written (--answers FILE gives all)") from None
            try:
                return check(answer)
            except ValueError as error:
                self.say(f'  "{answer}" {error}')
        raise ConfigError(f"{key}: {TIMES} answers that are none; nothing is written")

    def done(self) -> None:
        """Nothing is left over."""


@dataclass(slots=True)
class Answers:
    """Answers from a TOML file, by the key of the question; what is missing is answered by its default."""

    path: Path
    values: TomlTable
    used: set[str] = field(default_factory=set)

    def about(self, key: str, text: str, default: str | None, check: Check) -> Any:
        """The answer to one question, as `check` understands it."""
        self.used.add(key)
        answer = self.values.get(key, default)
        if answer is None:
            raise ConfigError(f'{self.path}: {key} is missing: "{text}" has no usual answer')
        answer = {True: "yes", False: "no"}.get(answer, str(answer)) if isinstance(answer, bool) else str(answer)
        try:
            return check(answer)
        except ValueError as error:
            raise ConfigError(f'{self.path}: {key} = "{answer}" {error}') from None

    def done(self) -> None:
        """Raise `ConfigError` where the file answers what nobody asked."""
        left = [key for key in self.values if key not in self.used]
        if left:
            raise ConfigError(
                f"{self.path}: {left[0]}: nothing of that name is asked; asked: {', '.join(sorted(self.used))}"
            )


# ---- what an answer may be ----


def positive(text: str) -> float:
    """A number above 0."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError("is no number; write it like 1000 or 0.5") from None
    if not (math.isfinite(value) and value > 0):
        raise ValueError("must be a number above 0")
    return value


def whole(low: int, high: int) -> Check:
    """A whole number."""

    def check(text: str) -> int:
        if not text.lstrip("+-").isdigit() or not low <= int(text) <= high:
            raise ValueError(f"must be a whole number from {low} to {high}")
        return int(text)

    return check


def fraction(text: str) -> float:
    """From 0 to 1, 0 excluded."""
    value = positive(text)
    if value > 1:
        raise ValueError("must be a fraction from 0 to 1")
    return value


def one_of(*words: str) -> Check:
    """One of some words."""

    def check(text: str) -> str:
        if text.lower() not in words:
            raise ValueError(f"is none of {', '.join(words)}")
        return text.lower()

    return check


def yes(text: str) -> bool:
    """Yes or no."""
    if text.lower() not in ("y", "yes", "n", "no"):
        raise ValueError("must be yes or no")
    return text.lower().startswith("y")


def some(text: str) -> str:
    """Any text that is not empty."""
    if not text or any(ord(c) < 32 for c in text):
        raise ValueError("is empty, or holds no plain text")
    return text


def port(text: str) -> str:
    """A port that is there."""
    if not some(text).startswith("COM") and "://" not in text and not Path(text).exists():
        raise ValueError("is no port that is there; plug it in, or write its name as /dev/serial/by-id shows it")
    return text


def angles(text: str) -> list[float]:
    """Lower and upper limit [deg]."""
    try:
        low, high = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise ValueError("must be two angles, lower and upper, like -95 95") from None
    if not -360 <= low < high <= 360:
        raise ValueError("must be two angles with the lower one first, within -360 to 360 deg")
    return [low, high]


def bands(text: str) -> list[TomlTable] | None:
    """None for a tunable source; else centre and width of each band [nm]."""
    if text.lower() == "tunable":
        return None
    out = []
    for part in text.split(","):
        try:
            centre, width = (positive(word) for word in part.split())
        except ValueError:
            raise ValueError('must be "tunable", or centre and width of each band in nm, like 450 20, 550 25') from None
        out.append({"name": f"{centre:g} nm", "centre_nm": centre, "fwhm_nm": width})
    return out


# ---- the wizard ----


@dataclass(slots=True)
class PortsFound:
    """What hangs at the ports."""

    servos: list[FoundServo] = field(default_factory=list)
    lamps: list[tuple[str, str, str]] = field(default_factory=list)
    """Port, dialect, what it calls itself."""
    releases: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    """Of ports that could not be asked, or at which something answers that is of no use."""


def look(plugin: DriverPlugin, ports: Sequence[str], say: Callable[[str], None]) -> PortsFound:
    """Ask at every port who is there. Nothing is lit, moved or exposed by it."""
    found = PortsFound()
    for name in ports:
        say(f"{name}: who is there?")
        try:
            if (lamp := plugin.lamp_on(name)) is not None:  # some answer ERR to what they do not know, as a box does
                found.lamps.append((name, *lamp))
                said = f'a lamp, "{lamp[1]}", dialect {lamp[0]}'
            elif plugin.is_release(name):
                found.releases.append(name)
                said = "a release box"
            elif servos := plugin.servos(name, lambda text: None):
                found.servos += servos
                said = "servos: " + ", ".join(f"id {s.id} ({s.model}, {s.baud} baud)" for s in servos)
            else:
                said = "nobody that is known here"
        except DeviceError as error:
            said = str(error)
            found.failures.append(f"{name}: {said}")
        say(f"  {said}")
    return found


def make(
    plugin: DriverPlugin, person: Person | Answers, say: Callable[[str], None], *, ports: Sequence[str] = ()
) -> tuple[str, RigDescription]:
    """The text of a new rig file, and what it says.

    Parameters
    ----------
    plugin
        The driver; its shipped file is the form.
    person
        Who answers.
    say
        Hears what was found, and what is done.
    ports
        To look at, instead of all that this computer has.

    Raises
    ------
    ConfigError
        An answer in a file is wrong, or the answers make no rig file.
    """
    import tomlkit

    form: Any = tomlkit.parse(plugin.toml)
    ask = person.about
    form["name"] = ask("name", "A name for the rig", "my goniometer", some)
    say("Looking at the ports. Nothing is lit or moved by it; servos are sought at every line speed.")
    found = look(plugin, ports or plugin.ports(), say)
    _servos(plugin, person, say, form, found)
    _lamp(person, form, found)
    _camera(person, form, found)
    _geometry(person, form)
    _reference(person, form)
    asked = (
        "A file that tells a robot, or the twins of gonio sim serve, what to put into the holder (none: a person does)"
    )
    target = ask("target_file", asked, "none", some)
    if target != "none":
        form["devices"]["holder"] = {"target_file": target}
    person.done()
    text = tomlkit.dumps(form)
    body = text[text.index("\n\n") + 2 :]  # the shipped file's own heading goes
    text = (
        "# Written by `gonio rig new`. Next: gonio rig check, then gonio rig align, both with --rig and this file.\n"
        "# Angles are in degrees, lengths in millimetres, from the centre of the sample.\n\n" + body
    )
    description = parse(RigDescription, tomlkit.parse(text).unwrap(), "the new rig file")
    # checks the table [devices], and touches nothing; a video camera has no response yet
    new = RigChoice(plugin, description, "the new rig file")
    new.open(by_hand=form["devices"]["camera"]["driver"].startswith("uvc"))
    return text, description


def _servos(
    plugin: DriverPlugin, person: Person | Answers, say: Callable[[str], None], form: Any, found: PortsFound
) -> None:
    ask, table, servos = person.about, form["devices"]["servos"], found.servos
    at = sorted({(s.port, s.baud) for s in servos})
    if not servos and found.failures:
        raise ConfigError("no servo was found; " + "; ".join(found.failures))
    if not servos:
        raise ConfigError(
            "no servo answers on any port at any line speed: is their supply on, the cable in, and the port free? "
            "--port names a port that is not listed"
        )
    if len(at) > 1:
        said = ", ".join(f"{where} at {baud} baud" for where, baud in at)
        raise ConfigError(
            f"servos answer in more than one place ({said}): all need one port and one speed; gonio rig ids --set-baud"
        )
    shared = next((s for s in servos if not s.alone), None)
    if shared is not None:
        raise ConfigError(
            f"two servos answer to id {shared.id}: connect one at a time and give each its own (gonio rig ids --set-id)"
        )
    table["port"], table["baud"] = at[0]
    may = ask("wiggle", "May each servo turn by 3 degrees and back, slowly? Hold the arms clear (yes, no)", "yes", yes)
    for _ in range(TIMES):
        axes = _axes(plugin, person, say, servos, may=may)
        missing = [name for name in ARMS if name not in axes]
        if not missing:
            break
        if isinstance(person, Answers):
            raise ConfigError(f'{person.path}: no servo turns the axis {missing[0]}: give servo_ID = "{missing[0]}"')
        say(f"No servo turns the axis {missing[0]}. Once more, from the first servo:")
    else:
        raise ConfigError("no servo was said to turn light or camera; nothing is written")
    form["holder"]["axes"] = [name for name in ("tilt", "spin") if name in axes]
    for name in {"tilt", "spin"} - set(axes):
        table["axes"].pop(name, None)
    if "changer" not in axes:
        table.pop("changer", None)
    for name, (servo, direction, zero) in axes.items():
        place = table["changer"] if name == "changer" else table["axes"].setdefault(name, {})
        place.update({"id": servo.id, "model": servo.model, "direction": direction, "zero_count": zero})
    for name in (n for n in (*ARMS, "azimuth") if n in axes):
        usual = "-170 170" if name == "azimuth" else "-95 95"
        text = f"How far may the axis {name} turn without touching anything [deg]; arms beyond +-92 can face each other"
        arm = form["arms"].setdefault(name, {})
        limits = ask(f"{name}_limits_deg", text, usual, angles)
        arm.update({"limits_deg": limits, "zero_offset_known": False})
        place = table["axes"][name]
        if "park_deg" in place and not limits[0] <= place["park_deg"] <= limits[1]:
            del place["park_deg"]
    if form["holder"]["axes"]:
        form["holder"]["zero_offset_known"] = False


def _axes(
    plugin: DriverPlugin, person: Person | Answers, say: Callable[[str], None], servos: list[FoundServo], *, may: bool
) -> dict[str, tuple[FoundServo, int, int]]:
    """By axis: its servo, which way it turns, and the count of its zero."""
    out: dict[str, tuple[FoundServo, int, int]] = {}
    for servo in servos:
        if may:
            say(f"servo id {servo.id} turns by 3 degrees now, and back")
            try:
                plugin.wiggle(servo)
            except DeviceError as error:
                say(f"  {error}")
        left = [name for name in TURNED if name not in out]

        def free(text: str, left: list[str] = left) -> str:
            word: str = one_of(*TURNED)(text)
            if word not in left:
                raise ValueError(f"has a servo already; left: {', '.join(left)}")
            return word

        text = f"Which axis does servo id {servo.id} turn ({', '.join(left)})"
        axis = person.about(f"servo_{servo.id}", text, left[0], free)
        if axis == "none":
            continue
        up = person.about(f"forward_{servo.id}", "Did it turn toward positive angles first (yes, no)", "yes", yes)
        text = 'Its count at 0 deg; or turn it to 0 deg by hand, by eye, and say "here"'
        zero = person.about(f"zero_{servo.id}", text, "2048", lambda t: t if t == "here" else whole(0, COUNTS - 1)(t))
        out[axis] = servo, 1 if up else -1, plugin.count_of(servo) if zero == "here" else zero
    return out


def _lamp(person: Person | Answers, form: Any, found: PortsFound) -> None:
    ask, table = person.about, form["devices"]["light"]
    first = found.lamps[0] if found.lamps else None
    where = ask("lamp_port", "Port of the lamp", first[0] if first else None, port)
    spoken = next((lamp[1] for lamp in found.lamps if lamp[0] == where), None)
    text = "Its dialect: scpi, mightex, arduino, or a .toml file of your own"
    table["port"], table["dialect"] = where, ask("lamp_dialect", text, spoken or "scpi", some)
    table["level"] = ask("lamp_level", "How bright, as a fraction of its largest output", "0.8", fraction)
    usual = ", ".join(f"{b['centre_nm']:g} {b['fwhm_nm']:g}" for b in form["bands"].get("list", ())) or "tunable"
    listed = ask("bands", 'Its bands: "tunable", or centre and width of each in nm (450 20, 550 25)', usual, bands)
    if listed is not None:
        form["bands"] = {"list": listed}


def _camera(person: Person | Answers, form: Any, found: PortsFound) -> None:
    ask, camera = person.about, form["camera"]
    text = "The camera: folder (tethered, RAW files), uvc, or another driver's name"
    usual = form["devices"]["camera"]["driver"]
    driver = ask("camera_driver", text, usual, some)
    if driver != usual:
        form["devices"]["camera"] = {"driver": driver}
    if driver == "folder":
        _tethered(person, form["devices"]["camera"], found)
    if driver.startswith("uvc"):
        text = "The device of the video camera"
        form["devices"]["camera"]["device"] = ask("camera_device", text, "/dev/video0", some)
    for key, text, check in (
        ("width", "Columns of its frames [pixels]", whole(32, 8192)),
        ("height", "Rows of its frames [pixels]", whole(32, 8192)),
        ("pixel_um", "Pitch of its pixels [um]", positive),
        ("focal_length_mm", "Focal length [mm]", positive),
    ):
        camera[key] = ask(key, text, str(camera[key]), check)


def _tethered(person: Person | Answers, table: Any, found: PortsFound) -> None:
    """A camera whose files come into a folder, and who releases it."""
    ask = person.about
    table["folder"] = ask("camera_folder", "The folder that its files come into", "frames-from-camera", some)
    usual = "serial" if found.releases else "none"
    ways = one_of("serial", "command", "none")
    how = ask("trigger", "Who releases it: serial (a box), command, none", usual, ways)
    trigger: TomlTable = {"how": how}
    if how == "serial":
        box = found.releases[0] if found.releases else None
        trigger["port"] = ask("release_port", "Port of the release box", box, port)
    elif how == "command":
        text = "The command, with {exposure_s} and {folder} where they belong"
        trigger["command"] = ask("trigger_command", text, None, some).split()
    table["trigger"] = trigger


def _geometry(person: Person | Answers, form: Any) -> None:
    ask, table = person.about, form["geometry"]
    disc, opening = (
        f"{2.0 * table[distance] * math.tan(math.radians(half)):.1f}"
        for distance, half in (
            ("light_distance_mm", form["lamp"]["half_angle_deg"]),
            ("camera_distance_mm", form["camera"]["lens_half_angle_deg"]),
        )
    )
    for name, what in (("light", "lamp"), ("camera", "lens")):
        text = f"Distance from the sample's centre to the {what} [mm]"
        table[f"{name}_distance_mm"] = ask(f"{name}_distance_mm", text, None, positive)
    for name, what in (("light", "lamp's housing"), ("camera", "camera")):
        key, text = f"{name}_body_radius_mm", f"Radius of the {what} [mm]"
        table[key] = ask(key, text, str(table[key]), positive)
    lamp = ask("lamp_diameter_mm", "Diameter of the lamp's bright disc [mm]", disc, positive)
    pupil = ask("aperture_mm", "Diameter of the lens's aperture: focal length / f-number [mm]", opening, positive)
    form["lamp"]["half_angle_deg"] = _half_angle(lamp, table["light_distance_mm"])
    form["camera"]["lens_half_angle_deg"] = _half_angle(pupil, table["camera_distance_mm"])


def _half_angle(diameter: float, distance: float) -> float:
    return round(math.degrees(math.atan(0.5 * diameter / distance)), 4)


def _reference(person: Person | Answers, form: Any) -> None:
    ask, table = person.about, form["reference"]
    if "changer" in form["devices"]["servos"]:
        table["how"] = "axis"
        changer = form["devices"]["servos"]["changer"]
        for what, usual in (("sample", "0"), ("reference", "60")):
            text = f"Where the changer stands for the {what} [deg]"
            changer[f"{what}_deg"] = ask(f"changer_{what}_deg", text, usual, _angle)
    else:
        text = "The white reference: swap (by hand), or beside (the sample, in the frame)"
        table["how"] = ask("reference", text, "swap", one_of("swap", "beside"))
        if table["how"] == "beside":
            table["offset_mm"] = [
                ask(f"reference_{n}_mm", f"Its centre in the sample's {n} [mm]", None, _angle) for n in "xy"
            ]
    table["albedo"] = ask(
        "reference_albedo", "Its reflectance, by its certificate (0 to 1)", str(table["albedo"]), fraction
    )
    table["u_rel"] = ask(
        "reference_u_rel", "Relative standard uncertainty of that", str(max(table["u_rel"], 0.005)), fraction
    )


def _angle(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError("is no number") from None
    if not abs(value) <= 1000:
        raise ValueError("must be a finite number")
    return value

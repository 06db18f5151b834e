"""A lamp on a serial port: one driver, and the language of its controller as data.

Nothing is believed that was not read back: every setting is followed by its query, and the lamp counts as dark or lit
only when its controller says so. It is darkened when the port is opened, when it is left, and after every failure;
`guard` darkens it when the program is killed, or shows no sign of life.
"""

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import Self

from gonio.errors import ConfigError, DeviceError, Disturbed, GonioError, Interrupted, PassingFault
from gonio.lab.rig import clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio_drivers import guard, log, ports, settings
from gonio_drivers.lamp_line import TRIES, LampLine, dialect
from gonio_drivers.patience import Patience

WAVELENGTH_STEP_NM = 0.1
GUARD_S = 10.0
"""The guard of a program that has died is done by then."""
STILL_S = 55.0
"""The guard darkens so long after the last sign of life of this program, beside what it was expected to wait for; on a
busy computer too the lamp is dark after the 60 s that docs/lab_setup.md states."""
TOLD_S = 10.0
"""A person is told of a warm-up from this length on."""
LOOK_S = 0.1
"""How often it is asked, in a longer wait, whether the lamp may still shine."""


class LampReset(Disturbed):
    """The lamp was not in the state that it was meant to be in."""


class SerialLight:
    """A lamp, as a `LightDevice`; dark whenever it is not asked to shine.

    Parameters
    ----------
    description
        The rig: its bands, and the lamp's warm-up time.
    light
        Port, dialect, level, channels.
    """

    def __init__(self, description: RigDescription, light: settings.Light) -> None:
        self._light = light
        self._usual = light.level
        self._dialect = dialect(light.dialect)
        self._bands = description.bands.all()
        self._warm_up_s = description.lamp.warm_up_s
        self._line = LampLine(light.port, self._dialect)
        self._guard: guard.Guard | None = None
        self.limit_s = 0.0
        """Time after opening [s] at which the guard darkens the lamp, even if this program stands still; 0: `STILL_S`
        after its last sign of life."""
        self._channel = light.channel
        self._band: Band | None = None
        self._monitored: float | None = None
        self._warmed = False
        self.identity = ""
        self.lit = False
        """Whether the lamp is meant to shine."""
        self.known_dark = False
        """Its controller has said that it is dark, and nothing has lit it since."""
        self.allowed: Callable[[], None] = lambda: None
        """Called before the lamp lights up; raises where it may not."""
        for name in light.channels:
            if name not in {band.name for band in self._bands}:
                known = ", ".join(band.name for band in self._bands[:8])
                raise ConfigError(f'devices.light.channels."{name}": the rig has no such band; it has {known}')

    def __enter__(self) -> Self:
        self.known_dark = False
        self._open()
        try:
            self._wake()
            self.off()
            orders = self._orders_to_darken()
            watching = guard.Guard(self._light.port, self._baud, orders, self.limit_s, self.darken_at_once)
            try:
                watching.start()
            except OSError as error:
                raise DeviceError(f"{self._no_guard}: {error}") from None
            self._guard = watching
        except BaseException as error:
            if isinstance(error, Interrupted) or not isinstance(error, GonioError):
                # a lamp that was found lit is darkened, whoever interrupts this
                with contextlib.suppress(GonioError):
                    self.off()
            self._close(in_order=self.known_dark)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.off()
        finally:
            self._close(in_order=self.known_dark)

    @contextlib.contextmanager
    def looked_at(self) -> Iterator[None]:
        """Opened to be asked, and left as it is: nothing is lit or darkened, and nobody guards it."""
        self._open()
        try:
            self._wake()
            yield
        finally:
            self._line.close()

    # ---- LightDevice ----

    def select(self, band: Band) -> None:
        """Choose the spectral band: a wavelength, or the channel of its emitter."""
        if band not in self._bands:
            raise ConfigError(f'the rig has no band "{band.name}"')
        if band == self._band:
            return
        channel = self._light.channels.get(band.name, self._light.channel)
        d = self._dialect
        if channel != self._channel and self.lit:
            self._off()
            self._channel = channel
            self._shine()
            clock.sleep(self._light.settle_s)
        self._channel = channel
        if d.select is not None and d.selected is not None:
            command = d.select.format(wavelength_nm=band.centre_nm, channel=channel)
            self._set(command, d.selected, d.selected_got, band.centre_nm, WAVELENGTH_STEP_NM)
            if self.lit:
                clock.sleep(self._light.settle_s)
        self._band = band

    def on(self) -> None:
        """Light up at the level of the rig file, and wait until the lamp has settled."""
        try:
            self._shine()
            self._settle()
        except BaseException:
            self.off()
            raise

    def off(self) -> None:
        """Darken.

        Raises
        ------
        DeviceError
            The controller does not say that the lamp is dark.
        """
        self.lit = self.known_dark = False
        try:
            self._off()
            self.known_dark = True
            if self._guard is not None:
                self._guard.rest()
        except DeviceError as failure:
            raise DeviceError(f"{failure}; the lamp may still be lit: switch it off by hand") from None

    def check(self) -> None:
        """Ask the controller whether the lamp is as it is meant to be; light it again where it has gone dark.

        Raises
        ------
        LampReset
            It was not; what has been exposed since the last look is worth nothing.
        DeviceError
            As of `require_time`.
        """
        d = self._dialect
        self.require_time()
        answer = self._ask_state(self._channel)
        as_meant = re.fullmatch(d.state_on if self.lit else d.state_off, answer) is not None
        if as_meant and (not self.lit or (self._level_kept() and self._band_kept())):
            return
        if not self.lit:
            self.off()
            raise LampReset("the lamp was lit when it should have been dark; darkened")
        band, self._band = self._band, None
        if band is not None:
            self.select(band)
        self._shine()
        log.warning("lamp on %s: it has gone dark, or lost its settings, by itself; lit again", self._light.port)
        clock.sleep(self._light.settle_s)
        raise LampReset("the lamp went dark, or lost its settings, by itself")

    def dim(self, level: float | None) -> None:
        """Shine at another level (above 0, at most 1) than the rig file's, from the next `on`; None: the file's."""
        self._light = self._light.model_copy(update={"level": self._usual if level is None else level})

    def state(self) -> tuple[bool, float]:
        """Whether the controller says that it is lit (a channel of several is enough), and its level from 0 to 1."""
        d = self._dialect
        lit = False
        for channel in self._channels_to_darken():
            answer = self._ask_state(channel)
            if not re.fullmatch(f"{d.state_on}|{d.state_off}", answer):
                raise DeviceError(f'the lamp on {self._light.port} says of its state: "{answer}"; is it lit or dark?')
            lit = lit or re.fullmatch(d.state_on, answer) is not None
        return lit, self._level() / d.full_scale

    def monitor(self) -> float | None:
        """Reading of the monitor photodiode in its own unit; None where the controller has none."""
        d = self._dialect
        if d.monitor is None:
            return None
        return self._line.number(d.monitor.format(channel=self._channel), d.monitor_got)

    def __str__(self) -> str:
        return f"{self.identity or self._dialect.name} on {self._light.port}"

    # ---- inside ----

    @property
    def _baud(self) -> int:
        return int(self._light.baud or self._dialect.baud)

    def _open(self) -> None:
        looked = Patience()
        while guard.is_darkening(self._light.port) and looked() < GUARD_S:
            clock.sleep(LOOK_S)
        ports.require_free(self._light.port, "devices.light.port")
        self._line.open(self._baud)

    def _wake(self) -> None:
        d = self._dialect
        if d.banner is not None:
            end = clock.monotonic() + d.banner_s
            while not re.fullmatch(d.banner, self._line.next()):
                if clock.monotonic() > end:
                    log.warning("lamp on %s: no banner within %g s; asking anyway", self._light.port, d.banner_s)
                    break
        for command in d.start:
            self._line.send(command)
            self._line.reply(d.acknowledge or "")
        try:
            for _ in range(TRIES):
                self.identity = self._line.ask(d.identify, d.identity)
                if re.fullmatch(d.identity, self.identity):
                    break
                self._line.calm(missing=False)  # it may have answered what another program asked, or half a line
        except DeviceError as failure:
            raise DeviceError(
                f'devices.light.port = "{self._light.port}": {failure}; is it on, is this its port, is '
                f'devices.light.dialect = "{self._light.dialect}" its language, and '
                f"devices.light.baud = {self._light.baud or d.baud:g} its line speed?"
            ) from None
        if not re.fullmatch(d.identity, self.identity):
            raise DeviceError(
                f'devices.light.dialect = "{self._light.dialect}": the lamp on {self._light.port} says it is '
                f'"{self.identity}", which is no {d.name} controller; correct the dialect, or devices.light.port'
            )
        self._line.drain_errors()

    # ---- signs of life ----

    def keep(self, seconds: float) -> None:
        """While it is open: the guard darkens it `seconds` from now, even if this program stands still; 0: `STILL_S`
        after the last sign of life."""
        watching = self._guard
        if watching is not None:
            watching.allow(seconds)

    def alive(self, busy_s: float = 0.0) -> None:
        """A sign of life, from any thread; the next one comes within `busy_s` and `STILL_S`, or the guard darkens."""
        watching = self._guard
        if watching is not None and self.lit:
            watching.alive(STILL_S + busy_s)

    def require_time(self) -> None:
        """Raise where the guard does not let the lamp shine that is meant to; it is dark then.

        Raises
        ------
        PassingFault
            There was no sign of life for too long. What was exposed since is worth nothing, and it may be lit again.
        DeviceError
            Its time was set, and is over; or another process has ordered darkness; or no guard can be kept alive.
        """
        watching = self._guard
        if watching is None:
            return
        said = watching.says()
        for text in watching.news():
            log.warning("%s", text)
        if said == guard.GOOD or not (self.lit or said == guard.ORDERED):
            return
        dark = f"the lamp on {self._light.port} stays dark"
        self._warmed = False
        self.off()
        if said == guard.ORDERED:
            raise DeviceError(f"{dark}: `gonio rig dark`, run beside this program, has darkened it")
        if said == guard.LOST:
            raise DeviceError(self._no_guard)
        over = f"{dark}: its time is over, and its guard has darkened it"
        if watching.by_hand:
            raise DeviceError(over)
        raise PassingFault(
            f"{over}, because this program stood still, or waited for a device, for more than {STILL_S:g} s", "lamp"
        )

    @property
    def _no_guard(self) -> str:
        return f"the lamp on {self._light.port} stays dark: the process that would darken it after a kill -9 cannot run"

    def darken_elsewhere(self) -> str:
        """Have the guard of another program that holds the port darken the lamp; what was done, "" where there is none.

        Raises
        ------
        DeviceError
            The guard cannot open the port.
        """
        ordered = guard.order_dark(self._light.port)
        if ordered is None:
            return ""
        program, sent = ordered
        who = f"process {program}, which holds {self._light.port}"
        if not sent:
            raise DeviceError(
                f"the lamp's guard cannot open the port; it has told {who}: that darkens the lamp unless it stands "
                "still. Look at the lamp"
            )
        return f"the order to darken is out, through the guard of {who} and may not light it again; look at the lamp"

    def darken_at_once(self) -> None:
        """Send what darkens the lamp, from whatever thread, and wait for nothing; `off` sees that it is dark."""
        self._line.shout(self._orders_to_darken())

    def locked(self) -> bool | None:
        """Whether the source says that it is in lock; None where its dialect has no such question."""
        d = self._dialect
        if d.lock is None:
            return None
        answer = self._line.ask(d.lock.format(channel=self._channel), f"{d.lock_good}|{d.lock_lost}")
        return re.fullmatch(d.lock_good, answer) is not None

    def _shine(self) -> None:
        self.allowed()
        self.lit = True  # it is meant to, from now on
        self.alive()
        self.require_time()
        d, self.known_dark = self._dialect, False
        value = self._light.level * d.full_scale
        command = d.set.format(value=value, channel=self._channel)
        self._set(command, d.get.format(channel=self._channel), d.got, value, d.resolution)
        self._switch(d.on, d.state_on, self._channel)

    def _off(self) -> None:
        for channel in self._channels_to_darken():
            self._switch(self._dialect.off, self._dialect.state_off, channel)

    def _channels_to_darken(self) -> list[int]:
        channels = sorted({self._light.channel, *self._light.channels.values()})
        return channels if "{channel}" in self._dialect.off else channels[:1]

    def _orders_to_darken(self) -> list[bytes]:
        d = self._dialect
        return [(d.off.format(channel=channel) + d.send_ending).encode() for channel in self._channels_to_darken()]

    def _ask_state(self, channel: int) -> str:
        d = self._dialect
        return self._line.ask(d.state.format(channel=channel), f"{d.state_on}|{d.state_off}")

    def _level(self) -> float:
        """The setting that the controller has, in its own unit."""
        return self._line.number(self._dialect.get.format(channel=self._channel), self._dialect.got)

    def _switch(self, command: str, wanted: str, channel: int) -> None:
        for _ in range(TRIES):
            self._line.order(command.format(channel=channel))
            state = self._ask_state(channel)
            if re.fullmatch(wanted, state):
                return
            log.warning('lamp on %s: after "%s" its state is "%s"; repeated', self._light.port, command, state)
        raise DeviceError(f'the lamp on {self._light.port} does not obey "{command}": its state is "{state}"')

    def _set(self, command: str, query: str, pattern: str, value: float, resolution: float) -> None:
        """A setting, read back; `resolution` is the largest difference that is none."""
        for _ in range(TRIES):
            self._line.order(command)
            got = self._line.number(query.format(channel=self._channel), pattern)
            if abs(got - value) <= resolution:
                return
            log.warning('lamp on %s: after "%s" it reads back %g; repeated', self._light.port, command, got)
        raise DeviceError(f'the lamp on {self._light.port} does not obey "{command}": it reads back {got:g}')

    def _level_kept(self) -> bool:
        d = self._dialect
        kept = abs(self._level() - self._light.level * d.full_scale) <= d.resolution
        if kept and self._light.monitor_tolerance is not None and (seen := self.monitor()) is not None:
            first = self._monitored = self._monitored or seen
            if not first > 0:
                raise DeviceError(f"the lamp's monitor reads {first:g} while the lamp is lit: is it connected?")
            if abs(seen / first - 1) > self._light.monitor_tolerance:
                raise DeviceError(
                    f"the lamp's monitor reads {seen:g}, and read {first:g} after lighting up: more than "
                    f"devices.light.monitor_tolerance = {self._light.monitor_tolerance:g} apart"
                )
        return kept

    def _band_kept(self) -> bool:
        d = self._dialect
        if d.selected is None or self._band is None:
            return True
        return abs(self._line.number(d.selected, d.selected_got) - self._band.centre_nm) <= WAVELENGTH_STEP_NM

    def _settle(self) -> None:
        wait = self._light.settle_s if self._warmed else max(self._light.settle_s, self._warm_up_s)
        if not self._warmed and wait >= TOLD_S:
            log.warning("the lamp warms up for %g s (lamp.warm_up_s)", wait)
        self._warmed = True
        self._wait(wait)
        self._monitored = self.monitor() if self._light.monitor_tolerance is not None else None

    def _wait(self, seconds: float) -> None:
        """A lamp may need an hour to warm up; raises as soon as it may not shine any more."""
        while seconds > 0:
            clock.sleep(min(seconds, LOOK_S))
            seconds -= LOOK_S
            self.allowed()
            self.alive()
            self.require_time()

    def _close(self, *, in_order: bool) -> None:
        """Close the port; the guard tries once more where the lamp may not be dark."""
        self._line.close()
        if self._guard is not None:
            self._guard.release(in_order=in_order)
            self._guard = None

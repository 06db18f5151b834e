"""The one clock of drivers, of their twins and of work by hand: look at it as `clock.monotonic()`.

Tests put another one here, on which waiting takes no time.
"""

from time import monotonic as monotonic
from time import sleep as sleep
from time import time as time

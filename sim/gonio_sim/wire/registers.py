"""The control table of a servo as it lies in its memory: bytes, items, indirect addresses.

Written from the e-Manual, from the device's side. What a value means, and whether it is allowed, the servo knows.
"""

from __future__ import annotations

from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire import tables


class Refused(Exception):
    """An instruction ends with an error number in its status packet."""

    def __init__(self, error: int) -> None:
        super().__init__(error)
        self.error = error


class Registers:
    """The memory of one servo, with its factory values.

    Parameters
    ----------
    table
        The items of its model.
    """

    def __init__(self, table: tables.Table) -> None:
        self.table = table
        self._bytes = bytearray(table.size)
        self._at = {item.address: item for item in table.items.values()}
        self._pointers = {
            item.address: table.items[name.replace("Data", "Address")].address
            for name, item in table.items.items()
            if name.startswith("Indirect Data")
        }
        for name, value in table.factory.items():
            self.put(name, value)

    def get(self, name: str) -> int:
        """The value of an item, as its owner means it (signed where it is)."""
        item = self.table.items[name]
        return int.from_bytes(self._bytes[item.address : item.address + item.size], "little", signed=item.signed)

    def put(self, name: str, value: int) -> None:
        """Write an item, whoever may write it."""
        item = self.table.items[name]
        raw = (value % (1 << 8 * item.size)).to_bytes(item.size, "little")
        self._bytes[item.address : item.address + item.size] = raw

    def identity(self) -> bytes:
        """Model number and firmware version."""
        return bytes(self._bytes[0:2] + self._bytes[6:7])

    def read(self, address: int, length: int) -> bytes:
        """Bytes from an address on, through the indirect data.

        Raises
        ------
        Refused
            There is no such item, or the run of bytes ends beyond the table.
        """
        if length < 1 or address not in self.table.defined or address + length > self.table.size:
            raise Refused(p2.ACCESS_ERROR)
        return bytes(self._bytes[self._indirect(address + k)] for k in range(length))

    def _indirect(self, address: int) -> int:
        """Where an indirect data byte points to; any other address is itself."""
        pointer = self._pointers.get(address)
        return address if pointer is None else int.from_bytes(self._bytes[pointer : pointer + 2], "little")

    def items(self, address: int, data: bytes) -> list[tuple[tables.Item, int]]:
        """The items that a write covers, each wholly and each writable, with the values that they are to take.

        Indirect data may mean items that are not adjacent, in any order; the bytes of each are together.
        """
        meant = [self._indirect(address + k) for k in range(len(data))]
        out, position = [], 0
        if not data:
            raise Refused(p2.LENGTH_ERROR)
        while position < len(data):
            item = self._at.get(meant[position])
            if item is None or not item.writable:
                raise Refused(p2.ACCESS_ERROR)
            end = position + item.size
            if meant[position:end] != list(range(item.address, item.address + item.size)):
                raise Refused(p2.LENGTH_ERROR)
            out.append((item, int.from_bytes(data[position:end], "little", signed=item.signed)))
            position = end
        return out

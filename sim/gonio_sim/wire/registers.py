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
        for first, table, data in ((1, 168, 224), (29, 578, 634)):
            if data <= address < data + 28 and f"Indirect Data {first}" in self.table.items:
                return int.from_bytes(self._bytes[table + 2 * (address - data) :][:2], "little")
        return address

    def follow(self, address: int, data: bytes) -> int:
        """The address that a write to indirect data means: the run of bytes must be contiguous behind it."""
        target = self._indirect(address)
        if any(self._indirect(address + k) != target + k for k in range(len(data))):
            raise Refused(p2.ACCESS_ERROR)
        return target

    def items(self, address: int, data: bytes) -> list[tuple[tables.Item, int]]:
        """The items that a write covers, each wholly and each writable, with the values that they are to take."""
        at = {item.address: item for item in self.table.items.values()}
        out, position = [], 0
        if not data:
            raise Refused(p2.LENGTH_ERROR)
        while position < len(data):
            item = at.get(address + position)
            if item is None or not item.writable:
                raise Refused(p2.ACCESS_ERROR)
            if position + item.size > len(data):
                raise Refused(p2.LENGTH_ERROR)
            raw = data[position : position + item.size]
            out.append((item, int.from_bytes(raw, "little", signed=item.signed)))
            position += item.size
        return out

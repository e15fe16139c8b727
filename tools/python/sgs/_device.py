"""Devices."""

from __future__ import annotations

import json
import threading
from typing import Any, Optional, Union

from . import _sgs

_OPEN: dict[Optional[str], Device] = {}
_LOCK = threading.Lock()


class Device:
    """Open Vulkan device.

    Functions take ``device`` as a :class:`Device`, as a string, or ``None`` for the default. A string is an index, a part of a
    name, ``uuid:…``, ``pci:…`` or ``auto``. A device that is named by a string is opened once in a process.

    Args:
        select: The device; ``None`` selects as ``auto`` (docs/reference/devices.md).
        timeout: Time limit of a wait for the device in seconds.

    Raises:
        sgs.Error: If no device fits.
    """

    def __init__(self, select: Optional[str] = None, *, timeout: Optional[float] = None) -> None:
        self._native = _sgs.Device(None if select is None else str(select), timeout)

    @property
    def info(self) -> dict[str, Any]:
        """Name, driver, UUID, PCI address, memory and limits, as ``sgs devices --json`` prints them."""
        return json.loads(self._native.info())

    @property
    def memory(self) -> tuple[int, int]:
        """Bytes of device memory in use, and their peak."""
        return self._native.memory()

    def __repr__(self) -> str:
        return f"<sgs.Device {self.info['name']!r}>"


#: Ways to name a device.
DeviceLike = Union[Device, str, int, None]


def open_device(device: DeviceLike) -> Device:
    """Returns the device that is meant."""
    if isinstance(device, Device):
        return device
    select = None if device is None else str(device)
    with _LOCK:
        if select not in _OPEN:
            _OPEN[select] = Device(select)
        return _OPEN[select]


def devices() -> list[dict[str, Any]]:
    """Returns the Vulkan devices, as ``sgs devices --json`` lists them.

    The device that is used by default has the key ``auto``, with the reason.

    Raises:
        sgs.Error: If the Vulkan loader is missing.
    """
    return json.loads(_sgs.devices())

"""SGS: Gaussians with materials, lights and shadows from photographs of a room.

    import sgs

    run = sgs.Run.open("run")
    image = run.render("012", ["rgb", "albedo"])["albedo"]
    relit = run.relight({"lights": {"scale": 0.2}}).render("012")["relit"]

Images are NumPy arrays of 32-bit floats, height × width × channels. They support DLPack and the buffer protocol, and so may
all arrays that functions take. Failures raise :class:`sgs.Error`. Messages of the libraries go to the logger ``sgs``.

Names are loaded when they are used, so that ``sgs.ray`` works without the native module.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._errors import Error

if TYPE_CHECKING:
    from . import rerun, torch
    from ._batch import batch
    from ._camera import Camera
    from ._config import Config
    from ._device import Device, devices
    from ._images import from_display, to_display, write_image
    from ._run import Relit, Run
    from ._scene import Scene, View, synthesize
    from ._trainer import Event, Outcome, Trainer

    __version__: str

_MODULES = {
    "Camera": "_camera",
    "Config": "_config",
    "Device": "_device",
    "Event": "_trainer",
    "Outcome": "_trainer",
    "Relit": "_run",
    "Run": "_run",
    "Scene": "_scene",
    "Trainer": "_trainer",
    "View": "_scene",
    "batch": "_batch",
    "devices": "_device",
    "from_display": "_images",
    "synthesize": "_scene",
    "to_display": "_images",
    "write_image": "_images",
    "__version__": "_sgs",
}
_SUBMODULES = ("ray", "rerun", "torch")

__all__ = ["Error", *(name for name in _MODULES if not name.startswith("_")), "rerun", "torch"]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value = getattr(importlib.import_module(f".{_MODULES[name]}", __name__), name)
    elif name in _SUBMODULES:
        value = importlib.import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES, *_SUBMODULES})

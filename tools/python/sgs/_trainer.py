"""Training."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Optional, Union

from . import _sgs
from ._config import Config, _native
from ._device import DeviceLike, open_device
from ._scene import Scene

if TYPE_CHECKING:
    from ._run import Run


@dataclass(frozen=True)
class Event:
    """Event of a training.

    Attributes:
        kind: ``started``, ``step``, ``densified``, ``decision``, ``rolled_back`` or ``finished``.
        stage: ``geometry``, ``intrinsic`` or ``transport``.
        step: Finished steps of the stage, if the event has a step.
        steps: Steps of the stage in all.
        loss: Loss of the step's image.
        gaussians: Number of Gaussians.
        text: Description for people.
    """

    kind: str
    stage: str
    step: Optional[int] = None
    steps: Optional[int] = None
    loss: Optional[float] = None
    gaussians: Optional[int] = None
    text: str = ""
    _log: Optional[str] = None

    @property
    def figures(self) -> dict[str, Any]:
        """All figures: of a step those of ``log.jsonl``, of a finished stage those of ``training.json``."""
        return json.loads(self._log) if self._log else {}


#: Function that receives events. A result of ``False`` stops the training, after steps that are in flight.
Callback = Callable[[Event], Any]


@dataclass(frozen=True)
class Outcome:
    """Outcome of a training.

    Attributes:
        finished: Whether all stages have all of their steps.
        stage, step: Where the callback stopped the training; ``None`` and 0 if it did not.
        path: Run directory.
    """

    finished: bool
    stage: Optional[str]
    step: int
    path: Path

    def run(self) -> Run:
        """Opens the run.

        Raises:
            sgs.Error: If the geometry stage was not finished.
        """
        from ._run import Run

        return Run.open(self.path)


class Trainer:
    """Training of a scene into a run directory, as ``sgs train`` does.

        sgs.Trainer("room", "run", sgs.Config(preset="draft"), stage="all").run(print)

    Args:
        scene: Scene, or its directory.
        output: Run directory to create or continue.
        config: Settings that differ from the defaults. A resumed run must have begun with the same ones; ``None`` means those.
        device: Device; the default one if ``None``.
        stage: ``geometry``, ``intrinsic``, ``transport`` or ``all``.
        start: Geometry of the intrinsic stage, a PLY or glTF file.
        resume: Continues an interrupted run. A finished run stays unchanged.
        force: Replaces the run in the directory.
    """

    def __init__(
        self,
        scene: Union[Scene, str, os.PathLike[str]],
        output: Union[str, os.PathLike[str]],
        config: Optional[Config] = None,
        *,
        device: DeviceLike = None,
        stage: str = "geometry",
        start: Union[str, os.PathLike[str], None] = None,
        resume: bool = False,
        force: bool = False,
    ) -> None:
        self.scene = scene.path if isinstance(scene, Scene) else Path(scene)
        self.output = Path(output)
        self.config = config
        self.device = device
        self.stage = stage
        self.start = None if start is None else Path(start)
        self.resume = resume
        self.force = force

    def run(self, callback: Optional[Callback] = None) -> Outcome:
        """Trains. Releases the interpreter's lock, except for the callback.

        Ctrl-C stops the training after a checkpoint and raises :class:`KeyboardInterrupt`. An exception of the callback does the
        same. A new trainer with ``resume=True`` continues from the checkpoint, with the same result as without the stop.

        Args:
            callback: Receives each :class:`Event`. A result of ``False`` stops the training after a checkpoint.

        Raises:
            sgs.Error: If settings, scene or directory are wrong, the device fails, or training diverges.
        """
        native = None if callback is None else lambda event: callback(_event(event))
        finished, stage, step = _sgs.train(
            (os.fspath(self.scene), os.fspath(self.output), None if self.start is None else os.fspath(self.start)),
            self.stage,
            _native(self.config),
            open_device(self.device)._native,
            (self.resume, self.force),
            native,
        )
        return Outcome(finished, stage, step, self.output)


def _event(event: dict[str, Any]) -> Event:
    return Event(_log=event.pop("log", None), **event)

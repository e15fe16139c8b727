"""Logging of a training to Rerun, a viewer of time series and images. Needs the package ``rerun-sdk``.

    logger = sgs.rerun.Logger(save="training.rrd")
    sgs.Trainer("room", "run").run(logger)
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Union

from ._errors import usage

if TYPE_CHECKING:
    from ._run import Run, Viewpoint
    from ._trainer import Event


class Logger:
    """Callback that logs the figures of each step.

    Args:
        name: Name of the recording.
        save: File to write; without one, ``spawn`` decides.
        spawn: Starts the viewer.
        every: Number of steps between two logged steps.

    Raises:
        sgs.Error: If the package ``rerun-sdk`` is missing, or ``every`` is not positive.
    """

    def __init__(
        self,
        name: str = "sgs",
        *,
        save: Union[str, os.PathLike[str], None] = None,
        spawn: bool = False,
        every: int = 1,
    ) -> None:
        try:
            import rerun
        except ImportError as error:
            raise usage('Logging needs the package "rerun-sdk"; install it with pip install rerun-sdk.') from error
        if every < 1:
            raise usage(f"every is {every}, but must be at least 1.")
        self._rerun = rerun
        self._every = every
        self._recording = rerun.RecordingStream(name)
        if save is not None:
            self._recording.save(os.fspath(save))
        elif spawn:
            self._recording.spawn()

    def __call__(self, event: Event) -> None:
        """Logs an event: figures of steps as ``stage/figure``, decisions as text."""
        if event.kind == "step" and event.step is not None and event.step % self._every == 0:
            self._at(event.step)
            figures = {"loss": event.loss, "gaussians": event.gaussians, **event.figures}
            for name, value in _numbers(figures):
                self._recording.log(f"{event.stage}/{name}", self._rerun.Scalars(value))
        elif event.kind in ("decision", "rolled_back"):
            self._recording.log(f"{event.stage}/log", self._rerun.TextLog(event.text))

    def log_run(self, run: Run, view: Viewpoint, *channels: str) -> None:
        """Logs the centers of a run, and images of a view: ``rgb`` or the named channels.

        Raises:
            sgs.Error: As :meth:`sgs.Run.render`.
        """
        from ._images import to_display

        self._recording.log("run/means", self._rerun.Points3D(run.gaussians()["means"]))
        for name, image in run.render(view, channels or ("rgb",)).items():
            linear = name in ("albedo", "pbr", "diffuse", "specular", "env", "direct")
            shown = to_display(image) if linear else image
            archetype = self._rerun.DepthImage(image[..., 0]) if name == "depth" else self._rerun.Image(shown)
            self._recording.log(f"run/{name}", archetype)

    def flush(self) -> None:
        """Writes everything that was logged."""
        self._recording.flush()

    def _at(self, step: int) -> None:
        self._recording.set_time("step", sequence=step)


def _numbers(figures: dict[str, Any], prefix: str = "") -> list[tuple[str, float]]:
    """Returns all numbers, those of groups with the name of the group before them."""
    found: list[tuple[str, float]] = []
    for name, value in figures.items():
        if isinstance(value, dict):
            found += _numbers(value, f"{prefix}{name}/")
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and name != "step":
            found.append((f"{prefix}{name}", float(value)))
    return found

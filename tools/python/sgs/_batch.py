"""Batches: many scenes by a manifest."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any, Optional, Sequence, Union

from ._errors import Error, usage


def find_program(program: Union[str, os.PathLike[str], None] = None) -> str:
    """Returns the path of the program ``sgs``: the given one, that of the variable ``SGS_PROGRAM``, or that on the ``PATH``.

    Raises:
        sgs.Error: If there is none.
    """
    wanted = program or os.environ.get("SGS_PROGRAM") or "sgs"
    found = shutil.which(os.fspath(wanted))
    if found is None:
        raise usage(
            f'The program "{os.fspath(wanted)}" does not exist; build it with cargo build --release -p sgs, and give its path as '
            "program or in the variable SGS_PROGRAM."
        )
    return found


def batch(
    manifest: Union[str, os.PathLike[str]],
    output: Union[str, os.PathLike[str]],
    *,
    jobs: int = 1,
    devices: Sequence[str] = (),
    shard: Optional[str] = None,
    retry_failed: bool = False,
    baseline: Union[str, os.PathLike[str], None] = None,
    tolerance: Optional[float] = None,
    program: Union[str, os.PathLike[str], None] = None,
) -> dict[str, Any]:
    """Trains many scenes by a manifest (docs/guide/batch.md). Starts the program ``sgs batch``.

    Each run is a process of its own, so a crash ends one run and not this interpreter. Arguments are the options of the
    command. Progress goes to standard error.

    Args:
        program: Path of the program ``sgs``; by default that of the variable ``SGS_PROGRAM``, or that on the ``PATH``.

    Returns:
        Numbers of ``runs``, ``done`` and ``skipped``, ``seconds``, ``summary`` (path), and ``results``, one dictionary for each run.

    Raises:
        sgs.Error: With the sentence and the exit status of the program.
        KeyboardInterrupt: After Ctrl-C, when the trainings have written checkpoints. The same call goes on from there.
    """
    command = [find_program(program), "batch", os.fspath(manifest), "-o", os.fspath(output), "--json", "--jobs", str(jobs)]
    if devices:
        command += ["--devices", ",".join(devices)]
    if shard is not None:
        command += ["--shard", shard]
    if retry_failed:
        command.append("--retry-failed")
    if baseline is not None:
        command += ["--baseline", os.fspath(baseline)]
    if tolerance is not None:
        command += ["--tolerance", str(tolerance)]
    answer = _answer(command)
    summary = Path(answer["summary"])
    answer["results"] = [json.loads(line) for line in summary.read_text(encoding="utf-8").splitlines()]
    return answer


def _answer(command: list[str]) -> dict[str, Any]:
    """Runs a command with ``--json``. Returns its answer, or raises its failure."""
    # A group of its own: Ctrl-C of a terminal reaches the program once, through this process.
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        output, _ = process.communicate()
    except BaseException:
        process.send_signal(signal.SIGINT)
        process.communicate()
        raise
    try:
        answer = json.loads(output)
    except json.JSONDecodeError:
        answer = {}
    if process.returncode != 0:
        text = answer.get("error") or f"{command[0]} {command[1]} ended with the status {process.returncode}."
        raise Error(text, answer.get("kind", "failed"), process.returncode)
    return answer

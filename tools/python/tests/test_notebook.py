"""The notebook runs from its first cell to its last, and its images show what they should."""

import base64
import os
from pathlib import Path

import numpy as np
import pytest

import sgs

nbformat = pytest.importorskip("nbformat", reason="the package nbformat is missing")
nbclient = pytest.importorskip("nbclient", reason="the package nbclient is missing")
pytest.importorskip("ipykernel", reason="the package ipykernel is missing")
pytest.importorskip("matplotlib", reason="the package matplotlib is missing")

NOTEBOOK = Path(__file__).parents[1] / "notebooks/first_room.ipynb"
#: Sizes of a run in seconds, in place of those of the notebook. The environment can give others.
QUICK = os.environ.get("SGS_NOTEBOOK", "5, (48, 36), 120, 8")


def test_the_notebook_runs(tmp_path, monkeypatch):
    path = os.pathsep.join([str(Path(sgs.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells), "the notebook is stored without outputs"
    parameters = next(cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", []))
    parameters.source = f"views, size, steps, intrinsic_steps = {QUICK}\ndirectory = 'first_room'"
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    pictures = [base64.b64decode(o.data["image/png"]) for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 2 and all(picture.startswith(b"\x89PNG") for picture in pictures)
    folder = Path(os.environ.get("SGS_NOTEBOOK_IMAGES", tmp_path))
    for name, picture in zip(("loss", "room"), pictures):
        (folder / f"{name}.png").write_bytes(picture)
    # The run that the notebook left: its render resembles the photograph, and the relit image differs from it.
    run = sgs.Run.open(tmp_path / "first_room/run")
    view = run.scene.test[0]
    photograph, render = view.photograph(), run.render(view)["rgb"]
    assert np.corrcoef(photograph.ravel(), render.ravel())[0, 1] > 0.7
    measures = eval(outputs[-1].data["text/plain"])
    assert measures["render"] > 15 and measures["albedo"] > 8

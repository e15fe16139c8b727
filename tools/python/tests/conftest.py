"""A small room and a run of all stages, made once."""

import logging
import os
import shutil

import pytest

import sgs



def quick(**more):
    return sgs.Config(preset="draft", **{"geometry_steps": 40, "intrinsic_steps": 8, "transport_steps": 20, **more})


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    logging.getLogger("sgs").setLevel(logging.ERROR)
    return sgs.synthesize(tmp_path_factory.mktemp("room") / "room", views=4, test_views=2, size=(40, 30))


@pytest.fixture(scope="session")
def run(scene, tmp_path_factory):
    output = tmp_path_factory.mktemp("run") / "run"
    outcome = sgs.Trainer(scene, output, quick(), stage="all").run()
    assert outcome.finished
    return outcome.run()


@pytest.fixture(scope="session")
def program():
    """The program `sgs`, where there is one."""
    found = shutil.which(os.environ.get("SGS_PROGRAM", "sgs"))
    if found is None:
        pytest.skip("the program sgs is missing; name it in the variable SGS_PROGRAM")
    return found

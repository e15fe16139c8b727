"""Tests of the package `sgs`: settings, scenes, training, runs, relighting, evaluation and failures."""

import copy
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import sgs
from conftest import quick

CHANNELS = {"rgb": 3, "alpha": 1, "depth": 1, "normal": 3, "albedo": 3, "roughness": 1, "metallic": 1, "pbr": 3}


def fails(kind, status, text=""):
    """Expects an error of a kind, whose sentence contains a text."""

    class Expected:
        def __enter__(self):
            return self

        def __exit__(self, kind_of, error, _):
            assert isinstance(error, sgs.Error), f"no sgs.Error, but {error!r}"
            assert (error.kind, error.status) == (kind, status), (error.kind, error.status, str(error))
            assert text in str(error) and "\n" not in str(error), str(error)
            return True

    return Expected()


# Settings.


def test_settings_have_the_same_values_however_they_are_named():
    one = sgs.Config(preset="draft", geometry={"steps": 9, "losses": {"normal": 0.5}})
    two = sgs.Config({"geometry.steps": 9, "geometry.losses.normal": np.float32(0.5)}, preset="draft")
    three = sgs.Config(preset="draft", geometry_steps=9, geometry_losses_normal=0.5)
    assert one == two == three != sgs.Config(preset="draft")
    assert one["geometry.steps"] == 9 and one.values["geometry"]["losses"]["normal"] == 0.5
    with pytest.raises(KeyError):
        one["geometry.nothing"]


def test_wrong_settings_are_refused_with_the_sentence_of_the_command_line():
    with fails("usage", 2, 'did you mean "geometry.steps"?'):
        sgs.Config(geometry={"step": 1})
    with fails("usage", 2, '"papr" is not a preset; did you mean "paper"?'):
        sgs.Config(preset="papr")
    with fails("usage", 2, 'geometry.steps is "many", but must be a whole number.'):
        sgs.Config(geometry_steps="many")
    with fails("usage", 2, "scale is 2"):
        sgs.Config(scale=2.0)
    with fails("usage", 2, "nothing_here"):
        sgs.Config(nothing_here=1)
    with fails("usage", 2):
        sgs.Config({"scale": None})


# Devices.


def test_devices_are_listed_and_one_is_the_default():
    devices = sgs.devices()
    assert devices and all(d["uuid"] and d["driver"] for d in devices)
    assert sum("auto" in d for d in devices) == 1
    device = sgs.Device(f"uuid:{devices[0]['uuid']}")
    assert device.info["name"] == devices[0]["name"] and device.memory[0] >= 0


def test_unknown_devices_are_refused(run):
    with fails("usage", 2, "no such device here"):
        sgs.Device("no such device here")
    with fails("usage", 2, "timeout is -1"):
        sgs.Device(timeout=-1)


# Scenes and cameras.


def test_scene_has_views_photographs_and_points(scene):
    assert len(scene.train) == 4 and len(scene.test) == 2 and len(scene.views) == 6
    view = scene.view(scene.test[0].name)
    photograph = view.photograph()
    assert photograph.shape == (30, 40, 3) and photograph.dtype == np.float32
    assert 0 <= photograph.min() < photograph.max() <= 1
    assert scene.points.shape[1] == 3 and not scene.points.flags.writeable and not scene.points.flags.owndata
    # The camera sees the points: most of them project into some view.
    camera = view.camera
    seen = scene.points @ camera.rotation.T + camera.translation
    ahead = seen[seen[:, 2] > 0]
    x, y = camera.fx * ahead[:, 0] / ahead[:, 2] + camera.cx, camera.fy * ahead[:, 1] / ahead[:, 2] + camera.cy
    assert ((0 < x) & (x < 40) & (0 < y) & (y < 30)).mean() > 0.3
    assert np.allclose(camera.rotation @ camera.position + camera.translation, 0, atol=1e-9)


def test_arrays_outlive_the_objects_that_made_them(scene):
    points = sgs.Scene.open(scene.path).points
    before = points.copy()
    import gc

    gc.collect()
    assert np.array_equal(points, before) and np.array_equal(points, scene.points)


def test_wrong_scenes_and_views_are_refused(scene, tmp_path):
    with fails("input", 42, "does not exist"):
        sgs.Scene.open(tmp_path / "nothing")
    with fails("usage", 2, 'no view "nobody"'):
        scene.view("nobody")
    with fails("usage", 2, "no view 99"):
        scene.view(99)
    with fails("usage", 2):
        sgs.synthesize(tmp_path / "room", name="castle")
    assert not (tmp_path / "room").exists()


def test_cameras_look_where_they_are_told():
    camera = sgs.Camera.look_at((1, 2, 3), (4, 5, 3), size=(80, 60), field_of_view=90)
    assert np.allclose(camera.position, (1, 2, 3))
    assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3)) and np.linalg.det(camera.rotation) > 0
    target = camera.rotation @ (4, 5, 3) + camera.translation
    assert np.allclose(target[:2], 0) and target[2] > 0 and camera.fx == pytest.approx(40)
    above = camera.rotation @ (4, 5, 4) + camera.translation
    assert above[1] < 0, "up in the world is up in the image"
    with fails("usage", 2, "cannot look"):
        sgs.Camera.look_at((0, 0, 0), (0, 0, 1))
    with fails("usage", 2, "rotation has the shape"):
        sgs.Camera(4, 4, 1, 1, 2, 2, np.eye(4), np.zeros(3))


# Training.


def test_events_describe_the_training(scene, tmp_path):
    events = []
    config = quick(geometry_steps=6)
    outcome = sgs.Trainer(scene, tmp_path / "run", config).run(events.append)
    assert outcome == sgs.Outcome(True, None, 0, tmp_path / "run")
    steps = [e for e in events if e.kind == "step"]
    assert [e.step for e in steps] == [1, 2, 3, 4, 5, 6] and {e.steps for e in steps} == {6}
    assert [events[0].kind, events[-1].kind] == ["started", "finished"]
    assert all(e.stage == "geometry" and e.loss > 0 and e.gaussians > 0 for e in steps)
    assert steps[0].figures["step"] == 1 and "l1" in steps[0].figures
    assert events[-1].figures["steps"] == 6


def test_a_stopped_training_resumes_with_the_same_bits(scene, tmp_path):
    config = quick(geometry_steps=12, geometry_backward="pixel")
    whole = sgs.Trainer(scene, tmp_path / "whole", config).run()
    stopped = sgs.Trainer(scene, tmp_path / "parts", config).run(lambda e: e.kind != "step" or e.step < 5)
    # Steps that are in flight when the callback answers are finished.
    assert not stopped.finished and stopped.stage == "geometry" and 5 <= stopped.step < 12
    with fails("failed", 1, "training was not finished"):
        stopped.run()
    with fails("usage", 2, "an unfinished run"):
        sgs.Trainer(scene, tmp_path / "parts", config).run()
    with fails("usage", 2, "was begun with geometry.steps = 12, not 13"):
        sgs.Trainer(scene, tmp_path / "parts", quick(geometry_steps=13, geometry_backward="pixel"), resume=True).run()
    seen = []
    assert sgs.Trainer(scene, tmp_path / "parts", resume=True).run(seen.append).finished
    assert [e.step for e in seen if e.kind == "step"] == list(range(stopped.step + 1, 13))
    ply = [(tmp_path / name / "scene.ply").read_bytes() for name in ("whole", "parts")]
    assert ply[0] == ply[1] and whole.finished
    # A finished run stays as it is.
    again = []
    assert sgs.Trainer(scene, tmp_path / "parts", resume=True).run(again.append).finished and not again


def test_an_exception_of_the_callback_stops_the_training(scene, tmp_path):
    class Mine(Exception):
        pass

    def callback(event):
        if event.step == 3:
            raise Mine("enough")

    with pytest.raises(Mine, match="enough"):
        sgs.Trainer(scene, tmp_path / "run", quick()).run(callback)
    assert (tmp_path / "run/checkpoint").is_dir()
    last = []
    sgs.Trainer(scene, tmp_path / "run", quick(), resume=True).run(lambda e: last.append(e.step) if e.kind == "step" else None)
    # Steps that were in flight are finished, and their events are not delivered.
    assert 4 <= last[0] < 10 and last[-1] == 40


def test_other_threads_run_while_a_training_does(scene, tmp_path):
    turns, done = 0, threading.Event()

    def train():
        sgs.Trainer(scene, tmp_path / "run", quick()).run()
        done.set()

    thread = threading.Thread(target=train)
    began = time.monotonic()
    thread.start()
    while not done.wait(0.005):
        turns += 1
    thread.join()
    # With the lock held, this thread would have had a turn at the beginning and at the end alone.
    assert turns > 20 * (time.monotonic() - began)


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_ctrl_c_writes_a_checkpoint_and_raises_keyboard_interrupt(scene, tmp_path):
    script = f"""
import sgs
config = sgs.Config(preset="draft", geometry_steps=100000)
try:
    sgs.Trainer({str(scene.path)!r}, "run", config).run(lambda e: print(e.kind, flush=True))
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
    path = os.pathsep.join([str(Path(sgs.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, "-c", script], cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, text=True
    )
    for line in process.stdout:
        if line.strip() == "step":
            break
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0 and output.split()[-1] == "interrupted"
    assert list((tmp_path / "run/checkpoint").iterdir())


def test_wrong_trainings_are_refused_and_leave_nothing(scene, run, tmp_path):
    with fails("usage", 2, "stage is"):
        sgs.Trainer(scene, tmp_path / "new", quick(), stage="everything").run()
    with fails("input", 42):
        sgs.Trainer(tmp_path, tmp_path / "new", quick()).run()
    with fails("usage", 2, "a finished run"):
        sgs.Trainer(scene, run.path, quick()).run()
    with fails("usage", 2, "is a scene"):
        sgs.Trainer(scene, scene.path, quick()).run()
    assert not (tmp_path / "new").exists()


# Runs.


def test_gaussians_share_the_memory_of_the_run(run):
    g = run.gaussians()
    n = len(run)
    shapes = {"means": (n, 3), "log_scales": (n, 3), "rotations": (n, 4), "opacity_logits": (n,), "sh0": (n, 1, 3)}
    shapes.update({"normals": (n, 3), "albedo": (n, 3), "roughness": (n,), "semantic": (n, 32), "emitters": (n,)})
    for name, shape in shapes.items():
        assert g[name].shape == shape and not g[name].flags.writeable and not g[name].flags.owndata, name
    again = run.gaussians()
    assert all(np.shares_memory(g[name], again[name]) for name in g)
    assert np.isfinite(g["means"]).all() and np.linalg.norm(g["rotations"], axis=1).min() > 0
    with pytest.raises(ValueError):
        g["means"][0] = 0


def test_channels_have_their_shapes_and_units(run):
    view = run.scene.test[0]
    images = run.render(view, list(CHANNELS))
    for name, channels in CHANNELS.items():
        assert images[name].shape == (30, 40, channels) and images[name].dtype == np.float32, name
        assert np.isfinite(images[name]).all(), name
    for name in ("rgb", "alpha", "albedo", "roughness", "metallic"):
        assert 0 <= images[name].min() and images[name].max() <= 1.0001, name
    opaque = images["alpha"][..., 0] > 0.9
    assert opaque.mean() > 0.3
    assert np.allclose(np.linalg.norm(images["normal"], axis=2)[opaque], 1, atol=1e-3)
    # Depths are within the room: between the camera and the farthest point.
    far = np.linalg.norm(run.gaussians()["means"] - view.camera.position, axis=1).max()
    assert 0.1 < images["depth"][opaque].mean() < far


def test_views_are_named_in_any_way(run):
    view = run.scene.test[0]
    images = [run.render(which)["rgb"] for which in (view, view.name, view.index, view.camera)]
    assert all(np.array_equal(images[0], image) for image in images)
    half = run.render(view.camera.scaled(20, 15))["rgb"]
    assert half.shape == (15, 20, 3)
    coarse = images[0].reshape(15, 2, 20, 2, 3).mean((1, 3))
    assert np.abs(half - coarse).mean() < 0.1


def test_the_background_shows_where_nothing_is(run):
    away = sgs.Camera.look_at((0, 0, 1000), (0, 0, 2000), up=(0, 1, 0), size=(8, 6))
    images = run.render(away, ["rgb", "alpha", "depth"], background=(0.25, 0.5, 0.75))
    assert np.allclose(images["rgb"], (0.25, 0.5, 0.75)) and not images["alpha"].any() and not images["depth"].any()


def test_classes_are_those_of_the_scene(run):
    labels = run.render(run.scene.test[0], "semantic")["semantic"]
    assert labels.dtype == np.int32 and labels.shape == (30, 40, 1)
    assert labels.min() >= -1 and labels.max() < len(run.classes) and len(run.classes) > 2


def test_images_match_those_of_the_command_line(run, tmp_path, program):
    view = run.scene.test[0]
    for channel, extension in [("rgb", "png"), ("albedo", "exr")]:
        command = [program, "render", str(run.path), "-o", str(tmp_path), "--channels", channel, "--format", extension]
        subprocess.run(command, check=True, capture_output=True)
        sgs.write_image(tmp_path / f"ours.{extension}", run.render(view, [channel])[channel])
        theirs = tmp_path / f"{view.name}_{channel}.{extension}"
        assert (tmp_path / f"ours.{extension}").read_bytes() == theirs.read_bytes(), channel


def test_light_scales_with_the_emitters(run):
    view = run.scene.test[0]
    names = [e["name"] for e in json.loads((run.path / "emitters.json").read_text())["emitters"]]
    own = run.relight()
    same = own.render(view)["relit"]
    assert own.lights == len(names) and np.array_equal(same, run.render(view, ["pbr"])["pbr"])
    half = run.relight({"emitters": {"change": [{"emitter": n, "intensity": np.float64(0.5)} for n in names]}})
    dark = run.relight({"emitters": {"off": True}})
    assert dark.lights == 0
    found, black = half.render(view)["relit"], dark.render(view)["relit"]
    # Light is linear in the emitters; what remains without them is outside light.
    assert np.allclose(found - black, 0.5 * (same - black), rtol=1e-3, atol=1e-4)
    assert same.mean() > 1.2 * found.mean()


def test_materials_are_edited_and_files_are_read(run, tmp_path):
    view = run.scene.test[0]
    edit = {"materials": [{"where": {"box": [[-1e3] * 3, [1e3] * 3]}, "set": {"albedo": [0.9, 0.1, 0.1]}}]}
    file = tmp_path / "edit.json"
    file.write_text(json.dumps(edit))
    images = [run.relight(e).render(view, ["albedo"])["albedo"] for e in (edit, file, str(file))]
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])
    opaque = run.render(view, ["alpha"])["alpha"][..., 0] > 0.99
    assert np.allclose(images[0][opaque], (0.9, 0.1, 0.1), atol=0.02)


def test_wrong_edits_and_channels_are_refused(run, tmp_path):
    view = run.scene.test[0]
    with fails("usage", 2, "unknown field `light`"):
        run.relight({"light": 1})
    with fails("usage", 2, "not made of numbers"):
        run.relight({"lights": object()})
    with fails("usage", 2, "cannot be read"):
        run.relight(tmp_path / "nothing.json")
    with fails("usage", 2, 'shadows is "soft"'):
        run.relight(shadows="soft")
    with fails("usage", 2, '"colour" is not a channel'):
        run.render(view, ["colour"])
    with fails("usage", 2, "No channel"):
        run.render(view, [])
    with fails("usage", 2, "background"):
        run.render(view, background=(0, 0))
    with fails("usage", 2, "visibility"):
        run.render(view, ["visibility"])
    bad = copy.copy(view.camera)
    object.__setattr__(bad, "fx", float("nan"))
    with fails("usage", 2, "focal lengths"):
        run.render(bad)


def test_evaluation_is_that_of_the_command_line(run, program):
    found = run.evaluate()
    assert set(found["mean"]["nvs"]) >= {"psnr", "ssim", "flip"} and len(found["views"]) == 2
    stored = json.loads((run.path / "metrics.json").read_text())["test"]
    assert stored["mean"]["nvs"] == found["mean"]["nvs"]
    answer = subprocess.run([program, "eval", str(run.path), "--json"], check=True, capture_output=True)
    theirs = json.loads(answer.stdout)
    assert theirs["mean"]["nvs"] == found["mean"]["nvs"] and theirs["mean"]["albedo"] == found["mean"]["albedo"]
    with fails("usage", 2, "split"):
        run.evaluate("all")


def test_views_are_aligned_on_request_and_where_cameras_are_learned(scene, run, tmp_path):
    aligned = run.evaluate(align=True)["mean"]["nvs"]
    stored = json.loads((run.path / "metrics.json").read_text())["test"]
    assert stored["mean"]["nvs"] == aligned and aligned["psnr_aligned"] != aligned["psnr"]
    plain = run.evaluate()["mean"]["nvs"]
    assert plain == {name: value for name, value in aligned.items() if not name.endswith("_aligned")}
    learning = quick(geometry_steps=4, geometry_rates_views=[1e-3, 0, 0, 0])
    learned = sgs.Trainer(scene, tmp_path / "learned", learning).run().run()
    assert {"psnr_aligned", "ssim_aligned"} <= set(learned.evaluate()["mean"]["nvs"])


def test_files_are_runs_without_a_scene(run):
    file = sgs.Run.open(run.path / "scene.ply")
    assert len(file) == len(run) and file.settings == {}
    camera = run.scene.test[0].camera
    assert np.array_equal(file.render(camera)["rgb"], run.render(camera)["rgb"])
    with fails("usage", 2, "is not a run directory"):
        file.scene
    with fails("usage", 2, "is not a run directory"):
        file.evaluate()


def test_wrong_runs_are_refused(tmp_path, run):
    with fails("failed", 1, "does not exist"):
        sgs.Run.open(tmp_path / "nothing")
    broken = tmp_path / "broken.ply"
    broken.write_bytes((run.path / "scene.ply").read_bytes()[:-100])
    with fails("input", 42):
        sgs.Run.open(broken)


# Arrays, errors and files.


def test_images_are_shared_by_dlpack(run):
    image = run.render(run.scene.test[0])["rgb"]
    shared = np.from_dlpack(image)
    assert np.shares_memory(image, shared) and memoryview(image).format == "f"


class Exported:
    """Array of another library: it has DLPack and nothing else."""

    def __init__(self, array):
        self._array = array

    def __dlpack__(self, **options):
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self._array.__dlpack_device__()


def test_arrays_come_by_dlpack_by_buffer_and_as_lists(run, tmp_path):
    camera = run.scene.test[0].camera
    rotation, translation = camera.rotation, camera.translation
    expected = run.render(camera)["rgb"]
    for wrap in (Exported, lambda a: memoryview(np.ascontiguousarray(a)), lambda a: a.tolist(), np.asfortranarray):
        other = sgs.Camera(
            40, 30, camera.fx, camera.fy, camera.cx, camera.cy, wrap(rotation), wrap(translation), camera.near
        )
        assert np.array_equal(run.render(other)["rgb"], expected)
    sgs.write_image(tmp_path / "a.exr", Exported(expected))
    sgs.write_image(tmp_path / "b.exr", expected)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_display_values_round_trip():
    values = np.linspace(0, 1, 101, dtype=np.float32)
    assert np.allclose(sgs.from_display(sgs.to_display(values)), values, atol=1e-6)
    assert sgs.to_display(0.5) == pytest.approx(0.7353569, abs=1e-6)


def test_wrong_images_are_not_written(tmp_path):
    with fails("usage", 2, "must end in .png or .exr"):
        sgs.write_image(tmp_path / "a.bmp", np.zeros((2, 2, 3)))
    with fails("usage", 2, "1 or 3"):
        sgs.write_image(tmp_path / "a.png", np.zeros((2, 2, 2)))
    with fails("usage", 2, "N × N × N"):
        sgs.write_image(tmp_path / "a.png", np.zeros((2, 2)))
    assert not list(tmp_path.iterdir())


def test_errors_can_be_pickled():
    error = pickle.loads(pickle.dumps(sgs.Error("A sentence.", "input", 42)))
    assert (str(error), error.kind, error.status) == ("A sentence.", "input", 42)


def test_pure_modules_need_no_native_module():
    script = "import sys; sys.modules['sgs._sgs'] = None; import sgs; assert sgs.Error and 'Run' in dir(sgs)"
    path = os.pathsep.join([str(Path(sgs.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    subprocess.run([sys.executable, "-c", script], check=True, env={**os.environ, "PYTHONPATH": path})


def test_names_are_listed_and_stubs_match_the_native_module():
    for name in sgs.__all__:
        if name not in ("torch", "rerun"):
            assert getattr(sgs, name) is not None
    with pytest.raises(AttributeError):
        sgs.nothing
    import ast

    from sgs import _sgs

    stub = ast.parse((Path(sgs.__file__).parent / "_sgs.pyi").read_text())
    listed = {node.name for node in stub.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
    assert listed == {name for name in dir(_sgs) if not name.startswith("_")}
    for node in stub.body:
        if isinstance(node, ast.ClassDef):
            methods = {inner.name for inner in node.body if isinstance(inner, ast.FunctionDef)} - {"__init__"}
            assert methods == {m for m in vars(getattr(_sgs, node.name)) if not m.startswith("_")}, node.name


def test_every_public_object_has_a_docstring():
    for name in sgs.__all__:
        if name not in ("torch", "rerun"):
            thing = getattr(sgs, name)
            assert thing.__doc__, name
            for inner, value in vars(thing).items() if isinstance(thing, type) else ():
                if not inner.startswith("_") and callable(getattr(thing, inner)):
                    assert value.__doc__ or getattr(value, "__func__", value).__doc__, f"{name}.{inner}"


# Batches and logging.


def test_a_batch_trains_its_runs_and_skips_them_the_second_time(scene, tmp_path, program):
    manifest = tmp_path / "rooms.toml"
    manifest.write_text(
        f'scenes = ["{scene.path}"]\nseeds = [0, 1]\nevaluate = false\n'
        '[[variants]]\nname = "fast"\npreset = "draft"\nsettings = { geometry = { steps = 4 } }\n'
    )
    first = sgs.batch(manifest, tmp_path / "out", program=program)
    assert (first["runs"], first["done"], first["skipped"]) == (2, 2, 0)
    assert [r["state"] for r in first["results"]] == ["done", "done"] and [r["seed"] for r in first["results"]] == [0, 1]
    assert sgs.batch(manifest, tmp_path / "out", program=program)["skipped"] == 2
    manifest.write_text("scenes = []\nword = 1\n")
    with fails("usage", 2, "word"):
        sgs.batch(manifest, tmp_path / "other", program=program)
    with fails("usage", 2, "does not exist; build it"):
        sgs.batch(manifest, tmp_path / "other", program="no-such-program")


def test_a_training_is_logged_to_rerun(scene, tmp_path):
    pytest.importorskip("rerun", reason="the package rerun-sdk is missing")
    logger = sgs.rerun.Logger(save=tmp_path / "training.rrd", every=2)
    sgs.Trainer(scene, tmp_path / "run", quick(geometry_steps=4)).run(logger)
    run = sgs.Run.open(tmp_path / "run")
    logger.log_run(run, run.scene.test[0], "rgb", "depth")
    logger.flush()
    content = (tmp_path / "training.rrd").read_bytes()
    assert b"geometry/loss" in content and b"run/means" in content and b"run/depth" in content


def test_logging_without_rerun_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with fails("usage", 2, "pip install rerun-sdk"):
        sgs.rerun.Logger()

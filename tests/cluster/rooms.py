"""Tiny scenes, a manifest of twelve runs, and what all tests of clusters check."""

import functools
import json
import os
import pathlib
import subprocess
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
SGS = pathlib.Path(os.environ.get("SGS", TARGET / "debug" / "sgs")).absolute()

# Three scenes, two presets and two seeds. The settings give the same bits on each attempt, and runs that are long enough to be
# stopped in the middle.
MANIFEST = """
scenes = ["scenes/*"]
seeds = [0, 1]

[[variants]]
name = "draft"
preset = "draft"
settings = { geometry = { backward = "pixel", steps = 100, densify = { until = 0.0 } }, train = { checkpoint_interval = 10 } }

[[variants]]
name = "paper"
preset = "paper"
settings = { geometry = { backward = "pixel", steps = 120, densify = { until = 0.0 } }, train = { checkpoint_interval = 10 } }
"""


def sgs(*words):
    """Runs sgs to its end. Returns its answer as JSON."""
    command = [str(SGS), *map(str, words), "--json", "-q"]
    ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if ended.returncode != 0:
        raise AssertionError("{} ended with {}: {}".format(" ".join(command), ended.returncode, ended.stderr))
    return json.loads(ended.stdout)


def until(what, condition, seconds=90, interval=0.05):
    """Waits until a condition returns a value that counts as true. Returns the value."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(interval)
    raise AssertionError("{} did not happen in {} s".format(what, seconds))


def accuracy(result):
    """Returns the measures of a result without frames per second, which depend on the load of the machine."""
    return {name: value for name, value in result["measures"].items() if not name.startswith("fps.")}


class Rooms:
    """Folder with three scenes, a manifest, and the directory of a batch for each test."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self.manifest = self.folder / "rooms.toml"

    def write(self):
        """Synthesizes the scenes, and trains all runs by one command. The other tests compare with it."""
        for seed, name in enumerate(["bath", "hall", "kitchen"]):
            scene = self.folder / "scenes" / name
            sgs("synth", scene, "--scene", "box", "--views", 8, "--size", "32x24", "--seed", seed)
        self.manifest.write_text(MANIFEST)
        sgs("batch", self.manifest, "-o", self.alone)

    @property
    def alone(self):
        return self.folder / "alone"

    @functools.cached_property
    def names(self):
        return [run["name"] for run in sgs("batch", self.manifest, "-o", self.alone, "--list")["runs"]]


class Batch:
    """Directory of a batch, as a test sees it from outside."""

    def __init__(self, rooms, name):
        self.rooms, self.path = rooms, rooms.folder / name

    def steps(self, name):
        log = self.path / "runs" / (name + ".log")
        lines = self.path / "runs" / name / "log.jsonl"
        return len(lines.read_text().splitlines()) if log.exists() and lines.exists() else 0

    def holder(self, name):
        """Returns the lease of a run, if one is held."""
        leases = sorted((self.path / "leases").glob(name.replace("/", ".") + ".*.json"), key=lambda p: int(p.name.split(".")[-2]))
        try:
            lease = json.loads(leases[-1].read_text()) if leases else None
        except (OSError, ValueError):
            return None
        return None if lease is None or lease["released"] else lease

    def is_done(self, name):
        return (self.path / "results" / (name.replace("/", ".") + ".json")).exists()

    def training(self, without=()):
        """Returns the name of a run in the middle of its training, and its lease."""
        for name in self.rooms.names:
            if name not in without and not self.is_done(name) and 2 < self.steps(name):
                lease = self.holder(name)
                if lease:
                    return name, lease
        return None

    def attempts(self, name):
        return json.loads((self.path / "runs" / (name + ".json")).read_text())["attempts"]

    def summary(self):
        """Returns the results by name, without what differs from one attempt to another."""
        results = {}
        for line in (self.path / "summary.jsonl").read_text().splitlines():
            result = json.loads(line)
            name = "{scene}/{variant}/seed{seed}".format(**result)
            assert name not in results, "two results of " + name
            results[name] = result
        return results

    def gaussians(self, name):
        return (self.path / "runs" / name / "scene.ply").read_bytes()

    def check(self, interrupted, perhaps=()):
        """Fails unless each run ended once, with the bits of the batch alone.

        The runs of `interrupted` were stopped in the middle, those of `perhaps` at an unknown time. All others were not.
        """
        alone = Batch(self.rooms, "alone")
        expected, results = alone.summary(), self.summary()
        assert sorted(results) == sorted(expected) and len(results) == 12, sorted(results)
        for name, result in results.items():
            assert result["state"] == "done", result
            measures, others = accuracy(result), accuracy(expected[name])
            assert measures == others and "nvs.psnr" in measures, "{}: {} {}".format(name, measures, others)
            assert result["identity"] == expected[name]["identity"], name
            assert self.gaussians(name) == alone.gaussians(name), name + " has other Gaussians"
            commands = [l for l in (self.path / "runs" / (name + ".log")).read_text().splitlines() if l.startswith("$ ")]
            trained = [c for c in commands if " train " in c]
            assert len(trained) == self.attempts(name), commands
            if name in interrupted:
                assert len(trained) > 1 and "--resume" in trained[-1], "{} was not resumed: {}".format(name, commands)
            elif name not in perhaps:
                assert len(trained) == 1, "{} was trained again: {}".format(name, commands)
        assert not list((self.path / "leases").iterdir()), "a lease stays"


def running(pid, started=None):
    """Returns whether a process runs; a zombie does not."""
    try:
        fields = pathlib.Path("/proc/{}/stat".format(pid)).read_text().rsplit(")", 1)[1].split()
    except OSError:
        return False
    return fields[0] != "Z" and (started is None or int(fields[19]) == started)


def children(pid):
    """Returns the process ids of the children of a process."""
    found = []
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def parent(pid):
    return int(pathlib.Path("/proc/{}/stat".format(pid)).read_text().rsplit(")", 1)[1].split()[1])

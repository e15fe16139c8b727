"""Trains twelve runs on a Ray cluster of five nodes. A worker is killed, a node is killed, and a node hangs."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest

import rooms
from rooms import ROOT, SGS, Batch, Rooms, children, parent, running, until

from ray.cluster_utils import Cluster

sys.path.insert(0, str(ROOT / "tools" / "python"))
from sgs.ray import gpu_share


def command(batch, address, *more):
    words = [sys.executable, "-m", "sgs.ray", str(batch.rooms.manifest), "-o", str(batch.path)]
    return words + ["--address", address, "--sgs", str(SGS), *more]


ENVIRONMENT = dict(os.environ, PYTHONPATH=str(ROOT / "tools" / "python"))


class RayTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.rooms = Rooms(os.environ["ROOMS"])
        # The head takes no tasks, so that the death of a node does not end the cluster.
        head = {"num_cpus": 0, "include_dashboard": False}
        cls.cluster = Cluster(initialize_head=True, head_node_args=head)
        cls.nodes = [cls.cluster.add_node(num_cpus=1) for _ in range(4)]
        cls.cluster.wait_for_nodes()

    @classmethod
    def tearDownClass(cls):
        cls.cluster.shutdown()

    def remove(self, raylet):
        """Kills a node of the cluster."""
        node = next(n for n in self.nodes if n.all_processes["raylet"][0].process.pid == raylet)
        self.nodes.remove(node)
        self.cluster.remove_node(node, allow_graceful=False)

    @staticmethod
    def lease(batch, name):
        return None if batch.is_done(name) else batch.holder(name)

    def run_to_end(self, batch, *more):
        words = command(batch, self.cluster.address, *more)
        return subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True, cwd="/")

    def test_1_every_run_ends_once_though_a_worker_and_a_node_die(self):
        batch = Batch(self.rooms, "ray")
        log = batch.rooms.folder / "ray.log"
        with open(log, "w") as file:
            words = command(batch, self.cluster.address)
            driver = subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=file, text=True, cwd="/")
        self.addCleanup(driver.kill)

        def training(without=()):
            self.assertIsNone(driver.poll(), log.read_text())
            return batch.training(without)

        # A worker dies. Its program stops, which frees the run; Ray starts the task again.
        first, lease = until("a training", training)
        program, worker = lease["pid"], parent(lease["pid"])
        trainings = children(program)
        os.kill(worker, signal.SIGKILL)
        until("the end of the dead worker's programs", lambda: not any(map(running, [program, *trainings])), seconds=15)

        # A node dies with all its programs, as after a power cut.
        second, lease = until("another training", lambda: training([first]))
        program, raylet = lease["pid"], parent(parent(lease["pid"]))
        for process in [*children(program), program]:
            os.kill(process, signal.SIGKILL)
        self.remove(raylet)

        # A node hangs: its program renews no lease, and the training stops without heartbeats. Then Ray loses the node.
        third, lease = until("another training", lambda: training([first, second]))
        program, worker = lease["pid"], parent(lease["pid"])
        raylet, trainings = parent(worker), children(program)
        os.kill(program, signal.SIGSTOP)
        hung = time.monotonic()
        os.kill(worker, signal.SIGKILL)
        self.remove(raylet)
        until("the takeover", lambda: (self.lease(batch, third) or lease)["token"] != lease["token"], interval=0.01)
        self.assertGreater(time.monotonic() - hung, 14, "the run was taken over before its lease expired")
        self.assertFalse(any(map(running, trainings)), "a training without heartbeats outlives its lease")
        # The program of the hung node goes on, and finds that it has lost the run.
        os.kill(program, signal.SIGCONT)
        until("the end of the hung node's program", lambda: not running(program), seconds=60)

        output, _ = driver.communicate(timeout=120)
        self.assertEqual(driver.returncode, 0, log.read_text())
        answer = json.loads(output)
        self.assertEqual((answer["runs"], answer["done"], answer["skipped"]), (12, 12, 0))
        lines = [line for line in log.read_text().splitlines() if line.startswith("done ")]
        self.assertEqual(sorted(line.split()[4] for line in lines), sorted(self.rooms.names))
        batch.check([first, second, third])

    def test_2_the_same_command_again_changes_nothing(self):
        batch = Batch(self.rooms, "ray")
        before = {path: path.stat().st_mtime_ns for path in batch.path.rglob("*") if path.is_file()}
        ended = self.run_to_end(batch)
        self.assertEqual(ended.returncode, 0, ended.stderr)
        self.assertEqual(json.loads(ended.stdout)["skipped"], 12)
        self.assertEqual({path: path.stat().st_mtime_ns for path in batch.path.rglob("*") if path.is_file()}, before)

    def test_3_stopped_command_stops_its_programs(self):
        batch = Batch(self.rooms, "ray-stopped")
        driver = subprocess.Popen(
            command(batch, self.cluster.address), env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd="/"
        )
        _, lease = until("a training", batch.training)
        programs = [lease["pid"], *children(lease["pid"])]
        driver.send_signal(signal.SIGTERM)
        _, messages = driver.communicate(timeout=60)
        self.assertEqual(driver.returncode, 75, messages)
        self.assertIn("stopped; the same command goes on", messages)
        until("the end of the programs", lambda: not any(map(running, programs)), seconds=20)

    def test_4_wrong_input_is_refused(self):
        batch = Batch(self.rooms, "ray-refused")
        for words, status, sentence in [
            (["--sgs", "/nowhere/sgs"], 2, "there is no program"),
            (["--cpus-per-run", "-1"], 2, "number of at least 0"),
            (["--retries", "x"], 2, "whole number"),
            (["--gpus-per-run", "half"], 2, "number of at least 0, or auto"),
            (["--gpus-per-run", "auto"], 2, "this machine has no GPU"),
        ]:
            ended = self.run_to_end(batch, *words)
            self.assertEqual(ended.returncode, status, ended.stderr)
            self.assertIn(sentence, ended.stderr)
            self.assertNotIn("Traceback", ended.stderr)
        self.assertFalse(batch.path.exists())

    def test_5_failures_have_the_exit_statuses_of_their_runs(self):
        # A scene with a damaged image fails for good and is not tried again.
        folder = tempfile.mkdtemp(dir=self.rooms.folder)
        rooms.sgs("synth", os.path.join(folder, "scenes", "broken"), "--scene", "box", "--views", 8, "--size", "32x24")
        images = sorted(os.listdir(os.path.join(folder, "scenes", "broken", "images")))
        image = os.path.join(folder, "scenes", "broken", "images", images[0])
        os.truncate(image, os.path.getsize(image) // 2)
        broken = Rooms(folder)
        broken.manifest.write_text(rooms.MANIFEST)
        batch = Batch(broken, "out")
        ended = self.run_to_end(batch)
        self.assertEqual(ended.returncode, 1, ended.stderr)
        self.assertIn("4 of 4 runs failed", ended.stderr)
        self.assertNotIn("again:", ended.stderr)
        self.assertEqual([result["attempts"] for result in batch.summary().values()], [1] * 4)

    def test_6_runs_share_a_gpu_by_their_plans(self):
        """The node has no GPU: Ray counts what it is told."""
        shares = [gpu_share(peak, 1000) for peak in (None, 450, 451, 2000)]
        self.assertEqual(shares, [1, 0.5, 1, 1])
        os.environ["RAY_EXPERIMENTAL_NOSET_CUDA_VISIBLE_DEVICES"] = "1"
        self.addCleanup(os.environ.pop, "RAY_EXPERIMENTAL_NOSET_CUDA_VISIBLE_DEVICES")
        self.nodes.append(self.cluster.add_node(num_cpus=2, num_gpus=1))
        self.cluster.wait_for_nodes()
        two = Rooms(self.rooms.folder)
        two.manifest = self.rooms.folder / "two.toml"
        two.manifest.write_text(rooms.MANIFEST.replace("scenes/*", "scenes/hall").split('[[variants]]\nname = "paper"')[0])
        for memory, sharing in [("2", 2), ("0.002", 0)]:
            batch = Batch(two, "ray-gpu-" + memory)
            words = command(batch, self.cluster.address, "--gpus-per-run", "auto", "--gpu-memory", memory)
            log = self.rooms.folder / "gpu.log"
            with open(log, "w") as file:
                driver = subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=file, cwd="/")
            most = 0
            while driver.poll() is None:
                most = max(most, sum(batch.holder(name) is not None for name in two.names))
                time.sleep(0.01)
            self.assertEqual(driver.returncode, 0, log.read_text())
            self.assertIn("{} of 2 runs share a GPU".format(sharing), log.read_text())
            self.assertEqual(most, 2 if sharing else 1)


if __name__ == "__main__":
    unittest.main(verbosity=2)

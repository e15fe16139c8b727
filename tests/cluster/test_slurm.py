"""Trains twelve runs as a job array of Slurm. Tasks are requeued, stopped, preempted and canceled in the middle."""

import os
import pathlib
import shutil
import socket
import subprocess
import tempfile
import unittest

import rooms
from rooms import Batch, Rooms, running, until

CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser={user}
AuthType=auth/munge
# A requeued task starts after the credentials of its first start have expired.
AuthInfo=socket={folder}/munge.socket,cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SchedulerParameters=batch_sched_delay=0,sched_min_interval=100000,sched_interval=1,bf_interval=1
ReturnToService=2
NodeName=node1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=2 State=UNKNOWN
PartitionName=usual Nodes=ALL Default=YES PriorityTier=1
PartitionName=urgent Nodes=ALL PriorityTier=10
"""


def free_ports(count):
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


class Slurm:
    """Slurm of one node on this machine, in a folder of its own."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self.processes = []
        for name in ["state", "spool", "out"]:
            (self.folder / name).mkdir()
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o400)
        configuration = self.folder / "slurm.conf"
        host = socket.gethostname().split(".")[0]
        values = {"host": host, "user": "root", "folder": self.folder, "ports": free_ports(2)}
        configuration.write_text(CONFIGURATION.format(**values))
        self.environment = dict(os.environ, SLURM_CONF=str(configuration))

    def start(self):
        at = ["--{}={}".format(n, self.folder / f) for n, f in [
            ("key-file", "munge.key"), ("socket", "munge.socket"), ("pid-file", "munged.pid"), ("log-file", "munged.log"),
            ("seed-file", "munged.seed"),
        ]]
        self.daemon("munged", "--foreground", "--force", *at)
        until("a socket of munge", (self.folder / "munge.socket").exists)
        self.daemon("slurmctld", "-D")
        until("slurmctld", lambda: self.succeeds("scontrol", "ping"))
        self.daemon("slurmd", "-D", "-N", "node1")
        until("an idle node", lambda: "idle" in self.ask("sinfo", "-h", "-o", "%T"))

    def daemon(self, *words):
        program = shutil.which(words[0], path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
        with open(self.folder / (words[0] + ".out"), "w") as log:
            self.processes.append(
                subprocess.Popen([program, *words[1:]], env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
            )

    def stop(self):
        for process in reversed(self.processes):
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def succeeds(self, *words):
        return subprocess.run(words, env=self.environment, capture_output=True).returncode == 0

    def ask(self, *words):
        ended = subprocess.run(words, env=self.environment, capture_output=True, text=True)
        assert ended.returncode == 0, "{}: {}{}".format(" ".join(words), ended.stdout, ended.stderr)
        return ended.stdout.strip()

    def submit(self, script, *more):
        output = str(self.folder / "out" / "%a.log")
        return self.ask("sbatch", "--parsable", "--output=" + output, *more, str(script)).split(";")[0]

    def tasks(self, job):
        """Returns the state of each task by index; that of a job without tasks by -1."""
        rows = subprocess.run(
            ["squeue", "-h", "-r", "-t", "all", "-j", job, "-o", "%K %T"], env=self.environment, capture_output=True, text=True
        ).stdout
        words = [row.split() for row in rows.splitlines()]
        return {int(index) if index.isdigit() else -1: state for index, state in words}


class SlurmTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.rooms = Rooms(os.environ["ROOMS"])
        cls.slurm = Slurm(tempfile.mkdtemp(dir=cls.rooms.folder))
        cls.addClassCleanup(cls.slurm.stop)
        cls.slurm.start()

    def wait(self, job, states=("COMPLETED",)):
        """Waits until all tasks have ended. Fails unless they ended in these states."""

        def tasks():
            found = self.slurm.tasks(job)
            return found if found and all(s not in ("PENDING", "RUNNING", "COMPLETING", "CONFIGURING") for s in found.values()) else None

        found = until("the end of job {}".format(job), tasks, seconds=150, interval=0.3)
        self.assertLessEqual(set(found.values()), set(states), self.logs())
        return found

    def logs(self):
        return "\n".join("{}:\n{}".format(p.name, p.read_text()) for p in sorted((self.slurm.folder / "out").iterdir()))

    def test_array_survives_requeues_signals_preemption_and_cancellation(self):
        batch, slurm = Batch(self.rooms, "slurm"), self.slurm
        script = slurm.folder / "rooms.sbatch"
        answer = rooms.sgs("batch", self.rooms.manifest, "-o", batch.path, "--slurm", script)
        self.assertEqual((answer["runs"], answer["tasks"]), (12, 12))
        self.assertFalse(batch.path.exists(), "the script alone makes no directory")
        order = self.rooms.names
        job = slurm.submit(script, "--time=10")
        interrupted = []

        def training():
            """Returns the next run in the middle of its training, its task and its program."""
            name, lease = until("a training", lambda: batch.training(interrupted), seconds=60)
            interrupted.append(name)
            return name, "{}_{}".format(job, order.index(name)), lease["pid"]

        # An operator requeues a task. Slurm sends SIGTERM to all its processes.
        name, task, program = training()
        slurm.ask("scontrol", "requeue", task)
        until("the end of the requeued program", lambda: not running(program), seconds=30)
        self.assertFalse(batch.is_done(name))

        # The signal before the time limit reaches the script alone. The task requeues itself.
        name, task, program = training()
        # scancel itself sends the signal again after 5 seconds while the task is requeued.
        scancel = subprocess.Popen(["scancel", "--signal=TERM", "--batch", task], env=slurm.environment, stderr=subprocess.DEVNULL)
        until("the end of the stopped program", lambda: not running(program), seconds=4)
        scancel.kill()
        scancel.wait()
        self.assertFalse(batch.is_done(name))

        # A canceled task stays canceled.
        name, task, program = training()
        slurm.ask("scancel", task)
        until("the end of the canceled program", lambda: not running(program), seconds=30)
        canceled = order.index(name)

        # A job of higher priority preempts the tasks that run. Some may have ended just before, others have just begun.
        until("a training", lambda: batch.training(interrupted), seconds=60)
        preempted = [n for n in order if n not in interrupted and batch.holder(n) and not batch.is_done(n)]
        urgent = slurm.ask(
            "sbatch", "--parsable", "--partition=urgent", "--cpus-per-task=2", "--output=/dev/null", "--wrap=sleep 1"
        )
        self.wait(urgent)

        tasks = self.wait(job, ["COMPLETED", "CANCELLED"])
        self.assertEqual([index for index, state in tasks.items() if state == "CANCELLED"], [canceled], self.logs())
        self.assertFalse(batch.is_done(order[canceled]))
        self.assertTrue(any(batch.attempts(name) > 1 for name in preempted), "no task was preempted")

        # The same script again trains what is missing. A job that depends on it writes the summary.
        job = slurm.submit(script, "--time=10", "--array={}".format(canceled))
        summary = "{} batch {} -o {} --summary".format(rooms.SGS, self.rooms.manifest, batch.path)
        last = slurm.ask("sbatch", "--parsable", "--dependency=afterany:" + job, "--output=/dev/null", "--wrap=" + summary)
        self.wait(job)
        self.wait(last)
        batch.check(interrupted, preempted)


if __name__ == "__main__":
    unittest.main(verbosity=2)

"""Trains the runs of a batch as tasks of a Ray cluster.

    python -m sgs.ray MANIFEST -o DIR [--address ADDR] [--sgs PATH] [--gpus-per-run F|auto] [--cpus-per-run F]

Each run is one task, which starts `sgs batch MANIFEST -o DIR --only NAME`. MANIFEST, its scenes and DIR are on a disk that
all nodes share. Ray repeats the tasks of lost nodes and workers; the runs go on from their checkpoints. A program whose
task was lost stops by itself: it reads heartbeats of the task from its standard input.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time

DONE, FAILED, USAGE, PERMANENT, AGAIN, INTERRUPTED = 0, 1, 2, 42, 75, 130

# Seconds between polls of Ray. Signals are handled between them.
POLL = 1.0


def train(command, interval=2.0):
    """Runs a command of `sgs` under this process. Returns its exit status, its answer and its last message.

    Ray runs this function in a process of its own, perhaps on another machine without this module. It therefore uses
    nothing of this module.
    """
    import json
    import os
    import socket
    import subprocess
    import tempfile
    import threading

    environment = dict(os.environ, SGS_SUPERVISED="1")
    answer = {"status": 75, "host": socket.gethostname(), "output": {}, "message": ""}
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as messages:
        try:
            program = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=output, stderr=messages, env=environment, start_new_session=True
            )
        except OSError as error:
            return dict(answer, status=1, message="{} cannot be started: {}".format(command[0], error.strerror))
        ended = threading.Event()

        def beat():
            # Without heartbeats the program writes a checkpoint and ends.
            while not ended.wait(interval):
                try:
                    program.stdin.write(b".")
                    program.stdin.flush()
                except (OSError, ValueError):
                    return

        thread = threading.Thread(target=beat, daemon=True)
        thread.start()
        try:
            status = program.wait()
        finally:
            # Also after a cancellation: the closed pipe stops the program.
            ended.set()
            thread.join()
            try:
                program.stdin.close()
            except OSError:
                pass
            program.wait()
        output.seek(0)
        messages.seek(0)
        try:
            answer["output"] = json.loads(output.read())
        except ValueError:
            pass
        lines = messages.read().decode(errors="replace").strip().splitlines()
    answer["message"] = lines[-1] if lines else ""
    # A program that a signal ended is tried again.
    answer["status"] = 75 if status < 0 or status == 143 else status
    return answer


def arguments(words):
    parser = argparse.ArgumentParser(
        prog="python -m sgs.ray",
        description="Trains the runs of a batch as tasks of a Ray cluster.",
        epilog="Exit statuses: 0 all runs are done, 1 a run failed, 2 wrong usage, 75 stopped or try again, 130 Ctrl-C.",
        allow_abbrev=False,
    )

    def number(least, whole=False):
        def parse(text):
            value = int(text) if whole else float(text)
            if not least <= value < float("inf"):
                raise ValueError
            return value

        parse.__name__ = "{} of at least {}".format("whole number" if whole else "number", least)
        return parse

    parser.add_argument("manifest", metavar="MANIFEST", help="manifest of the batch, on the shared disk")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="directory of the batch, on the shared disk")
    parser.add_argument("--address", metavar="ADDR", help="address of the cluster; otherwise Ray looks for one, or starts one here")
    parser.add_argument("--sgs", metavar="PATH", default="sgs", help="program, at this path on all nodes (default: sgs on the PATH)")
    def gpus(text):
        return text if text == "auto" else number(0)(text)

    gpus.__name__ = "number of at least 0, or auto"
    parser.add_argument(
        "--gpus-per-run",
        metavar="F|auto",
        type=gpus,
        help="GPUs of a run, also a fraction, so that runs share a GPU; auto: half of one for runs that leave half of its memory "
        "by their plans, otherwise 1 (default: 1 if the cluster has GPUs, otherwise 0)",
    )
    parser.add_argument(
        "--gpu-memory",
        metavar="GIB",
        type=number(0.001),
        help="memory of the cluster's smallest GPU for --gpus-per-run auto, in GiB (default: that of this machine's GPU)",
    )
    parser.add_argument("--cpus-per-run", metavar="F", type=number(0), default=1.0, help="processor cores of a run (default: 1)")
    parser.add_argument(
        "--retries",
        metavar="N",
        type=number(0, whole=True),
        default=5,
        help="how often a run is started again on another node, after its node was lost or its program ended with 75 (default: 5)",
    )
    parser.add_argument("--retry-failed", action="store_true", help="train failed runs again")
    return parser.parse_args(words)


class Refused(Exception):
    """Failure with a sentence and an exit status."""

    def __init__(self, status, sentence):
        super().__init__(sentence)
        self.status = status


def say(text):
    print(text, file=sys.stderr, flush=True)


class Stop:
    """Exit status of the first signal that stopped the command. The second one ends it at once."""

    def __init__(self):
        self.status = None

    def install(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self.handle)

    def handle(self, number, _frame):
        status = INTERRUPTED if number == signal.SIGINT else AGAIN
        if self.status is not None:
            os._exit(status)
        self.status = status

    def check(self):
        if self.status is not None:
            raise Refused(self.status, "stopped; the same command goes on from there")


def sgs(command):
    """Runs a short command of `sgs` on this machine. Returns its status, its answer and its message."""
    try:
        ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    except OSError as error:
        raise Refused(USAGE, "{} cannot be started: {}; name the program by --sgs".format(command[0], error.strerror))
    try:
        answer = json.loads(ended.stdout)
    except ValueError:
        answer = {}
    error = answer.get("error") if isinstance(answer, dict) else None
    sentence = error or ended.stderr.strip() or "{} ended with status {}".format(command[0], ended.returncode)
    return ended.returncode, answer, sentence


# Part of a device's memory that runs may fill together, and runs that share a device: those of `sgs batch`.
USABLE, SHARING = 0.9, 2


def gpu_share(peak, memory):
    """Returns the GPUs of a run. `peak`: predicted bytes, None if they are unknown. `memory`: bytes of a GPU."""
    return 1 / SHARING if peak is not None and peak * SHARING <= USABLE * memory else 1


def gpu_memory(program):
    """Returns the memory of this machine's default GPU in bytes."""
    status, devices, sentence = sgs([program, "devices", "--json", "-q"])
    if status != DONE:
        raise Refused(status, sentence)
    device = next((d for d in devices if "auto" in d), None)
    if device is None or device["kind"] == "cpu":
        raise Refused(USAGE, "this machine has no GPU; give --gpus-per-run auto the memory of the cluster's GPUs by --gpu-memory")
    return device["memory_bytes"]


class Cluster:
    """Runs of a batch on a Ray cluster."""

    def __init__(self, ray, options, program, stop, shares):
        self.ray, self.options, self.stop = ray, options, stop
        self.command = [program, "batch", os.path.abspath(options.manifest), "-o", os.path.abspath(options.output)]
        resources = ray.cluster_resources()
        self.gpus = options.gpus_per_run
        if self.gpus is None:
            self.gpus = 1 if resources.get("GPU", 0) > 0 else 0
        # Ray repeats tasks whose worker or node was lost.
        self.task = ray.remote(
            num_cpus=options.cpus_per_run, max_retries=options.retries, retry_exceptions=False
        )(train)
        # GPUs of each run, by its name.
        self.shares = shares
        self.retries = {}
        # Each pending task and the name of its run.
        self.pending = {}
        self.failed = []

    def submit(self, name):
        more = ["--retry-failed"] if self.options.retry_failed else []
        command = self.command + ["--only", name, "--json", "-q"] + more
        task = self.task.options(name="sgs " + name, num_gpus=self.shares.get(name, self.gpus))
        self.pending[task.remote(command)] = name

    def answer(self, task):
        try:
            return self.ray.get(task)
        except self.ray.exceptions.RayError as error:
            # Ray gave up: the node or the worker was lost too often, or the task cannot be placed.
            lines = str(error).strip().splitlines()
            return {"status": AGAIN, "host": "", "output": {}, "message": lines[0] if lines else type(error).__name__, "lost": True}

    def ended(self, task, total):
        name = self.pending.pop(task)
        answer = self.answer(task)
        status, error = answer["status"], answer["output"].get("error") or answer["message"]
        if status == AGAIN and not answer.get("lost") and self.retries.get(name, 0) < self.options.retries:
            self.retries[name] = self.retries.get(name, 0) + 1
            say("again: {}: {}".format(name, error))
            self.submit(name)
            return
        if status in (USAGE, INTERRUPTED):
            raise Refused(status, error)
        if status != DONE:
            self.failed.append((name, status, error))
        count, word = total - len(self.pending), "done" if status == DONE else "failed"
        text = "{} {} of {}: {}".format(word, count, total, name)
        say(text + (" on {}".format(answer["host"]) if status == DONE else ": {}".format(error)))

    def work(self, names):
        for name in names:
            self.submit(name)
        while self.pending:
            ready, _ = self.ray.wait(list(self.pending), timeout=POLL)
            self.stop.check()
            for task in ready:
                self.ended(task, len(names))


def run(options, stop):
    begun = time.monotonic()
    program = shutil.which(options.sgs)
    if program is None:
        raise Refused(USAGE, "there is no program \"{}\"; name it by --sgs".format(options.sgs))
    program = os.path.abspath(program)
    start = [program, "batch", options.manifest, "-o", options.output, "--json", "-q"]
    memory, shares = None, {}
    if options.gpus_per_run == "auto":
        memory = gpu_memory(program) if options.gpu_memory is None else options.gpu_memory * 2**30
    status, answer, sentence = sgs(start + ["--list"] + (["--plan"] if memory else []))
    if status != DONE:
        raise Refused(status, sentence)
    stop.check()
    # Most expensive first, as the list is. The program decides which failed runs are tried again.
    runs = answer["runs"]
    names = [run["name"] for run in runs if run["state"] != "done"]
    if memory:
        shares = {run["name"]: gpu_share(run.get("peak_bytes"), memory) for run in runs}
        sharing = sum(shares[name] < 1 for name in names)
        say("{} of {} runs share a GPU with another".format(sharing, len(names)))
    import ray

    if not hasattr(ray, "remote"):
        raise Refused(USAGE, "\"import ray\" finds {}, which is not Ray; start this as python -m sgs.ray".format(ray.__file__))
    if names:
        # Ray prints messages about nodes. Standard output holds the answer alone.
        output = os.dup(sys.stdout.fileno())
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        try:
            ray.init(address=options.address, log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise Refused(FAILED, "no connection to the Ray cluster: {}".format(" ".join(str(error).split())))
        # Ray replaces the handlers.
        stop.install()
        try:
            # By value: workers on other machines need not have this module.
            from ray import cloudpickle

            if __name__ != "__main__":
                cloudpickle.register_pickle_by_value(sys.modules[__name__])
            Cluster(ray, options, program, stop, shares).work(names)
        finally:
            # Ends the tasks of this command. Their programs then stop by themselves.
            ray.shutdown()
            os.dup2(output, sys.stdout.fileno())
            os.close(output)
    status, answer, sentence = sgs(start + ["--summary"])
    if status != DONE:
        raise Refused(status, sentence)
    skipped = len(runs) - len(names)
    seconds = time.monotonic() - begun
    print(json.dumps({"runs": len(runs), "done": len(names), "skipped": skipped, "seconds": seconds, "summary": answer["summary"]}))


def main(words=None):
    options = arguments(words)
    stop = Stop()
    stop.install()
    try:
        run(options, stop)
        return DONE
    except Refused as refused:
        say("sgs.ray: {}".format(refused))
        return refused.status


if __name__ == "__main__":
    sys.exit(main())

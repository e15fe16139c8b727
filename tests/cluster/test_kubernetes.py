"""Checks the Job of Kubernetes against the models of its API, and its rules against the exit statuses of sgs batch."""

import copy
import os
import subprocess
import tempfile
import typing
import unittest

import yaml
from kubernetes import client
from rooms import ROOT

JOB = ROOT / "tools" / "container" / "job.yaml"


def problems(value, model, path="job"):
    """Returns what is wrong with a value of a type of the API: unknown keys, missing keys, values of other types."""
    origin = typing.get_origin(model)
    if origin is typing.Union:
        return min((problems(value, m, path) for m in typing.get_args(model) if m is not type(None)), key=len)
    if origin is typing.Annotated:
        return problems(value, typing.get_args(model)[0], path)
    if origin is list:
        if not isinstance(value, list):
            return [path + " is no list"]
        return [p for i, v in enumerate(value) for p in problems(v, typing.get_args(model)[0], "{}[{}]".format(path, i))]
    if origin is dict:
        if not isinstance(value, dict):
            return [path + " is no map"]
        return [p for k, v in value.items() for p in problems(v, typing.get_args(model)[1], path + "." + k)]
    if hasattr(model, "model_fields"):
        if not isinstance(value, dict):
            return [path + " is no object"]
        fields = {f.serialization_alias or f.alias or name: f for name, f in model.model_fields.items()}
        found = ["{}.{} is unknown".format(path, key) for key in value if key not in fields]
        found += ["{}.{} is missing".format(path, k) for k, f in fields.items() if f.is_required() and k not in value]
        for key in value.keys() & fields.keys():
            found += problems(value[key], fields[key].annotation, path + "." + key)
        return found
    plain = {str: str, int: int, bool: bool, float: (int, float), object: object, typing.Any: object}
    if model not in plain:
        return ["{} has the unknown type {}".format(path, model)]
    right = isinstance(value, plain[model]) and (model is not int or not isinstance(value, bool))
    return [] if right else ["{} is no {}".format(path, model)]


class KubernetesTest(unittest.TestCase):
    def setUp(self):
        self.job = yaml.safe_load(JOB.read_text())

    def test_job_agrees_with_the_api(self):
        self.assertEqual((self.job["apiVersion"], self.job["kind"]), ("batch/v1", "Job"))
        self.assertEqual(problems(self.job, client.V1Job), [])

    def test_planted_errors_are_found(self):
        def with_error(change):
            job = copy.deepcopy(self.job)
            change(job["spec"])
            return problems(job, client.V1Job)

        rules = lambda spec: spec["podFailurePolicy"]["rules"]
        self.assertIn("backoffLimitPerIndx is unknown", str(with_error(lambda s: s.update(backoffLimitPerIndx=1))))
        self.assertIn("completions is no", str(with_error(lambda s: s.update(completions="12"))))
        self.assertIn("action is missing", str(with_error(lambda s: rules(s)[0].pop("action"))))
        self.assertIn("values[0] is no", str(with_error(lambda s: rules(s)[1]["onExitCodes"].update(values=["42"]))))
        container = lambda spec: spec["template"]["spec"]["containers"][0]
        self.assertIn("name is missing", str(with_error(lambda s: container(s).pop("name"))))
        self.assertIn("mountPath is missing", str(with_error(lambda s: container(s)["volumeMounts"][0].pop("mountPath"))))

    def test_each_index_trains_the_run_of_its_line(self):
        container = self.job["spec"]["template"]["spec"]["containers"][0]
        with tempfile.TemporaryDirectory() as folder:
            names, stand_in = os.path.join(folder, "names"), os.path.join(folder, "sgs")
            with open(names, "w") as file:
                file.write("kitchen/flat/seed0\na room/flat/seed1\n")
            with open(stand_in, "w") as file:
                file.write('#!/bin/sh\nprintf "%s|" "$@"\n')
            os.chmod(stand_in, 0o755)
            command = container["command"] + [word.replace("/batch/names", names) for word in container["args"]]
            for index, name in enumerate(["kitchen/flat/seed0", "a room/flat/seed1", ""]):
                environment = dict(os.environ, PATH=folder + ":" + os.environ["PATH"], JOB_COMPLETION_INDEX=str(index))
                output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
                self.assertEqual(output, "batch|/data/rooms.toml|-o|/data/out|--only|{}|".format(name))

    def test_rules_answer_the_exit_statuses(self):
        spec = self.job["spec"]
        # The API server demands these for the rules and for limits per index.
        self.assertEqual(spec["template"]["spec"]["restartPolicy"], "Never")
        self.assertEqual(spec["completionMode"], "Indexed")
        containers = [c["name"] for c in spec["template"]["spec"]["containers"]]

        def action(status):
            for rule in spec["podFailurePolicy"]["rules"]:
                codes = rule.get("onExitCodes")
                if codes and codes["operator"] == "In" and status in codes["values"]:
                    self.assertIn(codes["containerName"], containers)
                    return rule["action"]
            return None

        self.assertEqual([action(s) for s in [1, 2, 42]], ["FailIndex"] * 3)
        self.assertEqual([action(s) for s in [75, 137, 143]], ["Count"] * 3)
        first = spec["podFailurePolicy"]["rules"][0]
        self.assertEqual((first["action"], first["onPodConditions"][0]["type"]), ("Ignore", "DisruptionTarget"))


if __name__ == "__main__":
    unittest.main(verbosity=2)
